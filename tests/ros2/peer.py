"""A ROS 2 node for tests, without code of shmgen. It executes commands: lines of JSON on its standard input.

Values are lists, dictionaries by field, numbers and text; an octet is a number.
"""

from __future__ import annotations

import array
import json
import os
import sys
import threading
import time
from importlib import import_module

import numpy
import rclpy
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

publishers, subscriptions, clients, goals, received = {}, {}, {}, {}, {}
canceled_at = []
news = threading.Condition()


def main():
    global node
    rclpy.init(args=sys.argv)
    node = rclpy.create_node(f"peer_{os.getpid()}")
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin():
        try:
            executor.spin()
        except ExternalShutdownException:
            return

    threading.Thread(target=spin, daemon=True).start()
    for line in sys.stdin:
        command = json.loads(line)
        print(json.dumps(globals()[command.pop("do")](**command)), flush=True)
    os._exit(0)


def interface_class(name):
    package, kind, short = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), short)


def qos_profile(reliable=True, latch=False, depth=1000):
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latch else DurabilityPolicy.VOLATILE,
    )


def advertise(topic, type, **qos):
    publishers[topic] = node.create_publisher(interface_class(type), topic, qos_profile(**qos))


def withdraw(topic):
    node.destroy_publisher(publishers.pop(topic))


def connected(topic):
    """Wait up to 20 s for a subscriber, and return the number of subscribers."""
    deadline = time.monotonic() + 20
    while not publishers[topic].get_subscription_count() and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.1)  # until the subscriber has discovered this publisher
    return publishers[topic].get_subscription_count()


def publish(topic, messages, period=0.0):
    for values in messages:
        publishers[topic].publish(build_message(publishers[topic].msg_type, values))
        time.sleep(period)


def publish_raw(topic, messages):
    for text in messages:
        publishers[topic].publish(bytes.fromhex(text))


def subscribe(topic, type, **qos):
    def append(message):
        with news:
            received[topic].append(to_plain(message))
            news.notify_all()

    received[topic] = []
    subscriptions[topic] = node.create_subscription(interface_class(type), topic, append, qos_profile(**qos))


def wait_for_publisher(topic):
    """Wait up to 20 s for a publisher, and return the number of publishers."""
    deadline = time.monotonic() + 20
    while not node.count_publishers(topic) and time.monotonic() < deadline:
        time.sleep(0.01)
    return node.count_publishers(topic)


def take(topic, count, timeout=20.0):
    """Remove and return the oldest `count` received messages, or fewer after `timeout` seconds."""
    with news:
        news.wait_for(lambda: len(received[topic]) >= count, timeout)
        messages, received[topic][:count] = received[topic][:count], []
        return messages


def serve(service, type, answers, delay=0.0):
    """Answer each call with the next of `answers`."""

    def handle(request, response):
        time.sleep(delay)
        return build_message(kind.Response, answers.pop(0) if answers else {})

    kind = interface_class(type)
    clients[f"server of {service}"] = node.create_service(kind, service, handle)


def call(service, type, request, timeout=10.0):
    """Call the service and return the response, or the reason why there is none."""
    kind = interface_class(type)
    client = clients.setdefault(service, None) or node.create_client(kind, service)
    clients[service] = client
    if not client.wait_for_service(timeout_sec=timeout):
        return "no server"
    done = threading.Event()
    future = client.call_async(build_message(kind.Request, request))
    future.add_done_callback(lambda future: done.set())
    if not done.wait(timeout):
        client.remove_pending_request(future)
        return "no answer"
    return to_plain(future.result())


def act(action, type, period=0.02):
    """Serve a Fibonacci: the result is all numbers below the order. Reject an order below 0, and abort an order of 13.

    The feedback is the last eight numbers.
    """

    def execute(goal):
        numbers, feedback = [], kind.Feedback()
        for number in range(goal.request.order):
            if goal.is_cancel_requested:
                goal.canceled()
                canceled_at.append(number)
                return build_message(kind.Result, {"sequence": [-number]})
            numbers.append(number)
            feedback.sequence = numbers[-8:]
            goal.publish_feedback(feedback)
            time.sleep(period)
        goal.abort() if goal.request.order == 13 else goal.succeed()
        return build_message(kind.Result, {"sequence": numbers})

    kind = interface_class(type)
    clients[f"server of {action}"] = ActionServer(
        reentrant_node(),
        kind,
        action,
        execute,
        goal_callback=lambda goal: GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT,
        cancel_callback=lambda goal: CancelResponse.ACCEPT,
        callback_group=ReentrantCallbackGroup(),
    )


def seek(action, type, goal, timeout=10.0):
    """Send a goal, and return True if it was accepted."""
    kind = interface_class(type)
    client = clients.setdefault(action, None) or ActionClient(reentrant_node(), kind, action)
    clients[action] = client
    if not client.wait_for_server(timeout_sec=timeout):
        return "no server"
    received[action] = []
    append = received[action].append
    future = client.send_goal_async(
        build_message(kind.Goal, goal), feedback_callback=lambda message: append(to_plain(message.feedback))
    )
    goals[action] = wait_for_result(future, timeout)
    return bool(goals[action] and goals[action].accepted)


def canceled():
    """Return the progress of each canceled goal."""
    return canceled_at


def cancel(action, timeout=10.0):
    """Cancel the goal, and return how many goals the server cancels."""
    return len(wait_for_result(goals[action].cancel_goal_async(), timeout).goals_canceling)


def outcome(action, timeout=20.0):
    """Return the status, the result and all feedback."""
    reply = wait_for_result(goals[action].get_result_async(), timeout)
    return reply and [reply.status, to_plain(reply.result), received[action]]


def wait_for_result(future, timeout):
    event = threading.Event()
    future.add_done_callback(lambda future: event.set())
    return future.result() if event.wait(timeout) else None


def reentrant_node():
    """Return a node whose callbacks may wait for one another."""
    if "actor" not in clients:
        clients["actor"] = rclpy.create_node(f"actor_{os.getpid()}")
        executor = MultiThreadedExecutor(4)
        executor.add_node(clients["actor"])
        threading.Thread(target=executor.spin, daemon=True).start()
    return clients["actor"]


def graph(topic):
    infos = node.get_publishers_info_by_topic(topic)
    return [{"node": info.node_name, "hash": str(info.topic_type_hash)} for info in infos]


def build_message(kind, values):
    message = kind()
    for name, value in values.items():
        setattr(message, name, convert(getattr(message, name), kind.get_fields_and_field_types()[name], value))
    return message


def convert(current, type_, value):
    if type_.startswith("sequence<"):
        element = type_[len("sequence<") :].rstrip(">").split(",")[0]
        return [convert(None, element, item) for item in value]
    if type_.endswith("]"):
        return [convert(None, type_.partition("[")[0], item) for item in value]
    if type_ == "octet":
        return bytes([value])
    if "/" in type_:
        package, name = type_.split("/")
        return build_message(getattr(import_module(f"{package}.msg"), name), value)
    return value


def to_plain(value):
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, (list, tuple, array.array, numpy.ndarray)):
        return [to_plain(item) for item in value]
    if hasattr(value, "get_fields_and_field_types"):
        return {name: to_plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    return value.item() if isinstance(value, numpy.generic) else value


if __name__ == "__main__":
    main()
