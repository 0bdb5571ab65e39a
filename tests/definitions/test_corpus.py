"""Read all real definitions except known faults, and compare the number of fixed-size messages with other counts."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from shmgen.core.diagnostics import Rejected, Report
from shmgen.core.model import Array, Ref, Schema, Sequence, String, TypeName
from shmgen.definitions import Sources, load, open_library
from tests.conftest import SHARED
from tests.definitions.test_idl import HAS_ROSIDL

CORPUS = SHARED / "corpus"

pytestmark = pytest.mark.skipif(not CORPUS.is_dir(), reason="no corpus of real definitions at ../shared/corpus")

OTHER_PACKAGES = {"control_msgs", "px4_msgs", "ur_msgs", "industrial_msgs"}
FOR_TESTS = {"test_msgs", "test_interface_files", "rosbag2_test_msgdefs", "rosbag2_performance_benchmarking_msgs"}

REJECTED = {
    # rosidl_adapter (3.3.1 and the newest) also rejects the capital in `robot_voltage_48V`.
    "ur_msgs/msg/MasterboardDataMsg": "SHM202",
    # ROS copies test_msgs/BasicTypes from test_interface_files at build time; the corpus lacks this message.
    "test_msgs/action/NestedMessage_Goal": "SHM004",
    "test_msgs/action/NestedMessage_Result": "SHM004",
    "test_msgs/action/NestedMessage_Feedback": "SHM004",
}

NEEDS_IDL = {
    # These messages or their fields are defined only in .idl files.
    "rosbag2_test_msgdefs/msg/BasicIdl",
    "rosbag2_test_msgdefs/msg/ComplexIdl",
    "rosbag2_test_msgdefs/msg/ComplexMsgDependsOnIdl",
    "rosbag2_test_msgdefs/srv/ComplexSrvIdl_Request",
    "rosbag2_test_msgdefs/srv/ComplexSrvIdl_Response",
    "rosbag2_test_msgdefs/srv/ComplexSrvIdl_Reply",
}


def packages(distribution: str) -> list[str]:
    return sorted(folder.name for folder in (CORPUS / distribution).iterdir())


def read(distribution: str, *requests: str) -> Schema:
    return load(open_library(Sources((CORPUS / distribution,), distribution, CORPUS), Report()), requests, Report())


@pytest.mark.parametrize("distribution", ["jazzy", "noetic"])
def test_all_definitions_except_known_faults_are_read(distribution):
    rejected = {}
    try:
        read(distribution, *packages(distribution))
    except Rejected as caught:
        for finding in caught.diagnostics:
            kind = Path(finding.span.path).parts[-2]
            rejected[finding.field.rpartition(".")[0].replace("/", f"/{kind}/")] = finding.code
    without_rosidl = {} if HAS_ROSIDL else {"": "SHM008"}
    assert rejected == ({**REJECTED, **without_rosidl} if distribution == "jazzy" else {})


def ranking(schema: Schema) -> dict[tuple[str, str, str], str]:
    """Return the worst rank in each interface file and its nested messages. A bounded string is also a string."""
    ranks = ("fixed", "string", "bounded sequence", "unbounded sequence")
    worst: dict[TypeName, int] = {}
    for message in schema.messages:
        rank = 0
        for field in message.fields:
            element = field.type
            if isinstance(element, Sequence):
                rank = max(rank, 2 if element.capacity else 3)
            if isinstance(element, Array | Sequence):
                element = element.element
            rank = max(rank, worst[element.name] if isinstance(element, Ref) else int(isinstance(element, String)))
        worst[message.name] = rank
    by_file: dict[tuple[str, str, str], int] = {}
    for name, rank in worst.items():
        file = name.package, name.kind, name.name if name.kind == "msg" else name.name.rpartition("_")[0]
        by_file[file] = max(rank, by_file.get(file, 0))
    return {file: ranks[rank] for file, rank in by_file.items()}


@pytest.mark.parametrize(
    ("distribution", "leave_out", "kinds", "counts"),
    [
        ("jazzy", OTHER_PACKAGES | FOR_TESTS, (188, 45, 2), (77, 61, 1, 96)),
        ("noetic", set(), (154, 29, 3), (44, 66, 0, 76)),
        ("jazzy", None, (226, 1, 0), (227, 0, 0, 0)),
    ],
    ids=["jazzy core", "noetic", "px4_msgs"],
)
def test_number_of_messages_with_fixed_size(distribution, leave_out, kinds, counts):
    chosen = {"px4_msgs"} if leave_out is None else set(packages(distribution)) - leave_out
    files = {file: rank for file, rank in ranking(read(distribution, *sorted(chosen))).items() if file[0] in chosen}
    assert tuple(Counter(file[1] for file in files)[kind] for kind in ("msg", "srv", "action")) == kinds
    ranks = ("fixed", "string", "bounded sequence", "unbounded sequence")
    assert tuple(Counter(files.values())[rank] for rank in ranks) == counts
