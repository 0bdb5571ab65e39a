"""The release workflow checks the tag and the date, and takes the notes from CHANGELOG.md."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from shmgen import __version__

from .conftest import REPOSITORY

DATE = "2031-05-17"


def step(name: str) -> str:
    """Return the commands of a step of release.yml."""
    jobs = YAML(typ="safe").load(REPOSITORY / ".github/workflows/release.yml")["jobs"]
    steps = [step for job in jobs.values() for step in job["steps"] if step.get("name") == name]
    return str(steps[0]["run"])


def run_step(folder: Path, script: str, heading: str) -> subprocess.CompletedProcess[str]:
    page = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    page = re.sub(rf"^## {re.escape(__version__)} .*$", heading, page, flags=re.MULTILINE)
    (folder / "CHANGELOG.md").write_text(f"{page}\n## 0.0.1 (2030-01-01)\n\n* Older.\n", encoding="utf-8")
    (folder / "src/shmgen").mkdir(parents=True)
    (folder / "src/shmgen/__init__.py").write_text((REPOSITORY / "src/shmgen/__init__.py").read_text())
    github = {"REF_NAME": f"v{__version__}", "SERVER_URL": "https://example.org", "REPOSITORY": "us/shmgen"}
    environment = {**os.environ, **{f"GITHUB_{name}": value for name, value in github.items()}}
    command = ["bash", "-eo", "pipefail", "-c", script]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=30)


@pytest.mark.parametrize(
    ("heading", "code"),
    [
        (f"## {__version__} ({DATE})", 0),
        (f"## {__version__} (unreleased)", 1),
        (f"## {__version__}1 ({DATE})", 1),
    ],
)
def test_release_needs_a_date_in_the_changelog(heading: str, code: int, tmp_path: Path) -> None:
    assert run_step(tmp_path, step("Compare tag, version and changelog"), heading).returncode == code


def test_notes_are_one_section_with_absolute_links(tmp_path: Path) -> None:
    process = run_step(
        tmp_path,
        step("Copy the release notes from CHANGELOG.md"),
        f"## {__version__} ({DATE})",
    )
    assert process.returncode == 0, process.stderr
    notes = (tmp_path / "notes.md").read_text(encoding="utf-8")
    assert "### Generating" in notes
    assert "Older" not in notes
    links = re.findall(r"\]\(([^)]*)\)", notes)
    assert links
    assert [link for link in links if not link.startswith("https://")] == []


def test_make_dist_imports_an_existing_module() -> None:
    """Require the current name in the Makefile of the module that defines IN_C."""
    modules = re.findall(r"import (shmgen[\w.]*) as s; assert s\.IN_C", (REPOSITORY / "Makefile").read_text())
    assert modules == ["shmgen.runtime.engine"]
    from shmgen.runtime import engine

    assert isinstance(engine.IN_C, bool)
