"""Run tests on a mutant in a separate copy of the checkout. The result is killed, hung or lives.

The process has imported third-party modules only, and forks for each mutant. This saves a second for each.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from tests.support import REPOSITORY, SHARED
from tests.support.mutations import Mutant

CODE = Path("src") / "shmgen"
_LOG = ".mutant.log"
_LINES = ".mutant.lines"
_CACHE = ".mutant.cache"
"""A cache folder that is recreated for each mutant, because the mutant may write wrong entries."""
_OTHERS = ("hypothesis", "numpy", "rosbags.serde", "rosbags.typesys.store", "ruamel.yaml", "jinja2", "click")


class Worker:
    """The worker process in the copy, as the parent process sees it."""

    def __init__(self, folder: Path) -> None:
        self.copy = folder / "shmgen"
        command = ["git", "ls-files", "-co", "--exclude-standard", "-z"]
        names = subprocess.run(command, cwd=REPOSITORY, check=True, capture_output=True, text=True).stdout
        for name in filter(None, names.split("\0")):
            (self.copy / name).parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileNotFoundError):  # removed, and not yet committed
                shutil.copy2(REPOSITORY / name, self.copy / name, follow_symlinks=False)
        for extension in (REPOSITORY / CODE).glob("*.so"):
            shutil.copy2(extension, self.copy / CODE)
        (self.copy / ".venv").symlink_to(Path(sys.prefix))
        (folder / "shared").symlink_to(SHARED)
        self._time = int(time.time())
        environment = os.environ | {"PYTHONPATH": str(self.copy / "src"), "XDG_CACHE_HOME": str(self.copy / _CACHE)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        self._environment = environment
        self._start()

    def try_(self, mutant: Mutant, tests: list[str], limit: float, pure: bool = True) -> str:
        """Run tests on a mutant. `limit` is in seconds. If `pure`, the extension in C is not used."""
        path = self.copy / CODE / mutant.file
        return self.try_text(path, mutant.apply(path.read_bytes()), tests, limit, pure)

    def try_text(self, path: Path, wrong: bytes, tests: list[str], limit: float, pure: bool) -> str:
        """Run tests with the content `wrong` in the file `path` of the copy."""
        text = path.read_bytes()
        path.write_bytes(wrong)
        self._age(path)
        try:
            return self._ask(tests, limit, (), pure)[0]
        finally:
            path.write_bytes(text)
            self._age(path)

    def learn(self, tests: list[str], files: list[str]) -> tuple[float, dict[str, Any]]:
        """Return the duration in seconds, and for each test its duration and lines. Raises SystemExit if one fails."""
        (self.copy / _LINES).unlink(missing_ok=True)
        how, seconds = self._ask(tests, 900, tuple(files), True)
        if how != "lives":
            raise SystemExit(f"{how} without a mutant: {tests}\n{(self.copy / _LOG).read_text()[-2000:]}")
        return seconds, json.loads((self.copy / _LINES).read_text())

    def _start(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.mutation_worker"],
            cwd=self.copy,
            env=self._environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def close(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def _ask(self, tests: list[str], limit: float, files: tuple[str, ...], pure: bool) -> tuple[str, float]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([tests, limit, files, pure]) + "\n")
        self._process.stdin.flush()
        if answer := self._process.stdout.readline():
            how, seconds = json.loads(answer)
            return how, seconds
        self._process.wait()  # the mutant has sent a signal to it
        self._process.stdout.close()
        self._start()
        return "killed", 0.0

    def _age(self, path: Path) -> None:
        """Change the file's time stamp, because Python compares bytecode with the source by second and size only."""
        self._time += 2
        os.utime(path, (self._time, self._time))


# --- seen from within ----------------------------------------------------------------------------------------


def main() -> None:
    """Read requests from stdin and answer each."""
    for module in _OTHERS:
        with suppress(ImportError):
            __import__(module)
    for line in sys.stdin:
        tests, limit, files, pure = json.loads(line)
        begin = time.monotonic()
        shutil.rmtree(_CACHE, ignore_errors=True)
        pid = os.fork()
        if pid == 0:
            os.setsid()
            _run(tests, files, pure)
        code = _await(pid, limit)
        how = "hung" if code is None else "killed" if code else "lives"
        print(json.dumps([how, time.monotonic() - begin]), flush=True)


def _run(tests: list[str], files: list[str], pure: bool) -> None:
    if pure:
        os.environ["SHMGEN_PURE"] = "1"
    null = os.open(os.devnull, os.O_RDWR)
    log = os.open(_LOG, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for file, into in enumerate((null, log, log)):
        os.dup2(into, file)
    for name in [name for name in sys.modules if name.partition(".")[0] in ("shmgen", "tests")]:
        del sys.modules[name]
    sys.argv[0], sys.modules["__main__"].__package__ = "pytest", None
    lines = Lines([str(Path.cwd() / CODE / file) for file in files])
    early = ["-W", "ignore:Module already imported:pytest.PytestAssertRewriteWarning", "-p", "no:cacheprovider"]
    code = 3
    try:
        code = int(pytest.main(["-x", "-q", "--no-header", *early, *tests], plugins=[lines] if files else []))
        if files:
            Path(_LINES).write_text(json.dumps(lines.found))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


def _await(pid: int, limit: float) -> int | None:
    """Return the exit code, or None after `limit` seconds. End all child processes."""
    end = time.monotonic() + limit
    try:
        while time.monotonic() < end:
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.01)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        return None
    finally:
        with suppress(ProcessLookupError):
            os.killpg(pid, signal.SIGKILL)


class Lines:
    """A pytest plugin that records which lines of some files each test executes.

    Lines in child processes are not recorded, and neither are lines that run while a test uses a tracer of its own.
    """

    def __init__(self, files: list[str]) -> None:
        self.found: dict[str, dict[str, Any]] = {}
        self._names = {file: str(Path(file).relative_to(Path.cwd() / CODE)) for file in files}
        self._now: set[tuple[str, int]] = set()
        self._elsewhere = False
        self._shared: dict[str, tuple[set[tuple[str, int]], bool]] = {}
        sys.addaudithook(self._hear)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self._now = set()
        begin = time.monotonic()
        threading.settrace(self._call)
        sys.settrace(self._call)
        self._elsewhere = False
        yield
        elsewhere = self._elsewhere
        sys.settrace(None)
        threading.settrace(None)  # type: ignore[arg-type]
        for fixture in getattr(item, "fixturenames", ()):
            shared, started = self._shared.get(fixture, (set(), False))
            self._now |= shared
            elsewhere |= started
        lines: dict[str, list[int]] = {}
        for file, line in sorted(self._now):
            lines.setdefault(file, []).append(line)
        self.found[item.nodeid] = {"seconds": time.monotonic() - begin, "lines": lines, "elsewhere": elsewhere}

    @pytest.hookimpl(hookwrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        """Count the lines of a shared fixture for each test that uses it."""
        before, elsewhere, self._elsewhere = set(self._now), self._elsewhere, False
        yield
        if fixturedef.scope != "function":
            self._shared[fixturedef.argname] = self._now - before, self._elsewhere
        self._elsewhere |= elsewhere

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event in ("os.fork", "subprocess.Popen", "sys.settrace"):
            self._elsewhere = True

    def _call(self, frame: FrameType, event: str, argument: Any) -> Callable[..., Any] | None:
        name = self._names.get(frame.f_code.co_filename)
        if name is None:
            return None
        now = self._now
        now.add((name, frame.f_lineno))

        def line(frame: FrameType, event: str, argument: Any) -> Any:
            now.add((name, frame.f_lineno))
            return line

        return line


if __name__ == "__main__":
    main()
