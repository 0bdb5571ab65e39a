"""How often definitions are read, laid out and made into classes: once for a bridge and for each tool, or never."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shmgen import config
from shmgen.bridge.backend import RosClient, RosPublisher, RosSubscription
from shmgen.bridge.common import choice
from shmgen.bridge.run import run as run_bridge
from shmgen.core.diagnostics import Rejected, Report
from shmgen.definitions import library
from shmgen.generator import layout, pipeline, render
from shmgen.live.classes import ClassRegistry
from shmgen.live.session import Session
from shmgen.runtime import Time
from tests.support.command import Result, run

DEFINITIONS = {
    "Thing.msg": "float64 x\nPart[<=3] parts\nstring name\n",
    "Part.msg": "int32 number\n",
    "Ask.srv": "Part part\n---\nstring text\n",
    "Unused.msg": "int8 a\n",
}


@pytest.fixture
def folder(tmp_path: Path, topic: str) -> Path:
    """One topic and one service, of messages that share a part; a bound is for a message that neither holds."""
    place = tmp_path / "msgs" / "cell_msgs"
    for name, text in DEFINITIONS.items():
        file = place / name.partition(".")[2] / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    (tmp_path / "shmgen.toml").write_text(
        'path = ["msgs"]\n[bounds]\n"sensor_msgs/Imu" = 3\n'
        f'[[topics]]\ntopic = "{topic}"\ntype = "cell_msgs/Thing"\n'
        f'[[services]]\nservice = "{topic}_ask"\ntype = "cell_msgs/Ask"\n'
    )
    return tmp_path


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often each step was made; a definition by the name of its file."""
    counts: Counter[str] = Counter()

    def count(module: Any, name: str, called: str = "") -> None:
        real = getattr(module, name)

        def counting(*arguments: Any, **keywords: Any) -> Any:
            counts[called or Path(arguments[0].path).name] += 1
            return real(*arguments, **keywords)

        monkeypatch.setattr(module, name, counting)

    count(library, "catalogue", "folders")
    count(library.store, "catalogue", "store")
    count(library, "read")
    count(layout, "lay_out", "layouts")
    count(render, "render", "classes")
    return counts


ONCE = {"folders": 1, "store": 1, "layouts": 1, "classes": 1}
THING = ONCE | {"Thing.msg": 1, "Part.msg": 1}


def ended_well(done: Result) -> None:
    assert (done.code, done.stderr) == (0, "")


def test_a_bridge(folder: Path, counted: Counter[str], monkeypatch: pytest.MonkeyPatch) -> None:
    made = SimpleNamespace(header=SimpleNamespace(stamp=Time()), x=0.0, parts=[], name="")
    backend = SimpleNamespace(
        name="",
        publish_log=lambda text: None,
        publisher=lambda wire, *_: RosPublisher(lambda: made, lambda message: None),
        subscribe=lambda wire, callback, *_: RosSubscription(lambda: made),
        serve=lambda wire, answer, *_: None,
        client=lambda wire, *_: RosClient(lambda: None, lambda request, timeout: None),
        now=Time,
        alive=lambda: False,
        close=lambda: None,
    )
    monkeypatch.setattr(choice, "module", lambda name: SimpleNamespace(connect=lambda node: backend))
    told: list[str] = []
    settings = config.load(folder / "shmgen.toml", "shmgen.toml", Report())
    run_bridge(settings, (), told.append, told.append, lambda: settings)
    assert "running" in told
    assert not any("no diagnostics" in line for line in told)
    own = {name: count for name, count in counted.items() if not name.startswith("jazzy:") and name in THING}
    assert own == THING
    assert set(counted.values()) == {1}, counted


def test_pub(folder: Path, counted: Counter[str], topic: str) -> None:
    ended_well(run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder))
    assert counted == THING


def test_echo(folder: Path, counted: Counter[str], topic: str) -> None:
    run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder)
    counted.clear()
    ended_well(run(["echo", topic, "--once"], folder))
    assert counted == THING


def test_echo_of_a_layout_that_only_the_lock_has(folder: Path, counted: Counter[str], topic: str) -> None:
    """Another configuration is laid out anew, but of the definitions that were read."""
    assert run(["generate", "--quiet"], folder).code == 0
    run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder)
    settings = folder / "shmgen.toml"
    settings.write_text(settings.read_text() + "[strings]\ndefault = 20\n")
    counted.clear()
    ended_well(run(["echo", topic, "--once"], folder))
    assert counted == THING | {"layouts": 2}


def test_call(folder: Path, counted: Counter[str], topic: str) -> None:
    """Which nobody answers: the request and the class of the reply are made before."""
    done = run(["call", f"{topic}_ask", "cell_msgs/Ask", "{part: {number: 7}}", "--timeout", "0.1"], folder)
    assert "number=7" in done.stdout
    assert counted == ONCE | {"Ask.srv": 1, "Part.msg": 1}


def test_doctor(folder: Path, counted: Counter[str], topic: str) -> None:
    run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder)
    counted.clear()
    assert topic in run(["doctor", topic], folder).stdout
    wanted = ONCE | {"Ask.srv": 1, "Part.msg": 1, "Thing.msg": 1}
    assert counted == {name: count for name, count in wanted.items() if name != "classes"}


@pytest.mark.parametrize("command", [["hz", "TOPIC", "--timeout", "0.1"], ["top", "--once"], ["clean", "TOPIC"]])
def test_tools_that_need_no_definitions(folder: Path, counted: Counter[str], topic: str, command: list[str]) -> None:
    run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder)
    counted.clear()
    run([topic if word == "TOPIC" else word for word in command], folder)
    assert counted == {}


def session(folder: Path) -> Session:
    return Session(config.load(folder / "shmgen.toml", "shmgen.toml", Report()))


def test_what_was_wrong_is_told_again(folder: Path) -> None:
    """A library that has complained once does not take what it could not read for empty."""
    (folder / "msgs/cell_msgs/msg/Part.msg").write_text("int33 number\n")
    one = session(folder)
    for _ in range(2):
        with pytest.raises(Rejected, match="int33"):
            one.layouts(["cell_msgs/Thing"])
    assert [str(name) for name in one.layouts(["cell_msgs/Unused"])] == ["cell_msgs/msg/Unused"]


def test_a_session_gives_what_the_pipeline_does(folder: Path) -> None:
    one = session(folder)
    assert one.layouts(["cell_msgs/Ask"]) == pipeline.lay_out(one.config, ["cell_msgs/Ask"])
    kinds = one.classes(["cell_msgs/Ask"])
    assert one.classes(["cell_msgs/Ask"]) is kinds
    assert one.message("cell_msgs/srv/Ask_Reply", "cell_msgs/srv/Ask") is not kinds["cell_msgs/srv/Ask_Reply"]
    registry = ClassRegistry(one, None)
    pair = [registry.message(f"cell_msgs/srv/Ask_{half}", None, "cell_msgs/srv/Ask") for half in ("Request", "Reply")]
    assert [kind._type_name_ for kind in pair] == ["cell_msgs/srv/Ask_Request", "cell_msgs/srv/Ask_Reply"]
    with pytest.raises(ValueError, match="cell_msgs/Ask is 3 messages"):
        registry.message("cell_msgs/Ask")


def test_a_class_leaves_only_itself_behind(folder: Path) -> None:
    """A bridge makes its classes anew with each shmgen.toml that it is told of."""

    def known() -> tuple[int, ...]:
        return len(sys.path), len(sys.modules), len(sys.path_importer_cache)

    session(folder).classes(["cell_msgs/Thing"])
    before = known()
    session(folder).classes(["cell_msgs/Thing"])
    assert known() == before


def test_strings_that_do_not_fit_are_the_bridges_to_cut(folder: Path, topic: str) -> None:
    settings = folder / "shmgen.toml"
    settings.write_text(settings.read_text() + '[strings]\noverflow = "truncate"\ndefault = 4\n')
    one = session(folder)
    long = SimpleNamespace(x=0.0, parts=[], name="too long")
    name = "cell_msgs/msg/Thing"
    assert one.classes([name])[name]._from_object(long).name == "too "
    with pytest.raises(ValueError, match="capacity 4"):
        one.classes([name], overflow="error")[name]._from_object(long)
