"""Compare corner-cases.md with the current results of shmgen and the reference implementations."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import NamedTuple

import pytest

from shmgen.core.diagnostics import Rejected, Report
from shmgen.definitions import Sources, load, open_library
from shmgen.definitions.tokens import Dialect
from tests.definitions import references
from tests.definitions.corner_cases import ROS1, ROS2, Case
from tests.definitions.references import Answer, ConstantInfo, Definition, FieldInfo, MessageInfo, Refusal

PAGE = Path(__file__).parent / "corner-cases.md"
REFERENCES = {"ros2": ("rosidl_adapter", "rosidl_parser", "rosbags"), "ros1": ("genmsg", "rosbags")}
VERSIONS = {"rosidl_adapter": "3.3.1", "rosidl_parser": "3.3.1", "genmsg": "0.6.0", "rosbags": "0.11.9"}
"""The versions that the page describes. Other versions may give other results, so the test skips them."""


class Row(NamedTuple):
    """The results of one case. A result in `others` is None if the reference cannot read this kind of file."""

    case: Case
    own: Answer
    others: dict[str, Answer | None]


GROUPS: list[tuple[str, Dialect]] = [(title, "ros2") for title in ROS2] + [(title, "ros1") for title in ROS1]


@functools.cache
def available_references() -> tuple[str, ...]:
    installed = references.find_versions()
    return tuple(name for name, version in VERSIONS.items() if installed.get(name) == version)


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Row]]:
    """The rows of the page, by the title of their section."""
    answers_by_title = {}
    for dialect, groups in (("ros2", ROS2), ("ros1", ROS1)):
        cases = [case for group in groups.values() for case in group]
        definitions = [Definition("demo_msgs", case.kind, case.name, normalize_newlines(case.text)) for case in cases]
        folder = tmp_path_factory.mktemp(dialect)
        own = [read_with_shmgen(case, dialect, folder / str(number)) for number, case in enumerate(cases)]
        others = run_references(definitions, dialect)
        answers = [
            Row(case, own_answer, {name: others[name][number] for name in others})
            for number, (case, own_answer) in enumerate(zip(cases, own, strict=True))
        ]
        for title, group in groups.items():
            answers_by_title[title], answers = answers[: len(group)], answers[len(group) :]
    return answers_by_title


def normalize_newlines(text: str) -> str:
    """Return the text as a program reads it that opens the file in text mode, as all references do."""
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_with_shmgen(case: Case, dialect: Dialect, folder: Path) -> Answer:
    """Load the case with all steps of shmgen: reading files, resolving the types of fields, finding recursion."""
    package = folder / "demo_msgs"
    for kind in {"msg", case.kind}:
        (package / kind).mkdir(parents=True)
    (package / "msg" / "Bar.msg").write_text("int8 b\n")
    file = package / case.kind / f"{case.name}.{case.kind}"
    file.write_bytes(case.text.encode())
    try:
        source = {"ros1": "noetic", "ros2": "jazzy"}[dialect]
        schema = load(open_library(Sources((folder,), source, folder), Report()), [str(file)], Report())
    except Rejected as rejected:
        return Refusal(rejected.diagnostics[0].code, crashed=False)
    expected_names = [f"demo_msgs/{case.kind}/{case.name}{ending}" for ending in references.ENDINGS[case.kind]]
    messages = {str(each.name): references.from_shmgen(each) for each in schema.messages}
    return tuple(messages[name] for name in expected_names)


def run_references(definitions: list[Definition], dialect: Dialect) -> dict[str, list[Answer | None]]:
    others: dict[str, list[Answer | None]] = {}
    if dialect == "ros1" and "genmsg" in available_references():
        others["genmsg"] = list(references.run_genmsg(definitions))
    if dialect == "ros2" and "rosidl_adapter" in available_references():
        adapter = references.run_rosidl_adapter(definitions)
        others["rosidl_adapter"] = list(adapter)
        through_idl = references.run_rosidl_parser(definitions)
        pairs = zip(adapter, through_idl, strict=True)
        others["rosidl_parser"] = [None if isinstance(first, Refusal) else answer for first, answer in pairs]
    if "rosbags" in available_references():
        others["rosbags"] = [
            references.run_rosbags([definition], [[definition.text]], dialect)[0] if definition.kind == "msg" else None
            for definition in definitions
        ]
    return others


@pytest.mark.slow
@pytest.mark.parametrize(("title", "dialect"), GROUPS)
def test_exactly_the_different_rows_have_a_reason(rows: dict[str, list[Row]], title: str, dialect: Dialect) -> None:
    if not set(REFERENCES[dialect]) <= set(available_references()):
        pytest.skip(f"not all of {', '.join(REFERENCES[dialect])} are installed in the versions of the page")
    wrong = [row.case.text for row in rows[title] if has_difference(row) != bool(row.case.why)]
    assert not wrong


def has_difference(row: Row) -> bool:
    return any(is_different(row.own, answer, name) for name, answer in row.others.items() if answer is not None)


def is_different(own: Answer, other: Answer, reference: str) -> bool:
    """Return True if the results differ. A crash equals a rejection. rosbags and genmsg read no defaults and units."""
    if isinstance(own, Refusal) or isinstance(other, Refusal):
        return type(own) is not type(other) or (isinstance(other, Refusal) and not isinstance(own, Refusal))
    if reference in ("rosbags", "genmsg"):
        own = tuple(map(references.without_defaults, own))
    return repr(own) != repr(other)


@pytest.mark.slow
def test_page_matches_the_answers(rows: dict[str, list[Row]], update_golden: bool) -> None:
    if update_golden:
        PAGE.write_text(page_text(rows), encoding="utf-8")
    committed, rendered = (text.splitlines() for text in (PAGE.read_text(encoding="utf-8"), page_text(rows)))
    assert len(committed) == len(rendered)
    for old, new in zip(committed, rendered, strict=True):
        cells = zip(old.split(" | "), new.split(" | "), strict=True)
        assert [pair for pair in cells if pair[0] != pair[1] and pair[1] != NOT_RUN] == []


def test_page_has_at_least_80_cases(rows: dict[str, list[Row]]) -> None:
    assert sum(map(len, rows.values())) >= 80


# --- the page ------------------------------------------------------------------------------------------

NOT_RUN = "?"
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


def page_text(rows: dict[str, list[Row]]) -> str:
    """Return the text of the page. A row with a reason counts as different, even if a reference is not installed."""
    names = [f"{name} {version}" for name, version in VERSIONS.items()]
    text = HEAD.format(versions=f"{', '.join(names[:-1])} and {names[-1]}")
    for title, dialect in GROUPS:
        columns = REFERENCES[dialect]
        text += f"\n## {title}\n"
        different = [row for row in rows[title] if row.case.why]
        if different:
            text += f"| definition | here | {' | '.join(columns)} | why |\n|{'---|' * (len(columns) + 3)}\n"
        for row in different:
            cells = [case_text(row.case), answer_text(row.own), *(cell(row, name) for name in columns), row.case.why]
            text += f"| {' | '.join(cells)} |\n"
        text += equal_rows_text([row for row in rows[title] if not row.case.why], "\n" if different else "")
    return text


def equal_rows_text(rows: list[Row], before: str) -> str:
    """Return lists of equal rows: read as written, read as something else, rejected."""
    groups: dict[str, list[str]] = {}
    for row in rows:
        own, definition = answer_text(row.own), case_text(row.case)
        if isinstance(row.own, Refusal):
            groups.setdefault(f"Refused by all, here as {own}", []).append(definition)
        elif own == definition:
            groups.setdefault("Read by all as it is written", []).append(definition)
        else:
            groups.setdefault("Read by all as something else", []).append(f"{definition} as {own}")
    return before + "".join(f"* {what}: {'; '.join(texts)}\n" for what, texts in groups.items()) if groups else ""


def cell(row: Row, reference: str) -> str:
    if reference not in row.others:
        return NOT_RUN
    answer = row.others[reference]
    if answer is None:
        return "-"
    if isinstance(answer, Refusal):
        return f"crashes: {answer.exception}" if answer.crashed else "refused"
    return answer_text(answer) if is_different(row.own, answer, reference) else "same"


def case_text(case: Case) -> str:
    file = "" if (case.name, case.kind) == ("Foo", "msg") else f" in {case.name}.{case.kind}"
    return (code_text(case.text) if case.text else "an empty file") + file


def answer_text(answer: Answer) -> str:
    if isinstance(answer, Refusal):
        return answer.exception
    return " `---` ".join(message_text(message) for message in answer)


def message_text(message: MessageInfo) -> str:
    lines = [item_text(item) for item in (*message.fields, *message.constants)]
    return ", ".join(map(code_text, lines)) if lines else "no fields"


def item_text(item: FieldInfo | ConstantInfo) -> str:
    """Return a field or constant in the full syntax of ROS 2."""
    type_ = item.type.replace("/msg/", "/")
    if isinstance(item, ConstantInfo):
        return f"{type_} {item.name}={value_text(item.value)}"
    default = "" if item.default is None else f" {value_text(item.default)}"
    return f"{type_} {item.name}{default}{f' # [{item.unit}]' if item.unit else ''}"


def value_text(value: object) -> str:
    if isinstance(value, bool | str | list):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)


def code_text(text: str) -> str:
    """Return code for one line of a table, without characters that control Markdown or a terminal."""
    for control, picture in {"\n": "␊", "\t": "␉", "\r": "␍", "\x00": "␀"}.items():
        text = text.replace(control, picture)
    text = "".join(c if c.isprintable() else f"U+{ord(c):04X}" for c in text).replace("|", "\\|")
    edge = " " if text[:1] == "`" or text[-1:] == "`" or (text[:1] == text[-1:] == " ") else ""
    return f"`{edge}{text}{edge}`"
