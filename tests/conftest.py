"""What all tests share: where the corpus is, and regions that leave nothing behind."""

from __future__ import annotations

import getpass
import os
import shutil
import signal
import tempfile
import uuid
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, settings

from shmgen.core.plural import counted

from .support import machine

if TYPE_CHECKING:
    from tests.support.plc_calls import Calls
    from tests.support.plc_demo import Clock, Demo

REPOSITORY = Path(__file__).parents[1]
SHARED = REPOSITORY.parent / "shared"

# The machine may be busy, so how long an example takes says nothing about it.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")

machine.pretend()
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell's `make test &` has it: children would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def corpus() -> Path:
    """Real definitions, `jazzy/<package>/msg/…` and `noetic/…`; other people's data, so not part of the project."""
    folder = SHARED / "corpus"
    if not folder.is_dir():
        pytest.skip(f"no corpus of definitions at {folder}")
    return folder


@pytest.fixture
def topic() -> Iterator[str]:
    """A topic nobody else uses; its region and semaphores are removed afterwards."""
    name = f"shmgen_test/t{uuid.uuid4().hex}"
    yield f"/{name}"
    for file in Path("/dev/shm").glob(f"*{name.replace('/', '.')}*"):
        file.unlink()


@pytest.fixture
def space() -> Iterator[str]:
    """A namespace for topics that nobody else uses; their regions go afterwards."""
    name = f"t{uuid.uuid4().hex[:12]}"
    yield f"/{name}"
    for file in Path("/dev/shm").glob(f"*{name}*"):
        file.unlink()


def pytest_configure(config: pytest.Config) -> None:
    """What ROS, and whatever is killed, leaves in /tmp and ~/.ros goes with the session. Workers inherit this."""
    if not hasattr(config, "workerinput"):
        usual = os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())  # folders of failed tests stay
        before = {name: os.environ.get(name) for name in ("TMPDIR", "ROS_LOG_DIR")}
        folder = tempfile.mkdtemp(prefix="shmgen-tests-")
        os.chmod(folder, 0o711)  # tests become other users
        os.environ |= {"TMPDIR": folder, "ROS_LOG_DIR": f"{folder}/ros"}
        tempfile.tempdir = None  # asks again

        def leave() -> None:
            shutil.rmtree(folder, ignore_errors=True)
            for name, value in before.items():
                os.environ.pop(name)
                os.environ |= {name: value} if value else {}
            tempfile.tempdir = None
            for empty in Path(usual).glob(f"pytest-of-{getpass.getuser()}"):
                with suppress(OSError):
                    empty.rmdir()

        config.add_cleanup(leave)


PROGRAMS = ("gcc", "g++", "git")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[None]:
    """A test that runs one of these which is not here is left out, wherever in it that is."""
    try:
        return (yield)
    except FileNotFoundError as missing:
        if missing.filename not in PROGRAMS or shutil.which(missing.filename):
            raise
        pytest.skip(f"no {missing.filename}: apt-get install {missing.filename}")


pytest_runtest_call = pytest_runtest_setup


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-golden", action="store_true", help="write what is expected anew, then look at the diff")
    parser.addoption("--options-set", default="", help="of tests/plc/test_options.py: the name of one, or all")


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """What was left out, a line for each reason: how many tests, and how to have them."""
    skipped = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in terminalreporter.getreports("skipped"))
    for reason, count in skipped.most_common():
        terminalreporter.write_line(f"left out: {counted(count, 'test')}: {reason}")
    if terminalreporter.config.option.markexpr == "not slow":
        terminalreporter.write_line("left out: tests that take long: make test-all")


@pytest.fixture(scope="session")
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Whether tests/cases and tests/errors take what they get for what they want."""
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
    """A PLC as it comes; that no block ever waited for a semaphore is true of every test."""
    compiled_demo.plc.born(1)
    compiled_demo.plc.round_sizes(False)
    compiled_demo.plc.fail("", 0)
    yield compiled_demo
    assert compiled_demo.plc.waits == 0


@pytest.fixture(scope="session")
def compiled_calls(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Calls:
    """Made by the first of the workers that asks for it."""
    from tests.support.plc_calls import open_or_make

    folder = tmp_path_factory.getbasetemp()
    return open_or_make((folder if worker_id == "master" else folder.parent) / "plc_calls")


@pytest.fixture
def calls(compiled_calls: Calls) -> Iterator[Calls]:
    """A PLC that never waited for a semaphore; its clock stands still at 0 but for what a test adds to it."""
    compiled_calls.plc.set_clock(0)
    yield compiled_calls
    compiled_calls.plc.fail("", 0)
    compiled_calls.plc.run_clock()  # that of other tests runs
    assert compiled_calls.plc.waits == 0


@pytest.fixture(params=["exact", "rounded"])
def sizes(request: pytest.FixtureRequest, demo: Demo) -> None:
    """Both ways a runtime may compare the sizes of shared memory."""
    demo.plc.round_sizes(request.param == "rounded")
