"""The documentation's site builds without a warning. Every page is in its menu and follows the rules of style."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from shmgen import runtime

from .conftest import REPOSITORY
from .support import import_or_skip
from .test_style import prose_findings


def test_every_page_is_in_the_menu() -> None:
    menu = (REPOSITORY / "mkdocs.yml").read_text()
    for page in (REPOSITORY / "docs").rglob("*.md"):
        name = page.relative_to(REPOSITORY / "docs").as_posix()
        assert f": {name}\n" in menu, name


@pytest.mark.slow
def test_site_builds_without_a_warning(tmp_path: Path) -> None:
    import_or_skip("mkdocs", reason="no mkdocs: make site installs it")
    import_or_skip("mkdocstrings", reason="no mkdocstrings: make site installs it")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path / "site")]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    home = (tmp_path / "site" / "index.html").read_text()
    assert "I program PLCs" in home
    assert "I use ROS" in home
    assert 'property="og:image"' in home
    assert (tmp_path / "site" / "assets" / "card.png").is_file()
    members = re.findall(
        r'id="shmgen\.runtime\.(\w+)(?:\.(\w+))?"', (tmp_path / "site" / "api" / "index.html").read_text()
    )
    assert {name for name, _ in members} == set(runtime.__all__)
    assert [member for _, member in members if member.startswith("_") or member == "engine_end"] == []


def test_pages_are_short_and_describe_no_test_run() -> None:
    """Reject months and machine loads of test runs, which belong in docs/evidence."""
    menu = (REPOSITORY / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    sections = {section: re.findall(r": (\S+\.md)$", rows, re.MULTILINE) for section, rows in SECTION.findall(menu)}
    docs, others = REPOSITORY / "docs", {*sections["Reference"], *sections["Evidence"], *sections["Contributing"]}
    assert len((REPOSITORY / "README.md").read_text().split()) <= 900
    assert sum(len(page.read_text().split()) for page in docs.rglob("*.md")) <= MOST_WORDS
    texts = {page.name: page.read_text() for page in docs.glob("*.md") if page.name not in others}
    assert {name: runs for name, text in texts.items() if (runs := RUN.findall(text))} == {}


MOST_WORDS = 33_000
"""The largest number of words in docs/."""
SECTION = re.compile(r"^  - (\w+):\n((?:      .*\n)+)", re.MULTILINE)
MONTHS = "January February March April May June July August September October November December"
RUN = re.compile(rf"\b(?:{MONTHS.replace(' ', '|')}) 20\d\d|\ba load of \d|\bat load\b")


def test_pages_read_plainly() -> None:
    """Reject forbidden openings, forbidden words and long sentences, with the rules of tests/test_style.py."""
    own = [REPOSITORY / "README.md", REPOSITORY / "src" / "shmgen" / "diagnostics.md"]
    pages = [*own, *sorted((REPOSITORY / "docs").rglob("*.md"))]
    findings = [finding for page in pages for finding in prose_findings(page.name, prose(page.read_text()))]
    assert [f"{it.place}: {it.kind}: {it.text}" for it in findings] == []


CODE = re.compile(r"^ *```.*?^ *```|^ {4,}(?![*\d])[^\n]*|<!--.*?-->", re.MULTILINE | re.DOTALL)
"""Matches blocks and lines of code, and comments."""
INLINE = re.compile(r"`[^`\n]*`")
MARKS = re.compile(r"(?<=\])\([^)\s]*\)|[\[\]]|\*\*")
"""Matches targets and brackets of links, and the marks of bold text."""
BREAKS = re.compile(r"\||\n *(?:[*-]|\d+\.) ")
"""Matches the start of a table's cell or of an item: the sentence before it ends without a full stop."""


def prose(page: str) -> str:
    """Return the sentences of a page. Each cell, heading and item becomes its own paragraph."""
    text = re.sub(r"^#+ (.*)$", r"\n\1\n", CODE.sub("", f"\n{page}"), flags=re.MULTILINE)
    return BREAKS.sub("\n\n", MARKS.sub("", INLINE.sub("`x`", text)))


def test_prose_omits_code_and_separates_sentences() -> None:
    page = "# What is it\n\nRun `Of`:\n\n```sh\nOf a\n```\n\n    As code\n\n* [Of](x.md) three\n\n| Where it |\n"
    texts = [finding.text for finding in prose_findings("page", prose(page))]
    assert texts == ["What is it", "Of three", "Where it"]
