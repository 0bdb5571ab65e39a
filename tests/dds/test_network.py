"""Test discovery between two machines by ROS 2's environment variables, and the limits on message sizes and queues."""

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
"""The address of the other machine; this machine has 10.97.0.1."""

# The environment, and the visible peers: `inside` runs on this machine, `outside` on another one in the same subnet.
DISCOVERY = {
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

# Connect two network namespaces by a virtual cable. In each, a process searches for all others on every interface.
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
                settled = time.monotonic() + 3  # time for a peer that must stay invisible
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


@pytest.mark.sample("[SUBNET]", "[OFF and a peer]")
@pytest.mark.skipif(os.geteuid() != 0, reason="requires root to create network namespaces")
@pytest.mark.parametrize("case", DISCOVERY)
def test_environment_decides_the_visible_peers(tmp_path: Path, case: str) -> None:
    probe = ["unshare", "-n", "ip", "link", "add", "name", "ours", "type", "veth", "peer", "name", "theirs"]
    if not (shutil.which("unshare") and shutil.which("ip")) or subprocess.run(probe, capture_output=True).returncode:
        pytest.skip("no namespaces, or no ip, here")
    environment, expected = DISCOVERY[case]
    script = tmp_path / "two_machines.py"
    script.write_text(SCRIPT)
    command = ["unshare", "-n", sys.executable, str(script), "ours", json.dumps(sorted(expected))]
    clean = {name: value for name, value in os.environ.items() if name not in (RANGE, ONLY, PEERS, "CYCLONEDDS_URI")}
    fast = "<CycloneDDS><Domain><Discovery><SPDPInterval>500ms</SPDPInterval></Discovery></Domain></CycloneDDS>"
    clean |= environment | {"CYCLONEDDS_URI": fast, "PYTHONPATH": str(REPOSITORY / "src")}
    process = subprocess.run(command, capture_output=True, text=True, env=clean, timeout=60, check=False)
    assert process.returncode == 0, process.stderr
    result = json.loads(process.stdout.splitlines()[-1])
    assert set(result["seen"]) == expected
    assert {name for name, seen in result["seen by"].items() if "ours" in seen} == expected
    if importlib.util.find_spec("shmgen_fastdds"):
        services = expected if environment else set()  # without these variables, only CYCLONEDDS_URI limits discovery
        assert {name for name, seen in result["seen by"].items() if "ours_services" in seen} == services
    if expected == {"inside"}:
        assert result["dropped"] > 0  # packets that the other machine sent
        assert "dds: the bridge reaches only this machine" in result["notes"]


def test_ignored_discovery_variables_are_noted() -> None:
    assert network({}, LARGEST).notes == ()
    deprecated, only = network({ONLY: "1", PEERS: "x"}, LARGEST).notes
    assert (deprecated.startswith("ROS_LOCALHOST_ONLY is 1: "), only) == (True, "the bridge reaches only this machine")
    wrong, only = network({RANGE: "subnet"}, LARGEST).notes
    assert "'subnet', not one of OFF, LOCALHOST, SUBNET, SYSTEM_DEFAULT" in wrong
    assert network({RANGE: "SYSTEM_DEFAULT", PEERS: "x"}, LARGEST).notes[0].startswith("ROS_STATIC_PEERS is ignored")
    assert "<Peer address='&lt;\"'/>" in network({PEERS: '<"'}, LARGEST).config


def test_queue_size_is_bounded(schema: Schema) -> None:
    small, image = (replace(wire(schema, "/a", "std_msgs/String"), sample_size=size) for size in (81, 4 << 20))
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
def test_far_too_large_message_is_not_received(cell: Domain, domain: int, topic: str) -> None:
    """Reject three messages of 48 MiB for a region of 81 bytes, and pass the message that fits."""
    bridge = cell.bridge(f'[[topics]]\ntopic = "{topic}"\ntype = "std_msgs/String"\n')

    def peak_memory() -> int:
        status = Path(f"/proc/{bridge.process.pid}/status").read_text()
        return int(status.split("VmHWM:")[1].split()[0])

    before = peak_memory()
    command = [cell.python, "-c", FLOOD, str(domain), f"rt{topic}"]
    flood = cell.start(command, {"CYCLONEDDS_URI": LOOPBACK})
    assert flood.wait(60) == 0
    bridge.wait_for_line("rejected: the message has 50,331,656 bytes; the bridge receives at most 65,536")
    bridge.process.send_signal(signal.SIGUSR1)
    bridge.wait_for_line(f"{topic} +1 passed, 4 rejected")
    assert not [line for line in bridge.lines if line[0].isdigit()], "peers begin no line"
    assert peak_memory() - before < 16 * 1024  # KiB; one of the large messages has three times as many


JOINS = """
import sys, time
from shmgen.bridge.backend import Node
from shmgen.bridge.dds import backend
backend.connect(Node("shmgen_bridge", int(sys.argv[1]), lambda line: print(line, flush=True), lambda: False))
time.sleep(1)
"""


def test_log_lines_of_cyclone_have_a_prefix(cell: Domain, domain: int) -> None:
    """Log Cyclone's lines with a prefix: they may contain names that peers chose. A 100-byte limit provokes some."""
    small = "<CycloneDDS><Domain><Internal><MaxSampleSize>100B</MaxSampleSize></Internal></Domain></CycloneDDS>"
    node = cell.start([cell.python, "-c", JOINS, str(domain)], {"CYCLONEDDS_URI": f"{LOOPBACK},{small}"}, stderr=-2)
    lines = node.communicate(timeout=60)[0].splitlines()
    assert node.returncode == 0
    assert any(line.startswith("dds: Cyclone: dropping oversize ") for line in lines), lines
    assert all(line.startswith("dds: ") for line in lines), lines
