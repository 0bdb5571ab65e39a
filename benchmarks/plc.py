"""Times the call of a function block in the simulated PLC (tests/softplc), with a free lock and with a held lock.

A held lock must cost no more than a free one, because the block never waits for the lock. The figures are for C++
compiled without optimisation on this machine. A real PLC has other figures.
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import posix_ipc

from shmgen.config import Config
from shmgen.generator import pipeline
from shmgen.runtime.region.names import region_name

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.softplc import Block, Plc, compile_st

TOPIC = f"/shmgen_benchmark_{os.getpid()}/plc"
SERVICE = f"/shmgen_benchmark_{os.getpid()}/call"
DEFINITION = "geometry_msgs/Pose pose\n---\ngeometry_msgs/Pose pose\n"
PROGRAM = """
    PROGRAM PRG_Calls
    VAR_INPUT
        sService : STRING(80);
    END_VAR
    VAR_OUTPUT
        udiDone  : UDINT;
    END_VAR
    VAR
        fbServer : FB_bench_msgs_Go_Server;
        fbClient : FB_bench_msgs_Go_Client;
    END_VAR
    fbServer(xEnable := TRUE, sService := sService, xDone := fbServer.xExecute);
    fbClient(xEnable := TRUE, sService := sService, xExecute := NOT (fbClient.xDone OR fbClient.xError));
    IF fbClient.xDone THEN
        udiDone := udiDone + 1;
    END_IF
    END_PROGRAM
    """
"""A server, and a client that calls it again as soon as it answers, every few cycles."""
CYCLES = 2000
REGIONS = ("_fbRequest", "_fbReply")
PERIOD = 0.001


def main() -> None:
    """Print the longest of 2,000 cycles in us, and how often another process held the lock."""
    with tempfile.TemporaryDirectory() as folder:
        definition = Path(folder) / "bench_msgs" / "srv" / "Go.srv"
        definition.parent.mkdir(parents=True)
        definition.write_text(DEFINITION)
        config = Config(Path(folder), path=(Path(folder),), targets=("st",))
        texts = pipeline.generate(config, ["geometry_msgs/Pose", "bench_msgs/Go"])
        sources = {path: text for path, text in texts.items() if path.startswith("st/")}
        plc = compile_st({**sources, "PRG_Calls": PROGRAM})
    print(f"{CYCLES} cycles of {PERIOD * 1e3:.0f} ms each; longest call, calls that found the lock taken")
    try:
        topic(plc)
        service(plc)
    finally:
        for name in (TOPIC, f"{SERVICE}-request", f"{SERVICE}-response"):
            region = "/" + region_name(name)
            posix_ipc.unlink_shared_memory(region)
            for semaphore_name in (region, f"{region}-event"):
                with suppress(posix_ipc.ExistentialError):
                    posix_ipc.unlink_semaphore(semaphore_name)


def topic(plc: Plc) -> None:
    publisher, subscriber = (plc.block(f"FB_geometry_msgs_Pose_{role}") for role in ("Publisher", "Subscriber"))
    for block in (publisher, subscriber):
        for _ in range(1200 if block is publisher else 3):  # claiming a topic takes a writer one second
            block(xEnable=True, sTopic=TOPIC)
            time.sleep(PERIOD if not block.xBusy else 0.001)
    for name, block in (("publisher", publisher), ("subscriber", subscriber)):
        report(f"{name}, lock free", block)
        publisher()  # publish a sample, so that the subscriber tries the lock
        with_lock_held(f"{name}, Python holds the lock for a second", block, TOPIC)


def service(plc: Plc) -> None:
    program = plc.block("PRG_Calls")
    program.sService = SERVICE
    while not program.udiDone:  # wait until the regions are open and claimed, about a second
        program.run(PERIOD, 10)
    report("client and server, lock free", program)
    with_lock_held("client and server, Python holds the lock", program, f"{SERVICE}-request")
    assert program.udiDone > CYCLES // 5


def with_lock_held(name: str, block: Block, topic: str) -> None:
    holder = threading.Thread(target=hold, args=(posix_ipc.Semaphore("/" + region_name(topic)),))
    holder.start()
    time.sleep(0.05)
    report(name, block)
    holder.join()


def report(name: str, block: Block) -> None:
    before = _misses(block)
    cycles = CYCLES if "free" in name else 800
    longest = block.run(PERIOD, cycles)
    print(f"  {name:<48} {longest * 1e6:8.1f} us   {_misses(block) - before:5} of {cycles}")


def _misses(block: Block) -> int:
    """Return how often a block, or all blocks of a program, did not get the lock."""
    if block._name != "PRG_CALLS":
        return int(block.udiLockMisses)
    regions = (getattr(side, name) for side in (block.fbClient._fbClient, block.fbServer._fbServer) for name in REGIONS)
    return sum(region.udiLockMisses for region in regions)


def hold(semaphore: posix_ipc.Semaphore) -> None:
    semaphore.acquire()
    time.sleep(0.9)
    semaphore.release()


if __name__ == "__main__":
    main()
