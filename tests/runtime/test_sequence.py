"""`sync = "sequence"`: regions without a semaphore, for sides whose semaphores do not fit each other.

A program of 32 bits, the soft PLC and Python write and read under each other's hands; nothing torn is accepted.
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
"""Words; as many bytes as a copy takes long enough to be met half-way."""
SECONDS = 1.0
NAME = TypeName("sequence_msgs", "msg", "Block")
PEER = r"""
/* Reads or writes one region by docs/protocol.md until its input ends; says how many samples, how many of them torn. */
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


class Made(NamedTuple):
    """Everything generated with sync = "sequence", the PLC's compiled."""

    folder: Path
    message: Any
    publisher: Any
    subscriber: Any
    plc: Plc


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("sequence")
    put({"sequence_msgs/msg/Block.msg": f"uint32[{SIZE}] data\n"}, folder / "definitions")
    config = Config(folder, path=(folder / "definitions",), package="shm_sequence", regions=Regions(sync="sequence"))
    texts = pipeline.generate(config, ["sequence_msgs/Block"])
    put(texts, folder)
    plc = compile_st({path: text for path, text in texts.items() if path.endswith(".st")}, folder / "plc")
    return Made(folder, *classes(folder, "shm_sequence", NAME), plc)


@pytest.fixture(scope="module")
def peer(made: Made) -> list[str]:
    """The command of a 32-bit program, run by the kernel or else by qemu."""
    compiler = "gcc" if sys.maxsize < 2**32 else "i686-linux-gnu-gcc"
    if not shutil.which(compiler):
        pytest.skip(f"{compiler} is not installed")
    source, program = made.folder / "peer.c", made.folder / "peer"
    source.write_text(PEER)
    options = ["-std=gnu11", "-O2", "-Wall", "-Wno-address-of-packed-member", f"-DWORDS={SIZE}", "-static"]
    includes = ["-I", str(made.folder / "c")]
    subprocess.run([compiler, *options, *includes, str(source), "-o", str(program)], check=True)
    for command in ([str(program)], ["qemu-i386", str(program)]):
        try:
            asked = subprocess.run([*command, "r", "/dev/zero"], input="", capture_output=True, text=True)
        except OSError:
            continue
        if asked.stdout.startswith("32 bits"):
            return command
    pytest.skip("this machine runs no 32-bit programs")


class Peer:
    """It at work, until `end` or the end of a `with`."""

    def __init__(self, command: list[str], way: str, topic: str) -> None:
        self.process = subprocess.Popen(
            [*command, way, f"/dev/shm/{region_name(topic)}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout
        assert self.process.stdout.readline() == "32 bits\n"

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        with self.process:
            self.process.kill()

    def end(self) -> tuple[int, int, int]:
        """Samples, words of another sample in them, samples overwritten while they were read."""
        said, _ = self.process.communicate("end", timeout=20 * slower)
        done, torn, refused = map(int, said.split())
        return done, torn, refused


def until(seconds: float, enough: Callable[[], bool] = lambda: True) -> Iterator[int]:
    """Longer where the machine has other things to do, until there is `enough`."""
    start, number = time.monotonic(), 0
    while (lasted := time.monotonic() - start) < seconds or (lasted < 60 and not enough()):
        number += 1
        yield number


def fill(address: int, number: int) -> None:
    """The payload of sample `number` is that number in every word."""
    ctypes.memmove(address, number.to_bytes(4, "little") * SIZE, 4 * SIZE)


def whole(message: Any) -> bool:
    return bytes(message) == int(message.data[0]).to_bytes(4, "little") * SIZE


def read_whole(peer: list[str], topic: str, write: Callable[[int], None]) -> int:
    """Samples that 32 bits got of a flood; of more floods where the machine has other things to do."""
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
def test_python_writes_and_32_bits_read(made: Made, peer: list[str], topic: str) -> None:
    message = made.message()

    def write(number: int) -> None:
        fill(ctypes.addressof(message), number)
        publisher.publish(message)

    with made.publisher(topic) as publisher:
        assert read_whole(peer, topic, write) > 10
        assert publisher.lock_misses == 0


def test_32_bits_write_and_python_reads(made: Made, peer: list[str], topic: str) -> None:
    with made.subscriber(topic) as subscriber, Peer(peer, "w", topic) as writer:
        read: list[int] = []
        for _ in until(SECONDS, lambda: len(read) > 10):
            if message := subscriber.read():
                assert whole(message)
                assert message.data[0] == subscriber.sequence
                read.append(subscriber.sequence)
        assert subscriber.wait(1.0)
        done, _, _ = writer.end()
        assert (len(read) > 10, done > len(read)) == (True, True), (len(read), done)


def test_32_bits_and_the_plc(made: Made, peer: list[str], topic: str) -> None:
    block = made.plc.block("FB_sequence_msgs_Block_Publisher")
    inputs = {"xEnable": True, "sTopic": topic}
    while not block(**inputs, xSend=False)._fbRegion.xReady:
        assert block.eErrorID == "NO_ERROR"
        time.sleep(0.01)

    def write(number: int) -> None:
        fill(block.Msg._address, number)
        assert block(xSend=True).xSent

    assert read_whole(peer, topic, write) > 10
    block(xEnable=False)

    block = made.plc.block("FB_sequence_msgs_Block_Subscriber")
    read: list[int] = []
    with Peer(peer, "w", topic):
        for _ in until(SECONDS / 2, lambda: len(read) > 10):
            if block(**inputs).xNewData:
                message = made.message.from_buffer_copy(block.Msg.bytes())
                assert whole(message)
                assert message.data[0] == block.udiSequence
                read.append(block.udiSequence)
    assert (len(read) > 10, block.udiLockMisses) == (True, 0), len(read)


def test_there_is_no_semaphore_and_nobody_misses_one(made: Made, topic: str) -> None:
    plc = made.plc.block("FB_sequence_msgs_Block_Subscriber")
    with made.publisher(topic) as publisher, made.subscriber(topic) as subscriber:
        message = made.message(data=[1] * SIZE)
        publisher.publish(message)
        assert plc(xEnable=True, sTopic=topic).xNewData
        assert subscriber.wait(1.0) == message
        assert subscriber.wait(0.01) is None
        assert (publisher.lock_misses, subscriber.lock_misses, plc.udiLockMisses) == (0, 0, 0)
    fence = f"sem.{region_name(topic)}-event"  # the PLC's alone: what it has for a memory barrier
    assert {file.name for file in Path("/dev/shm").glob(f"*{region_name(topic)}*")} == {region_name(topic), fence}
    (made.folder / "shmgen.toml").write_text(
        f'path = ["definitions"]\n[regions]\nsync = "sequence"\n[[topics]]\ntopic = "{topic}"\ntype = "{NAME.short}"\n'
    )
    # A finding without a topic is about the machine, where another process may have left a semaphore behind.
    findings = json.loads(run(["doctor", topic, "--json"], made.folder).stdout)["findings"]
    assert [finding for finding in findings if finding["topic"] and "is missing" in finding["message"]] == []
    assert "semaphore is missing" in run(["doctor", topic, "-I", "definitions"], made.folder.parent).stdout


def test_a_plc_has_its_barriers_at_the_four_places(made: Made, topic: str) -> None:
    """Each is a post and a try of the event (docs/protocol.md): the slot's number, what is complete, there, copied."""
    writing, reading = (made.plc.block(f"FB_sequence_msgs_Block_{side}") for side in ("Publisher", "Subscriber"))
    inputs = {"xEnable": True, "sTopic": topic}
    for _ in until(0, lambda: writing._fbRegion.xReady and reading._fbRegion.xReady):
        writing(**inputs, xSend=False), reading(**inputs)
    fill(writing.Msg._address, 1)
    sample = writing.Msg.bytes()
    seen: list[tuple[int, int, bool, bool]] = []

    def look() -> None:
        words, data = region_of(topic).words, Path(f"/dev/shm/{region_name(topic)}").read_bytes()
        number, completed = words[region_of(topic).number_at(1)], words[h.COMPLETED0]
        seen.append((number, completed, sample in data, reading._Received.bytes() == sample))

    with made.plc.at_each_post(look):
        assert writing(xSend=True).xSent
        assert reading(**inputs).xNewData
    assert seen == [(0, 0, False, False), (0, 0, True, False), (1, 1, True, False), (1, 1, True, True)]


@pytest.mark.parametrize("machine", ["i686", "aarch64"])
def test_a_machine_with_barriers_is_not_refused(
    made: Made, topic: str, machine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever passes each other there: each word is looked at and written between two full barriers, in Python too."""
    monkeypatch.setattr(os, "uname", lambda: os.uname_result(("Linux", "", "", "", machine)))
    barriers: list[None] = []
    monkeypatch.setattr(memory_order, "fence", lambda: barriers.append(None))
    monkeypatch.setattr(opening, "has_barrier", lambda: True)
    use_python(monkeypatch)
    with made.publisher(topic) as publisher, made.subscriber(topic) as subscriber:
        publisher.publish(made.message(data=[7] * SIZE))
        message = subscriber.wait(1.0)
        assert message
        assert whole(message)
        assert (publisher.lock_misses, subscriber.lock_misses) == (0, 0)
    assert bool(barriers) == (machine == "aarch64")


def test_another_machine_is_refused(made: Made, topic: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from shmgen.runtime import RegionUnusable

    monkeypatch.setattr(os, "uname", lambda: os.uname_result(("Linux", "", "", "", "sparc")))
    use_python(monkeypatch)
    monkeypatch.setattr(opening, "has_barrier", memory_order.has_barrier)
    with pytest.raises(RegionUnusable, match="needs full memory barriers on sparc, and this Python has none"):
        made.publisher(topic)
    assert not Path(f"/dev/shm/{region_name(topic)}").exists()
