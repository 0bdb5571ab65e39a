"""A ROS 2 node that does what lines of JSON on its standard input tell it, for tests; knows nothing of shmgen.

Values are plain: lists, dictionaries by field, numbers, text; an octet is a number.
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
ended = []
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


def kind_of(name):
    package, kind, short = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), short)


def quality(reliable=True, latch=False, depth=1000):
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latch else DurabilityPolicy.VOLATILE,
    )


def advertise(topic, type, **qos):
    publishers[topic] = node.create_publisher(kind_of(type), topic, quality(**qos))


def withdraw(topic):
    node.destroy_publisher(publishers.pop(topic))


def connected(topic):
    """Waits for a subscriber."""
    deadline = time.monotonic() + 20
    while not publishers[topic].get_subscription_count() and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(0.1)  # and until it knows of us
    return publishers[topic].get_subscription_count()


def publish(topic, messages, period=0.0):
    for values in messages:
        publishers[topic].publish(made(publishers[topic].msg_type, values))
        time.sleep(period)


def publish_raw(topic, messages):
    for text in messages:
        publishers[topic].publish(bytes.fromhex(text))


def subscribe(topic, type, **qos):
    def take(message):
        with news:
            received[topic].append(plain(message))
            news.notify_all()

    received[topic] = []
    subscriptions[topic] = node.create_subscription(kind_of(type), topic, take, quality(**qos))


def heard(topic):
    """Waits for a publisher."""
    deadline = time.monotonic() + 20
    while not node.count_publishers(topic) and time.monotonic() < deadline:
        time.sleep(0.01)
    return node.count_publishers(topic)


def take(topic, count, timeout=20.0):
    """So many of the messages that have come and were not taken yet; fewer if they do not come in time."""
    with news:
        news.wait_for(lambda: len(received[topic]) >= count, timeout)
        taken, received[topic][:count] = received[topic][:count], []
        return taken


def serve(service, type, answers, delay=0.0):
    """Each call gets the next of `answers`."""

    def handle(request, response):
        time.sleep(delay)
        return made(kind.Response, answers.pop(0) if answers else {})

    kind = kind_of(type)
    clients[f"server of {service}"] = node.create_service(kind, service, handle)


def call(service, type, request, timeout=10.0):
    """The response, or why there is none."""
    kind = kind_of(type)
    client = clients.setdefault(service, None) or node.create_client(kind, service)
    clients[service] = client
    if not client.wait_for_service(timeout_sec=timeout):
        return "no server"
    done = threading.Event()
    future = client.call_async(made(kind.Request, request))
    future.add_done_callback(lambda future: done.set())
    if not done.wait(timeout):
        client.remove_pending_request(future)
        return "no answer"
    return plain(future.result())


def act(action, type, period=0.02):
    """Serves a Fibonacci: an order below 0 is rejected, one of 13 aborted, the rest counted up to.

    The feedback is the last eight numbers.
    """

    def execute(goal):
        so_far, feedback = [], kind.Feedback()
        for number in range(goal.request.order):
            if goal.is_cancel_requested:
                goal.canceled()
                ended.append(number)
                return made(kind.Result, {"sequence": [-number]})
            so_far.append(number)
            feedback.sequence = so_far[-8:]
            goal.publish_feedback(feedback)
            time.sleep(period)
        goal.abort() if goal.request.order == 13 else goal.succeed()
        return made(kind.Result, {"sequence": so_far})

    kind = kind_of(type)
    clients[f"server of {action}"] = ActionServer(
        actor(),
        kind,
        action,
        execute,
        goal_callback=lambda goal: GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT,
        cancel_callback=lambda goal: CancelResponse.ACCEPT,
        callback_group=ReentrantCallbackGroup(),
    )


def seek(action, type, goal, timeout=10.0):
    """Sends a goal; whether it was accepted."""
    kind = kind_of(type)
    client = clients.setdefault(action, None) or ActionClient(actor(), kind, action)
    clients[action] = client
    if not client.wait_for_server(timeout_sec=timeout):
        return "no server"
    received[action] = []
    heard = received[action].append
    future = client.send_goal_async(
        made(kind.Goal, goal), feedback_callback=lambda message: heard(plain(message.feedback))
    )
    goals[action] = done(future, timeout)
    return bool(goals[action] and goals[action].accepted)


def canceled():
    """How far the goals had come that were cancelled."""
    return ended


def cancel(action, timeout=10.0):
    """How many goals are to be cancelled."""
    return len(done(goals[action].cancel_goal_async(), timeout).goals_canceling)


def outcome(action, timeout=20.0):
    """Status, result, and all feedback."""
    found = done(goals[action].get_result_async(), timeout)
    return found and [found.status, plain(found.result), received[action]]


def done(future, timeout):
    event = threading.Event()
    future.add_done_callback(lambda future: event.set())
    return future.result() if event.wait(timeout) else None


def actor():
    """A node whose callbacks may wait for one another."""
    if "actor" not in clients:
        clients["actor"] = rclpy.create_node(f"actor_{os.getpid()}")
        executor = MultiThreadedExecutor(4)
        executor.add_node(clients["actor"])
        threading.Thread(target=executor.spin, daemon=True).start()
    return clients["actor"]


def graph(topic):
    infos = node.get_publishers_info_by_topic(topic)
    return [{"node": info.node_name, "hash": str(info.topic_type_hash)} for info in infos]


def made(kind, values):
    message = kind()
    for name, value in values.items():
        setattr(message, name, filled(getattr(message, name), kind.get_fields_and_field_types()[name], value))
    return message


def filled(there, type_, value):
    if type_.startswith("sequence<"):
        element = type_[len("sequence<") :].rstrip(">").split(",")[0]
        return [filled(None, element, item) for item in value]
    if type_.endswith("]"):
        return [filled(None, type_.partition("[")[0], item) for item in value]
    if type_ == "octet":
        return bytes([value])
    if "/" in type_:
        package, name = type_.split("/")
        return made(getattr(import_module(f"{package}.msg"), name), value)
    return value


def plain(value):
    if isinstance(value, bytes):
        return value[0]
    if isinstance(value, (list, tuple, array.array, numpy.ndarray)):
        return [plain(item) for item in value]
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    return value.item() if isinstance(value, numpy.generic) else value


if __name__ == "__main__":
    main()
