"""Tests of C on other CPUs, which qemu emulates, and of C++ threads with the thread sanitizer."""

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


def get_command(generated: Path, machine: str) -> list[str]:
    """Return a command that runs the test program on a machine."""
    compiler, emulator = MACHINES[machine]
    if not (shutil.which(compiler) and shutil.which(emulator)):
        pytest.skip(f"{compiler} or {emulator} is not installed")
    sources = cpp_peer.HERE / "machine.c", cpp_peer.HERE / "ends.c"
    return [emulator, str(cpp_peer.compiled(generated, machine, *sources, options=["-static"], compiler=compiler))]


@pytest.mark.slow
@pytest.mark.parametrize("machine", MACHINES)
def test_c_program_publishes_while_the_lock_is_held(machine: str, generated: Path, topic: str) -> None:
    """Publish without the lock on i386, which keeps the order of loads and stores. Other machines need the lock."""
    run = subprocess.run([*get_command(generated, machine), "self", topic], capture_output=True, text=True, check=False)
    status = 0 if machine == "i386" else LOCK_TIMEOUT
    expected = f"100 samples; with the lock held: {status}, by a dead process: 0 102\n"
    assert run.stdout == expected, run.stdout + run.stderr


@pytest.mark.slow
def test_aarch64_exchanges_samples_with_python(generated: Path, demo: Demo, topic: str) -> None:
    """Share a lock and an event: sem_t has the same layout on both machines."""
    command = [*get_command(generated, "aarch64"), "echo", topic, "50"]
    exchange_samples(command, demo.python.DemoPublisher, demo.python.DemoSubscriber, demo, topic)


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.slow
def test_machines_exchange_samples_with_python_without_a_lock(
    machine: str, generated: Path, demo: Demo, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Accept sequence regions on every machine: where a CPU reorders loads and stores, both sides use barriers."""
    monkeypatch.setattr(demo.python.Demo, "_regions_", RegionOptions(sync="sequence"))
    command = [*get_command(generated, machine), "sequence", topic, "50"]
    exchange_samples(command, demo.python.DemoPublisher, demo.python.DemoSubscriber, demo, topic)


def exchange_samples(command: list[str], publisher_of: type, subscriber_of: type, demo: Demo, topic: str) -> None:
    with publisher_of(f"{topic}/in") as publisher, subscriber_of(topic) as subscriber:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout
        with process.stdout as stdout:
            assert stdout.readline() == "ready\n"
            for a in range(50):
                publisher.publish(demo.message(a))
                sample = subscriber.wait(20)
                assert (sample.a, sample.b, list(sample.tail)) == (a + 1, 2 * a, [a, -a])
            assert stdout.readline() == "0 missed\n"
        assert process.wait(10) == 0


@pytest.mark.slow
def test_lock_of_another_bitness_is_refused_at_opening(generated: Path, demo: Demo, topic: str) -> None:
    """Refuse the second program: programs of 32 and 64 bits cannot share a lock."""
    command = [*get_command(generated, "i386"), "self", topic]
    demo.python.DemoPublisher(topic, depth=4).close()
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.stdout.startswith(f"publisher: {BITNESS} a program of another bitness created the semaphore"), run.stdout
    for file in Path("/dev/shm").glob(f"*{region_name(topic)}*"):
        file.unlink()
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    with pytest.raises(RegionUnusable, match=r'a 32-bit program, which this 64-bit .* sync = "sequence"'):
        demo.python.DemoSubscriber(topic, depth=4)


@pytest.mark.slow
def test_threads_share_a_region_without_data_races(generated: Path) -> None:
    options = ["-fsanitize=thread", "-Wno-tsan"]  # the sanitizer supports no fences; with the lock, none is needed
    threads = cpp_peer.compiled(generated, "threads", cpp_peer.HERE / "threads.cpp", options=options)

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "TSAN_OPTIONS": "halt_on_error=1 exitcode=66"}
        try:
            return subprocess.run([threads, *arguments], env=environment, capture_output=True, text=True, check=False)
        finally:
            for file in Path("/dev/shm").glob("*shmgen_test.threads*"):
                file.unlink()

    process = run()
    assert (process.returncode, process.stdout) == (0, "0 wrong; read and missed: 100000\n"), process.stderr[:3000]
    assert run("unlocked").returncode == 66, "no race reported without the lock"
