"""Each edit of a definition or a setting yields the expected severity and text in `check` and `diff`."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest

from shmgen.config import Config
from shmgen.config.entries import Bounds
from shmgen.config.file import CallEntry, TopicEntry
from shmgen.core.diagnostics import Span
from shmgen.core.model import TypeOptions
from shmgen.drift import lockfile
from shmgen.drift.compare import compare
from shmgen.drift.findings import Finding, for_people, worst
from shmgen.generator import pipeline

MESSAGES = {
    "Finger": "float32 force\nint16 id\n",
    "Hand": "uint8 grip\nFinger[2] fingers\n",
    "Arm": "string name\nHand hand\n",
    "Robot": """# A robot.
uint8 AUTO=1
string MAKER="us"
builtin_interfaces/Time stamp
bool ready
float64 speed 1.5  # [m/s]
int32[4] gears
float64[<=8] velocity
float64[<=8] effort
string<=20 label
Arm arm
""",
}

CALLS = {
    "Go.srv": "bool there\n---\nbool success\nstring<=20 message\n",
    "Move.action": "float64 position\n---\nbool there\n---\nFinger[2] fingers\n",
}


class Edit(NamedTuple):
    """An edit that replaces the lines `old` of a definition by `new`; `details` are reported for the message `of`."""

    name: str
    severity: str
    message: str
    of: str
    old: str
    new: str
    details: str


def read_edits() -> list[Edit]:
    """Read edits.txt: name, severity and message, removed and added lines, then the expected details."""
    text = (Path(__file__).parent / "edits.txt").read_text()
    matches = re.findall(
        r"^=== (.+): (\w+), ([\w.]+)(?:, (\w+))?\n((?:-.*\n)+)((?:\+.*\n)*)((?:.+\n)+)", text, re.MULTILINE
    )
    return [
        Edit(
            name,
            severity,
            message,
            of or "Robot",
            *(re.sub("^[-+]", "", lines, flags=re.MULTILINE) for lines in (old, new)),
            details,
        )
        for name, severity, message, of, old, new, details in matches
    ]


EDITS = read_edits()


def lock(folder: Path, messages: dict[str, str], **settings: object) -> lockfile.Lock:
    for name, text in messages.items():
        stem, _, kind = name.partition(".")
        file = folder / "demo_msgs" / (kind or "msg") / f"{stem}.{kind or 'msg'}"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    config = replace(Config(folder, path=(folder,), targets=("c",)), **settings)  # type: ignore[arg-type]
    text = pipeline.generate(
        config, ["demo_msgs/Robot", *(f"demo_msgs/{name.partition('.')[0]}" for name in CALLS if name in messages)]
    )[lockfile.LOCK]
    return lockfile.read(text, "layout.lock")


def details_of(message: str, findings: list[Finding]) -> str:
    (finding,) = [finding for finding in findings if f"demo_msgs/{message}" in finding.diagnostic.message.split()]
    return "\n".join(finding.diagnostic.details)


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> lockfile.Lock:
    return lock(tmp_path_factory.mktemp("before"), MESSAGES)


@pytest.fixture(scope="module")
def all_before(tmp_path_factory: pytest.TempPathFactory) -> lockfile.Lock:
    return lock(tmp_path_factory.mktemp("all_before"), MESSAGES | CALLS)


def test_edits_file_has_at_least_30_edits() -> None:
    assert len(EDITS) >= 30


@pytest.mark.parametrize("edit", EDITS, ids=[edit.name for edit in EDITS])
def test_edit_is_described_with_its_severity(edit: Edit, all_before: lockfile.Lock, tmp_path: Path) -> None:
    definitions = MESSAGES | CALLS
    assert definitions[edit.message].count(edit.old) == 1
    edited = {edit.message: definitions[edit.message].replace(edit.old, edit.new, 1)}
    findings = compare(all_before, lock(tmp_path, definitions | edited), "layout.lock")
    assert details_of(edit.of, findings) == edit.details.rstrip("\n")
    severity = worst(findings)
    assert severity is not None
    assert severity.name.lower() == edit.severity


def test_lock_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    """Accept a lock in which a field's message has its short name."""
    config = Config(tmp_path, path=(tmp_path,), targets=("c",))
    current = lock(tmp_path, MESSAGES | CALLS)
    text = pipeline.generate(config, current.requested)[lockfile.LOCK]
    earlier = re.sub(r'^(    "\d+ \w+ \w+)/\w+(/\w+(?:\[\d+\])?",)$', r"\1\2", text, flags=re.MULTILINE)
    assert (earlier.count("demo_msgs/Move_Goal"), earlier.count("demo_msgs/Finger[2]")) == (1, 2)
    assert lockfile.read(earlier, "layout.lock") == lockfile.read(text, "layout.lock")


SETTINGS = {
    "time mode": ({"types": TypeOptions(time="LTIME")}, "breaking", "stored as LTIME, was TIME"),
    "bool mode": ({"types": TypeOptions(bool="BOOL")}, "breaking", "ready   stored as BOOL, was USINT"),
    "encoding": ({"types": TypeOptions(encoding="latin-1")}, "breaking", "label      stored as latin-1, was utf-8"),
    "default capacity": ({"bounds": Bounds({}, {}, 16)}, "breaking", "arm.name   capacity 80 -> 16"),
    "overflow": ({"types": TypeOptions(overflow="truncate")}, "compatible", "overflow   error -> truncate"),
    "targets": ({"targets": ("c", "python")}, "compatible", "targets   c -> c python"),
    "a topic": (
        {"topics": (TopicEntry("/robot", "demo_msgs/Robot", "to_plc", 1, Span("")),)},
        "compatible",
        "topic /robot   none -> to_plc demo_msgs/Robot depth 1",
    ),
}


def test_service_moved_to_the_other_side_is_breaking(tmp_path: Path) -> None:
    (tmp_path / "demo_msgs" / "srv").mkdir(parents=True)
    (tmp_path / "demo_msgs" / "srv" / "Go.srv").write_text("bool there\n---\n")
    plc, ros = (CallEntry("/go", "demo_msgs/Go", server, 1.0, Span("")) for server in ("plc", "ros"))
    old, new, none = (lock(tmp_path, MESSAGES, services=services) for services in ((plc,), (ros,), ()))
    (finding,) = compare(old, new, "layout.lock")
    assert finding.severity.name == "BREAKING"
    assert finding.diagnostic.details == ("service /go   plc demo_msgs/Go -> ros demo_msgs/Go",)
    finding = compare(none, old, "layout.lock")[-1]
    assert finding.diagnostic.details == ("service /go   none -> plc demo_msgs/Go",)


@pytest.mark.parametrize(("settings", "severity", "expected"), SETTINGS.values(), ids=SETTINGS.keys())
def test_changed_setting_is_described_with_its_severity(
    settings: dict[str, object], severity: str, expected: str, before: lockfile.Lock, tmp_path: Path
) -> None:
    findings = compare(before, lock(tmp_path, MESSAGES, **settings), "layout.lock")
    assert expected in "\n".join(str(finding.diagnostic) for finding in findings)
    assert [finding.diagnostic.code for finding in findings][-1] == "SHM409" or "capacity" in expected
    worst_severity = worst(findings)
    assert worst_severity is not None
    assert worst_severity.name.lower() == severity


def test_changed_depth_of_a_topic_is_breaking(tmp_path: Path) -> None:
    old, new = (
        lock(tmp_path, MESSAGES, topics=(TopicEntry("/robot", "demo_msgs/Robot", "to_plc", depth, Span("")),))
        for depth in (1, 4)
    )
    (finding,) = compare(old, new, "layout.lock")
    assert finding.severity.name == "BREAKING"
    assert finding.diagnostic.details == (
        "topic /robot   to_plc demo_msgs/Robot depth 1 -> to_plc demo_msgs/Robot depth 4",
    )


def test_added_or_removed_message_is_reported(before: lockfile.Lock) -> None:
    fewer = {name: block for name, block in before.messages.items() if name != "demo_msgs/msg/Robot"}
    old = before._replace(requested=(), messages=fewer)
    assert [str(item.diagnostic) for item in compare(old, before, "a")] == ["a: error[SHM402]: demo_msgs/Robot is new"]
    (removal,) = compare(before, old, "b")
    assert (removal.diagnostic.code, removal.severity.name) == ("SHM401", "BREAKING")
    unrequested = before._replace(requested=())
    assert [item.severity.name for item in compare(unrequested, before, "a")] == ["COMPATIBLE"]
    assert [item.severity.name for item in compare(before, unrequested, "a")] == ["BREAKING"]


def test_message_with_another_origin_is_cosmetic(before: lockfile.Lock) -> None:
    moved = {name: block._replace(origin=f"elsewhere/{name}") for name, block in before.messages.items()}
    (finding,) = compare(before, before._replace(messages=moved), "a")
    expected = f"a: error[SHM402]: {len(moved)} messages have another origin, but did not change"
    assert (finding.severity.name, str(finding.diagnostic)) == ("COSMETIC", expected)
    assert [change.field for change in finding.changes] == [f"demo_msgs/{name}" for name in sorted(MESSAGES)]
    arm = "demo_msgs/msg/Arm"
    (finding,) = compare(before, before._replace(messages=before.messages | {arm: moved[arm]}), "a")
    assert finding.diagnostic.details == ("demo_msgs/Arm   demo_msgs/msg/Arm.msg -> elsewhere/demo_msgs/msg/Arm",)


def test_changed_unit_is_a_separate_breaking_finding(before: lockfile.Lock, tmp_path: Path) -> None:
    robot = MESSAGES["Robot"].replace("[m/s]", "[mm/s]")
    (finding,) = compare(before, lock(tmp_path, {**MESSAGES, "Robot": robot}), "layout.lock")
    assert (finding.diagnostic.code, finding.severity.name) == ("SHM410", "BREAKING")
    assert [change.kinds for change in finding.changes] == [("unit",)]


def test_messages_containing_the_edited_one_are_reported_too(before: lockfile.Lock, tmp_path: Path) -> None:
    findings = compare(before, lock(tmp_path, {**MESSAGES, "Finger": "float32 force\nint32 id\n"}), "layout.lock")
    assert [finding.name for finding in findings] == [
        f"demo_msgs/{name}" for name in ("Finger", "Arm", "Hand", "Robot")
    ]
    assert [change.field for finding in findings for change in finding.changes] == [
        "id",
        "hand.fingers[].id",
        "fingers[].id",
        "arm.hand.fingers[].id",
    ]


def test_text_lists_containing_messages_in_one_line(before: lockfile.Lock, tmp_path: Path) -> None:
    findings = compare(before, lock(tmp_path, {**MESSAGES, "Finger": "float32 force\nint32 id\n"}), "layout.lock")
    (finding,) = for_people(findings)
    assert finding.diagnostic.span.path == "demo_msgs/msg/Finger.msg"
    assert finding.diagnostic.details == (
        "id   retyped int16 -> int32",
        "changed too: 3 messages that contain it, demo_msgs/Arm, demo_msgs/Hand, demo_msgs/Robot",
    )


def test_edited_container_keeps_its_own_finding(before: lockfile.Lock, tmp_path: Path) -> None:
    hand = MESSAGES["Hand"].replace("uint8 grip", "uint16 grip")
    findings = compare(before, lock(tmp_path, {**MESSAGES, "Finger": "float32 force\n", "Hand": hand}), "layout.lock")
    assert [finding.name for finding in for_people(findings)] == ["demo_msgs/Finger", "demo_msgs/Hand"]
    assert [finding.diagnostic.details[-1] for finding in for_people(findings)] == [
        "size   8 -> 4",
        "changed too: 2 messages that contain it, demo_msgs/Arm, demo_msgs/Robot",
    ]


def test_setting_that_changes_every_message_hides_no_finding(before: lockfile.Lock, tmp_path: Path) -> None:
    findings = compare(before, lock(tmp_path, {**MESSAGES}, types=TypeOptions(bool="BOOL")), "layout.lock")
    assert "demo_msgs/Robot" in [finding.name for finding in for_people(findings)]


def test_removed_nested_field_is_reported_at_its_old_offset(before: lockfile.Lock, tmp_path: Path) -> None:
    robot = MESSAGES["Robot"].replace("bool ready", "float64[4] more\nbool ready")
    findings = compare(before, lock(tmp_path, {**MESSAGES, "Finger": "float32 force\n", "Robot": robot}), "layout.lock")
    (robot_finding,) = [finding for finding in findings if "demo_msgs/Robot" in finding.diagnostic.message]
    text_by_field = {change.field: change.text for change in robot_finding.changes}
    arm, hand, fingers, finger = (
        before.messages[f"demo_msgs/msg/{name}"].fields[field].offset
        for name, field in (("Robot", "arm"), ("Arm", "hand"), ("Hand", "fingers"), ("Finger", "id"))
    )
    assert text_by_field["arm.hand.fingers[].id"] == f"vanished from {arm + hand + fingers + finger}, was int16"
    assert text_by_field["arm"] == "moved 200 -> 240, shrank 104 -> 96"


def test_removed_topic_is_breaking(tmp_path: Path) -> None:
    topics = (TopicEntry("/robot", "demo_msgs/Robot", "to_plc", 1, Span("")),)
    old, new = (lock(tmp_path, MESSAGES, topics=entries) for entries in (topics, ()))
    (finding,) = compare(old, new, "layout.lock")
    assert finding.severity.name == "BREAKING"
    assert finding.diagnostic.details == ("topic /robot   to_plc demo_msgs/Robot depth 1 -> none",)


def test_unchanged_lock_yields_no_findings(before: lockfile.Lock) -> None:
    assert compare(before, before, "layout.lock") == []
