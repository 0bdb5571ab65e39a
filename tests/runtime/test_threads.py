"""Two threads call one publisher or subscriber. No call unmaps the memory in which the other thread waits."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import pytest

from shmgen import runtime
from shmgen.runtime import engine
from shmgen.runtime.region import header as h

from ..conftest import REPOSITORY
from ..support import machine, sanitizers
from . import thread_matrix
from .messages import WHY_NOT, PosePublisher, pose

PROGRAM = """
    import threading
    import time

    import posix_ipc

    from shmgen import runtime
    from tests.runtime.messages import PosePublisher, pose
    from tests.support.region_of import region_of

    def publish():
        error = runtime.LockTimeout()
        while isinstance(error, runtime.LockTimeout):
            try:
                publisher.publish(pose(2))
            except runtime.ShmError as raised:
                error = raised
        print(type(error).__name__ + "\\n", end="")  # in one write: another thread prints too

    publisher = PosePublisher({topic!r}, lock_timeout=0.3, reopen=False)
    publisher.publish(pose(1))
    words = region_of({topic!r}).words
    lock = posix_ipc.Semaphore({semaphore!r})
    lock.acquire()
    waiting = threading.Thread(target=publish)
    waiting.start()
    time.sleep(0.1)
    words[{word}] = {value}
    try:
        publisher.heartbeat()
    except runtime.ShmError as error:
        print(type(error).__name__ + "\\n", end="")  # in one write: another thread prints too
    lock.release()
    waiting.join()
"""


@pytest.mark.usefixtures("each_engine")
@pytest.mark.parametrize(
    ("word", "value", "error"), [(h.RETIRED, 1, "RegionRetired"), (h.WRITER, 0xFFFFFFFF, "ClaimLost")]
)
def test_heartbeat_keeps_memory_mapped_for_a_waiting_thread(topic, word, value, error):
    semaphore = f"/{runtime.region_name(topic)}"
    program = PROGRAM.format(topic=topic, semaphore=semaphore, word=word, value=value)
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == [error, error]


@pytest.mark.timeout(60)
@pytest.mark.usefixtures("each_engine")
def test_busy_loop_does_not_starve_calls_of_another_thread(topic: str) -> None:
    stop = threading.Event()

    def loop() -> None:
        while not stop.is_set():
            publisher.publish(pose(1))

    with PosePublisher(topic) as publisher:
        thread = threading.Thread(target=loop, daemon=True)
        thread.start()
        for _ in range(20):
            publisher.heartbeat()
        stop.set()
        thread.join()


def run_matrix(*arguments: object, environment: dict[str, str]) -> None:
    """Test every n-th pair. The second argument is n."""
    done = subprocess.run(
        [sys.executable, "-m", thread_matrix.__name__, *map(str, arguments)],
        cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=900, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-4000:]
    assert int(done.stdout) == len([*thread_matrix.pairs()][:: arguments[1]]) > 150 // arguments[1]


@pytest.mark.sample("[10]")
@pytest.mark.timeout(900)
@pytest.mark.parametrize("step", [1, 10])
@pytest.mark.skipif(not engine.IN_C, reason=WHY_NOT)
def test_pairs_of_calls_pass_under_the_sanitizers(tmp_path: Path, topic: str, step: int) -> None:
    run_matrix(topic, step, tmp_path, environment=sanitizers.environment(tmp_path))


@pytest.mark.sample("[10]")
@pytest.mark.timeout(900)
@pytest.mark.parametrize("step", [1, 10])
@pytest.mark.skipif(machine.NAME in os.environ, reason="the name of the machine changes nothing between threads")
def test_pairs_of_calls_pass_in_the_reference(topic: str, step: int) -> None:
    run_matrix(topic, step, environment={"SHMGEN_PURE": "1"})


SLEEPER = """
    import threading
    import time
    from pathlib import Path

    from shmgen import runtime
    from tests.runtime.messages import PoseSubscriber

    def sleep():
        try:
            subscriber.wait(5.0)
        except runtime.Closed:
            pass

    def system_call():
        try:
            return Path(f"/proc/self/task/{{sleeper.native_id}}/syscall").read_text().split()[:2]
        except OSError:  # the thread ended
            return []

    still_asleep = 0
    for _ in range(20):
        with PoseSubscriber({topic!r}) as subscriber:
            sleeper = threading.Thread(target=sleep)
            sleeper.start()
            before = [""]
            while before != (before := system_call()) or before == ["running"]:
                time.sleep(0.003)
        still_asleep += system_call() == before
        sleeper.join()
    print(still_asleep)
"""


@pytest.mark.skipif(not engine.IN_C, reason="the reference sleeps outside of its region")
def test_close_waits_until_no_thread_sleeps_on_the_region(topic):
    """Wait before close() unmaps the memory, because a sleeping thread reads the memory when it wakes."""
    program = textwrap.dedent(SLEEPER.format(topic=topic))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "0\n", "")
