"""No tracked text contains merge marks, paths of one machine, or calls that depend on the date."""

from __future__ import annotations

import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

from .conftest import REPOSITORY

MERGE = re.compile(r"^(?:<{7}|>{7}|\|{7})(?: .*)?$", re.MULTILINE)
"""The marks of a conflict, except `=======`, which also underlines headings in reStructuredText."""
WITH_MARKS = {"tests/errors/SHM408_damaged_lock/generated/layout.lock"}

FOLDERS = "home root Users work workspace tmp private mnt media data builds nix".split()  # noqa: SIM905
PLACE = re.compile(rf"(?<![\w.*)\]}}$~>/-])/(?:{'|'.join(FOLDERS)})/[\w.+-]+(?:/[\w.+-]+)*")
r"""A path to files of one user. `/dev/shm`, `/opt/ros` and Debian's files in `/usr` are on every machine."""
WINDOWS = re.compile(r"\b[A-Z]:\\Users\\\w+")
EXAMPLES = {"/home/dev"}
"""The home of the user that tests/rigs/bare.py creates."""

DAY = re.compile(r"\b(?:date\.today|datetime\.(?:now|utcnow|today)|time\.(?:localtime|gmtime|strftime|ctime))\(")
"""Python's functions for the current date. A test that calls one may fail on another day."""


@cache
def tracked() -> dict[str, str]:
    """Return {path: text} of all text files that git tracks."""
    command = ["git", "ls-files", "-z"]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("not a checkout of git")
    texts = {}
    for path in filter(None, done.stdout.split("\0")):
        file = REPOSITORY / path
        data = file.read_bytes() if file.is_file() else b""
        if b"\0" not in data:
            texts[path] = data.decode("utf-8", errors="replace")
    return texts


def missing_headings(text: str) -> list[str]:
    """Return the quoted headings, such as docs/protocol.md, "Write", that their page does not have."""
    return [
        f'{page}, "{heading}"'
        for page, heading in re.findall(r'(docs/[\w-]+\.md),\s+(?:#\s+|\*\s+)?"([^"]+)"', text)
        if not re.search(rf"^#+ {re.escape(heading)}$", (REPOSITORY / page).read_text(), re.MULTILINE)
    ]


def find_marks(text: str) -> list[str]:
    return MERGE.findall(text)


def find_paths(text: str) -> list[str]:
    paths = [*PLACE.findall(text), *WINDOWS.findall(text)]
    here = [str(place) for place in (REPOSITORY, Path.home()) if len(place.parts) > 2 and str(place) in text]
    return sorted({*paths, *here} - EXAMPLES)


def find_date_calls(text: str) -> list[str]:
    return DAY.findall(text)


def test_quoted_headings_are_on_their_page() -> None:
    page = "docs/protocol.md"
    assert missing_headings(f'{page}, "Write" and {page},\n * "Writing"') == [f'{page}, "Writing"']
    assert not [heading for text in tracked().values() for heading in missing_headings(text)]


def test_no_text_contains_merge_marks() -> None:
    merges = {path: marks for path, text in tracked().items() if path not in WITH_MARKS and (marks := find_marks(text))}
    assert merges == {}


def test_no_text_contains_a_path_of_one_machine() -> None:
    places = {path: paths for path, text in tracked().items() if (paths := find_paths(text)) and path != OWN}
    assert places == {}


def test_no_test_depends_on_the_date() -> None:
    tests = {path: text for path, text in tracked().items() if path.startswith("tests/") and path.endswith(".py")}
    assert {path: calls for path, text in tests.items() if (calls := find_date_calls(text)) and path != OWN} == {}


OWN = "tests/test_tracked_text.py"


@pytest.mark.parametrize(
    ("find", "text"),
    [
        (find_marks, f"a\n{'<' * 7} HEAD\nb\n{'=' * 7}\nc\n{'>' * 7} main\n"),
        (find_marks, f"{'|' * 7} merged common ancestors\n"),
        *((find_paths, f"see `/{folder}/anna/README.md`") for folder in FOLDERS),
        (find_paths, r"C:\Users\anna\shmgen"),
        (find_paths, str(REPOSITORY)),
        (find_date_calls, "number = datetime.date.today().toordinal()"),
        (find_date_calls, "if datetime.now().month == 2:"),
    ],
)
def test_marks_paths_and_date_calls_are_detected(find: object, text: str) -> None:
    assert callable(find)
    assert find(text)


@pytest.mark.parametrize(
    "text",
    [
        "/dev/shm/robot.pose",
        "/opt/ros/jazzy/setup.bash",
        "/usr/bin/env",
        "~/ros/x",
        "docs/tmp/x",
        "$HOME/tmp/x",
        "/home",
    ],
)
def test_paths_of_every_machine_are_accepted(text: str) -> None:
    assert find_paths(text) == []
