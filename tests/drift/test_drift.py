"""What becomes of a definition, in words: each row an edit, its severity, and what `check` and `diff` say of it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest

from shmgen.config import Config
from shmgen.config.entries import Bounds
from shmgen.config.file import ServiceEntry, TopicEntry
from shmgen.core.diagnostics import Report, Span
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
    """In a definition the lines `old` become `new`; `said` is of the message `of`."""

    name: str
    severity: str
    message: str
    of: str
    old: str
    new: str
    said: str


def edits() -> list[Edit]:
    """Those of edits.txt: name, severity and message, lines with - and +, then what is said."""
    text = (Path(__file__).parent / "edits.txt").read_text()
    found = re.findall(
        r"^=== (.+): (\w+), ([\w.]+)(?:, (\w+))?\n((?:-.*\n)+)((?:\+.*\n)*)((?:.+\n)+)", text, re.MULTILINE
    )
    return [
        Edit(
            name,
            severity,
            message,
            of or "Robot",
            *(re.sub("^[-+]", "", lines, flags=re.MULTILINE) for lines in (old, new)),
            said,
        )
        for name, severity, message, of, old, new, said in found
    ]


EDITS = edits()


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
    report = Report()
    found = lockfile.read(text, "layout.lock", report)
    report.stop_if_any()
    return found


def said_of(message: str, findings: list[Finding]) -> str:
    (found,) = [found for found in findings if f"demo_msgs/{message}" in found.diagnostic.message.split()]
    return "\n".join(found.diagnostic.details)


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> lockfile.Lock:
    return lock(tmp_path_factory.mktemp("before"), MESSAGES)


@pytest.fixture(scope="module")
def all_before(tmp_path_factory: pytest.TempPathFactory) -> lockfile.Lock:
    return lock(tmp_path_factory.mktemp("all_before"), MESSAGES | CALLS)


def test_there_are_enough() -> None:
    assert len(EDITS) >= 30


@pytest.mark.parametrize("edit", EDITS, ids=[edit.name for edit in EDITS])
def test_an_edit_is_told_in_words(edit: Edit, all_before: lockfile.Lock, tmp_path: Path) -> None:
    definitions = MESSAGES | CALLS
    assert definitions[edit.message].count(edit.old) == 1
    edited = {edit.message: definitions[edit.message].replace(edit.old, edit.new, 1)}
    found = compare(all_before, lock(tmp_path, definitions | edited), "layout.lock")
    assert said_of(edit.of, found) == edit.said.rstrip("\n")
    severity = worst(found)
    assert severity is not None
    assert severity.name.lower() == edit.severity


def test_a_lock_of_a_former_version_is_understood(tmp_path: Path) -> None:
    """Which called the message that a field holds by its short name."""
    config = Config(tmp_path, path=(tmp_path,), targets=("c",))
    now = lock(tmp_path, MESSAGES | CALLS)
    text = pipeline.generate(config, now.requested)[lockfile.LOCK]
    former = re.sub(r'^(    "\d+ \w+ \w+)/\w+(/\w+(?:\[\d+\])?",)$', r"\1\2", text, flags=re.MULTILINE)
    assert (former.count("demo_msgs/Move_Goal"), former.count("demo_msgs/Finger[2]")) == (1, 2)
    report = Report()
    assert lockfile.read(former, "layout.lock", report) == lockfile.read(text, "layout.lock", report)
    assert not report.diagnostics


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


def test_a_service_that_changes_sides_is_told(tmp_path: Path) -> None:
    (tmp_path / "demo_msgs" / "srv").mkdir(parents=True)
    (tmp_path / "demo_msgs" / "srv" / "Go.srv").write_text("bool there\n---\n")
    plc, ros = (ServiceEntry("/go", "demo_msgs/Go", server, 1.0, Span("")) for server in ("plc", "ros"))
    old, new, none = (lock(tmp_path, MESSAGES, services=services) for services in ((plc,), (ros,), ()))
    (found,) = compare(old, new, "layout.lock")
    assert found.severity.name == "BREAKING"
    assert found.diagnostic.details == ("service /go   plc demo_msgs/Go -> ros demo_msgs/Go",)
    found = compare(none, old, "layout.lock")[-1]
    assert found.diagnostic.details == ("service /go   none -> plc demo_msgs/Go",)


@pytest.mark.parametrize(("settings", "severity", "said"), SETTINGS.values(), ids=SETTINGS.keys())
def test_a_setting_is_told_in_words(
    settings: dict[str, object], severity: str, said: str, before: lockfile.Lock, tmp_path: Path
) -> None:
    found = compare(before, lock(tmp_path, MESSAGES, **settings), "layout.lock")
    assert said in "\n".join(str(one.diagnostic) for one in found)
    assert [one.diagnostic.code for one in found][-1] == "SHM409" or "capacity" in said
    most = worst(found)
    assert most is not None
    assert most.name.lower() == severity


def test_a_topic_that_changes_moves_bytes(tmp_path: Path) -> None:
    old, new = (
        lock(tmp_path, MESSAGES, topics=(TopicEntry("/robot", "demo_msgs/Robot", "to_plc", depth, Span("")),))
        for depth in (1, 4)
    )
    (found,) = compare(old, new, "layout.lock")
    assert found.severity.name == "BREAKING"
    assert found.diagnostic.details == (
        "topic /robot   to_plc demo_msgs/Robot depth 1 -> to_plc demo_msgs/Robot depth 4",
    )


def test_a_message_that_comes_or_goes(before: lockfile.Lock) -> None:
    fewer = {name: block for name, block in before.messages.items() if name != "demo_msgs/msg/Robot"}
    less = replace(before, requested=(), messages=fewer)
    assert [str(one.diagnostic) for one in compare(less, before, "a")] == ["a: error[SHM402]: demo_msgs/Robot is new"]
    (gone,) = compare(before, less, "b")
    assert (gone.diagnostic.code, gone.severity.name) == ("SHM401", "BREAKING")
    part = replace(before, requested=())
    assert [one.severity.name for one in compare(part, before, "a")] == ["COMPATIBLE"]
    assert [one.severity.name for one in compare(before, part, "a")] == ["BREAKING"]


def test_the_same_from_another_place_is_cosmetic(before: lockfile.Lock) -> None:
    moved = {name: replace(block, origin=f"elsewhere/{name}") for name, block in before.messages.items()}
    (found,) = compare(before, replace(before, messages=moved), "a")
    said = f"a: error[SHM402]: {len(moved)} messages have another origin, but did not change"
    assert (found.severity.name, str(found.diagnostic)) == ("COSMETIC", said)
    assert [change.field for change in found.changes] == [f"demo_msgs/{name}" for name in sorted(MESSAGES)]
    one = "demo_msgs/msg/Arm"
    (found,) = compare(before, replace(before, messages=before.messages | {one: moved[one]}), "a")
    assert found.diagnostic.details == ("demo_msgs/Arm   demo_msgs/msg/Arm.msg -> elsewhere/demo_msgs/msg/Arm",)


def test_a_unit_is_a_finding_of_its_own(before: lockfile.Lock, tmp_path: Path) -> None:
    robot = MESSAGES["Robot"].replace("[m/s]", "[mm/s]")
    (found,) = compare(before, lock(tmp_path, {**MESSAGES, "Robot": robot}), "layout.lock")
    assert (found.diagnostic.code, found.severity.name) == ("SHM410", "BREAKING")
    assert [change.kinds for change in found.changes] == [("unit",)]


def test_all_others_that_hold_it_are_told_too(before: lockfile.Lock, tmp_path: Path) -> None:
    found = compare(before, lock(tmp_path, {**MESSAGES, "Finger": "float32 force\nint32 id\n"}), "layout.lock")
    assert [one.name for one in found] == [f"demo_msgs/{name}" for name in ("Finger", "Arm", "Hand", "Robot")]
    assert [change.field for one in found for change in one.changes] == [
        "id",
        "hand.fingers[].id",
        "fingers[].id",
        "arm.hand.fingers[].id",
    ]


def test_in_text_the_edited_definition_is_named_and_all_that_contain_it_are_one_line(
    before: lockfile.Lock, tmp_path: Path
) -> None:
    found = compare(before, lock(tmp_path, {**MESSAGES, "Finger": "float32 force\nint32 id\n"}), "layout.lock")
    (only,) = for_people(found)
    assert only.diagnostic.span.path == "demo_msgs/msg/Finger.msg"
    assert only.diagnostic.details == (
        "id   retyped int16 -> int32",
        "changed too: 3 messages that contain it, demo_msgs/Arm, demo_msgs/Hand, demo_msgs/Robot",
    )


def test_a_message_that_was_edited_itself_is_not_folded_into_one_that_it_contains(
    before: lockfile.Lock, tmp_path: Path
) -> None:
    hand = MESSAGES["Hand"].replace("uint8 grip", "uint16 grip")
    found = compare(before, lock(tmp_path, {**MESSAGES, "Finger": "float32 force\n", "Hand": hand}), "layout.lock")
    assert [one.name for one in for_people(found)] == ["demo_msgs/Finger", "demo_msgs/Hand"]
    assert [one.diagnostic.details[-1] for one in for_people(found)] == [
        "size   8 -> 4",
        "changed too: 2 messages that contain it, demo_msgs/Arm, demo_msgs/Robot",
    ]


def test_a_setting_that_changes_each_message_folds_none(before: lockfile.Lock, tmp_path: Path) -> None:
    found = compare(before, lock(tmp_path, {**MESSAGES}, types=TypeOptions(bool="BOOL")), "layout.lock")
    assert "demo_msgs/Robot" in [one.name for one in for_people(found)]


def test_what_vanished_in_a_part_that_moved_is_told_by_its_old_place(before: lockfile.Lock, tmp_path: Path) -> None:
    robot = MESSAGES["Robot"].replace("bool ready", "float64[4] more\nbool ready")
    found = compare(before, lock(tmp_path, {**MESSAGES, "Finger": "float32 force\n", "Robot": robot}), "layout.lock")
    (robots,) = [one for one in found if "demo_msgs/Robot" in one.diagnostic.message]
    places = {change.field: change.text for change in robots.changes}
    arm, hand, fingers, finger = (
        before.messages[f"demo_msgs/msg/{name}"].fields[field].offset
        for name, field in (("Robot", "arm"), ("Arm", "hand"), ("Hand", "fingers"), ("Finger", "id"))
    )
    assert places["arm.hand.fingers[].id"] == f"vanished from {arm + hand + fingers + finger}, was int16"
    assert places["arm"] == "moved 200 -> 240, shrank 104 -> 96"


def test_a_topic_that_is_gone_breaks_its_readers(tmp_path: Path) -> None:
    topics = (TopicEntry("/robot", "demo_msgs/Robot", "to_plc", 1, Span("")),)
    old, new = (lock(tmp_path, MESSAGES, topics=entries) for entries in (topics, ()))
    (found,) = compare(old, new, "layout.lock")
    assert found.severity.name == "BREAKING"
    assert found.diagnostic.details == ("topic /robot   to_plc demo_msgs/Robot depth 1 -> none",)


def test_a_lock_without_change_is_without_findings(before: lockfile.Lock) -> None:
    assert compare(before, before, "layout.lock") == []
