"""Times service calls between two Python processes, and compares them with UDP in the same run.

    python benchmarks/call.py [--rounds 21] [--calls 200]

Client and server wait in the kernel. In the rows with `spin`, they first poll for the given time. The baseline is the
least code that a user of UDP would write: a packed request with its number, and a packed reply, both unchecked. The
time of the baseline depends on which processor the kernel wakes. The rounds of all rows alternate. The table shows, in
microseconds, the median over the rounds of the median in a round.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import statistics
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from shmgen.config import Config
from shmgen.generator import pipeline

SERVICE = "/shmgen_benchmark/call"
SPINS = {"shmgen": 0.0, "shmgen, spin=20e-6 at both ends": 20e-6}
DEFINITION = "int64 a\nint64 b\n---\nint64 sum\n"
REQUEST = struct.Struct("<Iqq")
REPLY = struct.Struct("<Iq")


def main() -> None:
    """Run the benchmark and print the table."""
    parser = argparse.ArgumentParser(description="Round trip of a service call.")
    parser.add_argument("--rounds", type=int, default=21)
    parser.add_argument("--calls", type=int, default=200)
    options = parser.parse_args()
    classes = generated()
    served, answered = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)  # one byte each means ready
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", 0))
    children = [child(lambda: serve_udp(udp))]
    try:
        with ExitStack() as opened:
            ways = {"UDP, by hand": udp_caller(udp.getsockname())}
            for way, spin in SPINS.items():
                topic = f"{SERVICE}/{spin > 0}"
                children.append(child(partial(serve, classes, answered, topic, spin)))
                served.recv(1)
                client = opened.enter_context(classes.AddClient(topic, spin=spin))
                ways[way] = caller(client, classes.Add_Request)
            times_by_way: dict[str, list[float]] = {way: [] for way in ways}
            for _ in range(options.rounds):
                for way, call in ways.items():
                    times_by_way[way].append(round_trip(call, options.calls))
    finally:
        for pid in children:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        for file in Path("/dev/shm").glob("*shmgen_benchmark.call*"):
            file.unlink()
    print(f"Python {sys.version.split()[0]}, {os.uname().machine}, {os.cpu_count()} cores; medians of {options.rounds}")
    print(f"\n{'A call and its answer':<40}{'us':>8}{'ratio':>8}")
    floor = times_by_way["UDP, by hand"]
    for way, times in times_by_way.items():
        ratio = statistics.median(one / base for one, base in zip(times, floor, strict=True))
        print(f"  {way:<38}{statistics.median(times) * 1e6:>8.1f}{ratio:>8.2f}")


def generated() -> Any:
    """Generate the code for a service and return the Python package with its classes."""
    with tempfile.TemporaryDirectory() as folder:
        definition = Path(folder, "call_msgs", "srv", "Add.srv")
        definition.parent.mkdir(parents=True)
        definition.write_text(DEFINITION)
        config = Config(Path(folder), path=(Path(folder),), targets=("python",), package="shmgen_call")
        for path, text in pipeline.generate(config, ["call_msgs/Add"]).items():
            Path(folder, path).parent.mkdir(parents=True, exist_ok=True)
            Path(folder, path).write_text(text)
        sys.path.insert(0, f"{folder}/python")
        from shmgen_call.call_msgs import srv  # type: ignore[import-not-found]

    return srv


def child(work: Callable[[], None]) -> int:
    pid = os.fork()
    if pid == 0:
        work()
        os._exit(0)
    return pid


def serve(classes: Any, ready: socket.socket, service: str, spin: float) -> None:
    with classes.AddServer(service, spin=spin) as server:
        ready.send(b".")
        server.serve(lambda request: classes.Add_Response(sum=request.a + request.b))


def serve_udp(udp: socket.socket) -> None:
    while True:
        data, peer = udp.recvfrom(64)
        number, a, b = REQUEST.unpack(data)
        udp.sendto(REPLY.pack(number, a + b), peer)


def caller(client: Any, request: Any) -> Callable[[int], int]:
    return lambda number: client.call(request(a=number, b=1), 10.0).sum  # type: ignore[no-any-return]


def udp_caller(peer: tuple[str, int]) -> Callable[[int], int]:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.connect(peer)
    udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 10, 0))  # settimeout adds a system call

    def call(number: int) -> int:
        udp.send(REQUEST.pack(number, number, 1))
        _, answer = REPLY.unpack(udp.recv(64))
        return int(answer)

    return call


def round_trip(call: Callable[[int], int], calls: int) -> float:
    """Call the service `calls` times and return the median duration of a call in seconds."""
    times = []
    for number in range(calls):
        began = time.perf_counter()
        answer = call(number)
        times.append(time.perf_counter() - began)
        assert answer == number + 1
    return statistics.median(times)


if __name__ == "__main__":
    main()
