"""Our `dataclass` beside that of the standard library: whatever is asked of either gets the same answer."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import subprocess
import sys
from typing import Any

import pytest

from shmgen.core import fast_dataclass


def pair(make: Any, **options: bool) -> list[Any]:
    """The class with ours and with theirs."""
    return [
        decorator(slots=True, **options)(make()) for decorator in (fast_dataclass._dataclass, dataclasses.dataclass)
    ]


def place() -> type:
    class Place:
        """Where."""

        name: str
        size: int = 3
        parts: dict[str, int] = dataclasses.field(default_factory=dict)
        text: str = dataclasses.field(default="", compare=False, repr=False)
        cost: Any = dataclasses.field(default=None, hash=False)

        @property
        def twice(self) -> int:
            return 2 * self.size

        def named(self, name: str) -> Any:
            return dataclasses.replace(self, name=name)  # type: ignore[type-var]

    return Place


@pytest.mark.parametrize(
    "ask",
    [
        lambda kind: repr(kind("a")),
        lambda kind: repr(kind("a", size=4, cost=[1])),
        lambda kind: (kind("a").twice, kind.__doc__, kind.__qualname__, kind.__module__, kind.__match_args__),
        lambda kind: (kind("a") == kind("a"), kind("a") == kind("b"), kind("a") != kind("a", 4)),
        lambda kind: (kind("a") == kind("a", text="other"), kind("a") == kind("a", cost=1), kind("a") == "a"),
        lambda kind: kind("a").parts is kind("a").parts,
        lambda kind: repr(kind("a").named("b")),
        lambda kind: [(field.name, field.default == 3, field.compare) for field in dataclasses.fields(kind)],
        lambda kind: dataclasses.asdict(kind("a", cost=kind("b"))),
        lambda kind: dataclasses.is_dataclass(kind),
        lambda kind: (repr(copy.copy(kind("a"))), copy.deepcopy(kind("a", parts={"x": 1})).parts),
        lambda kind: kind(),
        lambda kind: kind("a", 1, {}, "", None, 6),
        lambda kind: kind("a", wrong=1),
        lambda kind: setattr(kind("a"), "size", 4),
        lambda kind: delattr(kind("a"), "size"),
        lambda kind: kind("a").__dict__,
        lambda kind: hash(kind("a")),
    ],
)
@pytest.mark.parametrize("frozen", [True, False])
def test_it_does_as_the_standard_library(ask: Any, frozen: bool) -> None:
    answers = []
    for kind in pair(place, frozen=frozen):
        try:
            answers.append(ask(kind))
        except Exception as error:
            answers.append(type(error))
    assert answers[0] == answers[1]


def test_hashes_leave_out_what_they_should() -> None:
    for kind in pair(place, frozen=True):
        one, other = (kind("a", parts=(), cost=cost, text=cost) for cost in "xy")
        assert hash(one) == hash(other)
        assert one != other
        assert hash(kind("b", parts=())) != hash(one)


def test_it_can_be_matched_and_pickled() -> None:
    from shmgen.core.diagnostics import Span

    assert pickle.loads(pickle.dumps(Span("a", 3))) == Span("a", 3)
    match Span("a", 3):
        case Span(path, line):
            assert (path, line) == ("a", 3)


def test_what_every_run_loads_is_made_by_it() -> None:
    """The standard library's, in a module that `generate` loads, would be the slowest line of it."""
    code = (
        "import dataclasses, sys; real = dataclasses._process_class\n"
        "def slow(cls, *rest): print(cls.__module__, cls.__name__); return real(cls, *rest)\n"
        "dataclasses._process_class = slow\n"
        "sys.argv = ['shmgen', 'generate', 'std_msgs/Empty', '--quiet', '-o', sys.argv[1]]\n"
        "from shmgen.__main__ import main; main()"
    )
    command = [sys.executable, "-c", code, "/dev/null/no/folder"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "SHM007" in done.stderr
    assert done.stdout == ""
