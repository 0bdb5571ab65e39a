"""The nodes of tests/bridge/load_peer.py on Cyclone DDS, without code of shmgen: a source, an echo, a sink, a caller.

    python load_peer.py source SPACE SECONDS | echo SPACE | bytes SPACE | sink SPACE | caller SPACE

The echo decodes and encodes messages, as any node does. `bytes` is an echo that sends the received bytes back without
decoding them. The source and the sink pack and unpack the bytes of a geometry_msgs/PoseStamped themselves, so that
the test measures only DDS and the bridge.
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
"""The rate of each topic in Hz."""
RELIABLE = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(100_000))
"""A history so deep that no peer loses messages itself: Cyclone would not report that. The bridge's depth is 1000."""
POSE = struct.Struct("<4s8xI12s2d")
"""Encapsulation, stamp, the frame `load` with its padding up to a double, x and y of the position."""
HEAD = b"\0\1\0\0"
REST = bytes(5 * 8)


def idl_class(name, **fields):
    return make_idl_struct(name, f"{name.replace('.', '::')}_", fields)


TIME = idl_class("builtin_interfaces.msg.dds_.Time", sec_=types.int32, nanosec_=types.uint32)
HEADER = idl_class("std_msgs.msg.dds_.Header", stamp_=TIME, frame_id_=str)
POINT = idl_class("geometry_msgs.msg.dds_.Point", **{f"{axis}_": types.float64 for axis in "xyz"})
QUATERNION = idl_class("geometry_msgs.msg.dds_.Quaternion", **{f"{axis}_": types.float64 for axis in "xyzw"})
POSE_TYPE = idl_class("geometry_msgs.msg.dds_.Pose", position_=POINT, orientation_=QUATERNION)
CALL = {"client_guid_": types.uint64, "sequence_number_": types.int64}
"""The header that rmw_cyclonedds puts before a request and a reply."""
REQUEST = idl_class("std_srvs.srv.dds_.SetBool_Request", **CALL, data_=bool)
RESPONSE = idl_class("std_srvs.srv.dds_.SetBool_Response", **CALL, success_=bool, message_=str)
STAMPED = idl_class("geometry_msgs.msg.dds_.PoseStamped", header_=HEADER, pose_=POSE_TYPE)


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
    while not all(publisher.get_matched_subscriptions() for publisher in writers.values()):
        time.sleep(0.01)
    print("connected", flush=True)
    sys.stdin.readline()
    sent = dict.fromkeys(RATES, 0)

    def run(names, rate):
        started_at = time.monotonic()
        for number in range(round(float(seconds) * rate)):
            if (delay := started_at + number / rate - time.monotonic()) > 0:
                time.sleep(delay)
            for name in names:
                writers[name].write(raw(POSE.pack(HEAD, 5, b"load", number, time.monotonic()) + REST))
                sent[name] += 1

    threads = [
        threading.Thread(target=run, args=([name for name, topic_rate in RATES.items() if topic_rate == rate], rate))
        for rate in sorted(set(RATES.values()))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(json.dumps(sent), flush=True)
    sys.stdin.readline()  # stay until the last messages have arrived


def echo(node, space):
    for name in RATES:
        listen(node, f"{space}/{name}", writer(node, f"{space}/{name}_back").write)
    print("ready", flush=True)
    sys.stdin.readline()


def sink(node, space):
    rows_by_topic = {name: [] for name in RATES}

    def append_to(rows):
        def append(sample):
            *_, number, started_at = POSE.unpack_from(sample.data)
            rows.append((number, time.monotonic() - started_at))

        return append

    for name in RATES:
        listen(node, f"{space}/{name}_back", append_to(rows_by_topic[name]))
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps({"seen": rows_by_topic, "dropped": 0}), flush=True)


def caller(node, space):
    """Send a request every 0.5 s, so that one call is always pending."""
    client_qos = RELIABLE + Qos(Policy.Userdata(b"clientid=1.2.3;"))
    requests = DataWriter(node, Topic(node, f"rq{space}/callRequest", REQUEST), client_qos)
    replies = DataReader(node, Topic(node, f"rr{space}/callReply", RESPONSE), client_qos)
    while not (requests.get_matched_subscriptions() and replies.get_matched_publications()):
        time.sleep(0.01)
    print("ready", flush=True)
    for number in itertools.count(1):
        requests.write(REQUEST(1, number, True))
        time.sleep(0.5)


def writer(node, topic):
    return DataWriter(node, Topic(node, f"rt{topic}", STAMPED), RELIABLE)


def listen(node, topic, on_sample):
    reader = DataReader(node, Topic(node, f"rt{topic}", STAMPED), RELIABLE)
    waitset = WaitSet(node)
    waitset.attach(ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any))

    def run():
        while True:
            waitset.wait(10**9)
            for sample in reader.take(64):
                on_sample(sample)

    threading.Thread(target=run, daemon=True).start()


if __name__ == "__main__":
    main(*sys.argv[1:])
