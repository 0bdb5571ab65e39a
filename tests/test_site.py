"""The site of the documentation is built without a warning, and every page is in its menu."""

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
def test_it_is_built_without_a_warning(tmp_path: Path) -> None:
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
    shown = re.findall(
        r'id="shmgen\.runtime\.(\w+)(?:\.(\w+))?"', (tmp_path / "site" / "api" / "index.html").read_text()
    )
    assert {name for name, _ in shown} == set(runtime.__all__)
    assert [member for _, member in shown if member.startswith("_") or member == "engine_end"] == []


def test_pages_are_short_and_describe_no_single_run() -> None:
    """Runs and their circumstances belong in docs/evidence."""
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
    """No forbidden opening or word, and no sentence that is too long; the rules are those of tests/test_style.py."""
    own = [REPOSITORY / "README.md", REPOSITORY / "src" / "shmgen" / "diagnostics.md"]
    pages = [*own, *sorted((REPOSITORY / "docs").rglob("*.md"))]
    found = [finding for page in pages for finding in prose_findings(page.name, prose(page.read_text()))]
    assert [f"{it.place}: {it.kind}: {it.text}" for it in found] == []


CODE = re.compile(r"^ *```.*?^ *```|^ {4,}(?![*\d])[^\n]*|<!--.*?-->", re.MULTILINE | re.DOTALL)
"""Blocks and lines of code, and comments."""
INLINE = re.compile(r"`[^`\n]*`")
MARKS = re.compile(r"(?<=\])\([^)\s]*\)|[\[\]]|\*\*")
"""Targets and brackets of links, and bold."""
BREAKS = re.compile(r"\||\n *(?:[*-]|\d+\.) ")
"""A sentence ends here without a full stop: at cells of tables, headings, and items of lists."""


def prose(page: str) -> str:
    """The sentences of a page, with each cell, heading and item as a paragraph of its own."""
    text = re.sub(r"^#+ (.*)$", r"\n\1\n", CODE.sub("", f"\n{page}"), flags=re.MULTILINE)
    return BREAKS.sub("\n\n", MARKS.sub("", INLINE.sub("`x`", text)))


def test_prose_leaves_code_out_and_keeps_sentences_apart() -> None:
    page = "# What is it\n\nRun `Of`:\n\n```sh\nOf a\n```\n\n    As code\n\n* [Of](x.md) three\n\n| Where it |\n"
    found = [finding.text for finding in prose_findings("page", prose(page))]
    assert found == ["What is it", "Of three", "Where it"]
