"""A mobile manipulator: three times, it waits for a finished part, drives to the machine and takes the part.

Uses DDS with the names of ROS 2, like a ROS 2 node, and contains no shmgen code. With ROS 2 installed it would be a
node of rclpy. Here PyPI's cyclonedds is enough.
"""

import os
import sys
import time
from dataclasses import dataclass

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import byte, float32, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

WAITING, DRIVING, TAKING = 0, 1, 2
FINISHED = 2
PARTS = 3
XCDR1 = Policy.DataRepresentation(use_cdrv0_representation=True)  # the only representation that ROS 2 uses
RELIABLE = Qos(XCDR1, Policy.Reliability.Reliable(1_000_000_000), Policy.History.KeepLast(10))
LATCHED = Qos(
    XCDR1, Policy.Reliability.Reliable(1_000_000_000), Policy.Durability.TransientLocal, Policy.History.KeepLast(1)
)


@dataclass
class MachineState(IdlStruct, typename="machine_msgs::msg::dds_::MachineState_"):
    """machine_msgs/MachineState."""

    state_: byte  # rosidl declares uint8 to DDS as octet
    part_: uint32
    progress_: float32


@dataclass
class TenderState(IdlStruct, typename="machine_msgs::msg::dds_::TenderState_"):
    """machine_msgs/TenderState."""

    state_: byte  # rosidl declares uint8 to DDS as octet
    last_taken_part_: uint32


def main(seconds: float = 90.0) -> int:
    """Run the robot. Return 0 once it has taken three parts and the machine has begun the fourth."""
    node = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    machine = DataReader(node, Topic(node, "rt/machine/state", MachineState), qos=LATCHED)
    tender = DataWriter(node, Topic(node, "rt/machine/tender", TenderState), qos=RELIABLE)
    last_part, activity, since = 0, WAITING, time.monotonic()
    deadline = since + seconds
    while time.monotonic() < deadline:
        for state in machine.take(100):
            if not isinstance(state, MachineState):  # the machine has left
                continue
            if state.part_ > PARTS:
                print(f"   machine works on part {state.part_}: {PARTS} parts taken", flush=True)
                return 0
            if activity == WAITING and state.state_ == FINISHED and state.part_ != last_part:
                print(f"   machine: part {state.part_} is finished       robot: on my way", flush=True)
                activity, since, part = DRIVING, time.monotonic(), state.part_
        if activity == DRIVING and time.monotonic() - since > 0.4:
            activity, since = TAKING, time.monotonic()
        elif activity == TAKING and time.monotonic() - since > 0.2:
            activity, last_part = WAITING, part
            print(f"                                       robot: part {last_part} is taken", flush=True)
        tender.write(TenderState(activity, last_part))
        time.sleep(0.02)
    print(f"only {last_part} parts in {seconds} s", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
