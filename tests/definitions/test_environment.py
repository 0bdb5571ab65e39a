"""Test `source = "env"` with the folder structure of a sourced ROS 2 and ROS 1, and with Debian's ROS 1 packages."""

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
def _no_ros_is_sourced(monkeypatch, tmp_path):
    for name in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH", "ROS_VERSION", "ROS_DISTRO"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(environment, "DEBIAN", tmp_path / "no Debian")


def source(monkeypatch, **variables: object) -> None:
    for name, value in variables.items():
        places = value if isinstance(value, list | tuple) else [value]
        monkeypatch.setenv(name, os.pathsep.join(map(str, places)))


def install(prefix: Path, package: str, files: dict[str, str]) -> Path:
    """Install a package like rosidl_generate_interfaces: the definitions, their .idl files, and the index.

    The index also lists the requests and responses of services, as in releases up to Foxy.
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


def messages_by_name(schema: Schema) -> dict[str, Message]:
    return {str(message.name): message for message in schema.messages}


def rejection(*requests: str, sources: Sources = ENV) -> str:
    with pytest.raises(Rejected) as caught:
        load(open_library(sources, Report()), requests, Report())
    return str(caught.value)


def test_ros2_packages_come_from_the_ament_index(corpus, tmp_path, monkeypatch):
    packages = ("builtin_interfaces", "std_msgs", "geometry_msgs", "unique_identifier_msgs", "std_srvs")
    packages += ("example_interfaces", "action_msgs", "service_msgs")
    for package in packages:
        root = corpus / "jazzy" / package
        files = {str(file.relative_to(root)): file.read_text() for file in root.glob("*/*.*") if file.suffix != ".idl"}
        install(tmp_path, package, files)
    source(monkeypatch, AMENT_PREFIX_PATH=tmp_path)
    own_messages = messages_by_name(load(open_library(ENV, Report()), packages, Report()))
    reference = messages_by_name(load(open_library(Sources((corpus / "jazzy",)), Report()), packages, Report()))
    assert {name: references.from_shmgen(message) for name, message in own_messages.items()} == {
        name: references.from_shmgen(message) for name, message in reference.items()
    }
    assert "std_srvs/srv/SetBool_Request" in own_messages
    assert "example_interfaces/action/Fibonacci_Feedback" in own_messages
    assert not any("_" in name.rpartition("/")[2] for name in own_messages if "/msg/" in name)


def test_first_prefix_wins(tmp_path, monkeypatch):
    first = install(tmp_path / "mine", "a_msgs", {"msg/A.msg": "int8 mine"})
    second = install(tmp_path / "theirs", "a_msgs", {"msg/A.msg": "int8 theirs", "msg/Other.msg": ""})
    install(second, "b_msgs", {"msg/B.msg": "a_msgs/A a"})
    source(monkeypatch, AMENT_PREFIX_PATH=[tmp_path / "missing", first, "", second, first])
    loaded = messages_by_name(load(open_library(ENV, Report()), ["b_msgs"], Report()))
    assert [field.name for field in loaded["a_msgs/msg/A"].fields] == ["mine"]
    assert [str(name) for name in open_library(ENV, Report()).known()] == ["a_msgs/msg/A", "b_msgs/msg/B"]
    assert "looked in " + str(first / "share/a_msgs") in rejection("a_msgs/Other")


def test_invalid_index_entries_are_ignored(tmp_path, monkeypatch):
    prefix = install(tmp_path / "ros", "a_msgs", {"msg/A.msg": "int8 a"})
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
    assert rejection("c_msgs/OnlyIdl") == f"{prefix}/share/c_msgs/msg/OnlyIdl.idl: error[SHM001]: no such file"
    assert rejection("c_msgs/Gone") == f"{prefix}/share/c_msgs/msg/Gone.msg: error[SHM001]: no such file"


def test_ros1_packages_are_found_as_by_rospack(tmp_path, monkeypatch):
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
    loaded = messages_by_name(load(open_library(ENV, Report()), ["a_msgs"], Report()))
    assert list(loaded) == ["std_msgs/msg/Header", "a_msgs/msg/A"]
    assert [str(field.type) for field in loaded["a_msgs/msg/A"].fields][1:] == ["Scalar.INT8", "Clock.TIME"]
    assert loaded["a_msgs/msg/A"].origin == "a_msgs/msg/A.msg of ROS 1"
    assert {name.package for name in open_library(ENV, Report()).known()} == {"a_msgs", "std_msgs"}


def test_ros_version_selects_one_of_two_sourced_ros(tmp_path, monkeypatch):
    """Use the ROS that was sourced last, which sets ROS_VERSION, if ROS 1 and ROS 2 are sourced for a bridge."""
    install(tmp_path / "two", "a_msgs", {"msg/A.msg": "byte b"})
    write(tmp_path, {"one/a_msgs/msg/A.msg": "byte b", "one/b_msgs/msg/B.msg": "a_msgs/A a"})
    source(monkeypatch, AMENT_PREFIX_PATH=tmp_path / "two", ROS_PACKAGE_PATH=tmp_path / "one")
    types = {}
    for version in ("", "1", "2"):
        source(monkeypatch, ROS_VERSION=version)
        types[version] = load(open_library(ENV, Report()), ["a_msgs"], Report()).messages[0].fields[0].type.value
    assert types == {"": "uint8", "1": "int8", "2": "uint8"}
    assert "SHM004" in rejection("b_msgs")


DEBIAN = Path("/usr/share")
PACKAGES = sorted(folder.parent.name for folder in DEBIAN.glob("*_msgs/msg"))


@pytest.mark.skipif("std_msgs" not in PACKAGES, reason="no ROS 1 of Debian: apt-get install ros-sensor-msgs")
def test_debian_ros1_messages_match_rosbags(monkeypatch):
    monkeypatch.setattr(environment, "DEBIAN", DEBIAN)
    loaded = messages_by_name(load(open_library(ENV, Report()), PACKAGES, Report()))
    files = [file for package in PACKAGES for file in (DEBIAN / package / "msg").glob("*.msg")]
    assert len(files) >= 90
    for file in files:
        name = f"{file.parts[-3]}/msg/{file.stem}"
        reference = get_types_from_msg(file.read_text(), name)[name]
        assert references.without_defaults(references.from_shmgen(loaded[name])) == references.from_rosbags(
            name, reference, "ros1"
        )
    assert loaded["std_msgs/msg/Byte"].fields[0].type.value == "int8"
    assert loaded["std_msgs/msg/Header"].fields[0].name == "seq"
    assert {"sensor_msgs/srv/SetCameraInfo_Response", "nav_msgs/action/GetMap_Goal"} <= set(loaded)


def test_shell_without_sourced_ros(tmp_path, monkeypatch):
    assert rejection("std_msgs/Bool").startswith('source = "env": error[SHM506]: no ROS is sourced in this shell\n')
    assert "source /opt/ros/jazzy/setup.bash" in rejection("std_msgs/Bool")
    source(monkeypatch, ROS_VERSION=1)
    assert "source /opt/ros/noetic/setup.bash" in rejection("std_msgs/Bool")
    source(monkeypatch, ROS_VERSION=2)
    assert "source /opt/ros/jazzy/setup.bash" in rejection("std_msgs/Bool")
    source(monkeypatch, AMENT_PREFIX_PATH=tmp_path)
    assert f"AMENT_PREFIX_PATH is '{tmp_path}', but its folders contain no messages" in rejection("std_msgs/Bool")
    write(tmp_path, {"a_msgs/msg/A.msg": "int8 a"})
    assert load(open_library(Sources((tmp_path,), "env"), Report()), ["a_msgs/A"], Report()).messages


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
def test_package_xml_selects_the_dialect(tmp_path, manifest, byte):
    write(tmp_path, {"a_msgs/package.xml": f"<package>{manifest}</package>", "a_msgs/msg/A.msg": "byte a"})
    for store, default in (("jazzy", "uint8"), ("noetic", "int8")):
        (message,) = load(open_library(Sources((tmp_path,), store, tmp_path), Report()), ["a_msgs"], Report()).messages
        assert message.fields[0].type.value == (default if byte == "the source's" else byte)


def generate_texts(prefix: Path, root: Path, monkeypatch) -> dict[str, str]:
    root.mkdir(exist_ok=True)
    source(monkeypatch, AMENT_PREFIX_PATH=prefix)
    return pipeline.generate(Config(root, source="env"), ["a_msgs/A"])


def test_output_is_independent_of_the_folders(tmp_path, monkeypatch):
    """Generate equal output from equal definitions, independent of the folders and of ROS_DISTRO."""
    first_prefix = install(tmp_path / "opt" / "ros", "a_msgs", {"msg/A.msg": "int8 a  # [m]"})
    second_prefix = install(tmp_path / "home" / "ws", "a_msgs", {"msg/A.msg": "int8 a  # [m]"})
    first = generate_texts(first_prefix, tmp_path / "one", monkeypatch)
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    assert generate_texts(second_prefix, tmp_path / "two", monkeypatch) == first
    assert not any(str(tmp_path) in text for text in first.values())
    assert 'origin = "a_msgs/msg/A.msg of ROS 2"' in first["layout.lock"]
    write(second_prefix, {"share/a_msgs/msg/A.msg": "int8 a  # [mm]"})
    assert generate_texts(second_prefix, tmp_path / "two", monkeypatch)["layout.lock"] != first["layout.lock"]


def test_check_reports_a_different_sourced_ros(tmp_path, monkeypatch):
    work = tmp_path / "work"
    write(work, {"shmgen.toml": 'source = "env"\nmessages = ["a_msgs/A"]'})
    source(monkeypatch, AMENT_PREFIX_PATH=install(tmp_path / "one", "a_msgs", {"msg/A.msg": "int8 a\nint8 b"}))
    output = run(["show", "a_msgs/A"], work).stdout
    assert "\nfrom a_msgs/msg/A.msg of ROS 2; " in output
    assert f"\nread from {tmp_path}/one/share/a_msgs/msg/A.msg\n" in output
    assert "1 of 1 can be generated." in run(["list", "a_msgs"], work).stdout
    assert run(["generate"], work).code == 0
    assert run(["check"], work).code == 0
    source(monkeypatch, AMENT_PREFIX_PATH=install(tmp_path / "two", "a_msgs", {"msg/A.msg": "int16 a\nint8 b"}))
    result = run(["check"], work)
    assert result.code == 1
    assert "error[SHM401]: layout of a_msgs/A changed" in result.stderr
