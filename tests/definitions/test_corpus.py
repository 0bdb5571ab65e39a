"""Real definitions: all are read, as rosbags reads them where rosbags is right, and sort as the design says."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from rosbags.typesys import get_types_from_msg

from shmgen.definitions import Sources, load
from shmgen.definitions.parser import Source, parse
from shmgen.diagnostics import Rejected, Report
from shmgen.model import Array, Message, Ref, Schema, Sequence, String, TypeName
from tests.conftest import SHARED
from tests.definitions import compare

CORPUS = SHARED / "corpus"

pytestmark = pytest.mark.skipif(not CORPUS.is_dir(), reason="no corpus of real definitions at ../shared/corpus")

DIALECT = {"jazzy": "ros2", "noetic": "ros1"}
BESIDE_CORE = {"control_msgs", "px4_msgs", "ur_msgs", "industrial_msgs"}
FOR_TESTS = {"test_msgs", "test_interface_files", "rosbag2_test_msgdefs", "rosbag2_performance_benchmarking_msgs"}

REJECTED = {
    # rosidl_adapter (3.3.1 and the newest) rejects it likewise: a capital in `robot_voltage_48V`.
    "ur_msgs/msg/MasterboardDataMsg": "SHM202",
    # They hold rosbag2_test_msgdefs/BasicIdl, which exists as .idl only.
    "rosbag2_test_msgdefs/msg/ComplexMsgDependsOnIdl": "SHM004",
    "rosbag2_test_msgdefs/srv/ComplexSrvIdl_Request": "SHM004",
    "rosbag2_test_msgdefs/srv/ComplexSrvIdl_Response": "SHM004",
    # ROS copies test_msgs/BasicTypes from test_interface_files while it builds; the corpus does not.
    "test_msgs/action/NestedMessage_Goal": "SHM004",
    "test_msgs/action/NestedMessage_Result": "SHM004",
    "test_msgs/action/NestedMessage_Feedback": "SHM004",
}


def packages(distribution: str) -> list[str]:
    return sorted(folder.name for folder in (CORPUS / distribution).iterdir())


def read(distribution: str, *requests: str) -> Schema:
    return load(requests, Sources((CORPUS / distribution,), distribution, CORPUS), Report())


def files(distribution: str) -> list[Path]:
    return sorted((CORPUS / distribution).glob("*/msg/*.msg"))


def parsed(file: Path) -> tuple[Message, ...]:
    distribution, package, kind, _ = file.relative_to(CORPUS).parts
    source = Source(TypeName(package, kind, file.stem), file.read_text(), file.name, "")
    return parse(source, DIALECT[distribution], Report())


@pytest.mark.parametrize("distribution", DIALECT)
def test_all_is_read_but_for_those_named(distribution):
    rejected = {}
    try:
        read(distribution, *packages(distribution))
    except Rejected as rejection:
        for finding in rejection.diagnostics:
            kind = Path(finding.span.path).parts[-2]
            rejected[finding.field.rpartition(".")[0].replace("/", f"/{kind}/")] = finding.code
    assert rejected == (REJECTED if distribution == "jazzy" else {})


UNLIKE_ROSBAGS = {
    # rosbags 0.11.9 takes wstring for the name of a message.
    "jazzy": {"example_interfaces/WString", "test_interface_files/WStrings"},
    "noetic": set(),
}


@pytest.mark.parametrize(("distribution", "compared"), [("jazzy", 469), ("noetic", 154)])
def test_messages_are_what_rosbags_reads(distribution, compared):
    unlike = set()
    messages = [(file, message) for file in files(distribution) for message in parsed(file)]
    messages = [(file, message) for file, message in messages if REJECTED.get(str(message.name)) != "SHM202"]
    for file, message in messages:
        theirs = get_types_from_msg(file.read_text(), str(message.name))[str(message.name)]
        if compare.ours(message) != compare.rosbags(theirs, DIALECT[distribution]):
            unlike.add(message.name.short)
    assert unlike == UNLIKE_ROSBAGS[distribution]
    assert len(messages) == compared


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
