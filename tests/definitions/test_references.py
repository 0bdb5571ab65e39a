"""Compare how shmgen and ROS's own implementations read all real definitions; each difference has a reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import pytest

from shmgen.core.diagnostics import Report
from shmgen.core.model import TypeName
from shmgen.definitions import catalogue, parser
from shmgen.definitions.tokens import Dialect
from tests.conftest import SHARED
from tests.definitions import references
from tests.definitions.references import Answer, Definition, MessageInfo, Refusal

CORPUS = SHARED / "corpus"

pytestmark = pytest.mark.skipif(not CORPUS.is_dir(), reason="no corpus of real definitions at ../shared/corpus")


class Difference(NamedTuple):
    """The `places` where these references differ from shmgen. Each place must still differ."""

    references: set[str]
    places: set[str]
    why: str


ROSIDL = {"rosidl_adapter", "rosidl_parser"}

DIFFERENCES = [
    Difference(
        ROSIDL,
        {
            "px4_msgs/msg/SatelliteInfo.svid unit",
            "px4_msgs/msg/TecsStatus.fast_descend_ratio unit",
            "visualization_msgs/msg/ImageMarker.fill_color unit",
            "visualization_msgs/msg/Marker.color unit",
            "visualization_msgs/msg/Marker.uv_coordinates unit",
        },
        "a range, `[0.0-1.0]` or `[1..255]`, is no unit",
    ),
    Difference(
        ROSIDL,
        {
            "sensor_msgs/msg/CompressedImage.format unit",
            "sensor_msgs/msg/LaserScan.intensities unit",
            "sensor_msgs/msg/MultiEchoLaserScan.intensities unit",
            "visualization_msgs/msg/Marker.texture_resource unit",
        },
        "words and addresses in brackets are no units",
    ),
    Difference(
        {"rosbags"},
        {
            "example_interfaces/msg/WString.data type",
            "test_interface_files/msg/WStrings.array_of_wstrings type",
            "test_interface_files/msg/WStrings.bounded_sequence_of_wstrings type",
            "test_interface_files/msg/WStrings.unbounded_sequence_of_wstrings type",
            "test_interface_files/msg/WStrings.wstring_value type",
            "test_interface_files/msg/WStrings.wstring_value_default1 type",
            "test_interface_files/msg/WStrings.wstring_value_default2 type",
            "test_interface_files/msg/WStrings.wstring_value_default3 type",
        },
        "rosbags takes wstring for the name of a message",
    ),
    Difference(
        {"rosbags"},
        {"ur_msgs/msg/MasterboardDataMsg taken"},
        "rosbags takes a capital in the name of a field; rosidl_adapter refuses it as we do",
    ),
]

COMPARED = {"jazzy": {"msg": 470, "srv": 64, "action": 11}, "noetic": {"msg": 154, "srv": 29, "action": 3}}


def definitions(distribution: str) -> list[Definition]:
    result = []
    for kind, count in COMPARED[distribution].items():
        files = sorted(CORPUS.glob(f"{distribution}/*/{kind}/*.{kind}"))
        assert len(files) == count
        result += [Definition(file.parts[-3], kind, file.stem, file.read_text(encoding="utf-8")) for file in files]
    return result


def read_with_shmgen(definition: Definition, dialect: Dialect) -> tuple[Answer, list[str]]:
    """Return the messages that shmgen reads, or a refusal, and the texts of the parts."""
    report = Report()
    name = TypeName(definition.package, definition.kind, definition.name)
    messages = parser.parse(catalogue.Definition(name, "", "", definition.text), definition.text, dialect, report)
    user_written = {name.name + ending for ending in references.ENDINGS[name.kind]}
    messages = tuple(message for message in messages if message.name.name in user_written)
    texts = [message.text for message in messages]
    return (
        Refusal(report.diagnostics[0].code, False)
        if report.diagnostics
        else tuple(references.from_shmgen(message) for message in messages)
    ), texts


def differences(own: Answer, other_answer: Answer, name: str, with_defaults: bool) -> set[str]:
    """Return the places that differ, such as `demo_msgs/msg/Foo.speed unit`."""
    match own, other_answer:
        case Refusal(), Refusal():
            return set()
        case Refusal(), _:
            return {f"{name} taken"}
        case _, Refusal():
            return {f"{name} refused"}
    places: set[str] = set()
    for ours, theirs in zip(own, other_answer, strict=True):
        places |= message_differences(ours if with_defaults else references.without_defaults(ours), theirs)
    return places


def message_differences(ours: MessageInfo, theirs: MessageInfo) -> set[str]:
    places = set()
    for kind in ("fields", "constants"):
        one, other = ({item.name: item for item in getattr(message, kind)} for message in (ours, theirs))
        if list(one) != list(other) or ours.name != theirs.name:
            places.add(f"{ours.name} {kind}")
        for name in one.keys() & other.keys():
            parts = zip(one[name]._fields, one[name], other[name], strict=True)
            places |= {f"{ours.name}.{name} {part}" for part, a, b in parts if repr(a) != repr(b)}
    return places


def check(
    distribution: str, dialect: Dialect, reference: str, run: Callable[[Sequence[Definition], list], list[Answer]]
) -> None:
    inputs = definitions(distribution)
    own, texts = zip(*(read_with_shmgen(definition, dialect) for definition in inputs), strict=True)
    places: set[str] = set()
    for definition, ours, theirs in zip(inputs, own, run(inputs, list(texts)), strict=True):
        places |= differences(ours, theirs, "/".join(definition[:3]), reference in ROSIDL)
    expected = {place for row in DIFFERENCES if reference in row.references for place in row.places}
    assert places == (expected if dialect == "ros2" else set())


@pytest.mark.parametrize(("distribution", "dialect"), [("jazzy", "ros2"), ("noetic", "ros1")])
def test_corpus_matches_rosbags(distribution: str, dialect: Dialect) -> None:
    check(distribution, dialect, "rosbags", lambda inputs, texts: references.run_rosbags(inputs, texts, dialect))


needs_rosidl = pytest.mark.skipif(
    references.interpreter("by_rosidl.py") is None, reason="rosidl_adapter is missing: apt-get install python3-rosidl"
)
needs_genmsg = pytest.mark.skipif(
    references.interpreter("by_genmsg.py") is None, reason="genmsg is missing: apt-get install python3-genmsg"
)


@needs_rosidl
def test_corpus_matches_rosidl_adapter() -> None:
    check("jazzy", "ros2", "rosidl_adapter", lambda inputs, _: references.run_rosidl_adapter(inputs))


@pytest.mark.exhaustive
@needs_rosidl
def test_corpus_matches_rosidl_parser() -> None:
    check("jazzy", "ros2", "rosidl_parser", lambda inputs, _: references.run_rosidl_parser(inputs, comments=False))


@needs_genmsg
def test_corpus_matches_genmsg() -> None:
    check("noetic", "ros1", "genmsg", lambda inputs, _: references.run_genmsg(inputs))


def test_comparison_detects_a_difference() -> None:
    """Change each of the four parts of a field, and a constant."""
    field = references.FieldInfo("speed", "float64", 1.0, "m/s")
    one = MessageInfo("demo_msgs/msg/Foo", (field,), (references.ConstantInfo("MOST", "uint8", 1),))
    for change in ({"name": "s"}, {"type": "float32"}, {"default": 1}, {"unit": ""}):
        assert message_differences(one, one._replace(fields=(field._replace(**change),)))
    assert message_differences(one, one._replace(constants=(one.constants[0]._replace(value=True),)))
    assert message_differences(one, one) == set()
