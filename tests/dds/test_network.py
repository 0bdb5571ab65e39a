"""Who hears us and whom we hear: ROS 2's environment, two machines of which one is ours, and messages of any size."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from shmgen.bridge.backend import LARGEST
from shmgen.bridge.dds.network import network
from shmgen.core.model import Schema

from ..conftest import REPOSITORY
from ..support.dds import LOOPBACK, Domain
from .conftest import wire

RANGE, ONLY, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"
OUTSIDE = "10.97.0.2"
"""The other machine; ours is 10.97.0.1."""

# What is said, and who is then found of one process on this machine and one on another in the same subnet.
FOUND = {
    "nothing": ({}, {"inside", "outside"}),
    "SUBNET": ({RANGE: "SUBNET"}, {"inside", "outside"}),
    "SYSTEM_DEFAULT": ({RANGE: "SYSTEM_DEFAULT"}, {"inside", "outside"}),
    "LOCALHOST": ({RANGE: "LOCALHOST"}, {"inside"}),
    "OFF": ({RANGE: "OFF"}, set()),
    "no such range": ({RANGE: "localhost"}, {"inside"}),
    "ROS_LOCALHOST_ONLY": ({ONLY: "1"}, {"inside"}),
    "ROS_LOCALHOST_ONLY before all": ({ONLY: "1", RANGE: "SUBNET", PEERS: OUTSIDE}, {"inside"}),
    "ROS_LOCALHOST_ONLY=0": ({ONLY: "0"}, {"inside", "outside"}),
    "LOCALHOST and a peer": ({RANGE: "LOCALHOST", PEERS: f"; {OUTSIDE};"}, {"inside", "outside"}),
    "OFF and a peer": ({RANGE: "OFF", PEERS: OUTSIDE}, set()),
}

# Two network namespaces with a wire between them; in each a process that looks for all others, by all means.
SCRIPT = """
import json, os, subprocess, sys, time
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.qos import Policy, Qos

LOOKS = ("<CycloneDDS><Domain><Discovery><ParticipantIndex>auto</ParticipantIndex><SPDPInterval>500ms</SPDPInterval>"
    "<Peers><Peer address='localhost'/><Peer address='10.97.0.1'/></Peers></Discovery></Domain></CycloneDDS>")

def names(participant):
    reader = BuiltinDataReader(participant, BuiltinTopicDcpsParticipant)
    seen = set()
    while True:
        for found in reader.take(100):
            if found.sample_info.valid_data and Policy.EntityName in found.qos:
                seen.add(found.qos[Policy.EntityName].name)
        yield seen
        time.sleep(0.1)

def ip(*words):
    subprocess.run(["ip", *words], check=True)

role = sys.argv[1]
if role == "peer":
    domain = Domain(7, LOOKS)
    participant = DomainParticipant(7, Qos(Policy.EntityName(sys.argv[2])))
    print("ready", flush=True)
    for seen in names(participant):
        print(json.dumps(sorted(seen)), flush=True)
elif role == "outside":
    while subprocess.run(["ip", "link", "show", "theirs"], capture_output=True).returncode:
        time.sleep(0.05)
    ip("addr", "add", "10.97.0.2/24", "dev", "theirs"); ip("link", "set", "theirs", "up"); ip("link", "set", "lo", "up")
    os.execv(sys.executable, [sys.executable, __file__, "peer", "outside"])
else:
    ip("link", "set", "lo", "up"); ip("link", "add", "name", "ours", "type", "veth", "peer", "name", "theirs")
    ip("addr", "add", "10.97.0.1/24", "dev", "ours"); ip("link", "set", "ours", "up")
    def start(*words):
        return subprocess.Popen([*words], stdout=-1, text=True, env={"PATH": os.environ["PATH"]})
    me = [sys.executable, __file__]
    outside = start("unshare", "-n", *me, "outside")
    time.sleep(0.5)  # until it is in its own namespace
    ip("link", "set", "theirs", "netns", str(outside.pid))
    inside = start(*me, "peer", "inside")
    try:
        assert [peer.stdout.readline() for peer in (inside, outside)] == ["ready\\n"] * 2
        from shmgen.bridge.dds import backend
        from shmgen.bridge.backend import Node
        notes = []
        graph = backend.connect(Node("ours", 7, notes.append, lambda: False))
        graph._transport()
        wanted, deadline = set(json.loads(sys.argv[2])), time.monotonic() + 20
        settled = None
        for seen in names(graph._ends.participant):
            if wanted <= seen and settled is None:
                settled = time.monotonic() + 3  # so long for one who must not come
            if time.monotonic() > (settled or deadline):
                break
        with open("/proc/net/udp") as table:
            dropped = sum(int(line.split()[-1]) for line in table.readlines()[1:])
        last = {}
        for name, peer in (("inside", inside), ("outside", outside)):
            peer.kill()
            last[name] = json.loads(peer.stdout.read().splitlines()[-1])
        seen -= {"ours", "ours_services"}
        print(json.dumps({"seen": sorted(seen), "seen by": last, "notes": notes, "dropped": dropped}))
    finally:
        inside.kill(); outside.kill()
"""


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="makes network namespaces")
@pytest.mark.parametrize("said", FOUND)
def test_who_is_found(tmp_path: Path, said: str) -> None:
    able = ["unshare", "-n", "ip", "link", "add", "name", "ours", "type", "veth", "peer", "name", "theirs"]
    if not (shutil.which("unshare") and shutil.which("ip")) or subprocess.run(able, capture_output=True).returncode:
        pytest.skip("no namespaces, or no ip, here")
    environment, wanted = FOUND[said]
    script = tmp_path / "two_machines.py"
    script.write_text(SCRIPT)
    command = ["unshare", "-n", sys.executable, str(script), "ours", json.dumps(sorted(wanted))]
    clean = {name: value for name, value in os.environ.items() if name not in (RANGE, ONLY, PEERS, "CYCLONEDDS_URI")}
    fast = "<CycloneDDS><Domain><Discovery><SPDPInterval>500ms</SPDPInterval></Discovery></Domain></CycloneDDS>"
    clean |= environment | {"CYCLONEDDS_URI": fast, "PYTHONPATH": str(REPOSITORY / "src")}
    done = subprocess.run(command, capture_output=True, text=True, env=clean, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert set(result["seen"]) == wanted
    assert {name for name, seen in result["seen by"].items() if "ours" in seen} == wanted
    if importlib.util.find_spec("shmgen_fastdds"):
        services = wanted if environment else set()  # else nothing but CYCLONEDDS_URI has bounds
        assert {name for name, seen in result["seen by"].items() if "ours_services" in seen} == services
    if wanted == {"inside"}:
        assert result["dropped"] > 0  # what the other machine has sent us all the while
        assert "dds: only this machine is reachable" in result["notes"]


def test_what_is_said_of_what_counts_for_nothing() -> None:
    assert network({}, LARGEST).notes == ()
    before, only = network({ONLY: "1", PEERS: "x"}, LARGEST).notes
    assert (before.startswith("ROS_LOCALHOST_ONLY is 1: "), only) == (True, "only this machine is reachable")
    wrong, only = network({RANGE: "subnet"}, LARGEST).notes
    assert "'subnet', none of OFF, LOCALHOST, SUBNET, SYSTEM_DEFAULT" in wrong
    assert network({RANGE: "SYSTEM_DEFAULT", PEERS: "x"}, LARGEST).notes[0].startswith("ROS_STATIC_PEERS is ignored")
    assert "<Peer address='&lt;\"'/>" in network({PEERS: '<"'}, LARGEST).config


def test_what_may_wait_has_a_bound(schema: Schema) -> None:
    small, image = (replace(wire(schema, "/a", "std_msgs/String"), sample_size=room) for room in (81, 4 << 20))
    assert (small.largest, small.queue) == (LARGEST, 1000)
    assert (image.largest, image.queue) == (16 << 20, 4)
    assert replace(image, depth=16).queue == 16
    assert small.queue * small.largest <= 64 << 20


FLOOD = """
import sys, time
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic

kind = make_idl_struct("String", "std_msgs::msg::dds_::String_", {"data_": str})
kind.serialize = lambda self, **_: b"\\0\\1\\0\\0" + len(self.data_).to_bytes(4, "little") + self.data_
participant = DomainParticipant(int(sys.argv[1]))
qos = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(4))
writer = DataWriter(participant, Topic(participant, sys.argv[2], kind), qos)
while not writer.get_matched_subscriptions():
    time.sleep(0.05)
for size in (48 << 20, 48 << 20, 60_000, 48 << 20, 50):
    writer.write(kind(b"x" * (size - 1) + b"\\0"))
    time.sleep(1)
"""


@pytest.mark.slow
def test_what_is_too_large_is_not_even_received(cell: Domain, domain: int, topic: str) -> None:
    """A real peer sends 48 MiB for a region of 81 bytes, three times; what fits comes through all the same."""
    bridge = cell.bridge(f'[[topics]]\ntopic = "{topic}"\ntype = "std_msgs/String"\n')

    def high() -> int:
        status = Path(f"/proc/{bridge.process.pid}/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0])

    before = high()
    command = [cell.python, "-c", FLOOD, str(domain), f"rt{topic}"]
    flood = cell.start(command, {"CYCLONEDDS_URI": LOOPBACK})
    assert flood.wait(60) == 0
    bridge.wait_for_line("rejected: 50,331,656 bytes, and more than 65,536 are not received")
    bridge.process.send_signal(signal.SIGUSR1)
    bridge.wait_for_line(f"{topic} +1 passed, 4 rejected")
    assert not [line for line in bridge.lines if line[0].isdigit()], "peers begin no line"
    assert high() - before < 16 * 1024  # KiB; a single one of these has three times that


JOINS = """
import sys, time
from shmgen.bridge.backend import Node
from shmgen.bridge.dds import backend
backend.connect(Node("shmgen_bridge", int(sys.argv[1]), lambda line: print(line, flush=True), lambda: False))
time.sleep(1)
"""


def test_what_cyclone_says_begins_no_line_of_the_log(cell: Domain, domain: int) -> None:
    """Its lines have names in them that peers chose; here it hears of itself more than it is allowed to."""
    small = "<CycloneDDS><Domain><Internal><MaxSampleSize>100B</MaxSampleSize></Internal></Domain></CycloneDDS>"
    joins = cell.start([cell.python, "-c", JOINS, str(domain)], {"CYCLONEDDS_URI": f"{LOOPBACK},{small}"}, stderr=-2)
    said = joins.communicate(timeout=60)[0].splitlines()
    assert joins.returncode == 0
    assert any(line.startswith("dds: Cyclone: dropping oversize ") for line in said), said
    assert all(line.startswith("dds: ") for line in said), said
