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
BLOCK = re.compile(
    r"(?:ave (?:this|it)[^`]*\sas\s+`([\w./]+)`[^`]*\n\n)?^```(console|python|toml|c|cpp|text|iecst)\n(.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
"""A block of code, and the name of its file if the sentence before it is "Save this as `name`"."""
FILES = {"python": "example.py", "toml": "shmgen.toml", "c": "example.c", "cpp": "example.cpp"}


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
    for file in tmp_path.rglob("*pid"):
        with suppress(OSError):  # it has ended
            if Path(f"/proc/{int(file.read_text())}/cwd").resolve().is_relative_to(tmp_path):
                os.kill(int(file.read_text()), signal.SIGTERM)
    named = re.findall(r"(?:(?:Publisher|Subscriber|Client|Server)(?:\(|, )\"|shmgen pub )/([\w/]+)", page.read_text())
    for topic in set(named):
        for prefix in ("", "sem."):
            for region in Path("/dev/shm").glob(f"{prefix}{topic.replace('/', '.')}*"):
                region.unlink(missing_ok=True)


@pytest.mark.parametrize(
    "page", [page for page in PAGES if "```console" in page.read_text()], ids=lambda page: page.name
)
@pytest.mark.usefixtures("tidied")
@pytest.mark.family("[README.md]", "[python.md]", "[definitions.md]", "[configuration.md]")
def test_commands_print_what_the_page_shows(page: Path, tmp_path: Path, update_golden: bool, alone: list[str]) -> None:
    """In order, in one folder. A block that names no file is saved under its name in FILES."""
    if "run_plc.py" in page.read_text() and not shutil.which("g++"):
        pytest.skip("no g++: apt-get install g++")
    for tool in PROGRAMS:
        if re.search(rf"^\$ (.*[ ;])?{re.escape(tool)} ", page.read_text(), re.MULTILINE) and not shutil.which(tool):
            pytest.skip(f"no {tool}: apt-get install {tool}")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "COLUMNS": "100"}
    environment["SHMGEN"] = str(REPOSITORY)
    for name, language, text in BLOCK.findall(page.read_text()):
        if language != "console":
            if file := name or FILES.get(language, ""):
                (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
                (tmp_path / file).write_text(text)
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


def test_the_readme_names_only_blocks_of_the_committed_project() -> None:
    project = (REPOSITORY / "generated" / "plcopen" / "shmgen.xml").read_text()
    named = re.findall(r"\bFB_\w+", PAGES[0].read_text())
    assert named
    assert [block for block in named if f'name="{block}"' not in project] == []


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


@pytest.mark.slow
def test_the_tests_are_collected_on_a_machine_with_no_programs() -> None:
    """Without git, compilers and locales, each test that needs one skips itself, and none stops the others."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-n", "0", "-p", "no:cacheprovider"]
    environment = {"PATH": "/nonexistent", "HOME": os.environ.get("HOME", "/")}
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


def test_a_module_whose_import_fails_skips_its_tests_with_the_cause(tmp_path: Path) -> None:
    """GitPython raises an ImportError without git; another package may raise an OSError or any other."""
    (tmp_path / "half_installed.py").write_text("raise OSError('libfoo.so.1: cannot open\\nsecond line')")
    code = "import tests.support as support; support.import_or_skip({!r}, reason='pip install it')"
    for module, cause in (
        ("half_installed", "Skipped: half_installed cannot be imported: OSError: libfoo.so.1: cannot open"),
        ("not_installed", "Skipped: pip install it"),
    ):
        command = [sys.executable, "-c", code.format(module)]
        environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{REPOSITORY}"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.stderr.rstrip().endswith(cause)


def test_every_import_of_a_third_party_in_tests_catches_any_exception() -> None:
    for file in (REPOSITORY / "tests").rglob("*.py"):
        for line in re.findall(r"pytest\.importorskip\(.*", file.read_text()):
            assert "exc_type=Exception" in line, f"{file}: {line}"


def test_each_environment_of_the_readme_reads_idl() -> None:
    """`make demo` and `make test` set up .venv/ready; the lines for other environments name the extra."""
    command = ["make", "--dry-run", "--always-make", ".venv/ready"]
    steps = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout
    assert "--no-deps ros-rosidl-parser" in steps
    extras = re.findall(r"install '\.\[([\w,]+)\]'", PAGES[0].read_text())
    assert extras
    assert all("idl" in named.split(",") for named in extras)


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
