"""corner-cases.md is what shmgen and the reference implementations say today, each asked for real."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import NamedTuple

import pytest

from shmgen.core.diagnostics import Rejected, Report
from shmgen.definitions import Sources, load
from shmgen.definitions.tokens import Dialect
from tests.definitions import references
from tests.definitions.corner_cases import ROS1, ROS2, Case
from tests.definitions.references import Answer, ConstantRead, Definition, FieldRead, Read, Refused

PAGE = Path(__file__).parent / "corner-cases.md"
REFERENCES = {"ros2": ("rosidl_adapter", "rosidl_parser", "rosbags"), "ros1": ("genmsg", "rosbags")}
VERSIONS = {"rosidl_adapter": "3.3.1", "rosidl_parser": "3.3.1", "genmsg": "0.6.0", "rosbags": "0.11.9"}
"""Those that the page is about; others may answer otherwise, and are left out then."""


class Row(NamedTuple):
    """`there`: None where a reference has nothing to read."""

    case: Case
    here: Answer
    there: dict[str, Answer | None]


GROUPS: list[tuple[str, Dialect]] = [(title, "ros2") for title in ROS2] + [(title, "ros1") for title in ROS1]


@functools.cache
def asked() -> tuple[str, ...]:
    found = references.versions()
    return tuple(name for name, version in VERSIONS.items() if found.get(name) == version)


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Row]]:
    """By the titles of the page."""
    found = {}
    for dialect, groups in (("ros2", ROS2), ("ros1", ROS1)):
        cases = [case for group in groups.values() for case in group]
        definitions = [Definition("demo_msgs", case.kind, case.name, as_opened(case.text)) for case in cases]
        folder = tmp_path_factory.mktemp(dialect)
        here = [read_here(case, dialect, folder / str(number)) for number, case in enumerate(cases)]
        there = ask(definitions, dialect)
        answers = [
            Row(case, ours, {name: there[name][number] for name in there})
            for number, (case, ours) in enumerate(zip(cases, here, strict=True))
        ]
        for title, group in groups.items():
            found[title], answers = answers[: len(group)], answers[len(group) :]
    return found


def as_opened(text: str) -> str:
    """What a program gets that opens the file as text: all of the references do."""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_here(case: Case, dialect: Dialect, folder: Path) -> Answer:
    """Through the whole of reading: files, the types that a field names, recursion."""
    package = folder / "demo_msgs"
    for kind in {"msg", case.kind}:
        (package / kind).mkdir(parents=True)
    (package / "msg" / "Bar.msg").write_text("int8 b\n")
    file = package / case.kind / f"{case.name}.{case.kind}"
    file.write_bytes(case.text.encode())
    try:
        source = {"ros1": "noetic", "ros2": "jazzy"}[dialect]
        schema = load([str(file)], Sources((folder,), source, folder), Report())
    except Rejected as rejected:
        return Refused(rejected.diagnostics[0].code, crashed=False)
    wanted = [f"demo_msgs/{case.kind}/{case.name}{ending}" for ending in references.ENDINGS[case.kind]]
    messages = {str(message.name): references.ours(message) for message in schema.messages}
    return tuple(messages[name] for name in wanted)


def ask(definitions: list[Definition], dialect: Dialect) -> dict[str, list[Answer | None]]:
    there: dict[str, list[Answer | None]] = {}
    if dialect == "ros1" and "genmsg" in asked():
        there["genmsg"] = list(references.genmsg(definitions))
    if dialect == "ros2" and "rosidl_adapter" in asked():
        adapter = references.rosidl_adapter(definitions)
        there["rosidl_adapter"] = list(adapter)
        through_idl = references.rosidl_parser(definitions)
        pairs = zip(adapter, through_idl, strict=True)
        there["rosidl_parser"] = [None if isinstance(first, Refused) else answer for first, answer in pairs]
    if "rosbags" in asked():
        there["rosbags"] = [
            references.rosbags([definition], [[definition.text]], dialect)[0] if definition.kind == "msg" else None
            for definition in definitions
        ]
    return there


@pytest.mark.slow
@pytest.mark.parametrize(("title", "dialect"), GROUPS)
def test_every_difference_has_its_reason_and_no_other_row_has_one(
    rows: dict[str, list[Row]], title: str, dialect: Dialect
) -> None:
    if not set(REFERENCES[dialect]) <= set(asked()):
        pytest.skip(f"not all of {', '.join(REFERENCES[dialect])} are here in the versions that the page is about")
    wrong = [row.case.text for row in rows[title] if differs(row) != bool(row.case.why)]
    assert not wrong


def differs(row: Row) -> bool:
    return any(unlike(row.here, answer, name) for name, answer in row.there.items() if answer is not None)


def unlike(here: Answer, there: Answer, reference: str) -> bool:
    """Where we refuse, a crash is no difference. rosbags and genmsg tell neither defaults nor units."""
    if isinstance(here, Refused) or isinstance(there, Refused):
        return type(here) is not type(there) or (isinstance(there, Refused) and not isinstance(here, Refused))
    if reference in ("rosbags", "genmsg"):
        here = tuple(map(references.without_defaults, here))
    return repr(here) != repr(there)


def test_the_page_says_what_they_say(rows: dict[str, list[Row]], update_golden: bool) -> None:
    if update_golden:
        PAGE.write_text(page(rows), encoding="utf-8")
    shown, said = (text.splitlines() for text in (PAGE.read_text(encoding="utf-8"), page(rows)))
    assert len(shown) == len(said)
    for there, here in zip(shown, said, strict=True):
        cells = zip(there.split(" | "), here.split(" | "), strict=True)
        assert [pair for pair in cells if pair[0] != pair[1] and pair[1] != NOT_ASKED] == []


def test_there_are_enough(rows: dict[str, list[Row]]) -> None:
    assert sum(map(len, rows.values())) >= 80


# --- the page ------------------------------------------------------------------------------------------

NOT_ASKED = "?"
HEAD = """\
# Corner cases

How shmgen reads ambiguous or unusual definitions, and how the reference implementations read them:
{versions}. A test runs all of them and compares the results with this page;
`pytest --update-golden tests/definitions/test_corner_cases.py` regenerates it.

Each section has a table of what they read differently, with the reason, and below it what all read, or refuse, alike.

* **definition**: `␊` is a line break, `␉` a tab, `␍` a carriage return, `␀` a zero byte. It is the message
  `demo_msgs/Foo` if no file is named; its package also has `Bar.msg`, with one field `int8 b`.
* **here**: what shmgen reads; a code such as SHM003 is the [diagnostic](../../src/shmgen/diagnostics.md) that it
  reports.
* **same**: the same fields, types, bounds, defaults, constants and units. rosbags and genmsg do not return defaults
  and units, so these are not compared.
* **refused**: rejected with a message about the definition. **crashes**: an exception that does not describe it.
* **-**: no input: rosidl_parser reads the .idl that rosidl_adapter generates, and rosbags reads no .srv or .action.
"""


def page(rows: dict[str, list[Row]]) -> str:
    """Which rows differ is asked of their reasons, so that it is known where a reference is not."""
    names = [f"{name} {version}" for name, version in VERSIONS.items()]
    text = HEAD.format(versions=f"{', '.join(names[:-1])} and {names[-1]}")
    for title, dialect in GROUPS:
        columns = REFERENCES[dialect]
        text += f"\n## {title}\n"
        told_apart = [row for row in rows[title] if row.case.why]
        if told_apart:
            text += f"| definition | here | {' | '.join(columns)} | why |\n|{'---|' * (len(columns) + 3)}\n"
        for row in told_apart:
            cells = [written(row.case), told(row.here), *(cell(row, name) for name in columns), row.case.why]
            text += f"| {' | '.join(cells)} |\n"
        text += alike([row for row in rows[title] if not row.case.why], "\n" if told_apart else "")
    return text


def alike(rows: list[Row], before: str) -> str:
    """By what is read: as it is written, as something else, not at all."""
    found: dict[str, list[str]] = {}
    for row in rows:
        here, definition = told(row.here), written(row.case)
        if isinstance(row.here, Refused):
            found.setdefault(f"Refused by all, here as {here}", []).append(definition)
        elif here == definition:
            found.setdefault("Read by all as it is written", []).append(definition)
        else:
            found.setdefault("Read by all as something else", []).append(f"{definition} as {here}")
    return before + "".join(f"* {what}: {'; '.join(those)}\n" for what, those in found.items()) if found else ""


def cell(row: Row, reference: str) -> str:
    if reference not in row.there:
        return NOT_ASKED
    answer = row.there[reference]
    if answer is None:
        return "-"
    if isinstance(answer, Refused):
        return f"crashes: {answer.exception}" if answer.crashed else "refused"
    return told(answer) if unlike(row.here, answer, reference) else "same"


def written(case: Case) -> str:
    file = "" if (case.name, case.kind) == ("Foo", "msg") else f" in {case.name}.{case.kind}"
    return (code(case.text) if case.text else "an empty file") + file


def told(answer: Answer) -> str:
    if isinstance(answer, Refused):
        return answer.exception
    return " `---` ".join(message(read) for read in answer)


def message(read: Read) -> str:
    lines = [line(item) for item in (*read.fields, *read.constants)]
    return ", ".join(map(code, lines)) if lines else "no fields"


def line(item: FieldRead | ConstantRead) -> str:
    """As ROS 2 would write it, in full."""
    type_ = item.type.replace("/msg/", "/")
    if isinstance(item, ConstantRead):
        return f"{type_} {item.name}={literal(item.value)}"
    default = "" if item.default is None else f" {literal(item.default)}"
    return f"{type_} {item.name}{default}{f' # [{item.unit}]' if item.unit else ''}"


def literal(value: object) -> str:
    if isinstance(value, bool | str | list):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)


def code(text: str) -> str:
    """On one line of a table, nothing in it that Markdown or a terminal obeys."""
    for control, picture in {"\n": "␊", "\t": "␉", "\r": "␍", "\x00": "␀"}.items():
        text = text.replace(control, picture)
    text = "".join(c if c.isprintable() else f"U+{ord(c):04X}" for c in text).replace("|", "\\|")
    edge = " " if text[:1] == "`" or text[-1:] == "`" or (text[:1] == text[-1:] == " ") else ""
    return f"`{edge}{text}{edge}`"
