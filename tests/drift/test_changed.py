"""`generate` after a change prints what hangs on it, and leaves the same files as one that prints all."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from shmgen.drift import check_cache
from shmgen.generator import changed

from ..support.command import Result, inside, run, tree

SETTINGS = """
messages = ["cell_msgs", "std_srvs/SetBool", "geometry_msgs/Pose", "cell_tools"]
path = ["msgs"]
[bounds]
cell_msgs = 4
[[topics]]
topic = "/cell/state"
type = "cell_msgs/State"
direction = "to_plc"
[[services]]
service = "/cell/move"
type = "cell_msgs/Move"
server = "plc"
"""
FILES = {
    "cell_msgs/msg/Axis.msg": "# An axis.\nuint8 IDLE=0\nfloat64 position  # [m]\nint32[<=3] codes\n",
    "cell_msgs/msg/Tool.msg": "geometry_msgs/Point tip\nstring<=9 name\n",
    "cell_msgs/msg/State.msg": "Axis[3] axes\nTool tool\nbuiltin_interfaces/Time stamp\n",
    "cell_msgs/msg/Alone.msg": "uint8 a 3\nstring text\ngeometry_msgs/Vector3 way\n",
    "cell_msgs/srv/Move.srv": "Axis goal\n---\nbool success\nTool[<=2] tools\n",
    "cell_msgs/srv/Stop.srv": "---\nstring<=5 reason\n",
    "cell_msgs/action/Grip.action": "Axis goal\n---\nuint8 result\n---\nTool tool\n",
    "cell_tools/msg/Other.msg": "cell_msgs/State state\n",
}
LINES = """
uint8 NEW_{n}={n}
float32 field_{n}
int16[<=5] many_{n}
# Words {n}.
string<={n} text_{n}
bool[3] b_{n}
Axis axis_{n}
geometry_msgs/Pose pose_{n}
uint8 def_{n} 7
float64 metres_{n}  # [m] {n}
cell_msgs/Tool t_{n}
float64[] open_{n}
no such type
string NAME_{n}="<&>"
uint8 from_{n}
uint8 Rest{n}=1
""".strip().splitlines()
GENERATED = ("plcopen/shmgen.xml", "layout.lock", "c/shm_msgs/cell_msgs/msg/axis.h", "python/shm_msgs/__init__.py")


def add(files: Path, rng: random.Random) -> None:
    file = rng.choice(sorted(files.glob("msgs/*/*/*")))
    line = rng.choice(LINES).format(n=rng.randrange(1, 99))
    file.write_text(f"{line}\n{file.read_text()}" if rng.random() < 0.5 else f"{file.read_text()}{line}\n")


def take(files: Path, rng: random.Random) -> None:
    file = rng.choice(sorted(files.glob("msgs/*/*/*")))
    lines = file.read_text().splitlines(keepends=True)
    own = [number for number, line in enumerate(lines) if line != "---\n"]
    if own:
        del lines[rng.choice(own)]
    file.write_text("".join(lines))


def restore(files: Path, rng: random.Random) -> None:
    """Which brings most to rights again that are wrong."""
    for path, text in FILES.items():
        if not (files / "msgs" / path).is_file() or rng.random() < 0.5:
            (files / "msgs" / path).write_text(text)


def remove(files: Path, rng: random.Random) -> None:
    rng.choice(sorted(files.glob("msgs/*/*/*"))).unlink()


def by_hand(files: Path, rng: random.Random) -> None:
    file = files / "generated" / rng.choice(GENERATED[:1] + GENERATED[2:])
    if file.is_file():
        file.write_text(file.read_text() + "mine") if rng.random() < 0.7 else file.unlink()


def configure(files: Path, rng: random.Random) -> None:
    above = rng.choice(("task_interval = 5\n", "", 'targets = ["c", "python"]\n', 'package = "cell"\n'))
    below = rng.choice(("", "[types]\ntime = 'LTIME'\n"))
    (files / "shmgen.toml").write_text(above + SETTINGS + below)


def nothing(files: Path, rng: random.Random) -> None:
    pass


STEPS: tuple[Callable[[Path, random.Random], None], ...] = (
    *(add, add, add, add, add, take, take, restore, restore, restore),
    *(remove, by_hand, configure, nothing),
)


@pytest.fixture
def some(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """How many messages each run printed that did not print all."""
    counts: list[int] = []
    original = changed.texts

    def counted(*arguments: object) -> dict[str, str] | None:
        found = original(*arguments)  # type: ignore[arg-type]
        if found is not None:
            counts.append(len(found))
        return found

    monkeypatch.setattr(changed, "texts", counted)
    monkeypatch.setattr(check_cache, "_TICK", 0)
    return counts


def work(folder: Path) -> Path:
    for path, text in FILES.items():
        (folder / "msgs" / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / "msgs" / path).write_text(text)
    (folder / "shmgen.toml").write_text(SETTINGS)
    return folder


def again(folder: Path, *options: str) -> Result:
    """As the command does: first what is remembered."""
    arguments = ["generate", *options]
    with inside(folder):
        said = check_cache.load(arguments)
    return Result(0, said, "") if said is not None else run(arguments, folder)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("seed", range(4))
def test_what_hangs_on_a_change_is_all_that_differs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, some: list[int], seed: int
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    rng, dice = random.Random(seed), random.Random(seed)
    folders = work(tmp_path / "some" / "work"), work(tmp_path / "all" / "work")
    for number in range(90):
        options = rng.choice([(), (), (), ("-q",), ("-t", "c"), ("--skip-unbounded",)]) if rng.random() < 0.3 else ()
        mine, whole = again(folders[0], *options), run(["generate", "--no-cache", *options], folders[1])
        assert mine == whole, (seed, number)
        assert tree(folders[0]) == tree(folders[1]), (seed, number)
        step = rng.choice(STEPS)
        state = rng.getstate()
        for folder in folders:
            dice.setstate(state)
            step(folder, dice)
        rng.setstate(dice.getstate())
    assert len(some) >= 3, some
