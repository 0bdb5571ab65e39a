"""Imitates `ros2 run demo_nodes_cpp talker` and `ros2 topic echo` on a machine without ROS 2.

Uses DDS with the names of ROS 2, like a ROS 2 node. It contains no shmgen code.
"""

import os
import sys
import time
from dataclasses import dataclass

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

WORDS = 5
TIMEOUT = 20.0  # s
RELIABLE = Qos(Policy.Reliability.Reliable(1_000_000_000), Policy.History.KeepLast(10))


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    """std_msgs/String."""

    data_: str


@dataclass
class UInt32(IdlStruct, typename="std_msgs::msg::dds_::UInt32_"):
    """std_msgs/UInt32."""

    data_: uint32


def main() -> int:
    """Send words to the PLC. Return 0 once it has repeated all, and a late subscriber has received its last count."""
    node = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    talker = DataWriter(node, Topic(node, "rt/chatter", String), RELIABLE)
    listener = DataReader(node, Topic(node, "rt/plc/echo", String), RELIABLE)
    deadline = time.monotonic() + TIMEOUT
    while not (talker.get_matched_subscriptions() and listener.get_matched_publications()):
        if time.monotonic() > deadline:
            print("   no subscriber in this domain")
            return 1
        time.sleep(0.05)
    time.sleep(0.5)  # this participant has matched; the bridge may need longer
    for number in range(1, WORDS + 1):
        talker.write(String(f"Hello World: {number}"))
        print(f"   talker: Hello World: {number}       PLC: {listener.take_one(timeout=10**10).data_}", flush=True)
        time.sleep(0.2)
    late = Qos(Policy.Durability.TransientLocal, base=RELIABLE)
    count = DataReader(node, Topic(node, "rt/plc/count", UInt32), late).take_one(timeout=10**10)
    print(f"   a late subscriber receives the last count: {count.data_}", flush=True)
    return 0 if count.data_ == WORDS else 1


if __name__ == "__main__":
    sys.exit(main())
