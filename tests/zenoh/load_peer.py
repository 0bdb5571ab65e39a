"""The same nodes as tests/bridge/load_peer.py on eclipse-zenoh, with no code of ours: a source, an echo, a sink.

    python load_peer.py source SPACE SECONDS | echo SPACE | sink SPACE | caller SPACE

They have rmw_zenoh's keys and attachments, and handle the bytes of a geometry_msgs/PoseStamped themselves, as those of
tests/dds do, so that what is measured is zenoh and the bridge.
"""

from __future__ import annotations

import itertools
import json
import os
import struct
import sys
import threading
import time

import zenoh

RATES = {f"t{number}": 100.0 for number in range(10)} | {"fast": 1000.0}
"""Hz, by topic."""
POSE = struct.Struct("<4s8xI12s2d")
"""Encapsulation, stamp, the frame `load` with what fills it up to a double, x and y of the position."""
HEAD = b"\0\1\0\0"
REST = bytes(5 * 8)
ATTACHMENT = struct.Struct("<qqB16s")
STAMPED = (
    "geometry_msgs::msg::dds_::PoseStamped_/RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
)
SET_BOOL = "std_srvs::srv::dds_::SetBool_/RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"


def main(role, space, *more):
    config = zenoh.Config()
    for pair in os.environ["ZENOH_CONFIG_OVERRIDE"].split(";"):
        config.insert_json5(*pair.split("=", 1))
    session = zenoh.open(config)
    {"source": source, "echo": echo, "sink": sink, "caller": caller}[role](session, space, *more)
    os._exit(0)  # zenoh's threads would hold up the end


def source(session, space, seconds):
    writers = {name: writer(session, f"{space}/{name}") for name in RATES}
    while not all(one.is_met() for one in writers.values()):
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
                writers[name](POSE.pack(HEAD, 5, b"load", number, time.monotonic()) + REST)
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


def echo(session, space):
    kept = [listen(session, f"{space}/{name}", writer(session, f"{space}/{name}_back")) for name in RATES]
    print("ready", flush=True)
    sys.stdin.readline()
    del kept


def sink(session, space):
    seen = {name: [] for name in RATES}

    def sink(rows):
        def take(data):
            *_, number, begun = POSE.unpack_from(data)
            rows.append((number, time.monotonic() - begun))

        return take

    kept = [listen(session, f"{space}/{name}_back", sink(seen[name])) for name in RATES]
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps({"seen": seen, "dropped": 0}), flush=True)
    del kept


def caller(session, space):
    """There is always a call that waits."""
    print("ready", flush=True)
    for number in itertools.count(1):
        beside = ATTACHMENT.pack(number, time.time_ns(), 16, bytes(16))
        for _ in session.get(key(f"{space}/call", SET_BOOL), payload=HEAD + b"\1", attachment=beside, timeout=0.5):
            pass
        time.sleep(0.01)


def key(name, kind):
    return f"{os.environ['ROS_DOMAIN_ID']}{name}/{kind}"


def writer(session, topic):
    publisher = session.declare_publisher(key(topic, STAMPED), congestion_control=zenoh.CongestionControl.BLOCK)
    name, numbers = os.urandom(16), itertools.count(1)

    def write(data):
        publisher.put(data, attachment=ATTACHMENT.pack(next(numbers), time.time_ns(), 16, name))

    write.is_met = lambda: publisher.matching_status.matching
    return write


def listen(session, topic, take):
    heard = session.declare_subscriber(key(topic, STAMPED), zenoh.handlers.FifoChannel(100_000))

    def run():
        for sample in heard.handler:
            take(sample.payload.to_bytes())

    threading.Thread(target=run, daemon=True).start()
    return heard


if __name__ == "__main__":
    main(*sys.argv[1:])
