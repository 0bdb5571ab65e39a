"""A bridge and each tool read definitions, compute layouts and generate classes only once, or never."""

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
from shmgen.generator import layout, pipeline
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
    """A configuration with a topic and a service that share a nested message, and a bound for an unused message."""
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
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """The number of calls of each step. The key for reading a definition is the name of its file."""
    counts: Counter[str] = Counter()

    def count_calls(module: Any, name: str, label: str = "") -> None:
        real = getattr(module, name)

        def count_call(*arguments: Any, **keywords: Any) -> Any:
            counts[label or Path(arguments[0].path).name] += 1
            return real(*arguments, **keywords)

        monkeypatch.setattr(module, name, count_call)

    count_calls(library, "catalogue", "folders")
    count_calls(library.store, "catalogue", "store")
    count_calls(library, "read")
    count_calls(layout, "lay_out", "layouts")
    count_calls(pipeline, "render", "classes")
    return counts


ONCE = {"folders": 1, "store": 1, "layouts": 1, "classes": 1}
THING = ONCE | {"Thing.msg": 1, "Part.msg": 1}


def check_success(done: Result) -> None:
    assert (done.code, done.stderr) == (0, "")


def test_bridge_reads_each_definition_once(folder: Path, calls: Counter[str], monkeypatch: pytest.MonkeyPatch) -> None:
    message = SimpleNamespace(header=SimpleNamespace(stamp=Time()), x=0.0, parts=[], name="")
    backend = SimpleNamespace(
        name="",
        publish_log=lambda text: None,
        publisher=lambda wire, *_: RosPublisher(lambda: message, lambda message: None),
        subscribe=lambda wire, take, errors: RosSubscription(lambda: message),
        serve=lambda wire, answer, *_: None,
        client=lambda wire, *_: RosClient(lambda: None, lambda request, timeout: None),
        now=Time,
        alive=lambda: False,
        close=lambda: None,
    )
    monkeypatch.setattr(choice, "module", lambda name: SimpleNamespace(connect=lambda node: backend))
    lines: list[str] = []
    settings = config.load(folder / "shmgen.toml", "shmgen.toml", Report())
    run_bridge(settings, (), lines.append, lines.append, lambda: settings)
    assert "running" in lines
    assert not any("no diagnostics" in line for line in lines)
    own = {name: number for name, number in calls.items() if not name.startswith("jazzy:") and name in THING}
    assert own == THING
    assert set(calls.values()) == {1}, calls


def test_pub_reads_each_definition_once(folder: Path, calls: Counter[str], topic: str) -> None:
    check_success(run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder))
    assert calls == THING


def test_echo_reads_each_definition_once(folder: Path, calls: Counter[str], topic: str) -> None:
    run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder)
    calls.clear()
    check_success(run(["echo", topic, "--once"], folder))
    assert calls == THING


def test_echo_of_a_locked_layout_reads_definitions_once(folder: Path, calls: Counter[str], topic: str) -> None:
    """Compute a second layout for the locked configuration, but do not read the definitions again."""
    assert run(["generate", "--quiet"], folder).code == 0
    run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder)
    settings = folder / "shmgen.toml"
    settings.write_text(settings.read_text() + "[strings]\ndefault = 20\n")
    calls.clear()
    check_success(run(["echo", topic, "--once"], folder))
    assert calls == THING | {"layouts": 2}


def test_call_reads_each_definition_once(folder: Path, calls: Counter[str], topic: str) -> None:
    """Call without a server. The tool prepares the request and the class of the response before the timeout."""
    done = run(["call", f"{topic}_ask", "cell_msgs/Ask", "{part: {number: 7}}", "--timeout", "0.1"], folder)
    assert "number=7" in done.stdout
    assert calls == ONCE | {"Ask.srv": 1, "Part.msg": 1}


def test_doctor_reads_definitions_once_without_classes(folder: Path, calls: Counter[str], topic: str) -> None:
    run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder)
    calls.clear()
    assert topic in run(["doctor", topic], folder).stdout
    expected = ONCE | {"Ask.srv": 1, "Part.msg": 1, "Thing.msg": 1}
    assert calls == {name: number for name, number in expected.items() if name != "classes"}


@pytest.mark.parametrize("command", [["hz", "TOPIC", "--timeout", "0.1"], ["top", "--once"], ["clean", "TOPIC"]])
def test_other_tools_read_no_definitions(folder: Path, calls: Counter[str], topic: str, command: list[str]) -> None:
    run(["pub", topic, "cell_msgs/Thing", "{x: 1}", "--once"], folder)
    calls.clear()
    run([topic if word == "TOPIC" else word for word in command], folder)
    assert calls == {}


def make_session(folder: Path) -> Session:
    return Session(config.load(folder / "shmgen.toml", "shmgen.toml", Report()))


def test_session_reports_an_invalid_definition_again(folder: Path) -> None:
    """Report the error at each call. The library must not treat an unreadable definition as empty."""
    (folder / "msgs/cell_msgs/msg/Part.msg").write_text("int33 number\n")
    session = make_session(folder)
    for _ in range(2):
        with pytest.raises(Rejected, match="int33"):
            session.layouts(["cell_msgs/Thing"])
    assert [str(name) for name in session.layouts(["cell_msgs/Unused"])] == ["cell_msgs/msg/Unused"]


def test_session_returns_the_layouts_of_the_pipeline(folder: Path) -> None:
    session = make_session(folder)
    assert session.layouts(["cell_msgs/Ask"]) == pipeline.lay_out(session.config, ["cell_msgs/Ask"])
    kinds = session.classes(["cell_msgs/Ask"])
    assert session.classes(["cell_msgs/Ask"]) is kinds
    assert session.message("cell_msgs/srv/Ask_Reply", "cell_msgs/srv/Ask") is not kinds["cell_msgs/srv/Ask_Reply"]
    registry = ClassRegistry(session, None)
    pair = [registry.message(f"cell_msgs/srv/Ask_{half}", None, "cell_msgs/srv/Ask") for half in ("Request", "Reply")]
    assert [kind._type_name_ for kind in pair] == ["cell_msgs/srv/Ask_Request", "cell_msgs/srv/Ask_Reply"]
    with pytest.raises(ValueError, match="cell_msgs/Ask has 3 messages"):
        registry.message("cell_msgs/Ask")


def test_generated_classes_leave_the_import_state_unchanged(folder: Path) -> None:
    """Leave sys.path and sys.modules unchanged, because a bridge generates classes again for each new shmgen.toml."""

    def read_import_state() -> tuple[int, ...]:
        return len(sys.path), len(sys.modules), len(sys.path_importer_cache)

    make_session(folder).classes(["cell_msgs/Thing"])
    before = read_import_state()
    make_session(folder).classes(["cell_msgs/Thing"])
    assert read_import_state() == before


def test_bridge_may_override_the_truncation_of_strings(folder: Path, topic: str) -> None:
    settings = folder / "shmgen.toml"
    settings.write_text(settings.read_text() + '[strings]\noverflow = "truncate"\ndefault = 4\n')
    session = make_session(folder)
    long = SimpleNamespace(x=0.0, parts=[], name="too long")
    name = "cell_msgs/msg/Thing"
    assert session.classes([name])[name]._from_object(long).name == "too "
    with pytest.raises(ValueError, match="capacity 4"):
        session.classes([name], overflow="error")[name]._from_object(long)
