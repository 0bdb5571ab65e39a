"""A node of zenoh-ros2-sdk that does what lines of JSON on its standard input tell it; knows nothing of shmgen.

    python peer.py FOLDER: where definitions are, as FOLDER/std_msgs/msg/String.msg

Values are plain: lists, dictionaries by field, numbers, text. `keep` uses zenoh.ext as rmw_zenoh does, because the
SDK's publishers keep nothing.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import threading
import time

import numpy
import zenoh.ext
from rosbags.interfaces import Nodetype
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber
from zenoh_ros2_sdk.message_registry import get_registry
from zenoh_ros2_sdk.qos import QosDurability, QosProfile
from zenoh_ros2_sdk.session import ZenohSession

publishers, subscribers, servers, received = {}, {}, {}, {}
news = threading.Condition()


def main():
    logging.disable(logging.CRITICAL)
    get_registry(sys.argv[1])
    for line in sys.stdin:
        command = json.loads(line)
        try:
            answer = globals()[command.pop("do")](**command)
        except Exception as error:
            answer = {"failed": repr(error)}
        print(json.dumps(answer), flush=True)
    os._exit(0)  # zenoh's threads would hold up the end


def advertise(topic, type, **more):
    publishers[topic] = ROS2Publisher(topic, type, **more)
    return publishers[topic].keyexpr


def connected(topic):
    """Waits for a subscription, by its token."""
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        if tokens(f"@ros2_lv/*/*/*/*/MS/*/*/*/{topic.replace('/', '%')}/**"):
            return True
        time.sleep(0.05)
    return False


def publish(topic, messages, period=0.0):
    publisher = publishers[topic]
    begun = time.monotonic()
    for number, values in enumerate(messages):
        if (left := begun + number * period - time.monotonic()) > 0:
            time.sleep(left)
        publisher.publish(**members(publisher.msg_type, values))


def publish_raw(topic, messages):
    for text in messages:
        publishers[topic].pub.put(bytes.fromhex(text))


def keep(topic, messages):
    """The same by a publisher that is transient local, as rmw_zenoh makes one; it keeps the newest."""
    own, session = publishers[topic], ZenohSession.get_instance()
    own.pub = zenoh.ext.declare_advanced_publisher(
        session.session, own.keyexpr, cache=zenoh.ext.CacheConfig(1), publisher_detection=True
    )
    publish(topic, messages)


def skip(topic, count):
    """Numbers that nobody has sent."""
    publishers[topic].sequence_number += count


def withdraw(topic):
    publishers.pop(topic).close()


def subscribe(topic, type, latch=False, **more):
    def take(message):
        with news:
            received[topic].append(plain(message))
            news.notify_all()

    if topic in subscribers:
        subscribers.pop(topic).close()
    received[topic] = []
    qos = QosProfile(durability=QosDurability.TRANSIENT_LOCAL) if latch else None
    subscribers[topic] = ROS2Subscriber(topic, type, take, qos=qos, **more)


def take(topic, count, timeout=20.0):
    """So many of the messages that have come and were not taken yet; fewer if they do not come in time."""
    with news:
        news.wait_for(lambda: len(received[topic]) >= count, timeout)
        taken, received[topic][:count] = received[topic][:count], []
        return taken


def serve(service, type, answers, delay=0.0, **more):
    """Each call gets the next of `answers`; the last of them is not there, and fails."""

    def handle(request):
        time.sleep(delay)
        return made(server.response_store_type, answers.pop(0))

    servers[service] = server = ROS2ServiceServer(service, type, handle, **more)


def call(service, type, request, timeout=10.0, **more):
    """The response; None: there is none."""
    client = servers.setdefault(f"client of {service}", None) or ROS2ServiceClient(
        service, type, timeout=timeout, **more
    )
    servers[f"client of {service}"] = client
    response = client.call(**members(client.request_store_type, request))
    return response and plain(response)


def graph():
    """All tokens."""
    return tokens("@ros2_lv/**")


def tokens(pattern):
    """The tokens of sessions with a link to this one.

    While zenoh replaces the way through the router by a link, tokens, messages and queries may get lost.
    """
    zenoh = ZenohSession.get_instance()
    linked = {str(session) for session in (zenoh.session.info.zid(), *zenoh.session.info.peers_zid())}
    found = [str(reply.ok.key_expr) for reply in zenoh.liveliness.get(pattern)]
    return sorted(token for token in found if token.split("/")[2] in linked)


def made(type, values):
    return ZenohSession.get_instance().store.types[type](**members(type, values))


def members(type, values):
    described = dict(ZenohSession.get_instance().store.fielddefs[type][1])
    return {name: filled(described[name], value) for name, value in values.items()} | {
        name: 0 for name in described if name == "structure_needs_at_least_one_member"
    }


def filled(described, value):
    node, of = described
    if node == Nodetype.NAME:
        return made(of, value)
    if node == Nodetype.BASE:
        return value - 256 if of[0] == "byte" and value > 127 else value  # rosbags takes a byte for signed
    kind, (word, *_) = element = of[0]
    if kind == Nodetype.BASE and word != "string":
        return numpy.array(value, dtype="uint8" if word in ("byte", "char") else word)
    return [filled(element, one) for one in value]


def plain(value):
    if isinstance(value, (list, tuple, numpy.ndarray)):
        return [plain(item) for item in value]
    if hasattr(value, "__msgtype__"):
        described = ZenohSession.get_instance().store.fielddefs[value.__msgtype__][1]
        names = {name: kind for name, kind in described if not name.startswith("structure_needs")}
        return {name: unsigned(plain(getattr(value, name)), kind) for name, kind in names.items()}
    return value.item() if isinstance(value, numpy.generic) else value


def unsigned(value, described):
    """A byte, of which rosbags makes an int8."""
    if "('byte', 0)" not in repr(described):
        return value
    return [one % 256 for one in value] if isinstance(value, list) else value % 256


if __name__ == "__main__":
    main()
