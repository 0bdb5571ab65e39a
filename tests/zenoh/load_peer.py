"""The nodes of tests/bridge/load_peer.py on eclipse-zenoh, without code of shmgen: a source, an echo, a sink, a caller.

    python load_peer.py source SPACE SECONDS | echo SPACE | sink SPACE | caller SPACE

They use rmw_zenoh's keys and attachments. Like the nodes of tests/dds, they pack and unpack the bytes of a
geometry_msgs/PoseStamped themselves, so that the test measures only zenoh and the bridge.
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
"""The rate of each topic in Hz."""
POSE = struct.Struct("<4s8xI12s2d")
"""Encapsulation, stamp, the frame `load` with its padding up to a double, x and y of the position."""
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
    os._exit(0)  # do not wait for zenoh's threads


def source(session, space, seconds):
    writers = {name: writer(session, f"{space}/{name}") for name in RATES}
    while not all(publisher.is_matched() for publisher in writers.values()):
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
                writers[name](POSE.pack(HEAD, 5, b"load", number, time.monotonic()) + REST)
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


def echo(session, space):
    subscribers = [listen(session, f"{space}/{name}", writer(session, f"{space}/{name}_back")) for name in RATES]
    print("ready", flush=True)
    sys.stdin.readline()
    del subscribers


def sink(session, space):
    rows_by_topic = {name: [] for name in RATES}

    def append_to(rows):
        def append(data):
            *_, number, started_at = POSE.unpack_from(data)
            rows.append((number, time.monotonic() - started_at))

        return append

    subscribers = [listen(session, f"{space}/{name}_back", append_to(rows_by_topic[name])) for name in RATES]
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps({"seen": rows_by_topic, "dropped": 0}), flush=True)
    del subscribers


def caller(session, space):
    """Call the service in a loop, so that one call is always pending."""
    print("ready", flush=True)
    for number in itertools.count(1):
        attached = ATTACHMENT.pack(number, time.time_ns(), 16, bytes(16))
        for _ in session.get(key(f"{space}/call", SET_BOOL), payload=HEAD + b"\1", attachment=attached, timeout=0.5):
            pass
        time.sleep(0.01)


def key(name, type_key):
    return f"{os.environ['ROS_DOMAIN_ID']}{name}/{type_key}"


def writer(session, topic):
    publisher = session.declare_publisher(key(topic, STAMPED), congestion_control=zenoh.CongestionControl.BLOCK)
    name, numbers = os.urandom(16), itertools.count(1)

    def write(data):
        publisher.put(data, attachment=ATTACHMENT.pack(next(numbers), time.time_ns(), 16, name))

    write.is_matched = lambda: publisher.matching_status.matching
    return write


def listen(session, topic, on_data):
    subscription = session.declare_subscriber(key(topic, STAMPED), zenoh.handlers.FifoChannel(100_000))

    def run():
        for sample in subscription.handler:
            on_data(sample.payload.to_bytes())

    threading.Thread(target=run, daemon=True).start()
    return subscription


if __name__ == "__main__":
    main(*sys.argv[1:])
