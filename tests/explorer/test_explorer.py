"""The explorer runs the shipped endpoints in all schedules of the scenes, and finds only planted faults."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from ..conftest import REPOSITORY
from ..support import kept
from .build import build, explore, generate, missing
from .faults import FAULTS, TESTED, Fault
from .scenes import FULL, LARGE, QUICK, SCENES, Scene

pytestmark = pytest.mark.skipif(
    bool(missing()), reason=f"not installed: {', '.join(missing())}: the endpoints are not explored"
)
SECONDS = 200.0
"""Limit of the processor time of a scene in seconds. Most scenes take less than one second."""
PLANTED = list({fault.scene: fault for fault in reversed(FAULTS) if not fault.reason}.values())[::3]
"""The first fault of every third scene that finds faults. `make explore` plants all faults."""


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Callable[[str], Path]:
    """A function that returns the explorer for a `sync` setting, compiled once for all workers."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "explorer"

    def build_once(sync: str) -> Path:
        path = folder / sync
        with kept.locked(path / "guard"):
            return path / "explore" if (path / "explore").exists() else build(path, generate(path, sync))

    return build_once


def check_scene(program: Path, scene: Scene) -> None:
    verdict, steps = explore(program, scene.arguments, SECONDS)
    assert not verdict["found"], f"{verdict['found']}\nreplay='{verdict['schedule']}'\n{steps}"
    assert verdict["complete"], f"the search did not finish in {SECONDS} s: {verdict}"


@pytest.mark.parametrize("scene", QUICK, ids=lambda scene: scene.name)
@pytest.mark.family("[a PLC takes over from C]", "[one reader waits")
def test_quick_scene_has_no_error(program: Callable[[str], Path], scene: Scene) -> None:
    check_scene(program(scene.sync), scene)


@pytest.mark.sample(*(f"[{scene.name}]" for scene in FULL[1::4]))
@pytest.mark.parametrize("scene", FULL, ids=lambda scene: scene.name)
def test_full_scene_has_no_error(program: Callable[[str], Path], scene: Scene) -> None:
    check_scene(program(scene.sync), scene)


@pytest.mark.slow
def test_schedule_of_an_error_can_be_replayed(tmp_path: Path) -> None:
    """Run a printed schedule once more, with the same result and all steps."""
    (fault,) = (fault for fault in FAULTS if fault.name == "a takeover stores its id before it starts a turn")
    program = build(tmp_path, fault.planted(generate(tmp_path)))
    arguments = SCENES[fault.scene].arguments
    verdict, _ = explore(program, arguments, SECONDS)
    replayed, steps = explore(program, [f"replay={verdict['schedule']}", *arguments], SECONDS)
    assert (replayed["schedules"], replayed["found"]) == (1, verdict["found"]), steps
    assert steps.count("\n") > 20


@pytest.mark.sample(
    "[a writer does not acquire the record lock]",
    "[ST: the reader does not check the slot after the copy]",
    "[a writer that lost its claim keeps writing]",
)
@pytest.mark.parametrize("fault", PLANTED, ids=lambda fault: fault.name)
def test_planted_fault_is_found_by_its_scene(fault: Fault, tmp_path: Path) -> None:
    program = build(tmp_path, fault.planted(generate(tmp_path)))
    verdict, _ = explore(program, SCENES[fault.scene].arguments, SECONDS)
    assert verdict["found"], verdict


@pytest.mark.parametrize(
    "fault", list({fault.name: fault for fault in [*FAULTS, *TESTED]}.values()), ids=lambda fault: fault.name
)
@pytest.mark.slow
def test_every_fault_can_be_planted(fault: Fault, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Find the original text of each fault in a generated file or a template."""
    texts = generate(tmp_path_factory.getbasetemp())
    texts |= {str(path): path.read_text() for path in (REPOSITORY / "templates" / "cpp").glob("*.hpp")}
    assert fault.planted(texts) != texts
    assert fault.test or fault.scene in SCENES


@pytest.mark.parametrize(
    ("settings", "endpoints", "expected"),
    [
        ("p=90", "adder,adder last=1", "LOST"),
        ("p=0", "adder,adder last=1", ""),
        ("p=90", "store_then_load,store_then_load", ""),
        ("p=90 b=2", "store_then_load,store_then_load", "PASSED"),
        ("p=90 b=4 fence=1", "store_then_load,store_then_load", ""),
        ("p=90 b=4", "sender,receiver", ""),
        ("p=90", "copier,checker", "HALF"),
    ],
)
def test_explorer_finds_known_races(
    program: Callable[[str], Path], settings: str, endpoints: str, expected: str
) -> None:
    """Execute stores as on x86-64: a load may pass an earlier store, but two stores keep their order."""
    verdict, _ = explore(program("lock"), [*settings.split(), *endpoints.split(",")], SECONDS)
    assert verdict["found"].partition(":")[0] == expected
    assert verdict["complete"] == (not expected)


@pytest.mark.parametrize(
    "scene",
    [
        "a writer and a reader",
        "a PLC writer and a reader",
        "a writer and a PLC reader",
        "two processes acquire the lock",
    ],
)
@pytest.mark.family("[two processes acquire the lock]")
def test_table_of_states_hides_no_result(program: Callable[[str], Path], scene: str) -> None:
    """Compare the results with and without the table. One pre-emption keeps the search without the table short."""
    endpoints = SCENES[scene].endpoints
    settings = ["p=1", "c=1" if "PLC" not in scene else "c=0", "end_states=1", *endpoints]
    short, full = (explore(program("lock"), [f"table={table}", *settings], SECONDS)[0] for table in (1, 0))
    assert short["complete"]
    assert full["complete"]
    assert short["end_states"] == full["end_states"] > 1
    assert short["schedules"] <= full["schedules"]


def test_names_of_scenes_and_faults_are_unique() -> None:
    names = [scene.name for scene in [*QUICK, *FULL, *LARGE]]
    assert len(names) == len(set(names))
    assert len(FAULTS) == len({fault.name for fault in FAULTS})
