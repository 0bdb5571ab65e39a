"""What all tests share: where the corpus is, and regions that leave nothing behind."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
SHARED = REPOSITORY.parent / "shared"


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


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update-golden", action="store_true", help="write what is expected anew, then look at the diff")


@pytest.fixture(scope="session")
def update_golden(request: pytest.FixtureRequest) -> bool:
    """Whether tests/cases and tests/errors take what they get for what they want."""
    return bool(request.config.getoption("--update-golden"))
