"""The rospy nodes of tests/rigs/load_bridge.py: a source of numbered poses, an echo, and a sink that times them.

    python load_peer.py source SPACE SECONDS | echo SPACE | sink SPACE | caller SPACE

Times are from the monotonic clock, which all processes of a machine share.
"""

from __future__ import annotations

import json
import sys
import threading
import time

import rospy
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import SetBool

RATES = {f"t{number}": 100.0 for number in range(10)} | {"fast": 1000.0}
"""The rate of each topic in Hz."""


def main(role, space, *more):
    rospy.init_node(f"load_{role}", anonymous=True, disable_rosout=True)
    {"source": source, "echo": echo, "sink": sink, "caller": caller}[role](space, *more)


def source(space, seconds):
    publishers = {name: publisher(f"{space}/{name}") for name in RATES}
    while not all(node.get_num_connections() for node in publishers.values()):
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
                message.pose.position.x = number
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


def echo(space):
    for name in RATES:
        back = publisher(f"{space}/{name}_back")
        rospy.Subscriber(f"{space}/{name}", PoseStamped, back.publish, tcp_nodelay=True)
    print("ready", flush=True)
    rospy.spin()


def sink(space):
    rows_by_topic = {name: [] for name in RATES}

    def append(message, name):
        rows_by_topic[name].append((message.pose.position.x, time.monotonic() - message.pose.position.y))

    for name in RATES:
        rospy.Subscriber(f"{space}/{name}_back", PoseStamped, append, name, tcp_nodelay=True)
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps({"seen": rows_by_topic, "dropped": 0}), flush=True)


def caller(space):
    """Call the service in a loop, so that one call is always pending."""
    call = rospy.ServiceProxy(f"{space}/call", SetBool)
    print("ready", flush=True)
    while not rospy.is_shutdown():
        try:
            call(True)
        except rospy.ServiceException:
            time.sleep(0.01)


def publisher(topic):
    return rospy.Publisher(topic, PoseStamped, queue_size=1000, tcp_nodelay=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
