"""The site of the documentation is built without a warning, and every page is in its menu."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from .conftest import REPOSITORY


def test_every_page_is_in_the_menu() -> None:
    menu = (REPOSITORY / "mkdocs.yml").read_text()
    for page in (REPOSITORY / "docs").rglob("*.md"):
        name = page.relative_to(REPOSITORY / "docs").as_posix()
        assert f": {name}\n" in menu, name


@pytest.mark.slow
def test_it_is_built_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="no mkdocs: make site installs it")
    pytest.importorskip("mkdocstrings", reason="no mkdocstrings: make site installs it")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path / "site")]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "PointPublisher" in (tmp_path / "site" / "index.html").read_text()
    assert "ClaimLost" in (tmp_path / "site" / "api" / "index.html").read_text()


def test_user_pages_are_short_and_tell_of_no_run() -> None:
    """What was run, when and beside which load is in docs/evidence; Reference is looked up, all else is read."""
    menu = (REPOSITORY / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    apart = {section: re.findall(r": (\S+\.md)$", rows, re.MULTILINE) for section, rows in SECTION.findall(menu)}
    docs, others = REPOSITORY / "docs", {*apart["Reference"], *apart["Evidence"]}
    texts = {page.name: page.read_text() for page in docs.glob("*.md") if page.name not in others}
    assert sum(len(text.split()) for text in texts.values()) <= 25_000
    assert {name: told for name, text in texts.items() if (told := RUN.findall(text))} == {}


SECTION = re.compile(r"^  - (\w+):\n((?:      .*\n)+)", re.MULTILINE)
MONTHS = "January February March April May June July August September October November December"
RUN = re.compile(rf"\b(?:{MONTHS.replace(' ', '|')}) 20\d\d|\ba load of \d|\bat load\b")
