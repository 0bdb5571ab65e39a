"""How long a block call takes in the stand-in for a PLC (tests/softplc), with the lock free and with Python holding it.

What counts is that a held lock costs no more than a free one: the block only tries. The figures are of compiled C++
without optimisation, on this machine; a PLC has its own.
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from pathlib import Path

import posix_ipc

from shmgen import pipeline
from shmgen.config import Config

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.softplc import Block, compile_st

TOPIC = f"/shmgen_benchmark_{os.getpid()}/plc"
CYCLES = 2000
PERIOD = 0.001


def main() -> None:
    """Prints the median of the longest of 2,000 cycles, and the misses counted."""
    with tempfile.TemporaryDirectory() as folder:
        texts = pipeline.generate(Config(Path(folder), targets=("st",)), ["geometry_msgs/Pose"])
        plc = compile_st({path: text for path, text in texts.items() if path.startswith("st/")})
    publisher, subscriber = (plc.block(f"FB_geometry_msgs_Pose_{role}") for role in ("Publisher", "Subscriber"))
    try:
        for block in (publisher, subscriber):
            for _ in range(1200 if block is publisher else 3):  # a writer claims its topic for a second
                block(xEnable=True, sTopic=TOPIC)
                time.sleep(PERIOD if not block.xBusy else 0.001)
        print(f"{CYCLES} cycles of {PERIOD * 1e3:.0f} ms each; longest call, calls that found the lock taken")
        for name, block in (("publisher", publisher), ("subscriber", subscriber)):
            report(f"{name}, lock free", block)
            publisher()  # something to read, so that the subscriber tries the lock
            semaphore = posix_ipc.Semaphore("/" + TOPIC.strip("/").replace("/", "."))
            holder = threading.Thread(target=hold, args=(semaphore,))
            holder.start()
            time.sleep(0.05)
            report(f"{name}, Python holds the lock for a second", block)
            holder.join()
    finally:
        name = "/" + TOPIC.strip("/").replace("/", ".")
        posix_ipc.unlink_shared_memory(name)
        for semaphore_name in (name, f"{name}-event"):
            posix_ipc.unlink_semaphore(semaphore_name)


def report(name: str, block: Block) -> None:
    before = block.udiLockMisses
    cycles = CYCLES if "free" in name else 800
    longest = block.run(PERIOD, cycles)
    print(f"  {name:<48} {longest * 1e6:8.1f} us   {block.udiLockMisses - before:5} of {cycles}")


def hold(semaphore: posix_ipc.Semaphore) -> None:
    semaphore.acquire()
    time.sleep(0.9)
    semaphore.release()


if __name__ == "__main__":
    main()
