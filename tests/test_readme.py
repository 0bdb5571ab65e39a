"""Every command in README.md and docs/, executed; what it prints is what the page shows."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from .conftest import PROGRAMS, REPOSITORY

PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(console|python|toml|c|cpp)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILES = {"python": "example.py", "toml": "shmgen.toml"}


@pytest.fixture
def alone() -> Iterator[list[str]]:
    """In front of a command: it sees a /dev/shm of this test's own, where that can be had."""
    make = ["unshare", "-m", "sh", "-c", "mount -t tmpfs tmpfs /dev/shm && echo made && exec sleep 300"]
    with subprocess.Popen(make, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as holder:
        assert holder.stdout is not None
        made = holder.stdout.readline() == "made\n"
        try:
            yield ["nsenter", "-m", "-r", "-w", "-t", str(holder.pid)] if made else []  # -r: this may be a chroot
        finally:
            holder.kill()


@pytest.fixture
def tidied(page: Path, tmp_path: Path) -> Iterator[None]:
    """Ends what a page has left running if a command of it failed, and removes the regions that it names."""
    yield
    for file in tmp_path.rglob("pid"):
        with suppress(OSError):  # it has ended
            if Path(f"/proc/{int(file.read_text())}/cwd").resolve().is_relative_to(tmp_path):
                os.kill(int(file.read_text()), signal.SIGTERM)
    named = re.findall(r"(?:(?:Publisher|Subscriber|Client|Server)\(\"|shmgen pub )/([\w/]+)", page.read_text())
    for topic in set(named):
        for prefix in ("", "sem."):
            for region in Path("/dev/shm").glob(f"{prefix}{topic.replace('/', '.')}*"):
                region.unlink(missing_ok=True)


@pytest.mark.parametrize(
    "page", [page for page in PAGES if "```console" in page.read_text()], ids=lambda page: page.name
)
@pytest.mark.usefixtures("tidied")
def test_commands_print_what_the_page_shows(page: Path, tmp_path: Path, update_golden: bool, alone: list[str]) -> None:
    """In order, in one folder. A block of Python, C or C++ becomes example.py and so on, a TOML block shmgen.toml."""
    for tool in PROGRAMS:
        if re.search(rf"^\$ (.*[ ;])?{re.escape(tool)} ", page.read_text(), re.MULTILINE) and not shutil.which(tool):
            pytest.skip(f"no {tool}: apt-get install {tool}")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "COLUMNS": "100"}
    for language, text in BLOCK.findall(page.read_text()):
        if language != "console":
            (tmp_path / FILES.get(language, f"example.{language}")).write_text(text)
            continue
        for command, shown in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", text, re.MULTILINE):
            result = subprocess.run(
                [*alone, "sh", "-c", f"cd {shlex.quote(str(tmp_path))}\n{command}"],
                cwd=tmp_path,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                check=False,
            )
            told = any(word in shown for word in ("error", "fault", "hint"))
            assert told or not result.returncode, f"$ {command}\n{result.stdout}"  # not even where `...` is shown
            if update_golden and "...\n" not in shown:
                page.write_text(page.read_text().replace(f"$ {command}\n{shown}", f"$ {command}\n{result.stdout}"))
            else:
                assert re.fullmatch(pattern(shown), result.stdout), f"$ {command}\n{result.stdout}"


def pattern(shown: str) -> str:
    """What was printed, where a line `...` stands for any number of lines."""
    return "".join("(?:.*\n)*" if line == "...\n" else re.escape(line) for line in shown.splitlines(keepends=True))


def test_the_demo_needs_nothing_of_the_tests() -> None:
    code = "import sys; sys.modules['pytest'] = None; import tests.softplc.task, tests.softplc"
    subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, check=True)


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++: apt-get install g++")
def test_make_demo() -> None:
    result = subprocess.run(["make", "demo"], cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    assert re.search(r"poses sent, \d+ received by the PLC", result.stdout)


def test_what_a_newcomer_types_is_enough() -> None:
    """Python's headers too, or publish and read stay in Python; and `shmgen` is not on the PATH by `make` alone."""
    makefile = (REPOSITORY / "Makefile").read_text()
    needed = set(" ".join(re.findall(r"^(?:SETUP|FAST|TEST)_PACKAGES\s*:= (.*)", makefile, re.MULTILINE)).split())
    assert "python3-dev" in needed
    for page in (PAGES[0], REPOSITORY / "docs" / "tutorial-plc.md"):
        before, _, _ = page.read_text().partition("```console")
        named = re.findall(r"^    sudo apt-get install ([^#\n]*)", before, re.MULTILINE)
        assert needed - {"libc6-dev"} <= set(" ".join(named).split()), page  # which g++ brings
        assert before.index("make demo") < before.index("    . .venv/bin/activate"), page


def test_the_readme_names_no_other_make_target() -> None:
    """`make test` is what runs this; all others would need a test here."""
    assert set(re.findall(r"make (\w+)", PAGES[0].read_text())) == {"demo", "test"}


def test_links_lead_somewhere() -> None:
    """To a file or a folder, and to a heading in it; in code nothing is a link."""
    for page in [
        *REPOSITORY.glob("*.md"),
        *PAGES[1:],
        *REPOSITORY.glob("contrib/*.md"),
        *REPOSITORY.glob("examples/**/*.md"),
    ]:
        text = re.sub(r"^```.*?^```|`[^`\n]*`", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
        for link, anchor in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]+))?\)", text):
            target = page.parent / link if link else page
            assert target.exists(), f"{page.name}: {link}"
            assert not anchor or anchor in anchors(target), f"{page.name}: {link}#{anchor}"


def anchors(page: Path) -> list[str]:
    """The headings of a page as links name them, on GitHub and on the site alike."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return [re.sub(r"[^\w\s-]", "", heading).strip().lower().replace(" ", "-") for heading in headings]
