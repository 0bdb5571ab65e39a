"""Real definitions: all are read but for those named, and as many are of fixed size as other counts say."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from shmgen.core.diagnostics import Rejected, Report
from shmgen.core.model import Array, Ref, Schema, Sequence, String, TypeName
from shmgen.definitions import Sources, load
from tests.conftest import SHARED
from tests.definitions.test_idl import HAS_ROSIDL

CORPUS = SHARED / "corpus"

pytestmark = pytest.mark.skipif(not CORPUS.is_dir(), reason="no corpus of real definitions at ../shared/corpus")

BESIDE_CORE = {"control_msgs", "px4_msgs", "ur_msgs", "industrial_msgs"}
FOR_TESTS = {"test_msgs", "test_interface_files", "rosbag2_test_msgdefs", "rosbag2_performance_benchmarking_msgs"}

REJECTED = {
    # rosidl_adapter (3.3.1 and the newest) rejects it likewise: a capital in `robot_voltage_48V`.
    "ur_msgs/msg/MasterboardDataMsg": "SHM202",
    # ROS copies test_msgs/BasicTypes from test_interface_files while it builds; the corpus does not.
    "test_msgs/action/NestedMessage_Goal": "SHM004",
    "test_msgs/action/NestedMessage_Result": "SHM004",
    "test_msgs/action/NestedMessage_Feedback": "SHM004",
}

NEEDS_IDL = {
    # Of these, or of what they hold, there is only .idl.
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
    return load(requests, Sources((CORPUS / distribution,), distribution, CORPUS), Report())


@pytest.mark.parametrize("distribution", ["jazzy", "noetic"])
def test_all_is_read_but_for_those_named(distribution):
    rejected = {}
    try:
        read(distribution, *packages(distribution))
    except Rejected as rejection:
        for finding in rejection.diagnostics:
            kind = Path(finding.span.path).parts[-2]
            rejected[finding.field.rpartition(".")[0].replace("/", f"/{kind}/")] = finding.code
    without_rosidl = {} if HAS_ROSIDL else {"": "SHM008"}
    assert rejected == ({**REJECTED, **without_rosidl} if distribution == "jazzy" else {})


def classes(schema: Schema) -> dict[tuple[str, str, str], str]:
    """Interface file -> the worst that it, or anything it holds, has in it; a bounded string is a string too."""
    ranks = ("fixed", "string", "bounded sequence", "unbounded sequence")
    worst: dict[TypeName, int] = {}
    for message in schema.messages:
        found = 0
        for field in message.fields:
            element = field.type
            if isinstance(element, Sequence):
                found = max(found, 2 if element.capacity else 3)
            if isinstance(element, Array | Sequence):
                element = element.element
            found = max(found, worst[element.name] if isinstance(element, Ref) else int(isinstance(element, String)))
        worst[message.name] = found
    by_file: dict[tuple[str, str, str], int] = {}
    for name, found in worst.items():
        file = name.package, name.kind, name.name if name.kind == "msg" else name.name.rpartition("_")[0]
        by_file[file] = max(found, by_file.get(file, 0))
    return {file: ranks[found] for file, found in by_file.items()}


@pytest.mark.parametrize(
    ("distribution", "leave_out", "kinds", "counts"),
    [
        ("jazzy", BESIDE_CORE | FOR_TESTS, (188, 45, 2), (77, 61, 1, 96)),
        ("noetic", set(), (154, 29, 3), (44, 66, 0, 76)),
        ("jazzy", None, (226, 1, 0), (227, 0, 0, 0)),
    ],
    ids=["jazzy core", "noetic", "px4_msgs"],
)
def test_how_many_have_a_fixed_size(distribution, leave_out, kinds, counts):
    wanted = {"px4_msgs"} if leave_out is None else set(packages(distribution)) - leave_out
    found = {file: rank for file, rank in classes(read(distribution, *sorted(wanted))).items() if file[0] in wanted}
    assert tuple(Counter(file[1] for file in found)[kind] for kind in ("msg", "srv", "action")) == kinds
    ranks = ("fixed", "string", "bounded sequence", "unbounded sequence")
    assert tuple(Counter(found.values())[rank] for rank in ranks) == counts
