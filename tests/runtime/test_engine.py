"""The engine in C is newer than its source and behaves like the reference in Python."""

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


def test_extension_is_newer_than_its_source() -> None:
    built_at = Path(sys.modules["shmgen._core"].__file__).stat().st_mtime
    sources = [*(REPOSITORY / "src/shmgen/runtime/extension").glob("*.[ch]"), *(REPOSITORY / "templates/c").glob("*.h")]
    assert built_at >= max(source.stat().st_mtime for source in sources), "rebuild it: pip install -e ."


@pytest.mark.slow
def test_exchange_tests_pass_without_the_extension() -> None:
    """Run the tests of the exchange again in a process that does not load the extension."""
    files = [f"tests/runtime/test_{name}.py" for name in ("exchange", "samples", "truncations")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files]
    environment = {**os.environ, "SHMGEN_PURE": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]
    assert "skipped" not in done.stdout


def open_in_python(publishers, topic):
    with in_python():
        return publishers(f"{topic}/python")


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    """A message with all types of numbers, also nested, with its publisher and its subscriber."""
    folder = tmp_path_factory.mktemp("straight")
    texts = {"Inner": INNER, "Outer": "straight_msgs/Inner one\nint8 between\nstraight_msgs/Inner two\n"}
    put({f"straight_msgs/msg/{name}.msg": text for name, text in texts.items()}, folder / "definitions")
    config = Config(folder, path=(folder / "definitions",), package="shm_straight", targets=("python",))
    put(pipeline.generate(config, ["straight_msgs/Outer"]), folder)
    return classes(folder, "shm_straight", TypeName("straight_msgs", "msg", "Outer"))


def build_object(kind, value):
    """Return an object with the fields of a message class, each number from `value`."""

    def make_value(step):
        if step.length:
            return [value(CODES[step.kind]) for _ in range(step.length)]
        return value(CODES[step.kind]) if step.kind in CODES else build_object(step.kind, value)

    return SimpleNamespace(**{step.name: make_value(step) for step in kind._steps_})


def outcome(publisher, message):
    """Return the message in the region or the error. After an error, the former sample must remain the newest."""
    before = publisher.sequence
    try:
        publisher.publish(message)
    except Exception as error:
        assert publisher.sequence == before == region_of(publisher).words[h.COMPLETED0]
        return type(error), str(error)
    assert publisher.sequence == before + 1
    return read_newest(publisher)


def read_newest(publisher):
    """Return the newest sample as text: nan equals nan, and elements past a count do not appear."""
    region = region_of(publisher)
    payload = region.map[region.payload(region.find(publisher.sequence))]
    return repr(publisher.message_type.from_buffer_copy(payload))


def test_attribute_may_raise_or_close_the_publisher(topic, kinds):
    kind, publishers, _ = kinds
    publisher = publishers(topic)

    class Interrupt(BaseException):
        pass

    class Hook:
        def __init__(self, call):
            self.call = call

        def __getattr__(self, name):
            self.call()
            return getattr(message.one, name)

    def interrupt():
        raise Interrupt

    message = build_object(kind, lambda code: 0.0 if code in "fd" else False if code == "?" else 0)
    publisher.publish(message)
    message.two = Hook(interrupt)
    with pytest.raises(Interrupt):
        publisher.publish(message)
    message.two = Hook(publisher.close)
    with pytest.raises(runtime.Closed):
        publisher.publish(message)


def scan(number, data, ranges=None):
    return SimpleNamespace(id=number, ranges=ranges or [number + 0.5] * LONG, data=data, name="bow")


def test_long_arrays_equal_those_of_the_reference(topic):
    """Compare also the fields around the arrays, and short arrays after a longer array."""
    view = memoryview(bytes(2 * LONG))
    own = Scan(id=9, name="stern")
    messages = [
        scan(1, bytes(LONG)),
        scan(2, bytearray(b"ab")),
        scan(3, b""),
        scan(4, [1, 2, 255]),
        scan(5, view[::2]),
        own,
    ]
    with ScanPublisher(topic) as in_c, open_in_python(ScanPublisher, topic) as python, ScanSubscriber(topic) as reader:
        for message in messages:
            assert outcome(in_c, message) == outcome(python, message)
            assert reader.read() is not None
        # Numbers out of range and wrong numbers of elements raise the errors of the reference.
        for message in (scan(6, bytes(LONG + 1)), scan(7, [256]), scan(2**32, b"a"), scan(8, b"", [0.0])):
            kind, text = outcome(in_c, message)
            assert (kind, text) == outcome(python, message)
        lock = region_of(in_c).semaphore.value, region_of(in_c).words[h.LOCK_HOLDER]
        assert lock == (1, 0)


def test_publish_and_read_leak_no_memory(topic, kinds):
    """Release all memory and references: 50,000 leaked samples would need more than 2 MiB."""
    kind, publishers, _ = kinds
    arrays = build_object(kind, lambda code: 0.5 if code in "fd" else code == "?" or 1)
    arrays.one.float64_three, arrays.one.uint8_some = array.array("d", [1, 2, 3]), b"abc"
    message = SimpleNamespace(position=SimpleNamespace(x=1.5, y=2.5, z=3.5), orientation=pose(0).orientation)
    scans = ScanPublisher(f"{topic}/scan")
    array_publisher = publishers(f"{topic}/arrays")
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber, scans, array_publisher:

        def exchange(times):
            for number in range(times):
                if number % 4 == 0:
                    array_publisher.publish(arrays)
                publisher.publish(message)
                subscriber.read()
                scans.publish(long_scan)

        long_scan = Scan()
        exchange(1000)
        references_before, pages_before = (sys.getrefcount(message.position), sys.getrefcount(long_scan)), count_pages()
        exchange(50_000)
        references_after, pages_after = (sys.getrefcount(message.position), sys.getrefcount(long_scan)), count_pages()
    assert references_after == references_before
    assert pages_after - pages_before < 512


def count_pages() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1])


def test_waiting_subscriber_may_be_closed_by_another_thread(topic):
    subscriber = PoseSubscriber(topic)
    threading.Timer(0.02, subscriber.close).start()
    with pytest.raises(runtime.Closed):
        subscriber.wait(30)


def test_publish_wakes_a_waiting_reader(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert subscriber.wait(0) is None
        region_of(subscriber).words[h.ARMED] = 1
        publisher.publish(pose(1))
        assert (region_of(subscriber).words[h.ARMED], region_of(subscriber).words[h.BELL]) == (0, 1)


def test_publish_fails_after_another_writer_took_over(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        for writer in (h.PLC, os.getpid()):  # the second is another publisher of this process
            region_of(publisher).words[h.WRITER] = writer
            for message in (pose(2), SimpleNamespace(position=pose(2).position, orientation=pose(2).orientation)):
                with pytest.raises(runtime.ClaimLost):
                    publisher.publish(message)
        assert subscriber.read().position.x == 1.0
        assert region_of(publisher).semaphore.value == 1


def test_publish_and_wait_work_without_the_lock(topic):
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


def test_endpoint_without_settings_is_refused():
    for kind in (engine.Reader, engine.Writer):
        for create in (kind, lambda kind=kind: kind.__new__(kind), lambda kind=kind: object.__new__(kind)):
            with pytest.raises(TypeError):
                create()


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


def test_errors_keep_their_texts_after_a_subinterpreter_ended(topic):
    done = subprocess.run(
        [sys.executable, "-c", INTERPRETERS, topic], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    if "only supports" in done.stderr or "does not support loading in subinterpreters" in done.stderr:
        pytest.skip(done.stderr.splitlines()[-1])
    assert (done.stdout, done.stderr) == (f"{topic}: this publisher is closed\n", "")
