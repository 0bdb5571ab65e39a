"""C on other machines, under qemu; and what the sanitizers say of threads."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from shmgen.runtime import RegionOptions, RegionUnusable, region_name

from ..support import cpp_peer
from ..support.plc_demo import Demo

MACHINES = {
    "i386": ("i686-linux-gnu-gcc", "qemu-i386"),
    "armhf": ("arm-linux-gnueabihf-gcc", "qemu-arm"),
    "aarch64": ("aarch64-linux-gnu-gcc", "qemu-aarch64"),
}
LOCK_TIMEOUT, BITNESS = 33, 34


def program(generated: Path, machine: str) -> list[str]:
    """A command that runs it."""
    compiler, emulator = MACHINES[machine]
    if not (shutil.which(compiler) and shutil.which(emulator)):
        pytest.skip(f"{compiler} or {emulator} is not installed")
    sources = cpp_peer.HERE / "machine.c", cpp_peer.HERE / "ends.c"
    return [emulator, str(cpp_peer.compiled(generated, machine, *sources, options=["-static"], compiler=compiler))]


@pytest.mark.slow
@pytest.mark.parametrize("machine", MACHINES)
def test_it_writes_and_reads(machine: str, generated: Path, topic: str) -> None:
    """Goes on without the lock where the machine keeps the order of loads and stores, elsewhere when it is healed."""
    done = subprocess.run([*program(generated, machine), "self", topic], capture_output=True, text=True, check=False)
    wanted = 0 if machine == "i386" else LOCK_TIMEOUT
    said = f"100 samples; with the lock held: {wanted}, by a dead process: 0 102\n"
    assert done.stdout == said, done.stdout + done.stderr


@pytest.mark.slow
def test_aarch64_with_python(generated: Path, demo: Demo, topic: str) -> None:
    """One lock and one event: sem_t has one shape on both."""
    command = [*program(generated, "aarch64"), "echo", topic, "50"]
    echoed(command, demo.python.DemoPublisher, demo.python.DemoSubscriber, demo, topic)


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.family("i386")
def test_with_python_without_a_lock(
    machine: str, generated: Path, demo: Demo, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where loads and stores pass each other both sides have barriers, so it is refused nowhere."""
    monkeypatch.setattr(demo.python.Demo, "_regions_", RegionOptions(sync="sequence"))
    command = [*program(generated, machine), "sequence", topic, "50"]
    echoed(command, demo.python.DemoPublisher, demo.python.DemoSubscriber, demo, topic)


def echoed(command: list[str], publisher_of: type, subscriber_of: type, demo: Demo, topic: str) -> None:
    with publisher_of(f"{topic}/in") as publisher, subscriber_of(topic) as subscriber:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout
        with process.stdout as stdout:
            assert stdout.readline() == "ready\n"
            for a in range(50):
                publisher.publish(demo.message(a))
                found = subscriber.wait(20)
                assert (found.a, found.b, list(found.tail)) == (a + 1, 2 * a, [a, -a])
            assert stdout.readline() == "0 missed\n"
        assert process.wait(10) == 0


def test_a_lock_of_other_bitness_is_told_at_the_opening(generated: Path, demo: Demo, topic: str) -> None:
    """Whoever comes second is told; neither could use what the other has made."""
    command = [*program(generated, "i386"), "self", topic]
    demo.python.DemoPublisher(topic, depth=4).close()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.startswith(f"publisher: {BITNESS} the semaphore is of a program of other bitness"), done.stdout
    for file in Path("/dev/shm").glob(f"*{region_name(topic)}*"):
        file.unlink()
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    with pytest.raises(RegionUnusable, match=r'a program of 32 bits, this is one of 64, .* sync = "sequence"'):
        demo.python.DemoSubscriber(topic, depth=4)


@pytest.mark.slow
def test_threads(generated: Path) -> None:
    options = ["-fsanitize=thread", "-Wno-tsan"]  # which knows no fences: with the lock none is needed
    threads = cpp_peer.compiled(generated, "threads", cpp_peer.HERE / "threads.cpp", options=options)

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "TSAN_OPTIONS": "halt_on_error=1 exitcode=66"}
        try:
            return subprocess.run([threads, *words], env=environment, capture_output=True, text=True, check=False)
        finally:
            for file in Path("/dev/shm").glob("*shmgen_test.threads*"):
                file.unlink()

    done = run()
    assert (done.returncode, done.stdout) == (0, "0 wrong; read and missed: 100000\n"), done.stderr[:3000]
    assert run("unlocked").returncode == 66, "it would find a race"
