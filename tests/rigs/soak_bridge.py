"""Runs a bridge for an hour while everything around it fails, and reports each requirement that did not hold.

    python -m tests.rigs.soak_bridge --seconds 3600 --backend dds --seed 1

There are 26 topics, two services and two actions. A chaos takes topics over as a PLC does. It recreates and removes
regions, and replaces them by regions of another layout and by other files. It fills /dev/shm, cuts the network, and
stops and kills peers and the master of ROS 1 or the router of zenoh.

The chaos does not touch the topics CALM, whose heartbeats must never pause for LONGEST. At the end, each message must
be in exactly one counter of the bridge, all topics must work again without help, and memory and open descriptors must
not have grown. If a heartbeat pauses for too long, the stacks of the bridge's threads are kept.

With `--strangers`, a second bridge is incompatible. It sends another definition to a quiet topic, and offers best
effort to a reliable topic. It also reads messages of 1 MiB that the first bridge carries.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from math import nan
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from shmgen.bridge import plan
from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.live.classes import call_class, publisher
from shmgen.live.session import Session
from shmgen.runtime import ActionClient, ServiceClient, ShmError
from shmgen.runtime.region import header as h

from ..bridge.contract import FIBONACCI
from ..support import REPOSITORY, zenoh
from ..support.ros1 import Graph, wait_for
from ..support.standby import Onlooker, a_plc_writes, file_of, made_anew, words_of
from .load_bridge import RATES, Ros, busy, make_graph, peer

LONGEST = 0.3
"""The longest allowed pause of a heartbeat in seconds, on a topic that the chaos does not touch."""
QUIET = [f"q{number}" for number in range(5)]
"""Topics to the PLC without messages. Only the bridge sends their heartbeats."""
TOUCHED = [f"t{number}" for number in range(5, 10)]
CALM = [*QUIET, *(name for name in RATES if name not in TOUCHED)]
WRITTEN = ("calm", "anew")
"""Topics from the PLC that this rig publishes. It removes the region of the second topic every two seconds."""
TYPE = "geometry_msgs/PoseStamped"
OTHER = "geometry_msgs/Point"
IMAGE, BOOL = "sensor_msgs/Image", "std_msgs/Bool"
LARGE = 2**20
"""The size of a large message in bytes."""
STRANGERS = {"strange": "q0", "best_effort": "strict", "large_reader": "large"}
"""Each topic of the second bridge, and the topic of the first bridge with the same ROS name."""
FILL = "soak_fills_it"
SETTLE = 4.0
STACKS = 20_000
"""The number of printed characters of the stacks."""
GROWTH = 12
"""The largest growth of the bridge in MiB after a third of its time."""
GROWTH_OF_ZENOH = 40
"""The limit for zenoh. Messages that wait after a cut keep their read buffers, and this memory is not returned."""


@dataclass
class Verdict:
    """The result of a run. `gap` is the longest pause of a heartbeat of CALM in seconds, `cpu` a share of one core.

    `uncounted` is the number of messages of each topic that are in no counter.
    """

    mishaps: Counter[str] = field(default_factory=Counter)
    gap: float = 0.0
    sent: int = 0
    counted: Counter[str] = field(default_factory=Counter)
    uncounted: Counter[str] = field(default_factory=Counter)
    memory: list[float] = field(default_factory=lambda: [nan])
    descriptors: list[int] = field(default_factory=lambda: [0])
    cpu: float = 0.0
    complaints: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        counts = ", ".join(f"{count:,} {name}" for name, count in self.counted.items())
        first = min(1, len(self.memory) - 1)
        size = f"{self.memory[first]:.0f} to {self.memory[-1]:.0f} MiB"
        return (
            f"{sum(self.mishaps.values()):,} mishaps {dict(sorted(self.mishaps.items()))}; "
            f"longest gap {self.gap:.3f} s; {self.sent:,} sent: {counts}; "
            f"in no counter {dict(self.uncounted)}; {size}, "
            f"{self.descriptors[first]} to {self.descriptors[-1]} descriptors, {100 * self.cpu:.0f} % of a core"
        )


class Stage:
    """The ROS graph, the bridge and its peers. All names begin with `space`."""

    def __init__(self, graph: Ros, space: str, seconds: float, strangers: str = "") -> None:
        """Start everything. If `strangers` is the name of a backend, start a second bridge with that backend."""
        self.graph, self.space, self.seconds, self.strangers = graph, space, seconds, strangers
        self.stop = threading.Event()
        self.sent: Counter[str] = Counter()
        action = graph.folder / "msgs" / "test_msgs" / "action" / "Fibonacci.action"
        action.parent.mkdir(parents=True)
        action.write_text(FIBONACCI)
        graph.start, start = self._with_stack_dumps(graph.start), graph.start  # type: ignore[method-assign]
        self.bridge = graph.bridge(self._config([*RATES, *QUIET], services=True))
        graph.start = start  # type: ignore[method-assign]
        loaded = load(graph.folder / "shmgen.toml", "shmgen.toml", Report())
        self.session = Session(loaded)
        kinds = self.session.classes([TYPE, OTHER, *([IMAGE] if strangers else [])])
        self.kind = kinds["geometry_msgs/msg/PoseStamped"]
        with publisher(kinds["geometry_msgs/msg/Point"], self.topic("layout"), 3):
            self.other_layout = file_of(self.topic("layout")).read_bytes()
        (graph.folder / "echo.toml").write_text(self._config([name for name in RATES if name in CALM]))
        self.source = peer(graph, "source", space, str(seconds))
        self.echo, self.caller = self.start_echo(), peer(graph, "caller", space)
        works = [self._write, self._ask, self._seek]
        if strangers:
            strange = self._start_strangers()
            works += [
                partial(self._write_large, kinds["sensor_msgs/msg/Image"]),
                partial(self._write_strange, *strange),
            ]
        self.players = [threading.Thread(target=work, daemon=True) for work in works]

    def topic(self, name: str) -> str:
        return f"{self.space}/{name}"

    def touched(self, dice: random.Random) -> str:
        """Return a random topic that the chaos may disturb. Wait until its region exists again."""
        topic = self.topic(dice.choice(TOUCHED))
        wait_for(file_of(topic).exists, f"the region of {topic}")
        return topic

    def start_echo(self) -> Any:
        command = [sys.executable, "-m", "tests.rigs.load_bridge_echo", self.graph.folder / "echo.toml", self.space]
        echo = self.graph.start(command, {"PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY}"}, stdin=subprocess.PIPE)
        assert echo.stdout.readline() == "ready\n"
        return echo

    def start_caller(self) -> Any:
        return peer(self.graph, "caller", self.space)

    @property
    def stacks(self) -> Path:
        """The file to which the bridge writes the stacks of its threads on SIGUSR2, even if the threads are blocked."""
        return self.graph.folder / "stacks"

    def _with_stack_dumps(self, start: Callable[..., Any]) -> Callable[..., Any]:
        lines = "import faulthandler, signal", f"faulthandler.register(signal.SIGUSR2, open({str(self.stacks)!r}, 'a'))"
        (self.graph.folder / "site").mkdir()
        (self.graph.folder / "site" / "sitecustomize.py").write_text("\n".join(lines))
        path = f"{self.graph.folder / 'site'}:{REPOSITORY / 'src'}"
        return lambda command, more=None, **streams: start(command, {**(more or {}), "PYTHONPATH": path}, **streams)

    def _config(self, names: list[str], services: bool = False) -> str:
        back = [f"{name}_back" for name in names if name in RATES] + [*WRITTEN] * services
        topics = self._topics(*((name, TYPE, "to_plc", "depth = 64") for name in names))
        topics += self._topics(*((name, TYPE, "from_plc", "depth = 64") for name in back))
        if self.strangers and services:
            topics += self._topics(
                ("large", IMAGE, "from_plc", "depth = 2"), ("strict", BOOL, "to_plc", 'qos = "reliable"')
            )
        calls = "".join(
            f'[[{kind}s]]\n{kind} = "{self.topic(name)}"\ntype = "{type_}"\nserver = "{server}"\ntimeout = 0.2\n'
            for kind, name, type_, server in (
                ("service", "call", "std_srvs/SetBool", "plc"),
                ("service", "ask", "std_srvs/SetBool", "ros"),
                ("action", "do", "test_msgs/Fibonacci", "plc"),
                ("action", "seek", "test_msgs/Fibonacci", "ros"),
            )
        )
        return (
            self._head("msgs") + "test_msgs = 8\n[bridge]\ndiagnostics = 0.5\n" + topics + (calls if services else "")
        )

    def _head(self, folder: str) -> str:
        return f'source = "{self.graph.source}"\npath = ["{folder}"]\n[bounds]\n"sensor_msgs/Image.data" = {LARGE}\n'

    def _topics(self, *entries: tuple[str, str, str, str]) -> str:
        return "".join(
            f'[[topics]]\ntopic = "{self.topic(name)}"\ntype = "{type_}"\ndirection = "{way}"\n{more}\n'
            for name, type_, way, more in entries
        )

    def _start_strangers(self) -> tuple[Any, Any]:
        """Start a second bridge, for which geometry_msgs/PoseStamped has other fields. Return its class and Bool's."""
        folder = self.graph.folder / "strange"
        file = folder / "geometry_msgs" / "msg" / "PoseStamped.msg"
        file.parent.mkdir(parents=True)
        file.write_text("float64 x\n")
        (self.graph.folder / "strange.toml").write_text(
            self._head("strange")
            + self._topics(
                ("strange", TYPE, "from_plc", ""),
                ("best_effort", BOOL, "from_plc", 'qos = "best_effort"'),
                ("large_reader", IMAGE, "to_plc", ""),
            )
        )
        remapped = [word for old, new in STRANGERS.items() for word in ("-r", f"{self.topic(old)}:={self.topic(new)}")]
        command = [sys.executable, "-m", "shmgen", "bridge", "--backend", self.strangers, "-c", "strange.toml"]
        override = getattr(self.graph, "environment", {}).get("ZENOH_CONFIG_OVERRIDE", "")
        no_shm = {
            "ZENOH_CONFIG_OVERRIDE": f"{override};transport/shared_memory/enabled=false"
        }  # a small /dev/shm is full
        with (folder / "log").open("w") as log:
            self.graph.start([*command, "--ros-args", *remapped], no_shm, stdout=log, stderr=log)
        kinds = Session(load(self.graph.folder / "strange.toml", "strange.toml", Report())).classes([TYPE, BOOL])
        return kinds["geometry_msgs/msg/PoseStamped"], kinds["std_msgs/msg/Bool"]

    def _write_large(self, kind: Any) -> None:
        """Publish messages of 1 MiB at 5 Hz."""
        image = kind(data=bytes(LARGE))
        with publisher(kind, self.topic("large"), 2) as writer:
            while not self.stop.wait(0.2):
                with suppress(ShmError):  # the lock is not free
                    writer.publish(image)
                    self.sent["large"] += 1

    def _write_strange(self, strange: Any, plain: Any) -> None:
        """Publish the messages that the second bridge sends to the first one."""
        with (
            publisher(strange, self.topic("strange"), 1) as first,
            publisher(plain, self.topic("best_effort"), 1) as second,
        ):
            while not self.stop.wait(0.05):
                with suppress(ShmError):  # the lock is not free
                    first.publish(strange())
                    second.publish(plain())

    def _write(self) -> None:
        """Publish on two topics at 50 Hz. The region of the second topic is recreated every two seconds."""
        calm, recreated, due = self._writer("calm"), self._writer("anew"), time.monotonic() + 2
        while not self.stop.wait(0.02):
            for name, writer in (("calm", calm), ("anew", recreated)):
                with suppress(ShmError):  # the lock is not free
                    writer.publish(self.kind())
                    self.sent[name] += 1
            if time.monotonic() > due:
                recreated.close()
                file_of(self.topic("anew")).unlink()
                while not self.stop.wait(0.05):
                    with suppress(ShmError):  # /dev/shm is full
                        recreated = self._writer("anew")
                        break
                due = time.monotonic() + 2  # the bridge checks every 0.1 s, and must open each region

    def _writer(self, name: str) -> Any:
        return publisher(self.kind, self.topic(name), 64)

    def _ask(self) -> None:
        """Call a service that no ROS node offers, as a PLC would."""
        (route,) = [route for route in plan.services(self.session) if route.entry.name == self.topic("ask")]
        with call_class(ServiceClient, route.kinds)(route.entry.name) as plc:
            while not self.stop.wait(0.1):
                with suppress(ShmError):
                    plc.call(SimpleNamespace(data=True), 5.0)

    def _seek(self) -> None:
        """Send goals to an action that no ROS node offers."""
        for route in plan.actions(self.session):
            if not route.entry.on_plc:
                with call_class(ActionClient, route.kinds)(route.entry.name) as plc:
                    while not self.stop.wait(0.5):
                        with suppress(ShmError):
                            plc.send_goal(route.kinds["_Goal"](), 1.0)
                            plc.result(2.0)


def take_over(stage: Stage, dice: random.Random) -> None:
    with a_plc_writes(stage.touched(dice)):
        time.sleep(dice.uniform(0.2, 2.5))


def make_anew(stage: Stage, dice: random.Random) -> None:
    """Recreate a region as a PLC would that stops afterwards."""

    def set_writer(words: memoryview) -> None:
        words[h.WRITER] = h.PLC

    made_anew(stage.touched(dice), set_writer)


def remove(stage: Stage, dice: random.Random) -> None:
    """Remove the region of one topic, service or action, or several regions."""
    names = [*TOUCHED, "call-request", "call-response", "do-goal", "do-feedback", "do-result"]
    for name in dice.sample(names, dice.choice((1, 1, 5))):
        with suppress(FileNotFoundError):
            Path("/dev/shm", f"{stage.space[1:].replace('/', '.')}.{name}").unlink()


def replace(stage: Stage, dice: random.Random) -> None:
    """Replace some regions by regions of another layout, or by other files, for some time."""
    names = dice.sample(TOUCHED, dice.choice((1, 3, 5)))
    for name in names:
        other = file_of(stage.topic("other"))
        cut_off = file_of(stage.topic("q0")).read_bytes()[:700]
        other.write_bytes(dice.choice((b"", b"x" * 5000, cut_off, stage.other_layout)))
        other.rename(file_of(stage.topic(name)))
    time.sleep(dice.uniform(0.1, 1.5))
    for name in names:
        file_of(stage.topic(name)).unlink()


def fill(stage: Stage, dice: random.Random) -> None:
    """Fill /dev/shm for some time, and remove a region, so that its creation fails."""
    path = Path("/dev/shm", FILL)
    with path.open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    remove(stage, dice)
    time.sleep(dice.uniform(0.1, 1.5))
    path.unlink()


def stop_a_peer(stage: Stage, dice: random.Random) -> None:
    process = dice.choice((stage.echo, stage.caller))
    process.send_signal(signal.SIGSTOP)
    time.sleep(dice.uniform(0.1, 2.0))
    process.send_signal(signal.SIGCONT)


def kill_a_peer(stage: Stage, dice: random.Random) -> None:
    name = dice.choice(("echo", "caller"))
    killed = getattr(stage, name)
    killed.kill()
    killed.communicate()
    stage.graph.processes.remove(killed)
    setattr(stage, name, getattr(stage, f"start_{name}")())


def cut_the_network(stage: Stage, dice: random.Random) -> None:
    """Shut down the loopback interface for some time. It belongs to the network namespace of this run."""
    subprocess.run(["ip", "link", "set", "lo", "down"], check=True)
    time.sleep(dice.uniform(0.1, 1.0))
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)


def kill_the_master(stage: Stage, dice: random.Random) -> None:
    """Restart the master of ROS 1, or the router of zenoh, after some time without it."""
    assert isinstance(stage.graph, (Graph, zenoh.Graph))
    stage.graph.stop_master()
    time.sleep(dice.uniform(0.1, 2.0))
    stage.graph.start_master()


def reload(stage: Stage, dice: random.Random) -> None:
    """Remove a topic, service or action from shmgen.toml, and add it again. The bridge reads the file each time.

    The file is empty when the bridge begins to read it.
    """
    file = stage.graph.folder / "shmgen.toml"
    text = file.read_text()
    name = stage.topic(dice.choice((f"{TOUCHED[0]}_back", "call", "ask", "do", "seek")))
    entry = next(part for part in re.split(r"(?=\[\[)", text) if f'"{name}"' in part)
    for now in (text.replace(entry, ""), text):
        file.write_text("")
        stage.bridge.process.send_signal(signal.SIGHUP)
        time.sleep(0.1)
        file.write_text(now)
        time.sleep(1.5)


_OFTEN = (take_over, make_anew, remove, replace, fill, stop_a_peer, kill_a_peer, cut_the_network, kill_the_master)
MISHAPS: tuple[Callable[[Stage, random.Random], None], ...] = (*_OFTEN, *_OFTEN, *_OFTEN, reload)
"""A reload is rare, because it reads all definitions."""


def run(graph: Ros, space: str, seconds: float, seed: int, longest: float, strangers: str = "") -> Verdict:
    """Run the bridge with random faults for `seconds`, then wait some seconds and check the results."""
    dice, verdict, stage = random.Random(seed), Verdict(), Stage(graph, space, seconds, strangers)
    pid = stage.bridge.process.pid
    for player in stage.players:
        player.start()
    stage.source.stdin.write("\n")
    stage.source.stdin.flush()
    begun, before = time.monotonic(), busy(pid)
    measured = begun + max(3.0, seconds / 3)
    with Onlooker(map(stage.topic, CALM), longest, lambda: os.kill(pid, signal.SIGUSR2)) as looks:
        while time.monotonic() < begun + seconds:
            mishap = dice.choice(
                [choice for choice in MISHAPS if choice is not kill_the_master or hasattr(graph, "stop_master")]
            )
            mishap(stage, dice)
            verdict.mishaps[mishap.__name__] += 1
            time.sleep(dice.uniform(0.1, 1.0))
            if stage.bridge.process.poll() is not None:
                verdict.complaints.append(
                    "the bridge has ended: " + f"{stage.bridge.process.poll()}, " + "".join(stage.bridge.lines[-40:])
                )
                return verdict
            if time.monotonic() > measured and len(verdict.memory) == 1:
                measure(verdict, pid)
        verdict.cpu = (busy(pid) - before) / (time.monotonic() - begun)
    verdict.gap = max(looks.longest.values())
    if verdict.gap >= longest:
        stacks = stage.stacks.read_text() if stage.stacks.exists() else ""
        verdict.complaints.append(f"heartbeats paused: {looks.longest}\n{stacks[:STACKS]}")
    stage.sent.update(json.loads(stage.source.stdout.readline()))
    stage.stop.set()
    for player in stage.players:
        player.join()
    time.sleep(SETTLE)
    measure(verdict, pid)
    judge(stage, verdict)
    return verdict


def measure(verdict: Verdict, pid: int) -> None:
    size = int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    verdict.memory.append(size / 2**20)
    verdict.descriptors.append(len(os.listdir(f"/proc/{pid}/fd")))


def judge(stage: Stage, verdict: Verdict) -> None:
    """Check all requirements at the end of a run, and add a line for each that does not hold."""
    for name in (*TOUCHED, *CALM):
        with words_of(file_of(stage.topic(name))) as words:
            beat = words[h.HEARTBEAT]
            time.sleep(LONGEST)
            if words[h.WRITER] != stage.bridge.process.pid or words[h.HEARTBEAT] == beat:
                verdict.complaints.append(f"{name} was not restored")
    growth = GROWTH_OF_ZENOH if isinstance(stage.graph, zenoh.Graph) else GROWTH
    if verdict.memory[-1] > verdict.memory[1] + growth:
        verdict.complaints.append(f"it grew from {verdict.memory[1]:.0f} to {verdict.memory[-1]:.0f} MiB")
    if verdict.descriptors[-1] > verdict.descriptors[1] + 8:
        verdict.complaints.append(f"it had {verdict.descriptors} descriptors")
    stage.bridge.stop(signal.SIGTERM)
    verdict.complaints += [line for line in stage.bridge.lines if "Traceback" in line]
    for name, sent in stage.sent.items():
        (line,) = [line for line in stage.bridge.lines[-60:] if re.search(rf"{stage.topic(name)} +\d+ passed", line)]
        counts = {word: int(count) for count, word in re.findall(r"(\d+) (\w+)", line.split(maxsplit=1)[1])}
        counts.pop("truncated", None)
        verdict.sent += sent
        verdict.counted.update(counts)
        if sent != sum(counts.values()):
            verdict.uncounted[name] = sent - sum(counts.values())
        if verdict.uncounted[name] and not counts.get("lost"):
            verdict.complaints.append(f"{name}: {sent} sent, and {counts}")
    if stage.strangers:
        patterns = [
            rf"{stage.topic('q0')}( .* 0 passed, [1-9]\d* refused|: a peer's type is incompatible)",
            rf"{stage.topic('large')} .*[1-9]\d* passed",
        ]
        if stage.strangers != "zenoh":  # zenoh delivers best effort to reliable subscribers
            patterns.append(rf"{stage.topic('strict')}: a publisher is best effort")
        verdict.complaints += [
            f"no line {pattern}"
            for pattern in patterns
            if not any(re.search(pattern, line) for line in stage.bridge.lines)
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=1200)
    parser.add_argument("--backend", choices=("ros1", "ros2", "dds", "zenoh"), default="dds")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--longest", type=float, default=LONGEST, help="of a pause in seconds, for busy machines")
    parser.add_argument("--shm", type=int, default=48, help="MiB of the rig's own /dev/shm")
    parser.add_argument("--strangers", action="store_true", help="add incompatible peers and messages of 1 MiB")
    parser.add_argument("--own", action="store_true", help="set by the rig itself in its own namespaces")
    args = parser.parse_args()
    if not args.own:
        mount = f"mount -t tmpfs -o size={args.shm}m,mode=1777 none /dev/shm"
        begin = f'{mount}; ip link set lo up multicast on; exec "$@"'
        own = ["unshare", "-mn", "--propagation", "private", "sh", "-c", begin, "sh"]
        sys.exit(subprocess.call([*own, sys.executable, "-m", __spec__.name, *sys.argv[1:], "--own"]))
    with tempfile.TemporaryDirectory() as folder:
        graph = make_graph(args.backend, Path(folder))
        try:
            verdict = run(graph, "/soak", args.seconds, args.seed, args.longest, args.backend * args.strangers)
        finally:
            graph.close()
    print(f"{args.backend}: {verdict}")
    print(*verdict.complaints, sep="\n")
    sys.exit(1 if verdict.complaints else 0)


if __name__ == "__main__":
    main()
