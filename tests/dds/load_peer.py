"""The same nodes as tests/bridge/load_peer.py on Cyclone DDS, with no code of ours: a source, an echo, a sink.

    python load_peer.py source SPACE SECONDS | echo SPACE | bytes SPACE | sink SPACE | caller SPACE

The echo gets and sends messages, as any node does. `bytes` is one that sends back bytes it has not looked at, and the
source and the sink handle those of a geometry_msgs/PoseStamped themselves, so that what is measured is DDS and the
bridge.
"""

from __future__ import annotations

import itertools
import json
import os
import struct
import sys
import threading
import time

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

RATES = {f"t{number}": 100.0 for number in range(10)} | {"fast": 1000.0}
"""Hz, by topic."""
RELIABLE = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(100_000))
"""So much that no peer loses any itself, which Cyclone would not tell; the bridge has 1000."""
POSE = struct.Struct("<4s8xI12s2d")
"""Encapsulation, stamp, the frame `load` with what fills it up to a double, x and y of the position."""
HEAD = b"\0\1\0\0"
REST = bytes(5 * 8)


def made(name, **fields):
    return make_idl_struct(name, f"{name.replace('.', '::')}_", fields)


TIME = made("builtin_interfaces.msg.dds_.Time", sec_=types.int32, nanosec_=types.uint32)
HEADER = made("std_msgs.msg.dds_.Header", stamp_=TIME, frame_id_=str)
POINT = made("geometry_msgs.msg.dds_.Point", **{f"{axis}_": types.float64 for axis in "xyz"})
QUATERNION = made("geometry_msgs.msg.dds_.Quaternion", **{f"{axis}_": types.float64 for axis in "xyzw"})
POSE_TYPE = made("geometry_msgs.msg.dds_.Pose", position_=POINT, orientation_=QUATERNION)
CALL = {"client_guid_": types.uint64, "sequence_number_": types.int64}
"""As rmw_cyclonedds has it before a request and a reply."""
REQUEST = made("std_srvs.srv.dds_.SetBool_Request", **CALL, data_=bool)
RESPONSE = made("std_srvs.srv.dds_.SetBool_Response", **CALL, success_=bool, message_=str)
STAMPED = made("geometry_msgs.msg.dds_.PoseStamped", header_=HEADER, pose_=POSE_TYPE)


def raw(data, *_, **__):
    sample = object.__new__(STAMPED)
    sample.data = data
    return sample


def main(role, space, *more):
    node = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    if role != "echo":
        STAMPED.serialize = lambda self, **_: self.data
        STAMPED.deserialize = staticmethod(raw)
    {"source": source, "echo": echo, "bytes": echo, "sink": sink, "caller": caller}[role](node, space, *more)


def source(node, space, seconds):
    writers = {name: writer(node, f"{space}/{name}") for name in RATES}
    while not all(one.get_matched_subscriptions() for one in writers.values()):
        time.sleep(0.01)
    print("connected", flush=True)
    sys.stdin.readline()
    sent = dict.fromkeys(RATES, 0)

    def run(names, rate):
        begun = time.monotonic()
        for number in range(round(float(seconds) * rate)):
            if (left := begun + number / rate - time.monotonic()) > 0:
                time.sleep(left)
            for name in names:
                writers[name].write(raw(POSE.pack(HEAD, 5, b"load", number, time.monotonic()) + REST))
                sent[name] += 1

    threads = [
        threading.Thread(target=run, args=([name for name, own in RATES.items() if own == rate], rate))
        for rate in sorted(set(RATES.values()))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(json.dumps(sent), flush=True)
    sys.stdin.readline()  # stays, so that what is under way arrives


def echo(node, space):
    for name in RATES:
        listen(node, f"{space}/{name}", writer(node, f"{space}/{name}_back").write)
    print("ready", flush=True)
    sys.stdin.readline()


def sink(node, space):
    seen = {name: [] for name in RATES}

    def sink(rows):
        def take(sample):
            *_, number, begun = POSE.unpack_from(sample.data)
            rows.append((number, time.monotonic() - begun))

        return take

    for name in RATES:
        listen(node, f"{space}/{name}_back", sink(seen[name]))
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps({"seen": seen, "dropped": 0}), flush=True)


def caller(node, space):
    """There is always a call that waits."""
    us = RELIABLE + Qos(Policy.Userdata(b"clientid=1.2.3;"))
    requests = DataWriter(node, Topic(node, f"rq{space}/callRequest", REQUEST), us)
    replies = DataReader(node, Topic(node, f"rr{space}/callReply", RESPONSE), us)
    while not (requests.get_matched_subscriptions() and replies.get_matched_publications()):
        time.sleep(0.01)
    print("ready", flush=True)
    for number in itertools.count(1):
        requests.write(REQUEST(1, number, True))
        time.sleep(0.5)


def writer(node, topic):
    return DataWriter(node, Topic(node, f"rt{topic}", STAMPED), RELIABLE)


def listen(node, topic, take):
    reader = DataReader(node, Topic(node, f"rt{topic}", STAMPED), RELIABLE)
    waiting = WaitSet(node)
    waiting.attach(ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any))

    def run():
        while True:
            waiting.wait(10**9)
            for sample in reader.take(64):
                take(sample)

    threading.Thread(target=run, daemon=True).start()


if __name__ == "__main__":
    main(*sys.argv[1:])
