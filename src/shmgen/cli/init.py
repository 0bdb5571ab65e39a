"""Generates a first shmgen.toml for a folder with message packages, and the files of a commit hook and CI check."""

from __future__ import annotations

import json
from collections.abc import Collection
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from shmgen import __version__
from shmgen import config as configuration
from shmgen.config import Config
from shmgen.core.diagnostics import Diagnostic, Rejected, Report
from shmgen.definitions.folders import catalogue
from shmgen.generator import pipeline

FILES = r"(^|/)(generated/.*|shmgen\.toml|pyproject\.toml|package\.xml|[^/]+\.(msg|srv|action|idl))$"
"""Files that trigger the commit hook: all that a check reads. .pre-commit-hooks.yaml has the same pattern."""

DEFAULT = 32
"""Bound of sequences, in elements, that `shmgen init` proposes."""
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


def requirement() -> str | None:
    """Return the requirement with which pip installs the same shmgen on a CI machine, such as `shmgen[idl]==1.0`.

    The source of this shmgen is in pip's direct_url.json (PEP 610). Return None if shmgen was installed from a local
    folder.
    """
    try:
        noted = distribution("shmgen").read_text("direct_url.json")
    except PackageNotFoundError:
        return None
    if noted is None:
        return f"shmgen[idl]=={__version__}"
    origin = json.loads(noted)
    if "vcs_info" in origin:
        vcs = origin["vcs_info"]
        return f"shmgen[idl] @ {vcs['vcs']}+{origin['url']}@{vcs['commit_id']}"
    return None if origin["url"].startswith("file:") else f"shmgen[idl] @ {origin['url']}"


def propose(folder: Path) -> tuple[str, tuple[str, ...]]:
    """Return a shmgen.toml for the message packages in and below a folder, and lines of advice to print at the end.

    The shmgen.toml has all bounds that the messages need, and is `""` if the folder already has a configuration. Raises
    Rejected if a definition is invalid.
    """
    if there := configuration.find(folder):
        return "", (f"{there.name} already has a configuration and was not changed", "", *_next(True))
    report = Report()
    packages = {
        name: same_named for name, same_named in catalogue(folder, folder, report).items() if same_named[0].definitions
    }
    report.stop_if_any()
    places = sorted({str(Path(package.place).parent) for same_named in packages.values() for package in same_named})
    places = [place for place in places if not any(Path(other) in Path(place).parents for other in places)]
    source = "noetic" if any(same_named[0].dialect == "ros1" for same_named in packages.values()) else "jazzy"
    config = Config(folder, source=source, path=tuple(folder / place for place in places))
    missing: dict[str, None] = {}
    broken: dict[Diagnostic, None] = {}
    for name in sorted(packages):
        for entry in pipeline.inventory(config, name):
            missing |= dict.fromkeys(entry.unbounded)
            broken |= dict.fromkeys(entry.diagnostics if entry.size is None else ())
    if broken:
        raise Rejected(broken)
    text = _text(sorted(packages), places, source, list(missing))
    return text, (_summary(packages, missing), "", *_next(bool(packages)))


def _text(packages: list[str], places: list[str], source: str, missing: list[str]) -> str:
    lines = [
        "# Messages to generate; a package name selects all of its messages. Keys: docs/configuration.md of shmgen.",
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
            f"default = {DEFAULT}  # maximum number of elements of a sequence without a bound of its own",
            "# To set another bound for a sequence, remove the `#` of its line, and write a number after `=`.",
        ]
        lines += [f"# {json.dumps(key)} =" for key in missing]
    return "\n".join(lines) + "\n"


def _summary(packages: Collection[str], missing: Collection[str]) -> str:
    if not packages:
        return "this folder has no message package: list messages in shmgen.toml; `shmgen list` prints the known ones"
    holds = "1 sequence holds" if len(missing) == 1 else f"{len(missing)} sequences hold"
    bound_text = f"; {holds} at most {DEFAULT} elements (see [bounds] in shmgen.toml)" if missing else ""
    return f"found {', '.join(sorted(packages))}{bound_text}"


def _next(is_filled: bool) -> tuple[str, str, str]:
    commands = ("generate", "check") if is_filled else ("list", "generate")
    return "next:", f"  shmgen {commands[0]}", f"  shmgen {commands[1]}"
