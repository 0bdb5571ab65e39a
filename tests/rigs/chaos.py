"""Kills readers and writers of a region thousands of times at random instants, and checks that nothing is lost.

    python -m tests.rigs.chaos --seconds 60 --seed 1 [--no-plc] [--no-cpp] [--fault NAME]

The writers and readers of one topic are in Python (engine in C, or reference), in C++ and in Structured Text (the
simulated PLC). They are killed, stopped for a moment, and started again. From time to time all are killed and the
region is removed, so that they create it again. Also, signal handlers raise and fork, other processes post to the
semaphores, the region is truncated, foreign files have its names, and /dev/shm is full: see chaos_mishaps.py.

Every sample has its number and a checksum. Some of the processes copy small samples slowly, in two halves, so that
other processes run between the halves. A round is a burst of kills and stops, and then the time until each process has
published or read again. `--fault` plants a fault in the protocol, which must be detected: see chaos_faults.py.
"""

from __future__ import annotations

import argparse
import ctypes
import mmap
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

from shmgen.config import Config
from shmgen.core.model import TypeName
from shmgen.generator import pipeline
from shmgen.live import processes
from shmgen.runtime import LockTimeout, RegionInUse, RegionMissing, engine, read_header, reference, region_name
from shmgen.tools.doctor import clean

from ..support import cpp_peer, engines
from ..support.build import classes, put
from ..support.region_of import region_of
from . import chaos_faults, chaos_mishaps, chaos_still
from .chaos_faults import Wrapped, swap
from .chaos_mishaps import Interrupted

DEPTHS = (1, 4)
SIZES = {"Small": 2048, "Large": 131072}
"""Sizes in bytes, below and above LATE_FROM, because the runtime copies small and large samples differently."""
DEFINITIONS = {
    f"chaos_msgs/msg/{name}.msg": f"uint64 number\nuint32 checksum\nuint8[{size}] data\n"
    for name, size in SIZES.items()
}
PATTERNS = {name: [random.Random(seed).randbytes(size) for seed in range(61)] for name, size in SIZES.items()}
CHECKSUMS = {name: [zlib.crc32(pattern) for pattern in patterns] for name, patterns in PATTERNS.items()}
ROUNDS_A_REGION = 30
TIMEOUT = 1.5
"""Seconds that a new writer waits for children of its predecessor, which release the claim as soon as they run."""


INSTALLED = SimpleNamespace(**{name: getattr(engine, name) for name in engines.NAMES})
"""The engine of this process, before the processes of the chaos choose their engines."""


@dataclass
class Stage:
    """The data that all processes share: a topic, the classes, and a counter of samples for each role.

    `program` is the path of the C++ program, and `shared` the descriptor of the counters.
    """

    topic: str
    classes: dict[str, tuple[Any, Any, Any]]
    plc: Any
    moves: memoryview
    complaints: int
    depth: int = 1
    kind: str = "Small"
    calm: bool = False
    planted: bool = False
    calls: list[Callable[[], Any]] = field(default_factory=list)
    """Methods of the endpoints that this process has open. A forked child must not use these endpoints."""
    program: Path | None = None
    shared: int = -1
    stacks: int = -1
    """The descriptor of a file that processes write their stacks to."""

    @property
    def kinds(self) -> tuple[Any, Any, Any]:
        """The message class, the publisher class and the subscriber class."""
        return self.classes[self.kind]

    def become_cpp(self, place: int, rng: random.Random, way: str, complaints: int) -> NoReturn:
        """Replace this process by the C++ program. Signals that this process ignores stay ignored."""
        assert self.program
        patterns = self.program.with_name(f"{self.kind}.patterns")
        words = [way, self.kind, self.topic, self.depth, place, self.shared, complaints, patterns]
        for descriptor in (self.shared, complaints):
            os.set_inheritable(descriptor, True)
        os.execv(self.program, ["chaos", *map(str, words), str(rng.randrange(2**32))])

    def complain(self, text: str) -> None:
        os.write(self.complaints, f"{text}\n"[:500].encode())

    def sample(self, number: int) -> Any:
        message = self.kinds[0](number=number, checksum=CHECKSUMS[self.kind][number % 61] ^ number)
        ctypes.memmove(message.data, PATTERNS[self.kind][number % 61], SIZES[self.kind])
        return message

    def check(self, message: Any, sequence: int, role: str) -> None:
        number, data = message.number, bytes(message.data)
        # Comparing is faster than a checksum, so that more time remains for the protocol itself.
        expected = CHECKSUMS[self.kind][number % 61] ^ number
        if message.checksum != expected or data != PATTERNS[self.kind][number % 61]:
            self.complain(f"{role}: torn: sample {sequence} contains {number}, checksum {zlib.crc32(data):08X}")
        elif number != sequence:
            self.complain(f"{role}: sample {sequence} contains {number}")


@dataclass
class Verdict:
    """The result of a run. `pause` is the longest time in seconds from the end of a burst until all roles continued."""

    kills: int = 0
    stops: int = 0
    rounds: int = 0
    moves: dict[str, int] = field(default_factory=dict)
    recoveries: int = 0
    regions: int = 1
    half_made: int = 0
    pause: float = 0.0
    mishaps: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)


def write(stage: Stage, place: int, rng: random.Random) -> None:
    """Publish samples until this process is killed.

    In some processes the lock is mandatory, as on machines that are not x86. A dead holder then stops all others until
    the lock is recovered.
    """
    pause = rng.choice((0, 0, 0.0003))
    choose_engine(stage, rng)
    with stage.kinds[1](stage.topic, depth=stage.depth, lock_timeout=rng.choice((0, 0, 0.001, 0.01))) as publisher:
        stage.calls = [publisher.heartbeat]
        be_slow(publisher, stage, rng)
        while True:
            try:
                publisher.publish(stage.sample(publisher.sequence + 1))
            except (LockTimeout, Interrupted):
                continue
            stage.moves[place] += 1
            time.sleep(pause)


def read(stage: Stage, place: int, rng: random.Random) -> None:
    way = rng.choice(("read", "read_all", "wait"))
    choose_engine(stage, rng)
    with stage.kinds[2](stage.topic, depth=stage.depth, lock_timeout=rng.choice((0, 0, 0.001, 0.01))) as subscriber:
        stage.calls = [subscriber.read]
        be_slow(subscriber, stage, rng)
        is_consistent = True
        while is_consistent:
            with suppress(Interrupted):  # the interrupted read loses its samples, so counting restarts
                is_consistent = follow(stage, place, subscriber, way)


def follow(stage: Stage, place: int, subscriber: Any, way: str) -> bool:
    """Read samples and check them. Return False if the numbers of read and missed samples do not agree."""
    start, missed, count = subscriber._end.last, subscriber.missed, 0
    last = start
    while True:
        match way:
            case "read":
                messages = [subscriber.read()]
            case "wait":
                messages = [subscriber.wait(0.05)]
            case _:
                messages = subscriber.read_all()
        for message in filter(None, messages):
            count += 1
            stage.check(message, message.number if way == "read_all" else subscriber.sequence, way)
            if message.number <= last:
                stage.complain(f"{way}: {message.number} after {last}")
            last = message.number
            stage.moves[place] += 1
        lost = subscriber.missed - missed
        if count and (last != subscriber.sequence or start + count + lost != last):
            stage.complain(f"{way}: from {start} to {last}, {count} read and {lost} missed do not add up")
            return False


def choose_engine(stage: Stage, rng: random.Random) -> None:
    """Use the reference in Python in half of all processes, and in all processes if it contains a fault."""
    chosen = reference if stage.planted or rng.random() < 0.5 else INSTALLED
    for name in engines.NAMES:
        setattr(engine, name, getattr(chosen, name))


def be_slow(side: Any, stage: Stage, rng: random.Random) -> None:
    """Make endpoints in Python slow: some always use the lock, and half of them copy small samples slowly."""
    if not isinstance(side._end, (reference.Writer, reference.Reader)):
        return
    side._end.lock.keeps_order &= rng.random() < 0.7
    if stage.kind == "Small" and rng.random() < 0.5:
        swap(side, "map", lambda map: Halves(map, rng))


class Halves(Wrapped):
    """The map of a region. Samples are copied in two halves with a pause between them.

    A sample is read from the back and written from the front, so that reader and writer meet.
    """

    def __init__(self, inner: Any, rng: random.Random) -> None:
        super().__init__(inner)
        self.rng = rng

    def __getitem__(self, part: slice) -> bytes:
        middle = (part.start + part.stop) // 2
        back = self.inner[middle : part.stop]
        self.pause()
        return bytes(self.inner[part.start : middle] + back)

    def __setitem__(self, part: slice, data: bytearray) -> None:
        half = len(data) // 2
        self.inner[part.start : part.start + half] = data[:half]
        self.pause()
        self.inner[part.start + half : part.stop] = data[half:]

    def pause(self) -> None:
        """Sleep in three of ten copies. More pauses would leave no samples to a reader that does not use the lock."""
        if self.rng.random() < 0.3:
            time.sleep(self.rng.choice((0, 0.0001, 0.0005)))


def plc_write(stage: Stage, place: int, rng: random.Random) -> None:
    block = stage.plc.block(f"FB_chaos_msgs_{stage.kind}_Publisher")
    size = ctypes.sizeof(stage.kinds[0])
    region = block._fbRegion
    while True:
        ready = region.xReady  # only then is the next number known, because a new writer leaves out some numbers
        if ready:
            sample = stage.sample(region._udiLast + 1)
            ctypes.memmove(block.Msg._address, ctypes.addressof(sample), size)
        block(xEnable=True, xSend=ready, sTopic=stage.topic, udiDepth=stage.depth)
        stage.moves[place] += block.xSent
        time.sleep(0.0002)


def plc_read(stage: Stage, place: int, rng: random.Random) -> None:
    block = stage.plc.block(f"FB_chaos_msgs_{stage.kind}_Subscriber")
    newest = rng.random() < 0.5
    while True:
        block(xEnable=True, sTopic=stage.topic, udiDepth=stage.depth, xNewest=newest)
        if block.xNewData:
            message = stage.kinds[0].from_buffer_copy(block.Msg.bytes())
            stage.check(message, block.udiSequence, "plc_read")
            stage.moves[place] += 1
        time.sleep(0.0002)


def cpp_write(stage: Stage, place: int, rng: random.Random) -> None:
    stage.become_cpp(place, rng, "write", stage.complaints)


def cpp_read(stage: Stage, place: int, rng: random.Random) -> None:
    stage.become_cpp(place, rng, rng.choice(("read", "next", "wait")), stage.complaints)


class Actor:
    """A role, such as a writer in C++, and the process that currently has it."""

    def __init__(self, stage: Stage, place: int, work: Callable[[Stage, int, random.Random], None]) -> None:
        self.stage, self.place, self.work = stage, place, work
        self.pid = 0

    @property
    def moves(self) -> int:
        return self.stage.moves[self.place]

    @property
    def interpreted(self) -> bool:
        """True if the process runs Python, also if it runs the simulated PLC."""
        return self.work not in (cpp_write, cpp_read)

    def start(self, seed: float) -> None:
        # Ignore signals until the child has its own handlers. A PLC has none and ignores them for good.
        before = [(number, signal.signal(number, signal.SIG_IGN)) for number in (signal.SIGINT, signal.SIGUSR1)]
        self.pid = os.fork()
        if self.pid == 0:
            self.play(random.Random(seed))
        for number, handler in before:
            signal.signal(number, handler)

    def play(self, rng: random.Random) -> NoReturn:
        """Execute the role. If a signal handler's exception interrupts opening or closing, start again."""
        interrupts, deadline = True, time.monotonic() + TIMEOUT
        try:
            if self.interpreted:
                chaos_still.dump_stack_on_signal(self.stage)
            if self.work in (write, read):
                chaos_mishaps.prepare(self.stage, rng, self.work)
            while interrupts:
                interrupts = False
                try:
                    self.work(self.stage, self.place, rng)
                except Interrupted:
                    interrupts = True
                except RegionInUse as error:
                    # A child that the previous writer has just forked holds the claim until it runs.
                    interrupts = time.monotonic() < deadline
                    if not interrupts:
                        chaos_still.report_claim_holder(self.stage, error)
                self.stage.calls = []
        except BaseException as error:
            self.stage.complain(f"{self.work.__name__} ended: {error!r}")
        finally:
            os._exit(0)

    def state(self) -> str:
        """Return the process state as in `ps`, or the exit status.

        Only the first call after the end of the process returns the exit status.
        """
        try:
            pid, status = os.waitpid(self.pid, os.WNOHANG | os.WUNTRACED) if self.pid else (0, 0)
            if pid:
                return f"status {status:#x}"
            return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (ChildProcessError, FileNotFoundError):
            return "ended"

    def kill(self) -> None:
        with suppress(ProcessLookupError, ChildProcessError):  # it had already ended, and state() has reported this
            self.signal(signal.SIGKILL)
            os.waitpid(self.pid, 0)

    def signal(self, number: signal.Signals) -> None:
        os.kill(self.pid, number)


def play(
    folder: Path,
    seconds: float,
    kills: int,
    seed: int,
    limit: float,
    plc: bool,
    cpp: bool,
    fault: str | None,
    calm: bool,
) -> Verdict:
    """Run rounds until there were `kills` kills, `seconds` are over, or a fault was found. Return the result."""
    stage, complaints = _prepare_stage(folder, plc, cpp)
    stage.calm = calm
    if fault:
        stage.planted = True
        engines.become_python()  # also this process, because another engine would not have the fault
        plant = chaos_faults.PLANTED[fault]
        plant(stage)
        stage.calm = plant in chaos_faults.CALM
    rng, verdict = random.Random(seed), Verdict()
    before = _unfinished_semaphores()
    end = time.monotonic() + seconds
    scenes = [[write, read, read]]
    if plc:
        scenes += [[write, read, plc_read], [plc_write, read, plc_read]]
    if cpp:
        scenes += [[cpp_write, read, cpp_read], [write, cpp_read, cpp_read], [cpp_write, cpp_read, cpp_read]]
    if plc and cpp:
        scenes += [[cpp_write, cpp_read, plc_read], [plc_write, cpp_read, read]]
    try:
        while time.monotonic() < end and verdict.kills < kills and not verdict.faults:
            stage.depth = DEPTHS[verdict.regions % 2]
            stage.kind = "Small" if fault else tuple(SIZES)[verdict.regions // 2 % 2]
            works = scenes[verdict.regions % len(scenes)]
            gentle = not stage.calm and verdict.regions % 5 == 1
            cast = [Actor(stage, place, work) for place, work in enumerate(works)]
            for actor in cast:
                actor.start(rng.random())
            try:
                for _ in range(6 if plc_write in works else ROUNDS_A_REGION):
                    if gentle:
                        _gentle_burst(stage, cast, rng, verdict)
                    else:
                        _burst(stage, cast, rng, verdict)
                    _recover(cast, limit, verdict)
                    verdict.faults += complaints()
                    if verdict.faults or time.monotonic() > end:
                        break
                if gentle and (recoveries := read_header(region_name(stage.topic)).recoveries):
                    verdict.faults.append(f"without a kill or stop, the lock was recovered {recoveries} times")
            finally:
                for actor in cast:
                    actor.kill()
                    name = actor.work.__name__
                    verdict.moves[name] = verdict.moves.get(name, 0) + actor.moves
                    stage.moves[actor.place] = 0
            verdict.faults += complaints()
            verdict.recoveries += read_header(region_name(stage.topic)).recoveries
            verdict.regions += 1
            _clean(stage, verdict)
            if not stage.calm:
                mishap = rng.choice(chaos_mishaps.BETWEEN)
                verdict.mishaps[mishap.__name__] += 1
                verdict.faults += [f"{mishap.__name__}: {text}" for text in mishap(stage, rng)]
                verdict.faults += complaints()
    finally:
        for file in _files(stage):
            file.unlink()
    _clean_unfinished_semaphores(before, verdict)
    return verdict


def _prepare_stage(folder: Path, plc: bool, cpp: bool) -> tuple[Stage, Callable[[], list[str]]]:
    put(DEFINITIONS, folder / "definitions")
    config = Config(folder, path=(folder / "definitions",), package="shm_chaos", targets=("python", "st", "c", "cpp"))
    texts = pipeline.generate(config, [f"chaos_msgs/{name}" for name in SIZES])
    put(texts, folder)
    kinds = {name: classes(folder, config.package, TypeName("chaos_msgs", "msg", name)) for name in SIZES}
    compiled = None
    if plc:
        from ..softplc import compile_st

        compiled = compile_st({path: text for path, text in texts.items() if path.endswith(".st")})
    program = None
    if cpp:
        program = cpp_peer.compiled(folder, "chaos", cpp_peer.HERE / "chaos.cpp", options=["-O2"])
        for name in SIZES:
            checksums = b"".join(number.to_bytes(4, "little") for number in CHECKSUMS[name])
            (folder / f"{name}.patterns").write_bytes(checksums + b"".join(PATTERNS[name]))
    out, into = os.pipe()
    os.set_blocking(out, False)
    shared = os.memfd_create("moves")
    os.ftruncate(shared, mmap.PAGESIZE)
    moves = memoryview(mmap.mmap(shared, mmap.PAGESIZE)).cast("Q")

    def complaints() -> list[str]:
        try:
            return os.read(out, 65536).decode().splitlines()
        except BlockingIOError:
            return []

    topic = f"/shmgen_chaos/t{os.getpid()}"
    return Stage(
        topic, kinds, compiled, moves, into, program=program, shared=shared, stacks=os.memfd_create("stacks")
    ), complaints


def _burst(stage: Stage, cast: list[Actor], rng: random.Random, verdict: Verdict) -> None:
    verdict.rounds += 1
    for _ in range(rng.randint(1, 6)):
        time.sleep(rng.uniform(0, 0.004))
        actor = rng.choice(cast)
        if not stage.calm and rng.random() < 0.3:
            _mishap(rng.choice(chaos_mishaps.DURING), stage, actor, rng, verdict)
            continue
        if rng.random() < 0.5:
            for _ in range(rng.randint(1, 10)):
                _overtake(*rng.sample(cast, 2), rng)
                verdict.stops += 1
            continue
        actor.kill()
        verdict.kills += 1
        if actor.place == 0:
            verdict.faults += _last_sample_is_lost(stage)
        actor.start(rng.random())


def _gentle_burst(stage: Stage, cast: list[Actor], rng: random.Random, verdict: Verdict) -> None:
    verdict.rounds += 1
    for _ in range(rng.randint(1, 12)):
        time.sleep(rng.uniform(0, 0.004))
        _mishap(rng.choice(chaos_mishaps.GENTLE), stage, rng.choice(cast), rng, verdict)


def _mishap(mishap: Any, stage: Stage, actor: Actor, rng: random.Random, verdict: Verdict) -> None:
    verdict.mishaps[mishap.__name__] += 1
    mishap(stage, actor, rng)


def _overtake(first: Actor, second: Actor, rng: random.Random) -> None:
    """Stop a process for some microseconds while another one continues, and then let both run."""
    first.signal(signal.SIGSTOP)
    end = time.perf_counter() + rng.uniform(0, 0.0002)
    while time.perf_counter() < end:
        pass
    second.signal(signal.SIGSTOP)
    first.signal(signal.SIGCONT)
    time.sleep(0.0002)
    second.signal(signal.SIGCONT)


def _last_sample_is_lost(stage: Stage) -> Iterator[str]:
    """Yield a fault if a new reader does not get the newest sample while no writer exists."""
    with stage.kinds[2](stage.topic, depth=stage.depth, lock_timeout=0) as subscriber:
        completed = region_of(subscriber).newest()
        # If the lock is mandatory, a dead reader may hold it until it is recovered.
        message = subscriber.read() or subscriber.wait(TIMEOUT)
        if completed and message is None:
            yield f"sample {completed} was completed and is lost"
        elif completed:
            stage.check(message, completed, "after a kill")


def _recover(cast: list[Actor], limit: float, verdict: Verdict) -> None:
    start, before = time.monotonic(), [actor.moves for actor in cast]
    stage, late = cast[0].stage, ""
    # A PLC removes no surplus token before a recovery, and readers in C take the lock only if they must.
    surplus = chaos_still.Surplus(stage if cast[0].work is not plc_write else None)
    while any(actor.moves == moves for actor, moves in zip(cast, before, strict=True)) or surplus.is_there():
        took = time.monotonic() - start
        if took > limit and not late:
            what = "more than one token" if surplus.is_there() else "no sign of life"
            late = f"{what} within {limit:.1f} s of the last hit: {chaos_still.describe(stage, cast, before)}"
        if took > 5 * limit:
            verdict.faults.append(f"{late}\nnor within {took:.1f}: {chaos_still.describe(stage, cast, before)}")
            return
        time.sleep(0.0005)
    took = time.monotonic() - start
    verdict.pause = max(verdict.pause, took)
    if late:
        verdict.faults.append(f"{late}\nall moved after {took:.2f}")


def _files(stage: Stage) -> set[Path]:
    return set(Path("/dev/shm").glob(f"*{region_name(stage.topic)}*"))


def _clean(stage: Stage, verdict: Verdict) -> None:
    known = clean.leftovers(stage.topic)
    if unknown := _files(stage) - {Path(file) for file in known}:
        verdict.faults.append(f"`shmgen clean` does not know {unknown}")
    clean.remove(known)


def _unfinished_semaphores() -> set[Path]:
    """Return the files with temporary names of semaphores, which the C library uses while it creates a semaphore."""
    return set(Path("/dev/shm").glob("sem.??????"))


def _clean_unfinished_semaphores(before: set[Path], verdict: Verdict) -> None:
    """Remove the temporary files that killed processes left. Add a fault if shmgen does not recognize one of them."""
    if not (left := _unfinished_semaphores() - before):
        return
    time.sleep(clean.AGE + 0.1)
    left &= _unfinished_semaphores()
    known = {Path(file) for file in clean.orphan_semaphores(processes.look())}
    for file in left - known:
        with suppress(RegionMissing, ValueError):
            known |= {Path(file) for file in clean.leftovers(file.name.removeprefix("sem."))}
    verdict.half_made = len(left)
    if unknown := left - known:
        verdict.faults.append(f"`shmgen clean` does not know {unknown}")
    clean.remove([str(file) for file in left])


def main() -> None:
    """Run the chaos and print its result. The exit code is 1 if a fault was found."""
    parser = argparse.ArgumentParser(description="Kills readers and writers of a region at random instants.")
    parser.add_argument("--seconds", type=float, default=600)
    parser.add_argument("--kills", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit", type=float, default=1.2, help="seconds within which all processes continue")
    parser.add_argument("--no-plc", action="store_true")
    parser.add_argument("--calm", action="store_true", help="only kills and stops, without chaos_mishaps.py")
    parser.add_argument("--no-cpp", action="store_true")
    parser.add_argument("--fault", choices=chaos_faults.PLANTED)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="shmgen-chaos") as folder:
        plc = not (args.no_plc or args.fault)
        cpp = not (args.no_cpp or args.fault) and shutil.which("g++") is not None
        verdict = play(Path(folder), args.seconds, args.kills, args.seed, args.limit, plc, cpp, args.fault, args.calm)
    print(
        f"seed {args.seed}: {verdict.kills} kills and {verdict.stops} stops in {verdict.rounds} bursts on "
        f"{verdict.regions} regions; {verdict.recoveries} locks recovered, {verdict.half_made} semaphores half made; "
        f"mishaps: {dict(verdict.mishaps)}; "
        f"samples: {verdict.moves}; all moved again within {verdict.pause:.2f} s"
    )
    print("\n".join(verdict.faults[:20]) or "nothing torn, nothing lost, nobody stuck, nothing left over")
    sys.exit(bool(verdict.faults))


if __name__ == "__main__":
    main()
