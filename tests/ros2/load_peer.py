"""The nodes of tests/bridge/load_peer.py in rclpy, without code of shmgen: a source, an echo, a sink, a caller.

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
"""The rate of each topic in Hz."""
QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1000, reliability=ReliabilityPolicy.RELIABLE)


def main(role, space, *more):
    rclpy.init()
    node = rclpy.create_node(f"load_{role}_{os.getpid()}")
    {"source": source, "echo": echo, "sink": sink, "caller": caller}[role](node, space, *more)
    os._exit(0)


def source(node, space, seconds):
    publishers = {name: node.create_publisher(PoseStamped, f"{space}/{name}", QOS) for name in RATES}
    while not all(publisher.get_subscription_count() for publisher in publishers.values()):
        time.sleep(0.01)
    print("connected", flush=True)
    sys.stdin.readline()
    sent = dict.fromkeys(RATES, 0)

    def run(names, rate):
        message = PoseStamped()
        message.header.frame_id = "load"
        started_at = time.monotonic()
        for number in range(round(float(seconds) * rate)):
            if (delay := started_at + number / rate - time.monotonic()) > 0:
                time.sleep(delay)
            for name in names:
                message.pose.position.x = float(number)
                message.pose.position.y = time.monotonic()
                publishers[name].publish(message)
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
        back = node.create_publisher(PoseStamped, f"{space}/{name}_back", QOS)
        node.create_subscription(PoseStamped, f"{space}/{name}", back.publish, QOS)
    spin(node)


def sink(node, space):
    rows = {name: [] for name in RATES}
    last = dict.fromkeys(RATES, 0)

    def record(name):
        def append(message, info):
            """Record all queued messages too, because a turn of the executor costs more than a message."""
            while True:
                last[name] = info["publication_sequence_number"]
                rows[name].append((message.pose.position.x, time.monotonic() - message.pose.position.y))
                more = subscriptions[name].handle.take_message(PoseStamped, False)
                if more is None:
                    return
                message, info = more

        return append

    subscriptions = {
        name: node.create_subscription(PoseStamped, f"{space}/{name}_back", record(name), QOS) for name in RATES
    }
    spin(node)
    # Every publisher counts from 1, so the missing numbers are messages that this sink dropped.
    print(json.dumps({"seen": rows, "dropped": sum(last.values()) - sum(map(len, rows.values()))}), flush=True)


def caller(node, space):
    """Send a request every 0.5 s, so that one call is always pending."""
    client = node.create_client(SetBool, f"{space}/call")
    print("ready", flush=True)
    while True:
        client.call_async(SetBool.Request(data=True))
        time.sleep(0.5)


def spin(node):
    """Run the executor in a thread until a line arrives on the standard input."""
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
