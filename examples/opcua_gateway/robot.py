"""A robot that publishes its pose and joints 50 times a second: two ROS 2 topics, through PyPI's cyclonedds."""

import math
import os
import time
from dataclasses import dataclass

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic

XCDR1 = Policy.DataRepresentation(use_cdrv0_representation=True)  # the only representation that ROS 2 uses
RELIABLE = Qos(XCDR1, Policy.Reliability.Reliable(1_000_000_000), Policy.History.KeepLast(10))


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """builtin_interfaces/Time."""

    sec_: int32
    nanosec_: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """std_msgs/Header."""

    stamp_: Time
    frame_id_: str


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    """geometry_msgs/Point."""

    x_: float64
    y_: float64
    z_: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    """geometry_msgs/Quaternion."""

    x_: float64
    y_: float64
    z_: float64
    w_: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    """geometry_msgs/Pose."""

    position_: Point
    orientation_: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    """geometry_msgs/PoseStamped."""

    header_: Header
    pose_: Pose


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """sensor_msgs/JointState."""

    header_: Header
    name_: sequence[str]
    position_: sequence[float64]
    velocity_: sequence[float64]
    effort_: sequence[float64]


def main() -> None:
    """Publish the robot's pose and joints until the process is stopped."""
    node = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    poses = DataWriter(node, Topic(node, "rt/gateway/pose", PoseStamped), qos=RELIABLE)
    joints = DataWriter(node, Topic(node, "rt/gateway/joints", JointState), qos=RELIABLE)
    print("robot is on its way", flush=True)
    while True:
        now = time.time_ns()
        angle = now % 4_000_000_000 / 4e9 * 2 * math.pi
        header = Header(Time(*divmod(now, 10**9)), "map")
        turned = Quaternion(0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2))
        poses.write(PoseStamped(header, Pose(Point(math.cos(angle), math.sin(angle), 0.0), turned)))
        joints.write(JointState(header, ["shoulder", "elbow"], [angle, -angle], [math.pi / 2, -math.pi / 2], []))
        time.sleep(0.02)


if __name__ == "__main__":
    main()
