"""A ROS 1 node that does what lines of JSON on its standard input tell it, for tests; knows nothing of shmgen."""

from __future__ import annotations

import json
import sys
import threading
import time

import genpy
import roslib.message
import rospy

publishers, received, servers = {}, {}, {}
news = threading.Condition()


def main():
    rospy.init_node("peer", anonymous=True, disable_rosout=True)
    for line in sys.stdin:
        command = json.loads(line)
        print(json.dumps(globals()[command.pop("do")](**command)), flush=True)


def advertise(topic, type, latch=False):
    kind = roslib.message.get_message_class(type)
    publishers[topic] = rospy.Publisher(topic, kind, queue_size=1000, latch=latch, tcp_nodelay=True)


def connected(topic):
    """Waits for a subscriber."""
    deadline = time.monotonic() + 20
    while not publishers[topic].get_num_connections() and time.monotonic() < deadline:
        time.sleep(0.01)
    return publishers[topic].get_num_connections()


def publish(topic, messages, period=0.0):
    for values in messages:
        message = publishers[topic].data_class()
        genpy.message.fill_message_args(message, [values], keys={"now": rospy.Time.now()})
        publishers[topic].publish(message)
        time.sleep(period)


def subscribe(topic, type):
    def take(message):
        with news:
            received[topic].append(plain(message))
            news.notify_all()

    received[topic] = []
    rospy.Subscriber(topic, roslib.message.get_message_class(type), take, tcp_nodelay=True)


def take(topic, count, timeout=20.0):
    """So many of the messages that have come and were not taken yet; fewer if they do not come in time."""
    with news:
        news.wait_for(lambda: len(received[topic]) >= count, timeout)
        taken, received[topic][:count] = received[topic][:count], []
        return taken


def forget(topic):
    received[topic].clear()


def serve(service, type, answers):
    """Each call gets the next of `answers`; None is a failure."""
    kind = roslib.message.get_service_class(type)

    def handle(request):
        values = answers.pop(0)
        if values is None:
            raise rospy.ServiceException("told to fail")
        return kind._response_class(**values)

    rospy.Service(service, kind, handle)


def act(action, type):
    """Serves an actionlib/Test: 13 is aborted, the rest counted up to with feedback."""
    import actionlib

    def execute(goal):
        for number in range(goal.goal):
            if server.is_preempt_requested():
                return server.set_preempted(kind().action_result.result.__class__(-number))
            server.publish_feedback(kind().action_feedback.feedback.__class__(number))
            time.sleep(0.02)
        end = server.set_aborted if goal.goal == 13 else server.set_succeeded
        return end(kind().action_result.result.__class__(goal.goal))

    kind = roslib.message.get_message_class(type)
    servers[action] = server = actionlib.SimpleActionServer(action, kind, execute, auto_start=False)
    server.start()


def seek(action, type, goal):
    """Sends a goal."""
    import actionlib

    kind = roslib.message.get_message_class(type)
    client = servers.setdefault(action, None) or actionlib.SimpleActionClient(action, kind)
    servers[action] = client
    received[action] = []
    if not client.wait_for_server(rospy.Duration(10)):
        return "no server"
    message = kind().action_goal.goal
    genpy.message.fill_message_args(message, [goal])
    client.send_goal(message, feedback_cb=lambda feedback: received[action].append(plain(feedback)))
    return True


def cancel(action):
    servers[action].cancel_goal()


def state(action):
    return servers[action].get_state()


def outcome(action):
    """Status, result, and all feedback."""
    client = servers[action]
    client.wait_for_result(rospy.Duration(20))
    return [client.get_state(), plain(client.get_result()), received[action]]


def plain(value):
    if isinstance(value, genpy.Message):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, genpy.rostime.TVal):
        return {"secs": value.secs, "nsecs": value.nsecs}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return list(value) if isinstance(value, bytes) else value


if __name__ == "__main__":
    main()
