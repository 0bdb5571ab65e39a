"""No tracked text holds what is not finished, or what is true only on one machine or one day."""

from __future__ import annotations

import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

from .conftest import REPOSITORY

MERGE = re.compile(r"^(?:<{7}|>{7}|\|{7})(?: .*)?$", re.MULTILINE)
"""Not `=======`, which is a heading's line in reStructuredText and never stands alone."""
MEANT = {"tests/errors/SHM408_damaged_lock/generated/layout.lock"}

FOLDERS = "home root Users work workspace tmp private mnt media data builds nix".split()  # noqa: SIM905
PLACE = re.compile(rf"(?<![\w.*)\]}}$~>/-])/(?:{'|'.join(FOLDERS)})/[\w.+-]+(?:/[\w.+-]+)*")
r"""Where somebody's files are. `/dev/shm`, `/opt/ros` and what Debian has in `/usr` are on every machine."""
WINDOWS = re.compile(r"\b[A-Z]:\\Users\\\w+")
EXAMPLES = {"/home/dev"}
"""Of the user whom tests/rigs/bare.py makes."""

DAY = re.compile(r"\b(?:date\.today|datetime\.(?:now|utcnow|today)|time\.(?:localtime|gmtime|strftime|ctime))\(")
"""Python's ways to the date; a test that asks for it is another test tomorrow."""


@cache
def tracked() -> dict[str, str]:
    """{path: text} of what git knows and is text."""
    command = ["git", "ls-files", "-z"]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("not a checkout of git")
    found = {}
    for path in filter(None, done.stdout.split("\0")):
        file = REPOSITORY / path
        data = file.read_bytes() if file.is_file() else b""
        if b"\0" not in data:
            found[path] = data.decode("utf-8", errors="replace")
    return found


def missing_headings(text: str) -> list[str]:
    """Return the quoted headings, such as docs/protocol.md, "Write", that their page does not have."""
    return [
        f'{page}, "{heading}"'
        for page, heading in re.findall(r'(docs/[\w-]+\.md),\s+(?:#\s+|\*\s+)?"([^"]+)"', text)
        if not re.search(rf"^#+ {re.escape(heading)}$", (REPOSITORY / page).read_text(), re.MULTILINE)
    ]


def merges(text: str) -> list[str]:
    return MERGE.findall(text)


def places(text: str) -> list[str]:
    found = [*PLACE.findall(text), *WINDOWS.findall(text)]
    here = [str(place) for place in (REPOSITORY, Path.home()) if len(place.parts) > 2 and str(place) in text]
    return sorted({*found, *here} - EXAMPLES)


def days(text: str) -> list[str]:
    return DAY.findall(text)


def test_each_quoted_heading_is_on_its_page() -> None:
    page = "docs/protocol.md"
    assert missing_headings(f'{page}, "Write" and {page},\n * "Writing"') == [f'{page}, "Writing"']
    assert not [heading for text in tracked().values() for heading in missing_headings(text)]


def test_no_marks_of_an_unfinished_merge() -> None:
    found = {path: marks for path, text in tracked().items() if path not in MEANT and (marks := merges(text))}
    assert found == {}


def test_no_path_of_one_machine() -> None:
    found = {path: paths for path, text in tracked().items() if (paths := places(text)) and path != OWN}
    assert found == {}


def test_no_test_depends_on_the_day() -> None:
    tests = {path: text for path, text in tracked().items() if path.startswith("tests/") and path.endswith(".py")}
    assert {path: calls for path, text in tests.items() if (calls := days(text)) and path != OWN} == {}


OWN = "tests/test_tracked_text.py"


@pytest.mark.parametrize(
    ("look", "text"),
    [
        (merges, f"a\n{'<' * 7} HEAD\nb\n{'=' * 7}\nc\n{'>' * 7} main\n"),
        (merges, f"{'|' * 7} merged common ancestors\n"),
        *((places, f"see `/{folder}/anna/README.md`") for folder in FOLDERS),
        (places, r"C:\Users\anna\shmgen"),
        (places, str(REPOSITORY)),
        (days, "number = datetime.date.today().toordinal()"),
        (days, "if datetime.now().month == 2:"),
    ],
)
def test_each_is_seen(look: object, text: str) -> None:
    assert callable(look)
    assert look(text)


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
def test_what_is_on_every_machine_is_fine(text: str) -> None:
    assert places(text) == []
