"""Test requests for messages: their forms, the searched folders, and the diagnostics of unknown messages."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from shmgen.core.diagnostics import Rejected, Report
from shmgen.core.model import Schema
from shmgen.definitions import Sources, load, load_usable, open_library


@pytest.fixture(autouse=True)
def _cache_folder(monkeypatch, tmp_path_factory):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


def write(root: Path, files: dict[str, str | bytes]) -> None:
    for name, text in files.items():
        file = root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text if isinstance(text, bytes) else text.encode())


def load_folder(root: Path, *requests: str, source: str = "jazzy") -> Schema:
    return load(open_library(Sources((root,), source, root), Report()), requests, Report())


def load_files(*files: str | Path) -> Schema:
    return load(open_library(Sources(), Report()), map(str, files), Report())


def names(schema: Schema) -> list[str]:
    return [str(message.name) for message in schema.messages]


def rejection(root: Path, *requests: str, **options: str) -> str:
    with pytest.raises(Rejected) as caught:
        load_folder(root, *requests, **options)
    return str(caught.value)


DEMO = {
    "demo_msgs/msg/Robot.msg": "Arm arm\nArm[2] arms\ngeometry_msgs/Point at",
    "demo_msgs/msg/Arm.msg": "string name",
    "demo_msgs/srv/Move.srv": "Arm arm\n---\nbool done",
    "demo_msgs/srv/Arm.srv": "---",
    "demo_msgs/action/Go.action": "---\n---\nRobot robot",
}
ROBOT = ["demo_msgs/msg/Arm", "geometry_msgs/msg/Point", "demo_msgs/msg/Robot"]


@pytest.mark.parametrize(
    ("request_", "requested"),
    [
        ("demo_msgs/Robot", ["demo_msgs/msg/Robot"]),
        ("demo_msgs/msg/Robot", ["demo_msgs/msg/Robot"]),
        ("demo_msgs/Arm", ["demo_msgs/msg/Arm"]),
        ("demo_msgs/srv/Arm", [f"demo_msgs/srv/Arm_{part}" for part in ("Reply", "Request", "Response")]),
        ("demo_msgs/Move", [f"demo_msgs/srv/Move_{part}" for part in ("Reply", "Request", "Response")]),
        ("demo_msgs/srv/Move_Request", ["demo_msgs/srv/Move_Request"]),
        ("demo_msgs/Go_Goal", ["demo_msgs/action/Go_Goal"]),
    ],
)
def test_forms_of_requests(tmp_path, request_, requested):
    write(tmp_path, DEMO)
    schema = load_folder(tmp_path, request_)
    assert sorted(map(str, schema.requested)) == requested
    assert set(requested) <= set(names(schema))


def test_dependencies_are_loaded_first_and_once(tmp_path):
    write(tmp_path, DEMO)
    assert names(load_folder(tmp_path, "demo_msgs/Robot", "demo_msgs/Arm", "demo_msgs/Robot")) == ROBOT


def test_package_request_loads_all_its_messages(tmp_path):
    write(tmp_path, DEMO)
    schema = load_folder(tmp_path, "demo_msgs")
    assert len(schema.requested) == 14
    assert len(schema.messages) == 15


def test_file_request_finds_messages_in_its_folder(tmp_path, monkeypatch):
    write(tmp_path, DEMO)
    monkeypatch.chdir(tmp_path / "demo_msgs" / "msg")
    schema = load_files("Robot.msg")
    assert names(schema) == ROBOT
    assert schema.messages[2].span.path == "Robot.msg"


def test_folder_name_is_the_package_of_a_loose_file(tmp_path):
    write(tmp_path, {"demo/Robot.msg": "Arm arm", "demo/Arm.msg": "int8 a", "demo/Move.srv": "Arm arm\n---"})
    schema = load_files(tmp_path / "demo/Robot.msg", tmp_path / "demo/Move.srv")
    parts = [f"demo/srv/Move_{part}" for part in ("Request", "Response", "Reply")]
    assert names(schema) == ["demo/msg/Arm", "demo/msg/Robot", *parts]


def test_messages_in_group_folders_belong_to_the_package(tmp_path, monkeypatch):
    """Read group folders like rosidl_generate_interfaces. autoware_adapi_v1_msgs has planning/msg/ and routing/msg/."""
    files = {
        "adapi_msgs/package.xml": "<package><name>adapi_msgs</name></package>",
        "adapi_msgs/planning/msg/Factor.msg": "adapi_msgs/State state",
        "adapi_msgs/routing/deep/msg/State.msg": "int8 a",
        "adapi_msgs/routing/srv/Clear.srv": "---\nState state",
        "adapi_msgs/.git/msg/Not.msg": "int8 a",
        "adapi_msgs/test/other_msgs/package.xml": "<package><name>other_msgs</name></package>",
        "adapi_msgs/test/other_msgs/msg/Not.msg": "int8 a",
    }
    write(tmp_path, files)
    parts = [f"adapi_msgs/srv/Clear_{part}" for part in ("Reply", "Request", "Response")]
    expected = ["adapi_msgs/msg/Factor", "adapi_msgs/msg/State", *parts]
    assert sorted(map(str, load_folder(tmp_path, "adapi_msgs").requested)) == expected
    monkeypatch.chdir(tmp_path / "adapi_msgs")
    schema = load_files("planning/msg/Factor.msg")
    assert names(schema) == ["adapi_msgs/msg/State", "adapi_msgs/msg/Factor"]


def test_messages_in_folders_below_msg_belong_to_the_package(tmp_path, monkeypatch):
    """Read folders below msg/, such as msg/object_recognition/ of tier4_perception_msgs."""
    files = {
        "p_msgs/package.xml": "<package><name>p_msgs</name></package>",
        "p_msgs/msg/deep/v1.0/Arm.msg": "int8 a",
        "p_msgs/msg/deep/Robot.msg": "p_msgs/Arm[2] arms",
        "p_msgs/srv/deep/Stop.srv": "---\nArm arm",
        "p_msgs/msg/deep/Top.msg": "int8 below",
        "p_msgs/msg/Top.msg": "int8 above",
        "p_msgs/msg/.old/Not.msg": "int8 a",
        "loose/msg/deep/Not.msg": "int8 a",
    }
    write(tmp_path, files)
    (tmp_path / "p_msgs/msg/deep/round").symlink_to("..")
    stop = [f"p_msgs/srv/Stop_{part}" for part in ("Reply", "Request", "Response")]
    schema = load_folder(tmp_path, "p_msgs")
    assert sorted(map(str, schema.requested)) == [*(f"p_msgs/msg/{name}" for name in ("Arm", "Robot", "Top")), *stop]
    assert [field.name for it in schema.messages if it.name.name == "Top" for field in it.fields] == ["above"]
    monkeypatch.chdir(tmp_path / "p_msgs/msg")
    assert names(load_files("deep/Robot.msg")) == ["p_msgs/msg/Arm", "p_msgs/msg/Robot"]
    monkeypatch.chdir(tmp_path / "loose/msg/deep")
    assert names(load_files("Not.msg")) == ["deep/msg/Not"]


def test_ros1_action_messages_are_found_by_name(tmp_path):
    """Find FooGoal, FooResult and FooFeedback without a build, although genaction would write them to devel/."""
    files = {
        "p_msgs/package.xml": "<package><name>p_msgs</name><buildtool_depend>catkin</buildtool_depend></package>",
        "p_msgs/action/Dig.action": "int8 a\n---\nint8 b\n---\nint8 c",
        "p_msgs/action/Bad.action": "int8 a\n---\n---\nfrob c",
        "p_msgs/msg/Held.msg": "DigGoal goal\nDigResult[2] results",
        "p_msgs/msg/Broken.msg": "BadFeedback feedback",
    }
    write(tmp_path, files)
    schema = load_folder(tmp_path, "p_msgs/Held", "p_msgs/DigFeedback")
    assert names(schema) == [f"p_msgs/msg/{name}" for name in ("DigGoal", "DigResult", "Held", "DigFeedback")]
    assert [field.name for message in schema.messages for field in message.fields] == ["a", "b", "goal", "results", "c"]
    with pytest.raises(Rejected, match="unknown message type `p_msgs/DigFood`"):
        load_folder(tmp_path, "p_msgs/DigFood")
    _, broken = load_usable(open_library(Sources((tmp_path,)), Report()), ["p_msgs"], Report())
    assert {name.name for name in broken} >= {"Broken", "Bad_Feedback"}
    (tmp_path / "p_msgs/package.xml").write_text("<package><name>p_msgs</name></package>")
    with pytest.raises(Rejected, match=r"unknown message type `p_msgs/DigGoal`[\s\S]*did you mean `p_msgs/Dig_Goal`"):
        load_folder(tmp_path, "p_msgs/DigGoal")


def test_origins_are_independent_of_the_machine(tmp_path):
    write(tmp_path, DEMO)
    inside = load_folder(tmp_path, "demo_msgs/Robot")
    assert [message.origin for message in inside.messages] == [
        "demo_msgs/msg/Arm.msg",
        "built-in store jazzy",
        "demo_msgs/msg/Robot.msg",
    ]
    library = open_library(Sources((tmp_path,), "jazzy", tmp_path / "elsewhere"), Report())
    outside = load(library, ["demo_msgs/Arm"], Report())
    assert outside.messages[0].origin == "demo_msgs/msg/Arm.msg"
    assert outside.messages[0].span.path == str(tmp_path / "demo_msgs/msg/Arm.msg")


def test_first_folder_with_a_package_provides_all_its_messages(tmp_path):
    write(tmp_path, {"one/geometry_msgs/msg/Point.msg": "int8 a", "two/geometry_msgs/msg/Point.msg": "int8 b"})
    library = open_library(Sources((tmp_path / "one", tmp_path / "two"), "jazzy", tmp_path), Report())
    (point,) = load(library, ["geometry_msgs/Point"], Report()).messages
    assert point.fields[0].name == "a"
    with pytest.raises(Rejected, match=r"geometry_msgs/Pose[\s\S]*looked in one/geometry_msgs$"):
        load(library, ["geometry_msgs/Pose"], Report())


MANIFEST = "<package>\n<!-- <name>no</name> -->\n<name> {} </name></package>"


def test_package_search(tmp_path):
    write(
        tmp_path,
        {
            "src/deep/er/renamed/package.xml": MANIFEST.format("real_msgs"),
            "src/deep/er/renamed/msg/A.msg": "",
            "src/deep/er/renamed/nested/msg/E.msg": "",
            "src/plain_msgs/msg/B.msg": "",
            "src/plain_msgs/msg/notes.txt": "",
            "src/broken/package.xml": b"\xff<name",
            "src/broken/srv/C.srv": "---",
            "src/action/code.py": "",
            "src/action/inner_msgs/msg/D.msg": "",
            "src/.hidden/x/msg/No.msg": "",
            "src/no-package/msg/No.msg": "",
            **{f"src/no_{tool}/{tool}_IGNORE": "" for tool in ("COLCON", "AMENT", "CATKIN")},
            **{f"src/no_{tool}/x/msg/No.msg": "" for tool in ("COLCON", "AMENT", "CATKIN")},
            "src/ignored/COLCON_IGNORE": "",
            "src/ignored/package.xml": MANIFEST.format("ignored"),
            "src/ignored/msg/No.msg": "",
        },
    )
    (tmp_path / "src" / "deep" / "loop").symlink_to(tmp_path / "src")
    (tmp_path / "src" / "again").symlink_to(tmp_path / "src" / "plain_msgs")
    built_in = set(open_library(Sources(), Report()).known())
    known = [
        str(name)
        for name in open_library(Sources((tmp_path,), "jazzy", tmp_path), Report()).known()
        if name not in built_in
    ]
    assert known == [
        "again/msg/B",
        "broken/srv/C_Reply",
        "broken/srv/C_Request",
        "broken/srv/C_Response",
        "inner_msgs/msg/D",
        "real_msgs/msg/A",
        "real_msgs/msg/E",
    ]


def test_path_may_be_a_package_folder(tmp_path):
    write(tmp_path, {"pkg/package.xml": MANIFEST.format("real_msgs"), "pkg/msg/A.msg": "int8 a"})
    assert names(load_folder(tmp_path / "pkg", "real_msgs/A")) == ["real_msgs/msg/A"]
    assert load_folder(tmp_path / "pkg", "real_msgs/A").messages[0].origin == "msg/A.msg"


def test_duplicate_package_name_is_rejected(tmp_path):
    write(tmp_path, {"a/x_msgs/msg/A.msg": "", "b/x_msgs/msg/A.msg": "", "c_msgs/msg/C.msg": "int8 c"})
    assert "SHM505" in rejection(tmp_path, "x_msgs/A")
    assert names(load_folder(tmp_path, "c_msgs")) == ["c_msgs/msg/C"]
    write(tmp_path, {"a/c_msgs/package.xml": MANIFEST.format("c_msgs")})  # a package without messages
    assert names(load_folder(tmp_path, "c_msgs")) == ["c_msgs/msg/C"]
    with pytest.raises(Rejected, match="SHM505"):
        load_files(*(tmp_path / f"{parent}/x_msgs/msg/A.msg" for parent in "ab"))


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        (
            "geometry_msgs/Pos",
            ["error[SHM004]", "did you mean `geometry_msgs/Pose`?", "looked in built-in store jazzy"],
        ),
        ("geometry_msgs/pose", ["did you mean `geometry_msgs/Pose`?"]),
        ("geometry_msgs/srv/Pose", ["unknown message type"]),
        ("nav_msgs/Pose", ["did you mean `geometry_msgs/Pose`?"]),
        ("geometry_msg", ["unknown message package"]),
        ("geometry_msgs/msg", ["unknown message type `geometry_msgs/msg`"]),
        ("my_msgs/Thing", ["looked in ., built-in store jazzy", "with -I"]),
        ("../../etc/passwd", ["is not the name of a message"]),
        ("", ["is not the name of a message"]),
        ("a\x1b[2Jb", ["a\ufffd[2Jb"]),
        ("a\x00b.msg", ["is not the name of a message"]),
        ("nowhere/msg/Foo.msg", ["nowhere/msg/Foo.msg: error[SHM001]"]),
        ("1nowhere/Foo.msg", ["1nowhere/Foo.msg: error[SHM202]"]),
    ],
)
def test_unknown_request_is_rejected(tmp_path, monkeypatch, request_, expected):
    monkeypatch.chdir(tmp_path)
    output = rejection(Path(), request_)
    for text in expected:
        assert text in output


def test_field_of_unknown_type_is_reported(tmp_path):
    write(tmp_path, {"x_msgs/msg/A.msg": "Point at\n  x_msgs/B[] b\nHeader header\ndouble d"})
    assert rejection(tmp_path, "x_msgs/A").split("\n") == [
        "x_msgs/msg/A.msg:1:1: error[SHM004]: unknown message type `x_msgs/Point`",
        "    1 | Point at",
        "      | ^^^^^",
        "  field: x_msgs/A.at",
        "  hint: did you mean `geometry_msgs/Point`?",
        "  hint: looked in x_msgs",
        "x_msgs/msg/A.msg:2:3: error[SHM004]: unknown message type `x_msgs/B`",
        "    2 |   x_msgs/B[] b",
        "      |   ^^^^^^^^^^",
        "  field: x_msgs/A.b",
        "  hint: looked in x_msgs",
        "x_msgs/msg/A.msg:3:1: error[SHM004]: unknown message type `x_msgs/Header`",
        "    3 | Header header",
        "      | ^^^^^^",
        "  field: x_msgs/A.header",
        "  hint: did you mean `std_msgs/Header`?",
        "  hint: looked in x_msgs",
        "x_msgs/msg/A.msg:4:1: error[SHM004]: unknown message type `x_msgs/double`",
        "    4 | double d",
        "      | ^^^^^^",
        "  field: x_msgs/A.d",
        "  hint: did you mean `float64`?",
        "  hint: looked in x_msgs",
    ]


def test_recursion_is_reported_with_its_chain(tmp_path):
    write(
        tmp_path,
        {
            "x_msgs/msg/A.msg": "int8 a\nB[] b",
            "x_msgs/msg/B.msg": "C c\nB self",
            "x_msgs/msg/C.msg": "A back",
        },
    )
    output = rejection(tmp_path, "x_msgs")
    assert "x_msgs/msg/C.msg:1:1: error[SHM301]: recursive: x_msgs/A -> x_msgs/B -> x_msgs/C -> x_msgs/A" in output
    assert "x_msgs/msg/B.msg:2:1: error[SHM301]: recursive: x_msgs/B -> x_msgs/B" in output
    assert output.count("SHM301") == 2


@pytest.mark.slow
def test_deep_nesting_is_not_recursion(tmp_path):
    write(tmp_path, {f"x_msgs/msg/M{n}.msg": f"M{n + 1} next" for n in range(2000)})
    write(tmp_path, {"x_msgs/msg/M2000.msg": "int8 end"})
    assert names(load_folder(tmp_path, "x_msgs/M0")) == [f"x_msgs/msg/M{n}" for n in range(2000, -1, -1)]
    write(tmp_path, {"x_msgs/msg/M2000.msg": "M0 end"})
    output = rejection(tmp_path, "x_msgs/M0")
    assert "SHM301" in output
    assert len(output) < 500


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"int8 a\n\nint8 \xc3\xa4\xff b", "A.msg:3:7: error[SHM002]: byte 0xFF is not UTF-8"),
        ("int8 a".encode("utf-16"), "A.msg:1:1: error[SHM002]"),
        (b"int8 a\n" * 2_000_000, "A.msg: error[SHM001]: larger than 512 KiB"),
        (b"int8 a\n" * 70_000, "SHM201"),
        (b"x" * 500_000, "SHM003"),
        (b"\x00" * 500_000, "SHM003"),
    ],
    ids=["latin-1", "utf-16", "14 MB", "duplicates", "one line", "zeros"],
)
def test_hostile_files_are_rejected(tmp_path, content, expected):
    write(tmp_path, {"x_msgs/msg/A.msg": content})
    output = rejection(tmp_path, "x_msgs/A")
    assert expected in output
    assert len(output) < 5000


def test_byte_order_mark_is_ignored(tmp_path):
    write(tmp_path, {"x_msgs/msg/A.msg": b"\xef\xbb\xbfint8 a\r\n"})
    (message,) = load_folder(tmp_path, "x_msgs").messages
    assert (message.text, message.fields[0].span.column) == ("int8 a\n", 1)


def test_invalid_files_are_reported(tmp_path):
    write(tmp_path, {"x_msgs/msg/A.msg": "", "x_msgs/msg/small.msg": ""})
    os.mkfifo(tmp_path / "x_msgs/msg/Pipe.msg")
    (tmp_path / "x_msgs/msg/Folder.msg").mkdir()
    (tmp_path / "x_msgs/msg/Dangling.msg").symlink_to(tmp_path / "nothing")
    output = rejection(tmp_path, "x_msgs")
    assert [line for line in output.split("\n") if "error" in line] == [
        "x_msgs/msg/Dangling.msg: error[SHM001]: no such file",
        "x_msgs/msg/Folder.msg: error[SHM001]: not a file",
        "x_msgs/msg/Pipe.msg: error[SHM001]: not a file",
        "x_msgs/msg/small.msg: error[SHM202]: `small` is not a message name",
    ]


def test_file_name_with_invalid_utf8_is_reported(tmp_path):
    folder = tmp_path / "x_msgs" / "msg"
    folder.mkdir(parents=True)
    Path(os.fsdecode(bytes(folder) + b"/A\xff\n\x1b.msg")).write_text("")
    assert "x_msgs/msg/A\ufffd\ufffd\ufffd.msg: error[SHM202]" in rejection(tmp_path, "x_msgs")


def test_invalid_sources_are_reported(tmp_path):
    with pytest.raises(Rejected) as caught:
        open_library(Sources((tmp_path / "missing",), "jazy", tmp_path), Report())
    output = str(caught.value)
    assert "missing: error[SHM001]: no such folder" in output
    assert "SHM502" in output
    assert "humble, iron, jazzy" in output


def test_ros1_folders_are_read_as_ros1(tmp_path):
    write(tmp_path, {"x_msgs/msg/a_1.msg": "Header header\nbyte B\ntime t"})
    schema = load_folder(tmp_path, "x_msgs/a_1", source="noetic")
    assert names(schema) == ["std_msgs/msg/Header", "x_msgs/msg/a_1"]
    assert "noetic" in rejection(tmp_path, "x_msgs/a_1").replace("SHM202", "noetic")


@pytest.mark.slow
def test_only_20_unknown_types_are_reported(tmp_path):
    """Report 20 unknown types at most. Each report searches for similar names, and all reports would take minutes."""
    write(tmp_path, {"x_msgs/msg/A.msg": "".join(f"Unknown{n} a{n}\n" for n in range(20_000))})
    output = rejection(tmp_path, "x_msgs/A")
    assert output.count("SHM004") == 20
