"""The engine in C: it is what its source says, and one with the reference in Python."""

from __future__ import annotations

import array
import os
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from shmgen import runtime
from shmgen.config import Config
from shmgen.core.model import TypeName
from shmgen.generator import pipeline
from shmgen.runtime import engine
from shmgen.runtime.messages.steps import CODES
from shmgen.runtime.region import header as h
from tests.conftest import REPOSITORY
from tests.support.build import classes, put
from tests.support.engines import in_python
from tests.support.region_of import region_of

from .messages import (
    LONG,
    WHY_NOT,
    Pose,
    PosePublisher,
    PoseSubscriber,
    Scan,
    ScanPublisher,
    ScanSubscriber,
    pose,
)

pytestmark = pytest.mark.skipif(not engine.IN_C, reason=WHY_NOT)

KINDS = ["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]
INNER = "".join(f"{kind} {kind}_one\n{kind}[3] {kind}_three\n{kind}[<=4] {kind}_some\n" for kind in KINDS)


def test_it_is_not_older_than_its_source() -> None:
    made = Path(sys.modules["shmgen._core"].__file__).stat().st_mtime
    sources = [*(REPOSITORY / "src/shmgen/runtime/extension").glob("*.[ch]"), *(REPOSITORY / "templates/c").glob("*.h")]
    assert made >= max(source.stat().st_mtime for source in sources), "pip install -e . makes it anew"


@pytest.mark.slow
def test_all_holds_without_it() -> None:
    """What exchanges, once more in a process that does not load it."""
    files = [f"tests/runtime/test_{name}.py" for name in ("exchange", "samples", "truncations")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files]
    pure = {**os.environ, "SHMGEN_PURE": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=pure, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]
    assert "skipped" not in done.stdout


def of_python(publishers, topic):
    with in_python():
        return publishers(f"{topic}/python")


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    """A message of all kinds of numbers, alone and in others, with its publisher and its subscriber."""
    folder = tmp_path_factory.mktemp("straight")
    texts = {"Inner": INNER, "Outer": "straight_msgs/Inner one\nint8 between\nstraight_msgs/Inner two\n"}
    put({f"straight_msgs/msg/{name}.msg": text for name, text in texts.items()}, folder / "definitions")
    config = Config(folder, path=(folder / "definitions",), package="shm_straight", targets=("python",))
    put(pipeline.generate(config, ["straight_msgs/Outer"]), folder)
    return classes(folder, "shm_straight", TypeName("straight_msgs", "msg", "Outer"))


def any_object(kind, value):
    """With the fields of a message, each number made by `value`."""

    def made(step):
        if step.length:
            return [value(CODES[step.kind]) for _ in range(step.length)]
        return value(CODES[step.kind]) if step.kind in CODES else any_object(step.kind, value)

    return SimpleNamespace(**{step.name: made(step) for step in kind._steps_})


def outcome(publisher, message):
    """The message in the region, or what was raised; and that the former sample is there in that case."""
    before = publisher.sequence
    try:
        publisher.publish(message)
    except Exception as error:
        assert publisher.sequence == before == region_of(publisher).words[h.COMPLETED0]
        return type(error), str(error)
    assert publisher.sequence == before + 1
    return newest(publisher)


def newest(publisher):
    """As text: nan is nan, and what lies behind a count is nothing."""
    region = region_of(publisher)
    lies = region.map[region.payload(region.find(publisher.sequence))]
    return repr(publisher.message_type.from_buffer_copy(lies))


def test_an_attribute_that_is_interrupted_or_closes_the_publisher(topic, kinds):
    """Attributes may be any code."""
    kind, publishers, _ = kinds
    publisher = publishers(topic)

    class Interrupt(BaseException):
        pass

    class Odd:
        def __init__(self, call):
            self.call = call

        def __getattr__(self, name):
            self.call()
            return getattr(message.one, name)

    def interrupt():
        raise Interrupt

    message = any_object(kind, lambda code: 0.0 if code in "fd" else False if code == "?" else 0)
    publisher.publish(message)
    message.two = Odd(interrupt)
    with pytest.raises(Interrupt):
        publisher.publish(message)
    message.two = Odd(publisher.close)
    with pytest.raises(runtime.Closed):
        publisher.publish(message)


def scan(number, data, ranges=None):
    return SimpleNamespace(id=number, ranges=ranges or [number + 0.5] * LONG, data=data, name="bow")


def test_long_arrays_lie_where_python_puts_them(topic):
    """Scratch around them too, and what an older and longer array has left behind a shorter one."""
    view = memoryview(bytes(2 * LONG))
    own = Scan(id=9, name="stern")
    long = [
        scan(1, bytes(LONG)),
        scan(2, bytearray(b"ab")),
        scan(3, b""),
        scan(4, [1, 2, 255]),
        scan(5, view[::2]),
        own,
    ]
    with ScanPublisher(topic) as quick, of_python(ScanPublisher, topic) as python, ScanSubscriber(topic) as reader:
        for message in long:
            assert outcome(quick, message) == outcome(python, message)
            assert reader.read() is not None
        # Too many, too long, a number that does not fit: as in Python.
        for message in (scan(6, bytes(LONG + 1)), scan(7, [256]), scan(2**32, b"a"), scan(8, b"", [0.0])):
            kind, said = outcome(quick, message)
            assert (kind, said) == outcome(python, message)
        healthy = region_of(quick).semaphore.value, region_of(quick).words[h.LOCK_HOLDER]
        assert healthy == (1, 0)


def test_nothing_of_it_stays_behind(topic, kinds):
    """What publish and read have held is free again: 50,000 samples would be more than 2 MiB."""
    kind, publishers, _ = kinds
    arrays = any_object(kind, lambda code: 0.5 if code in "fd" else code == "?" or 1)
    arrays.one.float64_three, arrays.one.uint8_some = array.array("d", [1, 2, 3]), b"abc"
    message = SimpleNamespace(position=SimpleNamespace(x=1.5, y=2.5, z=3.5), orientation=pose(0).orientation)
    scans = ScanPublisher(f"{topic}/scan")
    more = publishers(f"{topic}/arrays")
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber, scans, more:

        def exchange(times):
            for number in range(times):
                if number % 4 == 0:
                    more.publish(arrays)
                publisher.publish(message)
                subscriber.read()
                scans.publish(long)

        long = Scan()
        exchange(1000)
        held, before = (sys.getrefcount(message.position), sys.getrefcount(long)), pages()
        exchange(50_000)
        holds, after = (sys.getrefcount(message.position), sys.getrefcount(long)), pages()
    assert holds == held
    assert after - before < 512


def pages() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1])


def test_who_waits_may_be_closed_by_another_thread(topic):
    subscriber = PoseSubscriber(topic)
    threading.Timer(0.02, subscriber.close).start()
    with pytest.raises(runtime.Closed):
        subscriber.wait(30)


def test_a_waiting_reader_is_woken(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert subscriber.wait(0) is None
        region_of(subscriber).words[h.ARMED] = 1
        publisher.publish(pose(1))
        assert (region_of(subscriber).words[h.ARMED], region_of(subscriber).words[h.BELL]) == (0, 1)


def test_a_topic_that_another_took_over_meanwhile(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        for writer in (h.PLC, os.getpid()):  # at last another publisher of this process
            region_of(publisher).words[h.WRITER] = writer
            for message in (pose(2), SimpleNamespace(position=pose(2).position, orientation=pose(2).orientation)):
                with pytest.raises(runtime.ClaimLost):
                    publisher.publish(message)
        assert subscriber.read().position.x == 1.0
        assert region_of(publisher).semaphore.value == 1


def test_a_mode_without_the_lock(topic):
    class Lockless(Pose):
        _regions_ = runtime.RegionOptions(sync="sequence")

    class LocklessPublisher(runtime.Publisher):
        message_type = Lockless

    class LocklessSubscriber(runtime.Subscriber):
        message_type = Lockless

    with LocklessPublisher(f"{topic}/lockless") as publisher, LocklessSubscriber(f"{topic}/lockless") as subscriber:
        region_of(publisher).words[h.ARMED] = 1  # there is no event to post
        publisher.publish(pose(1))
        assert subscriber.wait(0).position.x == 1.0


def test_an_end_without_settings_is_refused():
    for kind in (engine.Reader, engine.Writer):
        for made in (kind, lambda kind=kind: kind.__new__(kind), lambda kind=kind: object.__new__(kind)):
            with pytest.raises(TypeError):
                made()


INTERPRETERS = """
import sys
try:
    import _interpreters as interpreters
except ImportError:
    import _xxsubinterpreters as interpreters
from shmgen import runtime
from tests.runtime.messages import PosePublisher

other = interpreters.create()
interpreters.run_string(other, "import sys; sys.path[:] = %r; import shmgen.runtime" % sys.path)
interpreters.destroy(other)
publisher = PosePublisher(sys.argv[1])
publisher.close()
try:
    publisher.heartbeat()
except runtime.Closed as error:
    print(error)
"""


def test_errors_keep_their_texts_after_a_subinterpreter_has_ended(topic):
    done = subprocess.run(
        [sys.executable, "-c", INTERPRETERS, topic], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    if "only supports" in done.stderr or "does not support loading in subinterpreters" in done.stderr:
        pytest.skip(done.stderr.splitlines()[-1])
    assert (done.stdout, done.stderr) == (f"{topic}: this publisher is closed\n", "")
