"""A ROS 1 node for tests, without code of shmgen. It executes commands: lines of JSON on its standard input."""

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
    message_class = roslib.message.get_message_class(type)
    publishers[topic] = rospy.Publisher(topic, message_class, queue_size=1000, latch=latch, tcp_nodelay=True)


def connected(topic):
    """Wait up to 20 s for a subscriber, and return the number of connections."""
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
    def append(message):
        with news:
            received[topic].append(to_plain(message))
            news.notify_all()

    received[topic] = []
    rospy.Subscriber(topic, roslib.message.get_message_class(type), append, tcp_nodelay=True)


def take(topic, count, timeout=20.0):
    """Remove and return the oldest `count` received messages, or fewer after `timeout` seconds."""
    with news:
        news.wait_for(lambda: len(received[topic]) >= count, timeout)
        messages, received[topic][:count] = received[topic][:count], []
        return messages


def forget(topic):
    received[topic].clear()


def serve(service, type, answers):
    """Answer each call with the next of `answers`. None makes the call fail."""
    service_class = roslib.message.get_service_class(type)

    def handle(request):
        values = answers.pop(0)
        if values is None:
            raise rospy.ServiceException("told to fail")
        return service_class._response_class(**values)

    rospy.Service(service, service_class, handle)


def act(action, type):
    """Serve an actionlib/Test: publish the numbers below the goal as feedback, then succeed. Abort a goal of 13."""
    import actionlib

    def execute(goal):
        for number in range(goal.goal):
            if server.is_preempt_requested():
                return server.set_preempted(action_class().action_result.result.__class__(-number))
            server.publish_feedback(action_class().action_feedback.feedback.__class__(number))
            time.sleep(0.02)
        finish = server.set_aborted if goal.goal == 13 else server.set_succeeded
        return finish(action_class().action_result.result.__class__(goal.goal))

    action_class = roslib.message.get_message_class(type)
    servers[action] = server = actionlib.SimpleActionServer(action, action_class, execute, auto_start=False)
    server.start()


def seek(action, type, goal):
    """Send a goal."""
    import actionlib

    action_class = roslib.message.get_message_class(type)
    client = servers.setdefault(action, None) or actionlib.SimpleActionClient(action, action_class)
    servers[action] = client
    received[action] = []
    if not client.wait_for_server(rospy.Duration(10)):
        return "no server"
    message = action_class().action_goal.goal
    genpy.message.fill_message_args(message, [goal])
    client.send_goal(message, feedback_cb=lambda feedback: received[action].append(to_plain(feedback)))
    return True


def cancel(action):
    servers[action].cancel_goal()


def state(action):
    return servers[action].get_state()


def outcome(action):
    """Return the status, the result and all feedback."""
    client = servers[action]
    client.wait_for_result(rospy.Duration(20))
    return [client.get_state(), to_plain(client.get_result()), received[action]]


def to_plain(value):
    if isinstance(value, genpy.Message):
        return {name: to_plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, genpy.rostime.TVal):
        return {"secs": value.secs, "nsecs": value.nsecs}
    if isinstance(value, (list, tuple)):
        return [to_plain(item) for item in value]
    return list(value) if isinstance(value, bytes) else value


if __name__ == "__main__":
    main()
