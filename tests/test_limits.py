"""Definitions that are too large or too deep, or have thousands of mistakes, cause a diagnostic within seconds."""

from __future__ import annotations

from pathlib import Path

import pytest

from shmgen.config import Config
from shmgen.core.diagnostics import Diagnostic, Rejected
from shmgen.generator import pipeline
from tests.support.guard import within

MANY = 20_000
SECONDS = 20
"""The limit of CPU time. Each test takes less than three seconds; a quadratic algorithm would take minutes."""


def reject(folder: Path, files: dict[str, str]) -> tuple[Diagnostic, ...]:
    (folder / "demo_msgs" / "msg").mkdir(parents=True)
    for name, text in files.items():
        (folder / "demo_msgs" / "msg" / f"{name}.msg").write_text(text)
    with within(SECONDS), pytest.raises(Rejected) as rejection:
        pipeline.generate(Config(folder, path=(folder,)), ["demo_msgs/Foo"])
    return rejection.value.diagnostics


LINES = {
    "10 MB": ("x" * 10_000_000, "SHM001"),
    "brackets": (f"int8{'[' * 1000}{']' * 1000} a", "SHM003"),
    "brackets in a default": (f"int8[] a {'[' * 1000}{']' * 1000}", "SHM006"),
    "quotes": (f"string[] a [{'[' * 1000}{chr(34) * 1001}", "SHM006"),
    "blanks before a bracket": (f"int8[] a [{' ' * 400_000}x]", "SHM006"),
}


@pytest.mark.parametrize(("text", "code"), LINES.values(), ids=LINES)
def test_huge_line_or_file_is_rejected(text: str, code: str, tmp_path: Path) -> None:
    (finding,) = reject(tmp_path, {"Foo": text})
    assert finding.code == code
    assert len(str(finding)) < 1000


@pytest.mark.slow
def test_message_nested_a_thousand_times_is_rejected(tmp_path: Path) -> None:
    files = {f"M{number}": f"M{number + 1} next" for number in range(1000)}
    findings = reject(tmp_path, {**files, "Foo": "M0 first", "M1000": "int8 last"})
    assert {finding.code for finding in findings} == {"SHM304"}


@pytest.mark.slow
def test_cycle_of_a_thousand_messages_is_rejected(tmp_path: Path) -> None:
    files = {f"M{number}": f"M{(number + 1) % 1000} next" for number in range(1000)}
    (finding,) = reject(tmp_path, {**files, "Foo": "M0 first"})
    assert finding.code == "SHM301"
    assert len(str(finding)) < 1000


FLOODS = {
    "unknown types": ("Unknown{0} a{0}\n", "SHM004", 20),
    "the same name": ("int8 a\n", "SHM201", 20),
    "half a line": ("int8\n", "SHM003", 20),
    "names of the generator": ("int8 a{0}_count\nint8[<=2] a{0}\n", "SHM204", 20),
    "open sequences": ("int8[] a{0}\n", "SHM101", MANY),
    "a gap before each, and too large": ("int8 a{0}\nint64[99999] b{0}\n", "SHM303", 1),
}


@pytest.mark.slow
@pytest.mark.parametrize(("line", "code", "expected_count"), FLOODS.values(), ids=FLOODS)
def test_thousands_of_mistakes_are_reported_soon(line: str, code: str, expected_count: int, tmp_path: Path) -> None:
    many = MANY // 2 if line.count("\n") > 1 else MANY
    findings = reject(tmp_path, {"Foo": "".join(line.format(number) for number in range(many))})
    assert {finding.code for finding in findings} == {code}
    assert len(findings) == expected_count
