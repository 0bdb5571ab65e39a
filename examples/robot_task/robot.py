"""A robot that runs tasks on request: a ROS 2 service, compatible with rmw_cyclonedds, through PyPI's cyclonedds.

With ROS 2 installed this would be a node of rclpy with `create_service`.
"""

import math
import os
import time
import uuid
from dataclasses import dataclass

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import bounded_str, float32, float64, int64, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

XCDR1 = Policy.DataRepresentation(use_cdrv0_representation=True)  # the only representation that ROS 2 uses
ID = f"serviceid={'.'.join(f'{byte:x}' for byte in uuid.uuid4().bytes)};"  # of the server, for rmw_cyclonedds
SERVICE = Qos(
    XCDR1,
    Policy.Reliability.Reliable(1_000_000_000),
    Policy.History.KeepLast(10),
    Policy.Userdata(ID.encode()),
)
FASTEST = 0.5  # m/s


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    """geometry_msgs/Point."""

    x_: float64
    y_: float64
    z_: float64


@dataclass
class Request(IdlStruct, typename="robot_msgs::srv::dds_::RunTask_Request_"):
    """The request of robot_msgs/RunTask, after the two members that identify the call."""

    client_guid_: uint64
    sequence_number_: int64
    origin_: Point
    target_: Point
    speed_: float32
    tool_: bounded_str[32]


@dataclass
class Response(IdlStruct, typename="robot_msgs::srv::dds_::RunTask_Response_"):
    """The response of robot_msgs/RunTask, after the same two members."""

    client_guid_: uint64
    sequence_number_: int64
    done_: bool
    seconds_: float32
    message_: bounded_str[80]


def main() -> None:
    """Run the robot until the process is stopped."""
    node = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    replies = DataWriter(node, Topic(node, "rr/robot/run_taskReply", Response), qos=SERVICE)
    requests = DataReader(node, Topic(node, "rq/robot/run_taskRequest", Request), qos=SERVICE)
    print("robot waits for tasks", flush=True)
    while True:
        for request in requests.take(10):
            if not isinstance(request, Request):  # a client has left
                continue
            done, seconds, message = run(request)
            print(f"   robot: {message}", flush=True)
            replies.write(Response(request.client_guid_, request.sequence_number_, done, seconds, message))
        time.sleep(0.005)


def run(task: Request) -> tuple[bool, float, str]:
    """Run a task. Return True if the task was done, with its duration in seconds and a message."""
    if task.speed_ > FASTEST:
        return False, 0.0, f"{task.speed_:.2f} m/s is too fast for the {task.tool_}"
    length = math.dist(*((point.x_, point.y_, point.z_) for point in (task.origin_, task.target_)))
    time.sleep(length / task.speed_)
    return True, length / task.speed_, f"{task.tool_}: {length:.2f} m at {task.speed_:.2f} m/s"


if __name__ == "__main__":
    main()
