"""The shipped ends in all schedules of the scenes: nothing is found, but for what is planted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from ..conftest import REPOSITORY
from ..support import kept
from .build import build, explore, generated, missing
from .faults import FAULTS, TESTED, Fault
from .scenes import FULL, LARGE, QUICK, SCENES, Scene

pytestmark = pytest.mark.skipif(bool(missing()), reason=f"not here: {', '.join(missing())}: the ends are not explored")
SECONDS = 200.0
"""Of the processor, at most; most scenes take less than one."""
ONE_FOR_EACH_SCENE = list({fault.scene: fault for fault in reversed(FAULTS) if not fault.reason}.values())
"""The first fault that each scene finds; `make explore` plants all."""


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Callable[[str], Path]:
    """The explorer with what is generated for that `sync`, compiled once for all workers."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "explorer"

    def compiled(sync: str) -> Path:
        here = folder / sync
        with kept.locked(here / "guard"):
            return here / "explore" if (here / "explore").exists() else build(here, generated(here, sync))

    return compiled


def holds(program: Path, scene: Scene) -> None:
    verdict, told = explore(program, scene.arguments, SECONDS)
    assert not verdict["found"], f"{verdict['found']}\nreplay='{verdict['schedule']}'\n{told}"
    assert verdict["complete"], f"not gone through in {SECONDS} s: {verdict}"


@pytest.mark.parametrize("scene", QUICK, ids=lambda scene: scene.name)
@pytest.mark.family("[a PLC after C]", "[one waits")
def test_nothing_is_found(program: Callable[[str], Path], scene: Scene) -> None:
    holds(program(scene.sync), scene)


@pytest.mark.slow
@pytest.mark.parametrize("scene", FULL, ids=lambda scene: scene.name)
def test_nothing_is_found_where_it_takes_longer(program: Callable[[str], Path], scene: Scene) -> None:
    holds(program(scene.sync), scene)


@pytest.mark.slow
def test_what_is_found_can_be_replayed(tmp_path: Path) -> None:
    """The printed schedule, given back, is run once and ends in the same, told step by step."""
    (fault,) = (fault for fault in FAULTS if fault.name == "a turn is begun behind the name")
    program = build(tmp_path, fault.planted(generated(tmp_path)))
    arguments = SCENES[fault.scene].arguments
    verdict, _ = explore(program, arguments, SECONDS)
    again, told = explore(program, [f"replay={verdict['schedule']}", *arguments], SECONDS)
    assert (again["schedules"], again["found"]) == (1, verdict["found"]), told
    assert told.count("\n") > 20


@pytest.mark.slow
@pytest.mark.parametrize("fault", ONE_FOR_EACH_SCENE, ids=lambda fault: fault.name)
def test_a_planted_fault_is_found(fault: Fault, tmp_path: Path) -> None:
    program = build(tmp_path, fault.planted(generated(tmp_path)))
    verdict, _ = explore(program, SCENES[fault.scene].arguments, SECONDS)
    assert verdict["found"], verdict


@pytest.mark.parametrize(
    "fault", list({fault.name: fault for fault in [*FAULTS, *TESTED]}.values()), ids=lambda fault: fault.name
)
def test_a_fault_can_be_planted(fault: Fault, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Also those that no scene finds: what they change still stands in what is generated."""
    texts = generated(tmp_path_factory.getbasetemp())
    texts |= {str(path): path.read_text() for path in (REPOSITORY / "templates" / "cpp").glob("*.hpp")}
    assert fault.planted(texts) != texts
    assert fault.test or fault.scene in SCENES


@pytest.mark.parametrize(
    ("settings", "ends", "found"),
    [
        ("p=90", "adds,adds last=1", "LOST"),
        ("p=0", "adds,adds last=1", ""),
        ("p=90", "stores_and_loads,stores_and_loads", ""),
        ("p=90 b=2", "stores_and_loads,stores_and_loads", "PASSED"),
        ("p=90 b=4 fence=1", "stores_and_loads,stores_and_loads", ""),
        ("p=90 b=4", "sends,receives", ""),
        ("p=90", "copies,looks", "HALF"),
    ],
)
def test_the_explorer_finds_what_it_must(program: Callable[[str], Path], settings: str, ends: str, found: str) -> None:
    """Store buffers as on x86-64: a load passes an earlier store, two stores keep their order."""
    verdict, _ = explore(program("lock"), [*settings.split(), *ends.split(",")], SECONDS)
    assert verdict["found"].partition(":")[0] == found
    assert verdict["complete"] == (not found)


@pytest.mark.parametrize(
    "scene", ["a writer and a reader", "a PLC and a reader", "a writer and a PLC that reads", "two want the lock"]
)
@pytest.mark.family("[two want the lock]")
def test_the_table_of_states_hides_no_end(program: Callable[[str], Path], scene: str) -> None:
    """What is cut off would have come to the same ends; with one pre-emption it can be done without the table."""
    ends = SCENES[scene].ends
    settings = ["p=1", "c=1" if "PLC" not in scene else "c=0", "ends=1", *ends]
    with_it, without = (explore(program("lock"), [f"table={table}", *settings], SECONDS)[0] for table in (1, 0))
    assert with_it["complete"]
    assert without["complete"]
    assert with_it["ends"] == without["ends"] > 1
    assert with_it["schedules"] <= without["schedules"]


def test_no_name_is_used_twice() -> None:
    names = [scene.name for scene in [*QUICK, *FULL, *LARGE]]
    assert len(names) == len(set(names))
    assert len(FAULTS) == len({fault.name for fault in FAULTS})
