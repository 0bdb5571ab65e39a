"""Test ROS's command-line arguments in backends without ROS: ROS's rules apply, and ignored arguments are listed."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from shmgen.bridge.common.arguments import parse, with_parameters
from shmgen.config import Config
from shmgen.config.entries import TopicEntry, TransferOptions
from shmgen.core.diagnostics import Span


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("", {"/a": "/a", "b/c": "/b/c", "~/d": "/bridge/d"}),
        ("-r __ns:=/cell1", {"/a": "/a", "b": "/cell1/b", "~/d": "/cell1/bridge/d"}),
        ("-r __node:=cell_4", {"~/d": "/cell_4/d"}),
        ("-r /a:=/other/a -r b:=/c", {"/a": "/other/a", "b": "/c", "/b": "/c"}),
        ("-r __ns:=/x -r a:=y", {"a": "/x/y", "/a": "/a"}),
        ("-r bridge:/a:=/b --remap other:/c:=/d", {"/a": "/b", "/c": "/c"}),
        ("-p use_sim_time:=true --log-level debug", {"/a": "/a"}),
    ],
)
def test_names_follow_the_rules_of_ros_2(words: str, names: dict[str, str]) -> None:
    arguments = parse(("--ros-args", *words.split()), "bridge")
    assert {name: arguments.resolve(name) for name in names} == names
    assert arguments.use_sim_time == ("use_sim_time" in words)
    assert arguments.ignored == (["--log-level debug"] if "log-level" in words else [])


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--ros-args --bogus", "unknown ROS argument '--bogus'"),
        ("--ros-args -r", "-r needs a value"),
        ("--ros-args -r a", "'a' is not a remapping: write from:=to"),
        (
            "--ros-args -p speed:=5",
            "unknown parameter 'speed:=5'; without ROS, use use_sim_time, rate, stale",
        ),
        ("--ros-args -p use_sim_time:=yes", "parameter use_sim_time must be true or false, not 'yes'"),
        ("--ros-args --params-file nowhere", "--params-file nowhere: No such file"),
        ("__name:=x", "write ROS arguments after --ros-args"),
    ],
)
def test_unknown_argument_is_refused_by_name(words: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        parse(tuple(words.split()), "bridge")


def test_parameter_file_of_launch_is_read(tmp_path: Path) -> None:
    file = tmp_path / "launch_params"
    file.write_text("/**:\n  ros__parameters:\n    use_sim_time: true\n    other: 5\n")
    arguments = parse(("--ros-args", "--params-file", str(file)), "bridge")
    assert (arguments.use_sim_time, arguments.ignored) == (True, ["parameter other"])


@pytest.mark.parametrize(
    ("words", "parameters"),
    [
        ("-p bridge:rate:=5 -p other:rate:=50", {"rate": "5"}),
        ("-p other:speed:=50", {}),
        ("-p x:rate:=5 -p bridge:stale:=2 -r __node:=x", {"rate": "5"}),
        ("-p bridge:rate:=5 -r __ns:=/cell1", {}),
    ],
)
def test_parameter_with_a_node_name_is_for_that_node_only(words: str, parameters: dict[str, str]) -> None:
    """Return what rclpy of Jazzy returns, for node names that shmgen and rclpy accept."""
    assert parse(("--ros-args", *words.split()), "bridge").parameters == parameters


FILE = """\
/**:
  ros__parameters:
    rate: 1.0   # for all nodes
    qos_overrides:
      /a: 5
bridge:
  ros__parameters:
    rate: 2.0
cell1:
  bridge:
    ros__parameters:

      rate: 3.0
"/*/bridge":
    ros__parameters:
        stale: 4.0
/**/bridge:
  ros__parameters: {use_sim_time: true, "speed": 7}
other:
  ros__parameters:
    rate: 6.0
    speed: 7
"""


@pytest.mark.parametrize(("space", "parameters"), [("/", {"rate": "2.0"}), ("/cell1", {"rate": "3.0", "stale": "4.0"})])
def test_parameter_file_may_serve_several_nodes(space: str, parameters: dict[str, str], tmp_path: Path) -> None:
    """Read the file from a pipe, which can be read only once: a shell passes `<(command)` that way."""
    pipe = tmp_path / "parameters"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=(FILE,), daemon=True)
    writer.start()
    parsed = parse(("--ros-args", "--params-file", str(pipe), "-r", f"__ns:={space}"), "bridge")
    assert parsed.parameters == {**parameters, "use_sim_time": "true"}
    assert parsed.ignored == ["parameter qos_overrides./a", "parameter speed"]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("/**:\n  ros__parameters: {rate: 10\n", "params, line 3, column 1: expected ',' or '}'"),
        ("/**:\n\tros__parameters:\n", "params, line 2, column 1: found character"),
        ("bridge:\n  rate: 5\n", "params: move bridge/rate below"),
        ("rate", "params: move rate below"),
    ],
)
def test_invalid_parameter_file_is_refused_with_position(text: str, why: str, tmp_path: Path) -> None:
    (tmp_path / "params").write_text(text)
    with pytest.raises(ValueError, match=why):
        parse(("--ros-args", "--params-file", str(tmp_path / "params")), "bridge")


def test_empty_parameter_file_has_no_parameters(tmp_path: Path) -> None:
    (tmp_path / "params").write_text("# none\n")
    assert not parse(("--ros-args", "--params-file", str(tmp_path / "params")), "bridge").parameters


def test_rclpy_reports_unknown_arguments_itself() -> None:
    words = ("--ros-args", "--bogus", "-p", "speed:=5", "-p", "use_sim_time:=yes", "-p", "rate:=5")
    assert parse(words, "bridge", is_strict=False).parameters == {"rate": "5"}


def entry(**options: float) -> TopicEntry:
    return TopicEntry("/a", "std_msgs/String", "to_plc", 1, Span("shmgen.toml"), TransferOptions(**options))  # type: ignore[arg-type]


def test_rate_and_stale_apply_to_topics_without_these_keys(tmp_path: Path) -> None:
    file = tmp_path / "launch_params"
    file.write_text("/**:\n  ros__parameters:\n    rate: 5.0\n    stale: 0.5\n")
    config = Config(tmp_path, topics=(entry(), entry(rate=2.0)))
    words = ("--ros-args", "--params-file", str(file), "-p", "bridge:rate:=50")
    configured = with_parameters(config, parse(words, "bridge").parameters)
    assert [(item.carried.rate, item.carried.stale) for item in configured.topics] == [(50.0, 0.5), (2.0, 0.5)]
    assert with_parameters(config, {}) == config


@pytest.mark.parametrize("rule", ["rate:=fast", "rate:=-5", "rate:=20000", "stale:=0", "stale:=nan"])
def test_rate_or_stale_out_of_range_is_refused(rule: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"parameter {rule.partition(':')[0]} must be from "):
        with_parameters(Config(tmp_path, topics=(entry(),)), parse(("--ros-args", "-p", rule), "bridge").parameters)
