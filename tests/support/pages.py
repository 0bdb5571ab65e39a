"""Does what a page tells a contributor to do: writes the files that it shows, and makes the changes that it shows."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from ..conftest import REPOSITORY

_PLACE = re.compile(r"`([\w./-]+/[\w.-]+\.\w+)`")
_BLOCK = re.compile(r"```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def copy(folder: Path) -> Path:
    """What of the repository a target or a backend needs to be tried."""
    for name in ("src", "templates", "tests", "docs", "pyproject.toml", "shmgen.toml"):
        found, place = REPOSITORY / name, folder / name
        ignored = shutil.ignore_patterns("__pycache__", "cases", "errors", ".*")
        shutil.copytree(found, place, ignore=ignored) if found.is_dir() else shutil.copy(found, place)
    return folder


def follow(page: Path, folder: Path) -> list[Path]:
    """In a copy of the repository; gives the files that are new.

    A block belongs to the file that is named, alone in its line, above it. One of `diff` changes it: what it has
    without `+` must be there once, as whole lines or as the beginning of one.
    """
    place, new = Path(), []
    for part in re.split(r"(^`[\w./-]+`$)", page.read_text(encoding="utf-8"), flags=re.MULTILINE):
        if named := _PLACE.fullmatch(part):
            place = folder / named[1]
            continue
        for language, text in _BLOCK.findall(part):
            if language == "diff":
                _change(place, text)
            elif place != Path():
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_text(text, encoding="utf-8")
                new.append(place)
                place = Path()
    return new


def _change(file: Path, diff: str) -> None:
    lines = diff.splitlines()
    assert all(line[:1] in (" ", "+", "-", "") for line in lines), diff
    before = "\n".join(line[1:] for line in lines if not line.startswith("+"))
    after = "\n".join(line[1:] for line in lines if not line.startswith("-"))
    text = file.read_text(encoding="utf-8")
    assert text.count(before) == 1, f"{file}: {before!r} is there {text.count(before)} times"
    file.write_text(text.replace(before, after), encoding="utf-8")
