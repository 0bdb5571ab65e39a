"""A supervisor in ROS 2, as a DDS participant: reads both alarm topics and acknowledges alarms. No shmgen code."""

import os
import time
from dataclasses import dataclass

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import byte, float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

XCDR1 = Policy.DataRepresentation(use_cdrv0_representation=True)  # the only representation that ROS 2 uses
RELIABLE = Policy.Reliability.Reliable(1_000_000_000)
LATCHED = Qos(XCDR1, RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
PLAIN = Qos(XCDR1, RELIABLE, Policy.History.KeepLast(10))


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
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    """diagnostic_msgs/KeyValue."""

    key_: str
    value_: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    """diagnostic_msgs/DiagnosticStatus."""

    level_: byte
    name_: str
    message_: str
    hardware_id_: str
    values_: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    """diagnostic_msgs/DiagnosticArray."""

    header_: Header
    status_: sequence[DiagnosticStatus]


@dataclass
class Alarm(IdlStruct, typename="ros2_medkit_roxsie_msgs::msg::dds_::Alarm_"):
    """ros2_medkit_roxsie_msgs/Alarm."""

    alarm_id_: uint32
    source_: str
    alarm_class_: str
    priority_: byte  # rosidl maps uint8 to the DDS type octet
    producer_: str
    active_: bool
    acknowledged_: bool
    plc_timestamp_: Time
    associated_values_: sequence[float64]


@dataclass
class AlarmList(IdlStruct, typename="ros2_medkit_roxsie_msgs::msg::dds_::AlarmList_"):
    """ros2_medkit_roxsie_msgs/AlarmList."""

    stamp_: Time
    catalog_version_: str
    alarms_: sequence[Alarm]
    truncated_: bool


@dataclass
class UInt8(IdlStruct, typename="std_msgs::msg::dds_::UInt8_"):
    """std_msgs/UInt8."""

    data_: byte


class Supervisor:
    """Receives both alarm topics, and acknowledges alarms."""

    def __init__(self) -> None:
        self.node = node = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
        self.diagnostics = DataReader(node, Topic(node, "rt/diagnostics", DiagnosticArray), qos=LATCHED)
        self.lists = DataReader(node, Topic(node, "rt/plc/alarms", AlarmList), qos=LATCHED)
        self.acknowledged = DataWriter(node, Topic(node, "rt/alarms/acknowledge", UInt8), qos=PLAIN)
        self.last: dict[str, str] | None = None
        self.alarms: list[Alarm] = []

    def until(self, expected: dict[str, str], seconds: float = 30.0) -> float:
        """Wait until both alarm topics report the alarms `expected`, {name: message}. Return the seconds waited.

        Raises SystemExit if the state does not arrive in time.
        """
        begun = time.monotonic()
        while time.monotonic() - begun < seconds:
            for array in self.diagnostics.take(10):
                if isinstance(array, DiagnosticArray):  # otherwise the writer has left
                    self.last = {status.name_: status.message_ for status in array.status_}
            for alarms in self.lists.take(10):
                if isinstance(alarms, AlarmList):
                    self.alarms = list(alarms.alarms_)
            if self.last == expected == {alarm.source_: _message(alarm) for alarm in self.alarms}:
                return time.monotonic() - begun
            time.sleep(0.005)
        raise SystemExit(f"{seconds:g} s, and the alarm lists are {self.last} and {self.alarms}, not {expected}")

    def acknowledge(self, alarm: int) -> None:
        """Acknowledge the alarm of this number."""
        self.acknowledged.write(UInt8(alarm))


def _message(alarm: Alarm) -> str:
    acknowledged = "acknowledged" if alarm.acknowledged_ else "not acknowledged"
    return acknowledged if alarm.active_ else f"cleared, {acknowledged}"
