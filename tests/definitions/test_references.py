"""Every real definition, read here and by ROS's own implementations: equal, or a difference with its reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import pytest

from shmgen.core.diagnostics import Report
from shmgen.core.model import TypeName
from shmgen.definitions.parser import Source, parse
from shmgen.definitions.tokens import Dialect
from tests.conftest import SHARED
from tests.definitions import references
from tests.definitions.references import Answer, Definition, Read, Refused

CORPUS = SHARED / "corpus"

pytestmark = pytest.mark.skipif(not CORPUS.is_dir(), reason="no corpus of real definitions at ../shared/corpus")


class Difference(NamedTuple):
    """`places`, where these references read something else; each place must do so still."""

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
    found = []
    for kind, count in COMPARED[distribution].items():
        files = sorted(CORPUS.glob(f"{distribution}/*/{kind}/*.{kind}"))
        assert len(files) == count
        found += [Definition(file.parts[-3], kind, file.stem, file.read_text(encoding="utf-8")) for file in files]
    return found


def read_here(definition: Definition, dialect: Dialect) -> tuple[Answer, list[str]]:
    """And the texts of the parts."""
    report = Report()
    name = TypeName(definition.package, definition.kind, definition.name)
    messages = parse(Source(name, definition.text, "", ""), dialect, report)
    written = {name.name + ending for ending in references.ENDINGS[name.kind]}
    messages = tuple(message for message in messages if message.name.name in written)
    texts = [message.text for message in messages]
    return (
        Refused(report.diagnostics[0].code, False)
        if report.diagnostics
        else tuple(references.ours(message) for message in messages)
    ), texts


def differences(here: Answer, there: Answer, name: str, with_defaults: bool) -> set[str]:
    """What of the definition, such as `demo_msgs/msg/Foo.speed unit`, is not the same."""
    match here, there:
        case Refused(), Refused():
            return set()
        case Refused(), _:
            return {f"{name} taken"}
        case _, Refused():
            return {f"{name} refused"}
    found: set[str] = set()
    for ours, theirs in zip(here, there, strict=True):
        found |= unlike(ours if with_defaults else references.without_defaults(ours), theirs)
    return found


def unlike(ours: Read, theirs: Read) -> set[str]:
    found = set()
    for kind in ("fields", "constants"):
        one, other = ({item.name: item for item in getattr(read, kind)} for read in (ours, theirs))
        if list(one) != list(other) or ours.name != theirs.name:
            found.add(f"{ours.name} {kind}")
        for name in one.keys() & other.keys():
            parts = zip(one[name]._fields, one[name], other[name], strict=True)
            found |= {f"{ours.name}.{name} {part}" for part, mine, yours in parts if repr(mine) != repr(yours)}
    return found


def compare(
    distribution: str, dialect: Dialect, reference: str, read: Callable[[Sequence[Definition], list], list[Answer]]
) -> None:
    wanted = definitions(distribution)
    here, texts = zip(*(read_here(definition, dialect) for definition in wanted), strict=True)
    found: set[str] = set()
    for definition, ours, theirs in zip(wanted, here, read(wanted, list(texts)), strict=True):
        found |= differences(ours, theirs, "/".join(definition[:3]), reference in ROSIDL)
    named = {place for row in DIFFERENCES if reference in row.references for place in row.places}
    assert found == (named if dialect == "ros2" else set())


@pytest.mark.parametrize(("distribution", "dialect"), [("jazzy", "ros2"), ("noetic", "ros1")])
def test_as_rosbags_reads_it(distribution: str, dialect: Dialect) -> None:
    compare(distribution, dialect, "rosbags", lambda wanted, texts: references.rosbags(wanted, texts, dialect))


needs_rosidl = pytest.mark.skipif(
    references.interpreter("by_rosidl.py") is None, reason="no rosidl_adapter here: apt-get install python3-rosidl"
)
needs_genmsg = pytest.mark.skipif(
    references.interpreter("by_genmsg.py") is None, reason="no genmsg here: apt-get install python3-genmsg"
)


@needs_rosidl
def test_as_rosidl_adapter_reads_it() -> None:
    compare("jazzy", "ros2", "rosidl_adapter", lambda wanted, _: references.rosidl_adapter(wanted))


@pytest.mark.slow
@needs_rosidl
def test_as_rosidl_parser_reads_its_idl() -> None:
    compare("jazzy", "ros2", "rosidl_parser", lambda wanted, _: references.rosidl_parser(wanted, comments=False))


@needs_genmsg
def test_as_genmsg_reads_it() -> None:
    compare("noetic", "ros1", "genmsg", lambda wanted, _: references.genmsg(wanted))


def test_a_difference_is_seen() -> None:
    """All four parts of a field, and a constant."""
    field = references.FieldRead("speed", "float64", 1.0, "m/s")
    one = Read("demo_msgs/msg/Foo", (field,), (references.ConstantRead("MOST", "uint8", 1),))
    for change in ({"name": "s"}, {"type": "float32"}, {"default": 1}, {"unit": ""}):
        assert unlike(one, one._replace(fields=(field._replace(**change),)))
    assert unlike(one, one._replace(constants=(one.constants[0]._replace(value=True),)))
    assert unlike(one, one) == set()
