"""A zenoh-ros2-sdk node without code of shmgen. It executes commands: lines of JSON on its standard input.

    python peer.py FOLDER: the folder of definitions, for example FOLDER/std_msgs/msg/String.msg

Values are lists, dictionaries by field, numbers and text. `keep` uses zenoh.ext as rmw_zenoh does, because the SDK's
publishers do not keep messages for late subscribers.
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
    os._exit(0)  # do not wait for zenoh's threads


def advertise(topic, type, **more):
    publishers[topic] = ROS2Publisher(topic, type, **more)
    return publishers[topic].keyexpr


def connected(topic):
    """Wait until a subscriber's token appears. Return False after 20 s."""
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        if tokens(f"@ros2_lv/*/*/*/*/MS/*/*/*/{topic.replace('/', '%')}/**"):
            return True
        time.sleep(0.05)
    return False


def publish(topic, messages, period=0.0):
    publisher = publishers[topic]
    started_at = time.monotonic()
    for number, values in enumerate(messages):
        if (wait := started_at + number * period - time.monotonic()) > 0:
            time.sleep(wait)
        publisher.publish(**members(publisher.msg_type, values))


def publish_raw(topic, messages):
    for text in messages:
        publishers[topic].pub.put(bytes.fromhex(text))


def keep(topic, messages):
    """Publish by a transient local publisher that keeps the newest message, declared as rmw_zenoh does."""
    publisher, session = publishers[topic], ZenohSession.get_instance()
    publisher.pub = zenoh.ext.declare_advanced_publisher(
        session.session, publisher.keyexpr, cache=zenoh.ext.CacheConfig(1), publisher_detection=True
    )
    publish(topic, messages)


def skip(topic, count):
    """Leave out sequence numbers, as if messages were lost."""
    publishers[topic].sequence_number += count


def withdraw(topic):
    publishers.pop(topic).close()


def subscribe(topic, type, latch=False, **more):
    def append(message):
        with news:
            received[topic].append(to_plain(message))
            news.notify_all()

    if topic in subscribers:
        subscribers.pop(topic).close()
    received[topic] = []
    qos = QosProfile(durability=QosDurability.TRANSIENT_LOCAL) if latch else None
    subscribers[topic] = ROS2Subscriber(topic, type, append, qos=qos, **more)


def take(topic, count, timeout=20.0):
    """Remove and return the oldest `count` received messages, or fewer after `timeout` seconds."""
    with news:
        news.wait_for(lambda: len(received[topic]) >= count, timeout)
        messages, received[topic][:count] = received[topic][:count], []
        return messages


def serve(service, type, answers, delay=0.0, **more):
    """Answer each call with the next of `answers`. A call fails if none is left."""

    def handle(request):
        time.sleep(delay)
        return build_message(server.response_store_type, answers.pop(0))

    servers[service] = server = ROS2ServiceServer(service, type, handle, **more)


def call(service, type, request, timeout=10.0, **more):
    """Call the service and return the response, or None if there is none."""
    client = servers.setdefault(f"client of {service}", None) or ROS2ServiceClient(
        service, type, timeout=timeout, **more
    )
    servers[f"client of {service}"] = client
    response = client.call(**members(client.request_store_type, request))
    return response and to_plain(response)


def graph():
    """Return all tokens."""
    return tokens("@ros2_lv/**")


def tokens(pattern):
    """Return the tokens of this session and of sessions with a direct link to it.

    Tokens, messages and queries may get lost while zenoh replaces the route through the router by a direct link.
    """
    zenoh = ZenohSession.get_instance()
    linked = {str(session) for session in (zenoh.session.info.zid(), *zenoh.session.info.peers_zid())}
    keys = [str(reply.ok.key_expr) for reply in zenoh.liveliness.get(pattern)]
    return sorted(token for token in keys if token.split("/")[2] in linked)


def build_message(type, values):
    return ZenohSession.get_instance().store.types[type](**members(type, values))


def members(type, values):
    field_types = dict(ZenohSession.get_instance().store.fielddefs[type][1])
    return {name: to_rosbags(field_types[name], value) for name, value in values.items()} | {
        name: 0 for name in field_types if name == "structure_needs_at_least_one_member"
    }


def to_rosbags(field_type, value):
    node, detail = field_type
    if node == Nodetype.NAME:
        return build_message(detail, value)
    if node == Nodetype.BASE:
        return value - 256 if detail[0] == "byte" and value > 127 else value  # rosbags stores a byte as int8
    kind, (word, *_) = element = detail[0]
    if kind == Nodetype.BASE and word != "string":
        return numpy.array(value, dtype="uint8" if word in ("byte", "char") else word)
    return [to_rosbags(element, item) for item in value]


def to_plain(value):
    if isinstance(value, (list, tuple, numpy.ndarray)):
        return [to_plain(item) for item in value]
    if hasattr(value, "__msgtype__"):
        fields = ZenohSession.get_instance().store.fielddefs[value.__msgtype__][1]
        names = {name: kind for name, kind in fields if not name.startswith("structure_needs")}
        return {name: to_unsigned(to_plain(getattr(value, name)), kind) for name, kind in names.items()}
    return value.item() if isinstance(value, numpy.generic) else value


def to_unsigned(value, field_type):
    """Convert an int8 back to a byte; rosbags stores a byte as int8. Other values stay unchanged."""
    if "('byte', 0)" not in repr(field_type):
        return value
    return [item % 256 for item in value] if isinstance(value, list) else value % 256


if __name__ == "__main__":
    main()
