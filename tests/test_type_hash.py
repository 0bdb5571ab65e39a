"""Type hashes equal those that ROS 2 has computed and installed beside its definitions."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from shmgen.bridge.backend import ActionWire
from shmgen.bridge.plan import closure
from shmgen.bridge.ros2 import actions as ros2_actions
from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Report, Span
from shmgen.core.type_hash import TIMES, hash_of, service_hash, type_hash
from shmgen.definitions import Sources, open_library
from shmgen.generator import pipeline

from .support import import_or_skip, ros2

ADDED_BY_ROS = ("_Event", "_SendGoal", "_GetResult", "_FeedbackMessage")
"""Types that ROS 2 derives from services and actions, in addition to the parts in a .srv or .action file."""


@pytest.mark.parametrize("distribution", ros2.DISTRIBUTIONS)
def test_hashes_of_all_installed_definitions(distribution: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(ros2.prefix(distribution)))
    monkeypatch.setenv("ROS_VERSION", "2")
    theirs = ros2.hashes(distribution)
    names = [str(name) for name in open_library(Sources((), "env", Path.cwd()), Report()).known()]
    schema = pipeline.read(Config(Path.cwd(), source="env"), names)
    known = {message.name: message for message in schema.messages}
    parts = {str(name): name for name in known}
    ours = {str(name): hash_of(name, known) for name in known}
    compared = theirs.keys() & ours.keys()
    assert {name: ours[name] for name in compared} == {name: theirs[name] for name in compared}
    of_services = {
        name: service_hash(*(closure(schema, parts[f"{name}_{half}"]) for half in ("Request", "Response")))
        for name in theirs
        if f"{name}_Request" in parts
    }
    assert of_services == {name: theirs[name] for name in of_services}
    assert len(of_services) > 20
    wholes = {name for name in theirs if f"{name}_Request" in theirs or f"{name}_Goal" in theirs}
    left = theirs.keys() - compared - wholes - {str(name) for name in TIMES.values()}
    assert not {name for name in left if not any(part in name for part in ADDED_BY_ROS)}
    assert len(compared) > 150


@pytest.mark.parametrize("distribution", ros2.DISTRIBUTIONS)
def test_hashes_of_the_derived_types_of_an_action(distribution: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare the types that the bridge derives, because no definition file contains them."""
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(ros2.prefix(distribution)))
    monkeypatch.setenv("ROS_VERSION", "2")
    schema = pipeline.read(Config(Path.cwd(), source="env"), ["test_msgs/NestedMessage"])
    parts = {message.name.name: message.name for message in schema.messages if message.name.kind == "action"}
    goal, result, feedback = (
        closure(schema, parts[f"NestedMessage_{part}"]) for part in ("Goal", "Result", "Feedback")
    )
    action = ros2_actions.ActionInterface(ActionWire("/a", goal, result, feedback))
    halves = [half for call in (action.send, action.cancel, action.result) for half in (call.request, call.response)]
    ours = {str(wire[-1].name): type_hash(wire) for wire in (*halves, action.feedback.messages, action.status.messages)}
    ours |= {
        str(service.type): service_hash(service.request, service.response)
        for service in (action.send, action.cancel, action.result)
    }
    theirs = ros2.hashes(distribution)
    assert ours == {name: theirs[name] for name in ours}
    assert len(ours) == 11


@pytest.mark.parametrize(
    "name", ["Arrays", "BasicTypes", "BoundedSequences", "Nested", "UnboundedSequences", "WStrings"]
)
def test_hashes_of_messages_read_from_idl(name: str, tmp_path: Path) -> None:
    import_or_skip("lark")
    folder = tmp_path / "test_msgs" / "msg"
    folder.mkdir(parents=True)
    for file in (ros2.prefix("jazzy") / "share" / "test_msgs" / "msg").glob("*.idl"):
        (folder / file.name).symlink_to(file)
    read = pipeline.read(Config(Path.cwd(), path=(tmp_path,)), [f"test_msgs/{name}"]).messages
    assert type_hash(read) == ros2.hashes("jazzy")[f"test_msgs/msg/{name}"]


def test_hash_of_types_that_only_idl_has(tmp_path: Path) -> None:
    """Compare with the hash of rosidl_generator_type_description."""
    import_or_skip("lark")
    file = tmp_path / "cell_msgs" / "msg" / "Words.idl"
    file.parent.mkdir(parents=True)
    file.write_text(
        "module cell_msgs { module msg { typedef octet three[3]; typedef wchar two[2];"
        " struct Words { char a; octet b; wchar c; three d; two e; sequence<char> f; sequence<octet, 4> g;"
        " uint8 i; wstring<5> j; sequence<wstring> k; }; }; };"
    )
    request = {"package_name": "cell_msgs", "output_dir": str(tmp_path / "out")}
    request["idl_tuples"] = [f"{tmp_path}/cell_msgs:msg/Words.idl"]
    (tmp_path / "asked.json").write_text(json.dumps(request))
    code = "import sys, rosidl_generator_type_description as it; it.generate_type_hash(sys.argv[1])"
    python = ros2.prefix("jazzy") / "bin" / "python"
    subprocess.run([python, "-c", code, tmp_path / "asked.json"], check=True)
    theirs = json.loads((tmp_path / "out" / "msg" / "Words.json").read_text())["type_hashes"][0]["hash_string"]
    read = pipeline.read(Config(Path.cwd(), path=(tmp_path,)), ["cell_msgs/Words"]).messages
    assert type_hash(read) == theirs


def test_hash_ignores_bounds_of_the_configuration() -> None:
    config = Config(Path.cwd())
    written = type_hash(pipeline.read(config, ["sensor_msgs/JointState"]).messages)
    bounded = Config(Path.cwd(), bounds=Bounds({}, {"sensor_msgs": Bound(4, Span("x"))}))
    layouts = pipeline.lay_out(bounded, ["sensor_msgs/JointState"])
    assert type_hash(layout.message for layout in layouts.values()) == written
