"""`source = "env"`: a sourced ROS 2 and ROS 1 laid out as ROS lays them out, and Debian's real ROS 1 packages."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from rosbags.typesys import get_types_from_msg

from shmgen.config import Config
from shmgen.core.diagnostics import Rejected, Report
from shmgen.core.model import Message, Schema
from shmgen.definitions import Sources, environment, load, open_library
from shmgen.generator import pipeline
from tests.definitions import references
from tests.definitions.test_requests import MANIFEST, write
from tests.support.command import run

ENV = Sources((), "env")
INDEX = "share/ament_index/resource_index/rosidl_interfaces"


@pytest.fixture(autouse=True)
def _nothing_is_sourced(monkeypatch, tmp_path):
    for name in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH", "ROS_VERSION", "ROS_DISTRO"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(environment, "DEBIAN", tmp_path / "no Debian")


def source(monkeypatch, **variables: object) -> None:
    for name, value in variables.items():
        places = value if isinstance(value, list | tuple) else [value]
        monkeypatch.setenv(name, os.pathsep.join(map(str, places)))


def installed(prefix: Path, package: str, files: dict[str, str]) -> Path:
    """As rosidl_generate_interfaces installs a package: each definition, its .idl, and lines in the index.

    The halves of services are listed too, as up to Foxy.
    """
    lines = []
    for name, text in files.items():
        stem, _, kind = name.rpartition(".")
        write(prefix / "share" / package, {name: text, f"{stem}.idl": "not to be read, as there is the other"})
        lines += [f"{stem}.idl", name]
        lines += [f"{stem}_Request.msg", f"{stem}_Response.msg"] if kind == "srv" else []
    write(prefix / "share" / package, {"package.xml": MANIFEST.format(package)})
    write(prefix / INDEX, {package: "\n".join(lines)})
    return prefix


def messages(schema: Schema) -> dict[str, Message]:
    return {str(message.name): message for message in schema.messages}


def refusal(*requests: str, sources: Sources = ENV) -> str:
    with pytest.raises(Rejected) as caught:
        load(requests, sources, Report())
    return str(caught.value)


def test_a_ros2_is_what_its_index_says(corpus, tmp_path, monkeypatch):
    packages = ("builtin_interfaces", "std_msgs", "geometry_msgs", "unique_identifier_msgs", "std_srvs")
    packages += ("example_interfaces", "action_msgs", "service_msgs")
    for package in packages:
        root = corpus / "jazzy" / package
        files = {str(file.relative_to(root)): file.read_text() for file in root.glob("*/*.*") if file.suffix != ".idl"}
        installed(tmp_path, package, files)
    source(monkeypatch, AMENT_PREFIX_PATH=tmp_path)
    ours = messages(load(packages, ENV, Report()))
    theirs = messages(load(packages, Sources((corpus / "jazzy",)), Report()))
    assert {name: references.ours(one) for name, one in ours.items()} == {
        name: references.ours(one) for name, one in theirs.items()
    }
    assert "std_srvs/srv/SetBool_Request" in ours
    assert "example_interfaces/action/Fibonacci_Feedback" in ours
    assert not any("_" in name.rpartition("/")[2] for name in ours if "/msg/" in name)


def test_the_first_prefix_wins(tmp_path, monkeypatch):
    mine = installed(tmp_path / "mine", "a_msgs", {"msg/A.msg": "int8 mine"})
    theirs = installed(tmp_path / "theirs", "a_msgs", {"msg/A.msg": "int8 theirs", "msg/Other.msg": ""})
    installed(theirs, "b_msgs", {"msg/B.msg": "a_msgs/A a"})
    source(monkeypatch, AMENT_PREFIX_PATH=[tmp_path / "missing", mine, "", theirs, mine])
    found = messages(load(["b_msgs"], ENV, Report()))
    assert [field.name for field in found["a_msgs/msg/A"].fields] == ["mine"]
    assert [str(name) for name in open_library(ENV, Report()).known()] == ["a_msgs/msg/A", "b_msgs/msg/B"]
    assert "looked in " + str(mine / "share/a_msgs") in refusal("a_msgs/Other")


def test_an_index_may_say_anything(tmp_path, monkeypatch):
    prefix = installed(tmp_path / "ros", "a_msgs", {"msg/A.msg": "int8 a"})
    write(tmp_path, {"outside.msg": "int8 stolen", "ros/share/c_msgs/msg/Unlisted.msg": ""})
    lines = [
        "msg/../../../../outside.msg",
        "/etc/passwd.msg",
        "msg/B.srv",
        "rng/C.idl",
        "msg/Gone.msg",
        "\x00\xff",
        "",
        "msg/OnlyIdl.idl",
    ]
    write(prefix / INDEX, {"c_msgs": "\n".join(lines), "no package": "msg/D.msg"})
    (prefix / INDEX / "folder").mkdir()
    source(monkeypatch, AMENT_PREFIX_PATH=prefix)
    assert [str(name) for name in open_library(ENV, Report()).known()] == [
        "a_msgs/msg/A",
        "c_msgs/msg/Gone",
        "c_msgs/msg/OnlyIdl",
        "no package/msg/D",
    ]
    assert refusal("c_msgs/OnlyIdl") == f"{prefix}/share/c_msgs/msg/OnlyIdl.idl: error[SHM001]: no such file"
    assert refusal("c_msgs/Gone") == f"{prefix}/share/c_msgs/msg/Gone.msg: error[SHM001]: no such file"


def test_a_ros1_is_what_rospack_would_find(tmp_path, monkeypatch):
    write(
        tmp_path,
        {
            "ws/src/deep/er/package.xml": MANIFEST.format("a_msgs"),
            "ws/src/deep/er/msg/A.msg": "Header header\nbyte B\ntime t",
            "ws/src/stop/rospack_nosubdirs": "",
            "ws/src/stop/no_msgs/msg/No.msg": "",
            "ws/src/ignored/CATKIN_IGNORE": "",
            "ws/src/ignored/no_msgs/msg/No.msg": "",
            "ros/share/a_msgs/msg/A.msg": "int8 other",
            "ros/share/std_msgs/package.xml": MANIFEST.format("std_msgs"),
            "ros/share/std_msgs/msg/Header.msg": "uint32 seq\ntime stamp\nstring frame_id",
            "ros/share/std_msgs/srv/S.srv": "---",
        },
    )
    source(monkeypatch, ROS_PACKAGE_PATH=[tmp_path / "ws/src", tmp_path / "gone", tmp_path / "ros/share"])
    found = messages(load(["a_msgs"], ENV, Report()))
    assert list(found) == ["std_msgs/msg/Header", "a_msgs/msg/A"]
    assert [str(field.type) for field in found["a_msgs/msg/A"].fields][1:] == ["Scalar.INT8", "Clock.TIME"]
    assert found["a_msgs/msg/A"].origin == "a_msgs/msg/A.msg of ROS 1"
    assert {name.package for name in open_library(ENV, Report()).known()} == {"a_msgs", "std_msgs"}


def test_one_ros_at_a_time(tmp_path, monkeypatch):
    """Where a bridge has both sourced, the last one counts, as its setup.bash left it in ROS_VERSION."""
    installed(tmp_path / "two", "a_msgs", {"msg/A.msg": "byte b"})
    write(tmp_path, {"one/a_msgs/msg/A.msg": "byte b", "one/b_msgs/msg/B.msg": "a_msgs/A a"})
    source(monkeypatch, AMENT_PREFIX_PATH=tmp_path / "two", ROS_PACKAGE_PATH=tmp_path / "one")
    types = {}
    for version in ("", "1", "2"):
        source(monkeypatch, ROS_VERSION=version)
        types[version] = load(["a_msgs"], ENV, Report()).messages[0].fields[0].type.value
    assert types == {"": "uint8", "1": "int8", "2": "uint8"}
    assert "SHM004" in refusal("b_msgs")


DEBIAN = Path("/usr/share")
PACKAGES = sorted(folder.parent.name for folder in DEBIAN.glob("*_msgs/msg"))


@pytest.mark.skipif("std_msgs" not in PACKAGES, reason="no ROS 1 of Debian: apt-get install ros-sensor-msgs")
def test_debians_ros1_is_read_as_rosbags_reads_it(monkeypatch):
    monkeypatch.setattr(environment, "DEBIAN", DEBIAN)
    found = messages(load(PACKAGES, ENV, Report()))
    files = [file for package in PACKAGES for file in (DEBIAN / package / "msg").glob("*.msg")]
    assert len(files) >= 90
    for file in files:
        name = f"{file.parts[-3]}/msg/{file.stem}"
        theirs = get_types_from_msg(file.read_text(), name)[name]
        assert references.without_defaults(references.ours(found[name])) == references.of_typesdict(
            name, theirs, "ros1"
        )
    assert found["std_msgs/msg/Byte"].fields[0].type.value == "int8"
    assert found["std_msgs/msg/Header"].fields[0].name == "seq"
    assert {"sensor_msgs/srv/SetCameraInfo_Response", "nav_msgs/action/GetMap_Goal"} <= set(found)


def test_a_shell_where_nothing_is_sourced(tmp_path, monkeypatch):
    assert refusal("std_msgs/Bool").startswith('source = "env": error[SHM506]: no ROS is sourced in this shell\n')
    assert "source /opt/ros/jazzy/setup.bash" in refusal("std_msgs/Bool")
    source(monkeypatch, ROS_VERSION=1)
    assert "source /opt/ros/noetic/setup.bash" in refusal("std_msgs/Bool")
    source(monkeypatch, ROS_VERSION=2)
    assert "source /opt/ros/jazzy/setup.bash" in refusal("std_msgs/Bool")
    source(monkeypatch, AMENT_PREFIX_PATH=tmp_path)
    assert f"AMENT_PREFIX_PATH is '{tmp_path}', but its folders contain no messages" in refusal("std_msgs/Bool")
    write(tmp_path, {"a_msgs/msg/A.msg": "int8 a"})
    assert load(["a_msgs/A"], Sources((tmp_path,), "env"), Report()).messages


@pytest.mark.parametrize(
    ("manifest", "byte"),
    [
        ("<buildtool_depend>catkin</buildtool_depend>", "int8"),
        ('<buildtool_depend condition="x">ament_cmake</buildtool_depend>', "uint8"),
        ("<export><build_type> ament_python </build_type></export>", "uint8"),
        ("<buildtool_depend>rosidl_default_generators</buildtool_depend>", "uint8"),
        ("<!--<buildtool_depend>catkin</buildtool_depend>-->", "the source's"),
        ("<buildtool_depend>catkin</buildtool_depend><buildtool_depend>ament_cmake</buildtool_depend>", "the source's"),
        ("<buildtool_depend>cmake</buildtool_depend>", "the source's"),
        ("<!--" * 130_000 + "<buildtool_depend>catkin</buildtool_depend>", "the source's"),
    ],
    ids=["catkin", "ament", "build type", "rosidl", "in a comment", "both", "neither", "hostile"],
)
def test_package_xml_says_which_ros_a_package_is_for(tmp_path, manifest, byte):
    write(tmp_path, {"a_msgs/package.xml": f"<package>{manifest}</package>", "a_msgs/msg/A.msg": "byte a"})
    for store, default in (("jazzy", "uint8"), ("noetic", "int8")):
        (message,) = load(["a_msgs"], Sources((tmp_path,), store, tmp_path), Report()).messages
        assert message.fields[0].type.value == (default if byte == "the source's" else byte)


def texts(prefix: Path, root: Path, monkeypatch) -> dict[str, str]:
    root.mkdir(exist_ok=True)
    source(monkeypatch, AMENT_PREFIX_PATH=prefix)
    return pipeline.generate(Config(root, source="env"), ["a_msgs/A"])


def test_two_developers_get_one_output(tmp_path, monkeypatch):
    """Whatever lies where, and whichever distribution it is: what counts is the text of the definitions."""
    here = installed(tmp_path / "opt" / "ros", "a_msgs", {"msg/A.msg": "int8 a  # [m]"})
    there = installed(tmp_path / "home" / "ws", "a_msgs", {"msg/A.msg": "int8 a  # [m]"})
    first = texts(here, tmp_path / "one", monkeypatch)
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert texts(there, tmp_path / "two", monkeypatch) == first
    assert not any(str(tmp_path) in text for text in first.values())
    assert 'origin = "a_msgs/msg/A.msg of ROS 2"' in first["layout.lock"]
    write(there, {"share/a_msgs/msg/A.msg": "int8 a  # [mm]"})
    assert texts(there, tmp_path / "two", monkeypatch)["layout.lock"] != first["layout.lock"]


def test_another_developer_is_told_what_differs(tmp_path, monkeypatch):
    work = tmp_path / "work"
    write(work, {"shmgen.toml": 'source = "env"\nmessages = ["a_msgs/A"]'})
    source(monkeypatch, AMENT_PREFIX_PATH=installed(tmp_path / "one", "a_msgs", {"msg/A.msg": "int8 a\nint8 b"}))
    shown = run(["show", "a_msgs/A"], work).stdout
    assert "\nfrom a_msgs/msg/A.msg of ROS 2; " in shown
    assert f"\nread from {tmp_path}/one/share/a_msgs/msg/A.msg\n" in shown
    assert "1 of 1 can be generated." in run(["list", "a_msgs"], work).stdout
    assert run(["generate"], work).code == 0
    assert run(["check"], work).code == 0
    source(monkeypatch, AMENT_PREFIX_PATH=installed(tmp_path / "two", "a_msgs", {"msg/A.msg": "int16 a\nint8 b"}))
    said = run(["check"], work)
    assert said.code == 1
    assert "error[SHM401]: layout of a_msgs/A changed" in said.stderr
