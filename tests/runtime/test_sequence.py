"""Regions with `sync = "sequence"` need no semaphore, so peers with incompatible semaphores can use them.

A 32-bit program, the soft PLC and Python write and read at the same time. No torn sample is accepted.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from shmgen.config import Config
from shmgen.core.model import Regions, TypeName
from shmgen.generator import pipeline
from shmgen.runtime import region_name
from shmgen.runtime.reference import memory_order, opening
from shmgen.runtime.region import header as h
from tests.softplc import Plc, compile_st
from tests.support.engines import use_python
from tests.support.region_of import region_of

from ..support.build import classes, put
from ..support.command import run
from ..support.machine import slower

SIZE = 2048
"""The number of 32-bit words in a message. A copy takes long enough that it is often interrupted halfway."""
SECONDS = 1.0
NAME = TypeName("sequence_msgs", "msg", "Block")
PEER = r"""
/* Reads or writes one region (docs/protocol.md) until its input ends. Prints the numbers of samples and torn words. */
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include "shm_sequence/sequence_msgs/msg/block.h"
#define ORDERED() __sync_synchronize() /* on x86 too: `rep movsl` of a copy passes earlier stores there */

typedef shm_sequence_msgs_Block message;
static message own;

int main(int count, char **given) {
    int file = open(given[2], O_RDWR);
    struct stat status;
    fstat(file, &status);
    unsigned char *memory = mmap(0, (size_t)status.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    volatile shmgen_region *region = (void *)memory;
    struct pollfd input = {0, POLLIN, 0};
    uint32_t done = 0, torn = 0, refused = 0, last = 0;
    printf("%d bits\n", (int)sizeof(void *) * 8);
    fflush(stdout);
    while (poll(&input, 1, 0) == 0) {
        uint32_t number = region->completed0 + (given[1][0] == 'w');
        unsigned char *place = memory + region->header_size + number % region->slots * region->slot_size;
        volatile shmgen_slot *slot = (void *)place;
        if (given[1][0] == 'w') {
            for (int word = 0; word < WORDS; word++) own.data[word] = number;
            slot->number = 0;
            ORDERED();
            slot->stamp_ns = 0;
            memcpy(place + sizeof *slot, &own, sizeof own);
            ORDERED();
            slot->number = number;
            region->completed0 = number;
            region->heartbeat++;
            done++;
        } else if (number != last && number != 0) {
            uint32_t found = slot->number;
            ORDERED();
            memcpy(&own, place + sizeof *slot, sizeof own);
            ORDERED();
            if (found != number || slot->number != number) {
                refused++;
                continue;
            }
            for (int word = 0; word < WORDS; word++) torn += own.data[word] != number;
            last = number;
            done++;
        }
    }
    printf("%u %u %u\n", (unsigned)done, (unsigned)torn, (unsigned)refused);
    return count == 0;
}
"""


class Generated(NamedTuple):
    """The generated files and classes with sync = "sequence", and the compiled PLC program."""

    folder: Path
    message: Any
    publisher: Any
    subscriber: Any
    plc: Plc


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Generated:
    folder = tmp_path_factory.mktemp("sequence")
    put({"sequence_msgs/msg/Block.msg": f"uint32[{SIZE}] data\n"}, folder / "definitions")
    config = Config(folder, path=(folder / "definitions",), package="shm_sequence", regions=Regions(sync="sequence"))
    texts = pipeline.generate(config, ["sequence_msgs/Block"])
    put(texts, folder)
    plc = compile_st({path: text for path, text in texts.items() if path.endswith(".st")}, folder / "plc")
    return Generated(folder, *classes(folder, "shm_sequence", NAME), plc)


@pytest.fixture(scope="module")
def peer(generated: Generated) -> list[str]:
    """The command of a 32-bit program, executed by the kernel or by qemu."""
    compiler = "gcc" if sys.maxsize < 2**32 else "i686-linux-gnu-gcc"
    if not shutil.which(compiler):
        pytest.skip(f"{compiler} is not installed")
    source, program = generated.folder / "peer.c", generated.folder / "peer"
    source.write_text(PEER)
    options = ["-std=gnu11", "-O2", "-Wall", "-Wno-address-of-packed-member", f"-DWORDS={SIZE}", "-static"]
    includes = ["-I", str(generated.folder / "c")]
    subprocess.run([compiler, *options, *includes, str(source), "-o", str(program)], check=True)
    for command in ([str(program)], ["qemu-i386", str(program)]):
        try:
            result = subprocess.run([*command, "r", "/dev/zero"], input="", capture_output=True, text=True)
        except OSError:
            continue
        if result.stdout.startswith("32 bits"):
            return command
    pytest.skip("this machine runs no 32-bit programs")


class Peer:
    """The running 32-bit program, until end() or the end of a `with`."""

    def __init__(self, command: list[str], job: str, topic: str) -> None:
        self.process = subprocess.Popen(
            [*command, job, f"/dev/shm/{region_name(topic)}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout
        assert self.process.stdout.readline() == "32 bits\n"

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        with self.process:
            self.process.kill()

    def end(self) -> tuple[int, int, int]:
        """End the program. Return its numbers of samples, torn words, and samples overwritten during the copy."""
        output, _ = self.process.communicate("end", timeout=20 * slower)
        done, torn, refused = map(int, output.split())
        return done, torn, refused


def until(seconds: float, enough: Callable[[], bool] = lambda: True) -> Iterator[int]:
    """Count for some seconds. If the machine is busy, continue up to 60 s until `enough` returns True."""
    start, number = time.monotonic(), 0
    while (lasted := time.monotonic() - start) < seconds or (lasted < 60 and not enough()):
        number += 1
        yield number


def fill(address: int, number: int) -> None:
    """Fill each word of the payload with the number of the sample."""
    ctypes.memmove(address, number.to_bytes(4, "little") * SIZE, 4 * SIZE)


def is_whole(message: Any) -> bool:
    return bytes(message) == int(message.data[0]).to_bytes(4, "little") * SIZE


def read_flood(peer: list[str], topic: str, write: Callable[[int], None]) -> int:
    """Return the number of samples that the 32-bit program reads from a flood. Repeat the flood on a busy machine."""
    samples = number = 0
    for _ in range(20):
        with Peer(peer, "r", topic) as reader:
            for _ in until(SECONDS / 2):
                number += 1
                write(number)
            done, torn, _ = reader.end()
        assert torn == 0
        samples += done
        if samples > 10:
            break
    return samples


@pytest.mark.slow
def test_32_bit_program_reads_samples_of_python(generated: Generated, peer: list[str], topic: str) -> None:
    message = generated.message()

    def write(number: int) -> None:
        fill(ctypes.addressof(message), number)
        publisher.publish(message)

    with generated.publisher(topic) as publisher:
        assert read_flood(peer, topic, write) > 10
        assert publisher.lock_misses == 0


def test_python_reads_samples_of_a_32_bit_program(generated: Generated, peer: list[str], topic: str) -> None:
    with generated.subscriber(topic) as subscriber, Peer(peer, "w", topic) as writer:
        read: list[int] = []
        for _ in until(SECONDS, lambda: len(read) > 10):
            if message := subscriber.read():
                assert is_whole(message)
                assert message.data[0] == subscriber.sequence
                read.append(subscriber.sequence)
        assert subscriber.wait(1.0)
        done, _, _ = writer.end()
        assert (len(read) > 10, done > len(read)) == (True, True), (len(read), done)


def test_32_bit_program_and_plc_exchange_samples(generated: Generated, peer: list[str], topic: str) -> None:
    block = generated.plc.block("FB_sequence_msgs_Block_Publisher")
    inputs = {"xEnable": True, "sTopic": topic}
    while not block(**inputs, xSend=False)._fbRegion.xReady:
        assert block.eErrorID == "NO_ERROR"
        time.sleep(0.01)

    def write(number: int) -> None:
        fill(block.Msg._address, number)
        assert block(xSend=True).xSent

    assert read_flood(peer, topic, write) > 10
    block(xEnable=False)

    block = generated.plc.block("FB_sequence_msgs_Block_Subscriber")
    read: list[int] = []
    with Peer(peer, "w", topic):
        for _ in until(SECONDS / 2, lambda: len(read) > 10):
            if block(**inputs).xNewData:
                message = generated.message.from_buffer_copy(block.Msg.bytes())
                assert is_whole(message)
                assert message.data[0] == block.udiSequence
                read.append(block.udiSequence)
    assert (len(read) > 10, block.udiLockMisses) == (True, 0), len(read)


def test_region_without_a_semaphore_counts_no_lock_misses(generated: Generated, topic: str) -> None:
    plc = generated.plc.block("FB_sequence_msgs_Block_Subscriber")
    with generated.publisher(topic) as publisher, generated.subscriber(topic) as subscriber:
        message = generated.message(data=[1] * SIZE)
        publisher.publish(message)
        assert plc(xEnable=True, sTopic=topic).xNewData
        assert subscriber.wait(1.0) == message
        assert subscriber.wait(0.01) is None
        assert (publisher.lock_misses, subscriber.lock_misses, plc.udiLockMisses) == (0, 0, 0)
    fence = f"sem.{region_name(topic)}-event"  # only the PLC uses it, as a memory barrier
    assert {file.name for file in Path("/dev/shm").glob(f"*{region_name(topic)}*")} == {region_name(topic), fence}
    (generated.folder / "shmgen.toml").write_text(
        f'path = ["definitions"]\n[regions]\nsync = "sequence"\n[[topics]]\ntopic = "{topic}"\ntype = "{NAME.short}"\n'
    )
    # A finding without a topic is about the machine, where another process may have left a semaphore behind.
    findings = json.loads(run(["doctor", topic, "--json"], generated.folder).stdout)["findings"]
    assert [finding for finding in findings if finding["topic"] and "is missing" in finding["message"]] == []
    assert "semaphore is missing" in run(["doctor", topic, "-I", "definitions"], generated.folder.parent).stdout


def test_plc_has_memory_barriers_at_four_places(generated: Generated, topic: str) -> None:
    """Read the region at each barrier, which is a post and a try of the event: two of the writer, two of the reader."""
    writing, reading = (generated.plc.block(f"FB_sequence_msgs_Block_{side}") for side in ("Publisher", "Subscriber"))
    inputs = {"xEnable": True, "sTopic": topic}
    for _ in until(0, lambda: writing._fbRegion.xReady and reading._fbRegion.xReady):
        writing(**inputs, xSend=False), reading(**inputs)
    fill(writing.Msg._address, 1)
    sample = writing.Msg.bytes()
    states: list[tuple[int, int, bool, bool]] = []

    def record_state() -> None:
        words, data = region_of(topic).words, Path(f"/dev/shm/{region_name(topic)}").read_bytes()
        number, completed = words[region_of(topic).number_at(1)], words[h.COMPLETED0]
        states.append((number, completed, sample in data, reading._Received.bytes() == sample))

    with generated.plc.at_each_post(record_state):
        assert writing(xSend=True).xSent
        assert reading(**inputs).xNewData
    assert states == [(0, 0, False, False), (0, 0, True, False), (1, 1, True, False), (1, 1, True, True)]


@pytest.mark.parametrize("machine", ["i686", "aarch64"])
def test_machine_with_barriers_is_accepted(
    generated: Generated, topic: str, machine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Accept i686, and aarch64 with full barriers around each access of the reference to the header."""
    monkeypatch.setattr(os, "uname", lambda: os.uname_result(("Linux", "", "", "", machine)))
    barriers: list[None] = []
    monkeypatch.setattr(memory_order, "fence", lambda: barriers.append(None))
    monkeypatch.setattr(opening, "has_barrier", lambda: True)
    use_python(monkeypatch)
    with generated.publisher(topic) as publisher, generated.subscriber(topic) as subscriber:
        publisher.publish(generated.message(data=[7] * SIZE))
        message = subscriber.wait(1.0)
        assert message
        assert is_whole(message)
        assert (publisher.lock_misses, subscriber.lock_misses) == (0, 0)
    assert bool(barriers) == (machine == "aarch64")


def test_machine_without_barriers_is_refused(generated: Generated, topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from shmgen.runtime import RegionUnusable

    monkeypatch.setattr(os, "uname", lambda: os.uname_result(("Linux", "", "", "", "sparc")))
    use_python(monkeypatch)
    monkeypatch.setattr(opening, "has_barrier", memory_order.has_barrier)
    with pytest.raises(RegionUnusable, match="needs full memory barriers on sparc, which this Python lacks"):
        generated.publisher(topic)
    assert not Path(f"/dev/shm/{region_name(topic)}").exists()
