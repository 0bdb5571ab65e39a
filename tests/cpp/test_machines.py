"""C on other machines, under qemu; and what the sanitizers say of threads."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from shmgen.runtime import RegionOptions

from ..support import cpp_peer
from ..support.plc_demo import Demo

MACHINES = {
    "i386": ("i686-linux-gnu-gcc", "qemu-i386"),
    "armhf": ("arm-linux-gnueabihf-gcc", "qemu-arm"),
    "aarch64": ("aarch64-linux-gnu-gcc", "qemu-aarch64"),
}
LOCK_TIMEOUT, NEEDS_LOCK = 33, 8


def program(generated: Path, machine: str) -> list[str]:
    """A command that runs it."""
    compiler, emulator = MACHINES[machine]
    if not (shutil.which(compiler) and shutil.which(emulator)):
        pytest.skip(f"{compiler} or {emulator} is not installed")
    sources = cpp_peer.HERE / "machine.c", cpp_peer.HERE / "ends.c"
    return [emulator, str(cpp_peer.compiled(generated, machine, *sources, options=["-static"], compiler=compiler))]


@pytest.mark.parametrize("machine", MACHINES)
def test_it_writes_and_reads(machine: str, generated: Path, topic: str) -> None:
    """And goes on without the lock only where the machine keeps the order of loads and stores."""
    done = subprocess.run([*program(generated, machine), "self", topic], capture_output=True, text=True, check=False)
    wanted = 0 if machine == "i386" else LOCK_TIMEOUT
    assert done.stdout == f"100 samples; with the lock held: {wanted}\n", done.stdout + done.stderr


def test_aarch64_with_python(generated: Path, demo: Demo, topic: str) -> None:
    """One lock and one event: sem_t has one shape on both."""
    command = [*program(generated, "aarch64"), "echo", topic, "50"]
    echoed(command, demo.python.DemoPublisher, demo.python.DemoSubscriber, demo, topic)


def test_i386_with_python_without_a_lock(
    generated: Path, demo: Demo, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo.python.Demo, "_regions_", RegionOptions(sync="sequence"))
    command = [*program(generated, "i386"), "sequence", topic, "50"]
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


@pytest.mark.parametrize("machine", ["armhf", "aarch64"])
def test_a_machine_without_order_needs_the_lock(machine: str, generated: Path, topic: str) -> None:
    done = subprocess.run(
        [*program(generated, machine), "sequence", topic, "1"], capture_output=True, text=True, check=False
    )
    assert done.stdout.startswith(f"subscriber: {NEEDS_LOCK} "), done.stdout


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
