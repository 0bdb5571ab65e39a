"""A robot that runs tasks: a ROS 2 action server, compatible with rmw_cyclonedds, through PyPI's cyclonedds.

With ROS 2 installed this would be a node of rclpy with an ActionServer. An action consists of three services and two
topics. This robot omits the status topic, because it has no subscriber here.
"""

import math
import os
import time
import uuid
from dataclasses import dataclass
from typing import Any

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, bounded_str, byte, float32, float64, int32, int64, sequence, uint32, uint64
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

ACTION = "robot/run_task/_action"
FASTEST = 0.5  # m/s
PERIOD = 0.05  # s between two feedback messages
SUCCEEDED, CANCELED = 4, 5  # numbers of action_msgs/GoalStatus
QUALITY = Qos(
    Policy.DataRepresentation(use_cdrv0_representation=True),  # the only representation that ROS 2 uses
    Policy.Reliability.Reliable(1_000_000_000),
    Policy.History.KeepLast(10),
)


@dataclass
class UUID(IdlStruct, typename="unique_identifier_msgs::msg::dds_::UUID_"):
    """unique_identifier_msgs/UUID."""

    uuid_: array[byte, 16]


@dataclass
class Stamp(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """builtin_interfaces/Time."""

    sec_: int32
    nanosec_: uint32


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    """geometry_msgs/Point."""

    x_: float64
    y_: float64
    z_: float64


@dataclass
class Goal(IdlStruct, typename="robot_msgs::action::dds_::RunTask_Goal_"):
    """The goal of RunTask.action."""

    origin_: Point
    target_: Point
    speed_: float32
    tool_: bounded_str[32]


@dataclass
class Result(IdlStruct, typename="robot_msgs::action::dds_::RunTask_Result_"):
    """The result of RunTask.action."""

    length_: float32
    message_: bounded_str[80]


@dataclass
class Feedback(IdlStruct, typename="robot_msgs::action::dds_::RunTask_Feedback_"):
    """The feedback of RunTask.action."""

    fraction_: float32


@dataclass
class Info(IdlStruct, typename="action_msgs::msg::dds_::GoalInfo_"):
    """action_msgs/GoalInfo."""

    goal_id_: UUID
    stamp_: Stamp


# The messages that ROS 2 derives from an action. The first two members of a request and its reply identify the call.


@dataclass
class SendGoal(IdlStruct, typename="robot_msgs::action::dds_::RunTask_SendGoal_Request_"):
    client_guid_: uint64
    sequence_number_: int64
    goal_id_: UUID
    goal_: Goal


@dataclass
class Accepted(IdlStruct, typename="robot_msgs::action::dds_::RunTask_SendGoal_Response_"):
    client_guid_: uint64
    sequence_number_: int64
    accepted_: bool
    stamp_: Stamp


@dataclass
class Cancel(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Request_"):
    client_guid_: uint64
    sequence_number_: int64
    goal_info_: Info


@dataclass
class Canceling(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Response_"):
    client_guid_: uint64
    sequence_number_: int64
    return_code_: byte
    goals_canceling_: sequence[Info]


@dataclass
class GetResult(IdlStruct, typename="robot_msgs::action::dds_::RunTask_GetResult_Request_"):
    client_guid_: uint64
    sequence_number_: int64
    goal_id_: UUID


@dataclass
class Outcome(IdlStruct, typename="robot_msgs::action::dds_::RunTask_GetResult_Response_"):
    client_guid_: uint64
    sequence_number_: int64
    status_: byte
    result_: Result


@dataclass
class Progress(IdlStruct, typename="robot_msgs::action::dds_::RunTask_FeedbackMessage_"):
    goal_id_: UUID
    feedback_: Feedback


class Service:
    """The server of a ROS 2 service."""

    def __init__(self, node: DomainParticipant, name: str, request: type, response: type) -> None:
        server_id = f"serviceid={'.'.join(f'{byte:x}' for byte in uuid.uuid4().bytes)};"  # for rmw_cyclonedds
        qos = Qos(Policy.Userdata(server_id.encode()), base=QUALITY)
        self.writer = DataWriter(node, Topic(node, f"rr/{ACTION}/{name}Reply", response), qos)
        self._reader = DataReader(node, Topic(node, f"rq/{ACTION}/{name}Request", request), qos)
        self._response = response

    def requests(self) -> list[Any]:
        """Return the new requests."""
        return [sample for sample in self._reader.take(10) if not isinstance(sample, InvalidSample)]

    def reply(self, request: Any, *values: Any) -> None:
        """Send the reply to a request."""
        self.writer.write(self._response(request.client_guid_, request.sequence_number_, *values))


class Robot:
    """Runs the tasks that the PLC requests through the action, one task at a time.

    A new task would replace the current task, so the PLC sends no task before the current task ends.
    """

    def __init__(self, node: DomainParticipant) -> None:
        self.goals = Service(node, "send_goal", SendGoal, Accepted)
        self.cancels = Service(node, "cancel_goal", Cancel, Canceling)
        self.results = Service(node, "get_result", GetResult, Outcome)
        self.progress = DataWriter(node, Topic(node, f"rt/{ACTION}/feedback", Progress), QUALITY)
        self.waiting: list[GetResult] = []
        self.task: SendGoal | None = None
        self.outcome: tuple[int, Result] | None = None
        self.begun = self.due = 0.0

    def step(self) -> None:
        """Handle all new requests, and continue the current task by one step."""
        for request in self.goals.requests():
            accepted = request.goal_.speed_ <= FASTEST
            if accepted:
                self.task, self.outcome, self.begun = request, None, time.monotonic()
            else:
                print(f"   robot: {request.goal_.speed_:.2f} m/s is too fast for the {request.goal_.tool_}", flush=True)
            self.goals.reply(request, accepted, Stamp(0, 0))
        self.waiting += self.results.requests()
        cancels = self.cancels.requests()
        if self.task and self.outcome is None:
            self.move(self.task.goal_, bool(cancels))
        for request in cancels:
            self.cancels.reply(request, 0, [request.goal_info_])
        if self.outcome:
            for request in self.waiting:
                self.results.reply(request, *self.outcome)
            self.waiting.clear()

    def move(self, goal: Goal, cancel: bool) -> None:
        """Move along the seam until its end or until the task is cancelled."""
        length = math.dist(*((point.x_, point.y_, point.z_) for point in (goal.origin_, goal.target_)))
        done = min(length, (time.monotonic() - self.begun) * goal.speed_)
        if time.monotonic() >= self.due and self.task:
            self.due = time.monotonic() + PERIOD
            self.progress.write(Progress(self.task.goal_id_, Feedback(done / length)))
        if cancel or done >= length:
            message = f"{goal.tool_}: {done:.2f} of {length:.2f} m at {goal.speed_:.2f} m/s"
            print(f"   robot: {message}", flush=True)
            self.outcome = (CANCELED if cancel else SUCCEEDED, Result(done, message))


def main() -> None:
    """Run the robot until the process is stopped."""
    robot = Robot(DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0"))))
    print("robot waits for tasks", flush=True)
    while True:
        robot.step()
        time.sleep(0.005)


if __name__ == "__main__":
    main()
