from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from shmgen import config, pipeline
from shmgen.diagnostics import Diagnostic, Rejected, Report

blark = pytest.importorskip("blark")

POSE_AND_STATE = """\
task_interval = 4

[[topics]]
topic = "/conveyor/state"
type = "std_msgs/Float64"
direction = "from_plc"
depth = 4

[[topics]]
topic = "/robot/pose"
type = "geometry_msgs/msg/Pose"
"""


def generate(folder: Path, text: str, *messages: str) -> dict[str, str]:
    (folder / "shmgen.toml").write_text(text)
    return pipeline.generate(config.load(folder / "shmgen.toml", "shmgen.toml", Report()), messages)


def refusal(folder: Path, text: str) -> list[Diagnostic]:
    with pytest.raises(Rejected) as rejected:
        generate(folder, text)
    return list(rejected.value.diagnostics)


def topic(name: str, type_: str = "std_msgs/Bool", more: str = "") -> str:
    return f'[[topics]]\ntopic = "{name}"\ntype = "{type_}"\n{more}\n'


def service(name: str) -> str:
    return f'[[services]]\nservice = "{name}"\ntype = "std_srvs/SetBool"\n'


def parse(text: str) -> Any:
    (found,) = blark.parse_source_code(text).transform().items
    return found


@pytest.fixture(scope="module")
def texts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return generate(tmp_path_factory.mktemp("topics"), POSE_AND_STATE)


def test_as_a_user_reads_it(texts: dict[str, str]) -> None:
    assert texts["st/GVL_Ros.st"] == (
        "// A block for each topic, service and action of shmgen.toml. PRG_Ros calls them; programs of your own\n"
        "// read and write what they carry.\n"
        "// Made by shmgen; changes made here are lost.\n"
        "{attribute 'qualified_only'}\n"
        "VAR_GLOBAL\n"
        "    robot_pose     : FB_geometry_msgs_Pose_Subscriber;  // /robot/pose, geometry_msgs/msg/Pose\n"
        "    conveyor_state : FB_std_msgs_Float64_Publisher;     // /conveyor/state, std_msgs/msg/Float64\n"
        "END_VAR\n"
    )
    assert texts["st/PRG_Ros.st"].partition("PROGRAM ")[2] == (
        "PRG_Ros\n"
        "VAR\n"
        "END_VAR\n"
        "\n"
        "GVL_Ros.robot_pose(\n"
        "    xEnable := TRUE,\n"
        "    sTopic := '/robot/pose',\n"
        "    udiDepth := 1);\n"
        "GVL_Ros.conveyor_state(\n"
        "    xEnable := TRUE,\n"
        "    sTopic := '/conveyor/state',\n"
        "    udiDepth := 4);\n"
        "\n"
        "END_PROGRAM\n"
    )


def test_blark_reads_it_and_every_block_is_there_and_called_once(texts: dict[str, str]) -> None:
    items = parse(texts["st/GVL_Ros.st"]).items
    declared = {str(name): str(item.init) for item in items for name in item.spec.variables}
    program = parse(texts["st/PRG_Ros.st"])
    assert str(program.name) == "PRG_Ros"
    called = [str(statement) for statement in program.body.statements]
    assert [call.partition("(")[0] for call in called] == [f"GVL_Ros.{name}" for name in declared]
    for block in declared.values():
        assert any(path.endswith(f"/{block}.st") for path in texts), block


SERVICES = """\
path = ["."]

[[services]]
service = "/robot/stop"
type = "cell_msgs/Start"
server = "ros"

[[services]]
service = "/cell/start"
type = "cell_msgs/srv/Start"

[[actions]]
action = "/robot/move"
type = "cell_msgs/Move"
server = "ros"

[[actions]]
action = "/cell/move"
type = "cell_msgs/Move"
"""


def test_services_and_actions_as_a_user_reads_them(tmp_path: Path) -> None:
    for kind, name, text in (("srv", "Start", "---\nbool on\n"), ("action", "Move", "bool on\n---\n---\n")):
        file = tmp_path / "cell_msgs" / kind / f"{name}.{kind}"
        file.parent.mkdir(parents=True)
        file.write_text(text)
    texts = generate(tmp_path, SERVICES + topic("/robot/pose", "geometry_msgs/Pose"))
    assert texts["st/GVL_Ros.st"].partition("VAR_GLOBAL\n")[2] == (
        "    robot_pose : FB_geometry_msgs_Pose_Subscriber;  // /robot/pose, geometry_msgs/msg/Pose\n"
        "    cell_start : FB_cell_msgs_Start_Server;         // /cell/start, cell_msgs/srv/Start\n"
        "    cell_move  : FB_cell_msgs_Move_ActionServer;    // /cell/move, cell_msgs/action/Move\n"
        "    robot_stop : FB_cell_msgs_Start_Client;         // /robot/stop, cell_msgs/srv/Start\n"
        "    robot_move : FB_cell_msgs_Move_ActionClient;    // /robot/move, cell_msgs/action/Move\n"
        "END_VAR\n"
    )
    for call in (
        "GVL_Ros.cell_start(\n    xEnable := TRUE,\n    sService := '/cell/start');\n",
        "GVL_Ros.robot_move(\n    xEnable := TRUE,\n    sAction := '/robot/move');\n",
    ):
        assert call in texts["st/PRG_Ros.st"]
    blocks = {Path(path).stem for path in texts if Path(path).stem.startswith("FB_cell")}
    assert blocks == {
        "FB_cell_msgs_Start_Client",
        "FB_cell_msgs_Start_Server",
        "FB_cell_msgs_Move_ActionClient",
        "FB_cell_msgs_Move_ActionServer",
    }, "what travels in a call needs no publisher and no subscriber of its own"


def test_without_services_their_common_blocks_are_not_there(texts: dict[str, str]) -> None:
    assert not any("FB_ShmCaller" in path or "FB_ShmServer" in path for path in texts)


def test_the_task_calls_the_program(texts: dict[str, str]) -> None:
    xml = texts["plcopen/shmgen.xml"]
    assert re.findall(r"<task [^>]*>", xml) == ['<task name="RosTask" interval="PT0.004S" priority="10">']
    assert re.findall(r'<pouInstance name="(\w+)"', xml) == ["PRG_Ros"]
    assert 'INTERVAL = "t#4ms"' in texts["plcopen/import_shmgen.py"]


def test_without_topics_there_is_none_of_it(tmp_path: Path) -> None:
    texts = generate(tmp_path, "", "std_msgs/Bool")
    assert not any("Ros" in text for path, text in texts.items() if path.startswith(("st/", "plcopen/")))


def test_plcopen_alone_holds_the_code_without_its_files(tmp_path: Path, texts: dict[str, str]) -> None:
    alone = generate(tmp_path, 'targets = ["plcopen"]\n' + POSE_AND_STATE)
    assert sorted(alone) == ["layout.lock", "plcopen/import_shmgen.py", "plcopen/shmgen.xml"]
    assert alone["plcopen/shmgen.xml"] == texts["plcopen/shmgen.xml"]


def test_types_of_topics_come_along(tmp_path: Path) -> None:
    texts = generate(tmp_path, topic("/a"), "std_msgs/Int8")
    assert {"st/std_msgs/FB_std_msgs_Bool_Subscriber.st", "st/std_msgs/FB_std_msgs_Int8_Subscriber.st"} <= set(texts)


@pytest.mark.parametrize(
    ("name", "identifier"),
    [("/robot/pose", "robot_pose"), ("step", "step_"), ("/a__b/c_", "a_b_c_"), ("/_x", "_x"), ("/TYPE", "TYPE_")],
)
def test_identifiers(tmp_path: Path, name: str, identifier: str) -> None:
    texts = generate(tmp_path, topic(name))
    assert f"    {identifier} : FB_std_msgs_Bool_Subscriber;" in texts["st/GVL_Ros.st"]
    assert f"sTopic := '{name}'" in texts["st/PRG_Ros.st"]


@pytest.mark.parametrize(
    ("text", "code", "line", "words"),
    [
        (topic("/robot/pose") + topic("/robot_pose"), "SHM203", 6, "both `robot_pose`"),
        (topic("/step") + topic("/Step_"), "SHM203", 6, "ignores case"),
        (topic("/a/b") + service("/a_b"), "SHM203", 6, "topic /a/b and service /a_b are both `a_b`"),
        (service("/" + 66 * "a"), "SHM502", 2, "66 characters, more than the 65"),
        (topic("/a/"), "SHM502", 2, "single slashes"),
        (topic("/a b"), "SHM502", 2, "letters"),
        (topic("/\u00e4"), "SHM502", 2, "letters"),
        (topic("/a/1b"), "SHM502", 2, "no digit first"),
        (topic("/sem/a"), "SHM502", 2, "semaphores"),
        (topic("/GWDrvSharedMemShm"), "SHM502", 2, "CODESYS keeps"),
        (topic("/" + 75 * "a"), "SHM502", 2, "75 characters"),
        (topic("/a", "std_msgs"), "SHM502", 3, "names no message"),
        (topic("/a", "std_srvs/SetBool"), "SHM502", 3, "is several messages"),
        (topic("/a", more="depth = 65536"), "SHM502", 4, "from 1 to 65535"),
        ("task_interval = 0\n" + topic("/a"), "SHM502", 1, "task_interval is a whole number"),
    ],
)
def test_refusals(tmp_path: Path, text: str, code: str, line: int, words: str) -> None:
    (tmp_path / "std_srvs" / "srv").mkdir(parents=True)
    (tmp_path / "std_srvs" / "srv" / "SetBool.srv").write_text("bool data\n---\nbool success\n")
    (found,) = refusal(tmp_path, 'path = ["."]\n' + text if "srv" in text else text)
    assert (found.code, found.span.line - ("srv" in text)) == (code, line), str(found)
    assert words in found.message


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("[[services]]\nservice = '/a'\ntype = 'cell_msgs/Move'", 3, "cell_msgs/Move is not a service"),
        ("[[actions]]\naction = '/a'\ntype = 'cell_msgs/Start'", 3, "cell_msgs/Start is not an action"),
        ("[[services]]\nservice = '/a'\ntype = 'cell_msgs/Start_Request'", 3, "is not a service"),
        ("[[services]]\nservice = '/a'\ntype = 'cell_msgs/Go'", 3, "unknown message type `cell_msgs/Go`"),
    ],
)
def test_a_type_that_is_none(tmp_path: Path, text: str, line: int, words: str) -> None:
    for path, definition in {"srv/Start.srv": "---\n", "action/Move.action": "---\n---\n"}.items():
        (tmp_path / "cell_msgs" / path).parent.mkdir(parents=True)
        (tmp_path / "cell_msgs" / path).write_text(definition)
    (found,) = refusal(tmp_path, 'path = ["."]\n' + text)
    assert words in found.message
    assert found.span.line in (line + 1, 0), str(found)
