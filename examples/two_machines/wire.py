"""Simulates a cable between two network namespaces, and drops frames on request.

    python wire.py PID_OF_A PID_OF_B

Each namespace gets an interface `eth0`. A line on standard input, such as `0.2`, sets the share of frames to drop.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import random
import select
import struct
import sys
from contextlib import suppress

TUNSETIFF = 0x400454CA
TAP_WITHOUT_HEADER = 0x0002 | 0x1000


def main(*pids: str) -> None:
    """Run the simulated cable until standard input ends."""
    ends = [tap(pid) for pid in pids]
    print("ready", flush=True)
    loss = 0.0
    while True:
        ready, _, _ = select.select([*ends, 0], [], [])
        if 0 in ready:
            line = sys.stdin.readline()
            if not line:
                return
            loss = float(line)
        for end in ready:
            if end == 0:
                continue
            with suppress(OSError):  # the interface is down
                frame = os.read(end, 65536)
                if random.random() >= loss:
                    os.write(ends[1 - ends.index(end)], frame)


def tap(pid: str) -> int:
    """Create `eth0` in the network namespace of a process, and return the file descriptor of its other end."""
    libc = ctypes.CDLL(None, use_errno=True)
    with open(f"/proc/{pid}/ns/net") as space:
        if libc.setns(space.fileno(), 0):
            raise OSError(ctypes.get_errno(), "setns")
    end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(end, TUNSETIFF, struct.pack("16sH22x", b"eth0", TAP_WITHOUT_HEADER))
    return end


if __name__ == "__main__":
    main(*sys.argv[1:])
