"""The same nodes as tests/bridge/load_peer.py in rclpy, with no code of ours: a source, an echo, a sink.

python load_peer.py source SPACE SECONDS | echo SPACE | sink SPACE | caller SPACE
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import SetBool

RATES = {f"t{number}": 100.0 for number in range(10)} | {"fast": 1000.0}
"""Hz, by topic."""
QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000, reliability=ReliabilityPolicy.RELIABLE)


def main(role, space, *more):
    rclpy.init()
    node = rclpy.create_node(f"load_{role}_{os.getpid()}")
    {"source": source, "echo": echo, "sink": sink, "caller": caller}[role](node, space, *more)
    os._exit(0)


def source(node, space, seconds):
    publishers = {name: node.create_publisher(PoseStamped, f"{space}/{name}", QOS) for name in RATES}
    while not all(one.get_subscription_count() for one in publishers.values()):
        time.sleep(0.01)
    print("connected", flush=True)
    sys.stdin.readline()
    sent = dict.fromkeys(RATES, 0)

    def run(names, rate):
        message = PoseStamped()
        message.header.frame_id = "load"
        begun = time.monotonic()
        for number in range(round(float(seconds) * rate)):
            if (left := begun + number / rate - time.monotonic()) > 0:
                time.sleep(left)
            for name in names:
                message.pose.position.x = float(number)
                message.pose.position.y = time.monotonic()
                publishers[name].publish(message)
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
        back = node.create_publisher(PoseStamped, f"{space}/{name}_back", QOS)
        node.create_subscription(PoseStamped, f"{space}/{name}", back.publish, QOS)
    spin(node)


def sink(node, space):
    seen = {name: [] for name in RATES}
    last = dict.fromkeys(RATES, 0)

    def sink(name):
        def take(message, about):
            """And all that waits behind it: an executor's turn costs more than a message, and is not measured here."""
            while True:
                last[name] = about["publication_sequence_number"]
                seen[name].append((message.pose.position.x, time.monotonic() - message.pose.position.y))
                more = subscriptions[name].handle.take_message(PoseStamped, False)
                if more is None:
                    return
                message, about = more

        return take

    subscriptions = {
        name: node.create_subscription(PoseStamped, f"{space}/{name}_back", sink(name), QOS) for name in RATES
    }
    spin(node)
    # Every publisher counts from 1: what was sent and did not come into our hands is nobody else's fault.
    print(json.dumps({"seen": seen, "dropped": sum(last.values()) - sum(map(len, seen.values()))}), flush=True)


def caller(node, space):
    """There is always a call that waits."""
    client = node.create_client(SetBool, f"{space}/call")
    print("ready", flush=True)
    while True:
        client.call_async(SetBool.Request(data=True))
        time.sleep(0.5)


def spin(node):
    """Until a line comes."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def run():
        try:
            executor.spin()
        except ExternalShutdownException:
            return

    threading.Thread(target=run, daemon=True).start()
    print("ready", flush=True)
    sys.stdin.readline()


if __name__ == "__main__":
    main(*sys.argv[1:])
