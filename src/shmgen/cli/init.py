"""Writes a first shmgen.toml for a folder with message packages, and says how it is checked before commit and merge."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from shmgen import config as configuration
from shmgen.config import Config
from shmgen.core.diagnostics import Diagnostic, Rejected, Report
from shmgen.definitions.folders import catalogue
from shmgen.generator import pipeline

FILES = r"(^|/)(generated/.*|shmgen\.toml|pyproject\.toml|package\.xml|[^/]+\.(msg|srv|action|idl))$"
"""Of a hook: whatever a check looks at. .pre-commit-hooks.yaml has the same."""

DEFAULT = 32
"""Elements of a sequence, as `shmgen init` proposes it."""
HOOK_FILE = ".pre-commit-config.yaml"
HOOK = rf"""repos:
  - repo: local
    hooks:
      - id: shmgen-check
        name: shmgen check
        entry: shmgen check
        language: system
        files: {FILES}
        pass_filenames: false
"""
CI_FILE = ".github/workflows/shmgen.yml"
CI = """name: shmgen
on: [push, pull_request]
permissions:
  contents: read
jobs:
  check:
    runs-on: ubuntu-latest
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with:
          python-version: "3.12"
      - run: pip install {requirement}
      - run: shmgen check --format github
"""


@dataclass(frozen=True, slots=True)
class Beginning:
    """The text of shmgen.toml, empty if the folder has one, and what to say at the end."""

    configuration: str
    advice: tuple[str, ...]


def begin(folder: Path) -> Beginning:
    """Finds the packages in and below a folder, and what must be bounded. Raises Rejected: a definition is wrong."""
    if there := configuration.find(folder):
        return Beginning("", (f"{there.name} has a configuration, and is left as it is", "", *_next(True)))
    report = Report()
    found = {name: packages for name, packages in catalogue(folder, folder, report).items() if packages[0].definitions}
    report.stop_if_any()
    places = sorted({_parent(package.place) for packages in found.values() for package in packages})
    places = [place for place in places if not any(_is_above(other, place) for other in places)]
    source = "noetic" if any(packages[0].dialect == "ros1" for packages in found.values()) else "jazzy"
    config = Config(folder, source=source, path=tuple(folder / place for place in places))
    missing: dict[str, None] = {}
    broken: dict[Diagnostic, None] = {}
    for name in sorted(found):
        for entry in pipeline.inventory(config, name):
            missing |= dict.fromkeys(entry.unbounded)
            broken |= dict.fromkeys(entry.faults if entry.size is None else ())
    if broken:
        raise Rejected(broken)
    text = _text(sorted(found), places, source, list(missing))
    return Beginning(text, (_told(found, missing), "", *_next(bool(found))))


def _text(packages: list[str], places: list[str], source: str, missing: list[str]) -> str:
    lines = [
        "# What `shmgen generate` writes; a package means all of it. Every key: docs/configuration.md of shmgen.",
        f"messages = {json.dumps(packages)}" if packages else 'messages = []  # such as ["geometry_msgs/Pose"]',
        f"path = {json.dumps(places)}",
        f"source = {json.dumps(source)}",
        "",
        "[strings]",
        "default = 80  # capacity of a string without a bound of its own",
        "",
        "[bounds]",
    ]
    if missing:
        lines += [
            f"default = {DEFAULT}  # elements that a sequence without a bound of its own may hold",
            "# For some of them another: put a number behind `=`, and take the `#` away.",
        ]
        lines += [f"# {json.dumps(key)} =" for key in missing]
    return "\n".join(lines) + "\n"


def _told(found: Collection[str], missing: Collection[str]) -> str:
    if not found:
        return "no message package is in this folder: name messages in shmgen.toml, `shmgen list` prints what there is"
    holds = "1 sequence holds" if len(missing) == 1 else f"{len(missing)} sequences hold"
    wanted = f"; {holds} at most {DEFAULT}, unless [bounds] says otherwise" if missing else ""
    return f"found {', '.join(sorted(found))}{wanted}"


def _next(is_filled: bool) -> tuple[str, str, str]:
    commands = ("generate", "check") if is_filled else ("list", "generate")
    return "next:", f"  shmgen {commands[0]}", f"  shmgen {commands[1]}"


def _parent(place: str) -> str:
    """The folder a package is found from: the one above it, or itself if it is this one."""
    return str(Path(place).parent)


def _is_above(other: str, place: str) -> bool:
    return other != place and Path(other) in Path(place).parents
