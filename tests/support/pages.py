"""Follow a page for contributors: copy the files of its example, and apply its diffs."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from . import REPOSITORY

_PLACE = re.compile(r"`([\w./-]+/[\w.-]+\.\w+)`")
_LINKED = re.compile(r"\((\.\./tests/added/\w+\.md)\)")
_DIFF = re.compile(r"```diff\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def copy(folder: Path) -> Path:
    """Copy the parts of the repository that a new target or backend needs."""
    for name in ("src", "templates", "tests", "docs", "pyproject.toml", "shmgen.toml"):
        original, place = REPOSITORY / name, folder / name
        ignored = shutil.ignore_patterns("__pycache__", "cases", "errors", ".*")
        shutil.copytree(original, place, ignore=ignored) if original.is_dir() else shutil.copy(original, place)
    return folder


def follow(page: Path, example: str, folder: Path) -> list[Path]:
    """Copy the files of tests/added/`example` into a copy of the repository, and apply the page's diffs to other files.

    A block of `diff` changes the file that is named above it, alone in its line. The file must contain the lines
    without `+` once. If the page links to another page in tests/added, apply its diffs too. Return the new files.
    """
    added = REPOSITORY / "tests" / "added" / example
    shutil.copytree(added, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    new = [folder / file.relative_to(added) for file in sorted(added.rglob("*.*")) if "__pycache__" not in file.parts]
    place = Path()
    texts = [page.read_text(encoding="utf-8")]
    texts += [(page.parent / link).read_text(encoding="utf-8") for link in _LINKED.findall(texts[0])]
    for part in re.split(r"(^`[\w./-]+`$)", "\n".join(texts), flags=re.MULTILINE):
        if named := _PLACE.fullmatch(part):
            place = folder / named[1]
            continue
        for text in _DIFF.findall(part):
            _change(place, text)
    return new


def _change(file: Path, diff: str) -> None:
    lines = diff.splitlines()
    assert all(line[:1] in (" ", "+", "-", "") for line in lines), diff
    before = "\n".join(line[1:] for line in lines if not line.startswith("+"))
    after = "\n".join(line[1:] for line in lines if not line.startswith("-"))
    text = file.read_text(encoding="utf-8")
    assert text.count(before) == 1, f"{file}: {before!r} is there {text.count(before)} times"
    file.write_text(text.replace(before, after), encoding="utf-8")
