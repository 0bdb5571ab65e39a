"""Every command in README.md and docs/ prints what the page shows, and links and package names are right."""

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
def prefix() -> Iterator[list[str]]:
    """The words before a command that give it a /dev/shm of its own. The list is empty if the kernel forbids that."""
    make = ["unshare", "-m", "sh", "-c", "mount -t tmpfs tmpfs /dev/shm && echo made && exec sleep 300"]
    with subprocess.Popen(make, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as holder:
        assert holder.stdout is not None
        is_mounted = holder.stdout.readline() == "made\n"
        try:
            yield ["nsenter", "-m", "-r", "-w", "-t", str(holder.pid)] if is_mounted else []  # -r: this may be a chroot
        finally:
            holder.kill()


@pytest.fixture
def clean_up_page(page: Path, tmp_path: Path) -> Iterator[None]:
    """End processes that a failed command left, and remove the regions that the page names."""
    yield
    for file in tmp_path.rglob("*pid"):
        with suppress(OSError):  # the process has already ended
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
@pytest.mark.usefixtures("clean_up_page")
@pytest.mark.family("[README.md]", "[python.md]", "[definitions.md]", "[configuration.md]")
def test_commands_print_what_the_page_shows(page: Path, tmp_path: Path, update_golden: bool, prefix: list[str]) -> None:
    """Run all commands of a page in one folder. Save each other block under the name in the text or in FILES."""
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
        for command, output in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", text, re.MULTILINE):
            result = subprocess.run(
                [*prefix, "sh", "-c", f"cd {shlex.quote(str(tmp_path))}\n{command}"],
                cwd=tmp_path,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                check=False,
            )
            is_error = any(word in output for word in ("error", "fault", "hint"))
            assert is_error or not result.returncode, f"$ {command}\n{result.stdout}"  # a line `...` hides no failure
            if update_golden and "...\n" not in output:
                page.write_text(page.read_text().replace(f"$ {command}\n{output}", f"$ {command}\n{result.stdout}"))
            else:
                assert re.fullmatch(pattern(output), result.stdout), f"$ {command}\n{result.stdout}"


def pattern(output: str) -> str:
    """Return a regular expression for the output. A line `...` matches any number of lines."""
    return "".join("(?:.*\n)*" if line == "...\n" else re.escape(line) for line in output.splitlines(keepends=True))


def test_demo_needs_no_pytest() -> None:
    code = "import sys; sys.modules['pytest'] = None; import tests.softplc.task, tests.softplc"
    subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, check=True)


def test_readme_names_only_existing_function_blocks() -> None:
    project = (REPOSITORY / "generated" / "plcopen" / "shmgen.xml").read_text()
    named = re.findall(r"\bFB_\w+", PAGES[0].read_text())
    assert named
    assert [block for block in named if f'name="{block}"' not in project] == []


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++: apt-get install g++")
@pytest.mark.slow
def test_make_demo_succeeds() -> None:
    result = subprocess.run(["make", "demo"], cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    assert re.search(r"poses sent, \d+ received by the PLC", result.stdout)


def test_pages_name_all_packages_and_activate_the_environment() -> None:
    """Name python3-dev: without it, publish and read are not compiled. `make` does not put `shmgen` on the PATH."""
    makefile = (REPOSITORY / "Makefile").read_text()
    needed = set(" ".join(re.findall(r"^(?:SETUP|FAST|TEST)_PACKAGES\s*:= (.*)", makefile, re.MULTILINE)).split())
    assert "python3-dev" in needed
    for page in (PAGES[0], REPOSITORY / "docs" / "tutorial-plc.md"):
        before, _, _ = page.read_text().partition("```console")
        named = re.findall(r"^    sudo apt-get install ([^#\n]*)", before, re.MULTILINE)
        assert needed - {"libc6-dev"} <= set(" ".join(named).split()), page  # g++ depends on libc6-dev
        assert before.index("make demo") < before.index("    . .venv/bin/activate"), page


@pytest.mark.exhaustive
def test_tests_are_collected_without_any_program() -> None:
    """Collect all tests without git, compilers and locales: a test that needs one of them skips itself."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-n", "0", "-p", "no:cacheprovider"]
    environment = {"PATH": "/nonexistent", "HOME": os.environ.get("HOME", "/")}
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


def test_failed_import_skips_with_the_cause(tmp_path: Path) -> None:
    """Accept every exception. GitPython raises an ImportError without git, and other packages raise an OSError."""
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


def test_importorskip_catches_every_exception() -> None:
    for file in (REPOSITORY / "tests").rglob("*.py"):
        for line in re.findall(r"pytest\.importorskip\(.*", file.read_text()):
            assert "exc_type=Exception" in line, f"{file}: {line}"


def test_readme_installs_the_idl_parser() -> None:
    """Require the IDL parser in .venv/ready, which `make demo` and `make test` set up, and in each other command."""
    command = ["make", "--dry-run", "--always-make", ".venv/ready"]
    steps = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout
    assert "--no-deps ros-rosidl-parser" in steps
    extras = re.findall(r"install '\.\[([\w,]+)\]'", PAGES[0].read_text())
    assert extras
    assert all("idl" in named.split(",") for named in extras)


def test_readme_names_only_two_make_targets() -> None:
    """Reject further targets in README.md, because no test would run them. `make test` runs this test."""
    assert set(re.findall(r"make (\w+)", PAGES[0].read_text())) == {"demo", "test"}


def test_links_of_all_pages_have_targets() -> None:
    """Require a file or folder, and the heading if the link names one. Code contains no links."""
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
    """Return the headings of a page in the form that links to GitHub and to the site use."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return [re.sub(r"[^\w\s-]", "", heading).strip().lower().replace(" ", "-") for heading in headings]
