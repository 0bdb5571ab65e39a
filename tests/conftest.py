"""Fixtures of all tests: the corpus, unique topics whose regions are removed, and compiled PLCs."""

from __future__ import annotations

import getpass
import os
import shutil
import signal
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, Phase, settings

from shmgen.core.plural import counted

from .support import REPOSITORY as REPOSITORY
from .support import SHARED, machine

if TYPE_CHECKING:
    from tests.support.plc_calls import Calls
    from tests.support.plc_demo import Clock, Demo

# The machine may be busy, so how long an example takes says nothing about it. The examples are the same in each run, so
# that no commit is red over the fault of another; `make fuzz` and `make fuzz-walkers` draw new ones. The first failing
# example of a planted fault is enough, because shrinking an example takes minutes.
settings.register_profile(
    "any machine",
    deadline=None,
    derandomize="SHMGEN_EXAMPLES" not in os.environ,
    suppress_health_check=[HealthCheck.too_slow],
    phases=(Phase.explicit, Phase.generate) if "SHMGEN_PLANTED_FAULT" in os.environ else tuple(Phase),
)
settings.load_profile("any machine")

machine.pretend()
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell's `make test &` has it: children would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def corpus() -> Path:
    """Real definitions, `jazzy/<package>/msg/…` and `noetic/…`. They belong to others and are not in the repository."""
    folder = SHARED / "corpus"
    if not folder.is_dir():
        pytest.skip(f"no corpus of definitions at {folder}")
    return folder


@pytest.fixture
def topic() -> Iterator[str]:
    """A unique topic. Its region and semaphores are removed afterwards."""
    name = f"shmgen_test/t{uuid.uuid4().hex}"
    yield f"/{name}"
    for file in Path("/dev/shm").glob(f"*{name.replace('/', '.')}*"):
        file.unlink()


@pytest.fixture
def space() -> Iterator[str]:
    """A unique namespace for topics. Their regions are removed afterwards."""
    name = f"t{uuid.uuid4().hex[:12]}"
    yield f"/{name}"
    for file in Path("/dev/shm").glob(f"*{name}*"):
        file.unlink()


def pytest_configure(config: pytest.Config) -> None:
    """Create a folder for temporary files and logs of ROS, which is removed after the session. Workers inherit it."""
    if not hasattr(config, "workerinput"):
        usual = os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())  # folders of failed tests stay
        before = {name: os.environ.get(name) for name in ("TMPDIR", "ROS_LOG_DIR")}
        folder = tempfile.mkdtemp(prefix="shmgen-tests-")
        os.chmod(folder, 0o711)  # tests become other users
        os.environ |= {"TMPDIR": folder, "ROS_LOG_DIR": f"{folder}/ros"}
        tempfile.tempdir = None  # asks again
        started = time.time()

        def leave() -> None:
            _remove_orphan_semaphores(started)
            shutil.rmtree(folder, ignore_errors=True)
            for name, value in before.items():
                os.environ.pop(name)
                os.environ |= {name: value} if value else {}
            tempfile.tempdir = None
            for empty in Path(usual).glob(f"pytest-of-{getpass.getuser()}"):
                with suppress(OSError):
                    empty.rmdir()

        config.add_cleanup(leave)


def _remove_orphan_semaphores(since: float) -> None:
    """Remove the temporary file that glibc leaves if a process is killed while it creates a semaphore."""
    from shmgen.live import processes
    from shmgen.tools.doctor.clean import orphan_semaphores

    for file in orphan_semaphores(processes.look()):
        with suppress(OSError):
            if os.lstat(file).st_ctime > since:
                os.unlink(file)


PROGRAMS = ("gcc", "g++", "git")
_PASSED = "shmgen/passed"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[None]:
    """Skip a test that runs one of PROGRAMS if this program is not installed."""
    try:
        return (yield)
    except FileNotFoundError as missing:
        if missing.filename not in PROGRAMS or shutil.which(missing.filename):
            raise
        pytest.skip(f"no {missing.filename}: apt-get install {missing.filename}")


pytest_runtest_call = pytest_runtest_setup


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-golden", action="store_true", help="write what is expected anew, then look at the diff")
    parser.addoption("--rest", action="store_true", help="leave out the tests that passed in the run before")
    parser.addoption("--options-set", default="", help="of tests/plc/test_options.py: the name of one, or all")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return two workers for each processor, because tests wait for other processes about half of the time."""
    return 2 * (os.cpu_count() or 1)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests that `make test` or CI leaves out (see pyproject.toml). With `--rest`, drop tests that passed."""
    for item in items:
        for marker, beyond in (("family", "slow"), ("sample", "exhaustive")):
            chosen = item.get_closest_marker(marker)
            if chosen and not any(name in item.name for name in chosen.args):
                item.add_marker(beyond)
        if "kilted" in item.name:
            item.add_marker("exhaustive")
        if item.get_closest_marker("sample") or item.get_closest_marker("exhaustive"):
            item.add_marker("slow")
    if config.option.rest:
        passed = set(config.cache.get(_PASSED, []) if getattr(config, "cache", None) else [])
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid in passed])
        items[:] = [item for item in items if item.nodeid not in passed]


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Remember for `--rest` the tests that passed."""
    config = session.config
    if getattr(config, "cache", None) and not hasattr(config, "workerinput"):
        reporter: Any = config.pluginmanager.get_plugin("terminalreporter")
        passed = {report.nodeid for report in reporter.getreports("passed") if report.when == "call"}
        failed = {report.nodeid for kind in ("failed", "error") for report in reporter.getreports(kind)}
        before = set(config.cache.get(_PASSED, [])) if config.option.rest or config.option.lf else set()
        config.cache.set(_PASSED, sorted((before | passed) - failed))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print a line for each reason to skip: the number of tests, and how to run them."""
    skipped = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in terminalreporter.getreports("skipped"))
    for reason, count in skipped.most_common():
        terminalreporter.write_line(f"left out: {counted(count, 'test')}: {reason}")
    if terminalreporter.config.option.markexpr in ("not slow", "not exhaustive"):
        terminalreporter.write_line("left out: tests that take long: make test-all")


@pytest.fixture(scope="session")
def update_golden(request: pytest.FixtureRequest) -> bool:
    """True if tests write their output as the new expected output."""
    return bool(request.config.getoption("--update-golden"))


@pytest.fixture(scope="session")
def compiled_demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    from tests.support.plc_demo import make  # what translates is slow to import, and few tests need it

    return make(tmp_path_factory.mktemp("plc_demo"))


@pytest.fixture
def clock(compiled_demo: Demo) -> Clock:
    from tests.support.plc_demo import Clock

    return Clock(compiled_demo.plc)


@pytest.fixture
def demo(compiled_demo: Demo, clock: Clock) -> Iterator[Demo]:
    """A PLC with default settings. The fixture checks that no block has waited for a semaphore."""
    compiled_demo.plc.born(1)
    compiled_demo.plc.round_sizes(False)
    compiled_demo.plc.fail("", 0)
    yield compiled_demo
    assert compiled_demo.plc.waits == 0


@pytest.fixture(scope="session")
def compiled_calls(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Calls:
    """The compiled services and actions, which the first worker that needs them creates."""
    from tests.support.plc_calls import open_or_make

    folder = tmp_path_factory.getbasetemp()
    return open_or_make((folder if worker_id == "master" else folder.parent) / "plc_calls")


@pytest.fixture
def calls(compiled_calls: Calls) -> Iterator[Calls]:
    """A PLC whose clock is 0 until the test advances it. The fixture checks that no block waited for a semaphore."""
    compiled_calls.plc.set_clock(0)
    yield compiled_calls
    compiled_calls.plc.fail("", 0)
    compiled_calls.plc.run_clock()  # that of other tests runs
    assert compiled_calls.plc.waits == 0


@pytest.fixture(params=["exact", "rounded"])
def sizes(request: pytest.FixtureRequest, demo: Demo) -> None:
    """Both ways in which a PLC runtime may compare the sizes of shared memory."""
    demo.plc.round_sizes(request.param == "rounded")
