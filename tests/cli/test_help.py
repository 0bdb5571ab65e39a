"""Test the help of `shmgen` and of its commands on a terminal of 80 columns."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from shmgen.cli.main import GROUPS
from shmgen.targets import KEYS

from ..conftest import REPOSITORY
from ..support import import_or_skip
from ..support.command import run

COMMANDS = [name for names in GROUPS.values() for name in names]


@pytest.fixture(autouse=True)
def terminal_of_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


def test_help_lists_commands_in_groups(tmp_path: Path) -> None:
    text = run(["--help"], tmp_path).stdout
    titles = re.findall(r"^(\w[\w ]+):$", text, re.MULTILINE)
    assert titles == ["Options", "Generate", "Check", "Bridge", "Live", "Record and view", "PLC", "Setup"]
    rows = re.findall(r"^  (\w+) {2,}([A-Z].+\.)$", text.partition("\nGenerate:\n")[2], re.MULTILINE)
    assert [name for name, _ in rows] == COMMANDS
    assert len(set(COMMANDS)) == len(COMMANDS)
    assert [line for line in text.splitlines() if len(line) > 80] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_help_lines_fit_80_columns(tmp_path: Path, command: str) -> None:
    lines = run([command, "--help"], tmp_path).stdout.splitlines()
    assert [line for line in lines if len(line) > 80] == []


def test_help_of_generate_lists_all_targets(tmp_path: Path) -> None:
    text = run(["generate", "--help"], tmp_path).stdout.partition("  Targets")[2]
    assert tuple(re.findall(r"^    [* ] (\w+) ", text, re.MULTILINE)) == KEYS


def test_reference_has_the_groups_of_the_help(monkeypatch: pytest.MonkeyPatch) -> None:
    import_or_skip("mkdocs", reason="no mkdocs: make site installs it")
    monkeypatch.syspath_prepend(str(REPOSITORY / "docs" / "site"))
    import hooks  # type: ignore[import-not-found]

    headings = re.findall(r"^#+ (.+)$", hooks._commands(), re.MULTILINE)
    expected = [title for group, names in GROUPS.items() for title in (group, *(f"shmgen {name}" for name in names))]
    assert headings == ["Commands", *expected]
