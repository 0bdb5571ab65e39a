"""Test incomplete requests: a partial name, the number of a code, and a package with unbounded messages."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ..support.build import put
from ..support.command import Result, run, tree


def shmgen(folder: Path, line: str) -> Result:
    return run(line.split(), folder)


def generated_names(folder: Path) -> set[str]:
    return {path.stem for path in (folder / "generated/c").rglob("*/msg/*.h") if not path.stem.endswith("_shm")}


# --- names ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_name", "hint"),
    [
        ("Pose", "did you mean `geometry_msgs/Pose`?"),
        ("pose", "did you mean `geometry_msgs/Pose`?"),
        ("stop", "did you mean `demo_msgs/Stop`?"),
        ("geometry_msg", "did you mean `geometry_msgs`?"),
        ("geometry_msgs/Poze", "did you mean `geometry_msgs/Pose`?"),
        ("std_msgs/Pose", "did you mean `geometry_msgs/Pose`?"),
    ],
)
@pytest.mark.parametrize("command", ["generate", "show", "list"])
def test_similar_name_is_suggested(tmp_path: Path, command: str, request_name: str, hint: str) -> None:
    put({"msgs/demo_msgs/srv/Stop.srv": "---\n"}, tmp_path)
    result = shmgen(tmp_path, f"{command} {request_name} -I msgs")
    assert result.code == 1
    assert result.stderr.startswith(f"{request_name}: error[SHM004]")
    assert f"  hint: {hint}\n" in result.stderr


@pytest.mark.parametrize("code", ["SHM101", "shm101", "101"])
def test_explain_accepts_a_number(tmp_path: Path, code: str) -> None:
    result = shmgen(tmp_path, f"explain {code}")
    assert result.code == 0
    assert result.stdout.startswith("SHM101 unbounded sequence\n")


def test_explain_accepts_a_number_below_100(tmp_path: Path) -> None:
    assert shmgen(tmp_path, "explain 7").stdout.startswith("SHM007 cannot write output\n")
    result = shmgen(tmp_path, "explain shm11")
    assert (result.code, "shm11 is not a diagnostic code" in result.stderr) == (2, True)


def test_list_of_one_message(tmp_path: Path) -> None:
    assert shmgen(tmp_path, "list geometry_msgs/Pose").stdout == (
        "geometry_msgs/Pose         56 bytes\n\n1 of 1 can be generated.\n"
    )
    assert shmgen(tmp_path, "list sensor_msgs/msg/JointState").stdout.startswith(
        "sensor_msgs/JointState  needs a bound for sensor_msgs/JointState.name, "
    )
    put({"msgs/demo_msgs/srv/Stop.srv": "---\n"}, tmp_path)
    names = [entry["type"] for entry in json.loads(shmgen(tmp_path, "list demo_msgs/Stop -I msgs --json").stdout)]
    assert names == [f"demo_msgs/srv/Stop_{part}" for part in ("Reply", "Request", "Response")]


def test_list_continues_after_an_invalid_message_name(tmp_path: Path) -> None:
    put({"msgs/demo_msgs/msg/Arm.v2.msg": "int8 a\n", "msgs/demo_msgs/msg/Arm.msg": "int8 a\n"}, tmp_path)
    result = shmgen(tmp_path, "list -I msgs")
    assert result.code == 0
    assert "SHM202 msgs/demo_msgs/msg/Arm.v2.msg: `Arm.v2` is not a message name" in result.stdout
    assert "demo_msgs/Arm " in result.stdout
    assert "108 of 173 can be generated." in result.stdout


def test_output_contains_1_byte_in_the_singular(tmp_path: Path) -> None:
    """Print `1 byte` instead of `1 bytes` in all outputs."""
    texts = shmgen(tmp_path, "show std_msgs/Bool").stdout + shmgen(tmp_path, "list std_msgs/Bool").stdout
    texts += shmgen(tmp_path, "show std_msgs/Bool --svg").stdout
    assert shmgen(tmp_path, "generate std_msgs/Bool -q").code == 0
    texts += "".join(path.read_text() for path in (tmp_path / "generated").rglob("*") if path.is_file())
    assert texts.count("1 byte") >= 5
    assert "1 bytes" not in texts.replace("11 bytes", "").replace("21 bytes", "")


# --- unbounded messages --------------------------------------------------------------------------------------

SETTINGS = """messages = ["demo_msgs"]
path = ["msgs"]
targets = ["c"]
"""
MESSAGES = {
    "msgs/demo_msgs/msg/Plain.msg": "uint8 a\n",
    "msgs/demo_msgs/msg/Held.msg": "uint8 a\n",
    "msgs/demo_msgs/msg/Open.msg": "other_msgs/Used used\nuint8[] data\n",
    "msgs/demo_msgs/msg/Holder.msg": "Held held\nOpen[2] open\n",
    "msgs/demo_msgs/srv/Go.srv": "uint8 a\n---\nuint8[] b\n",
    "msgs/demo_msgs/srv/Stop.srv": "uint8 a\n---\nuint8 b\n",
    "msgs/other_msgs/msg/Used.msg": "uint8 a\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    put({"shmgen.toml": SETTINGS, **MESSAGES}, tmp_path)
    return tmp_path


def test_error_suggests_skip_unbounded(folder: Path) -> None:
    result = shmgen(folder, "generate")
    assert result.code == 1
    assert result.stderr.endswith(
        "  hint: 5 of 10 requested messages need no more bounds: "
        "`shmgen generate` with --skip-unbounded leaves out the others\n"
    )
    assert not (folder / "generated").exists()
    assert "--skip-unbounded" not in shmgen(folder, "generate demo_msgs/Open").stderr


def test_skip_unbounded_omits_messages_and_check_agrees(folder: Path) -> None:
    result = shmgen(folder, "generate --skip-unbounded")
    assert (result.code, result.stderr) == (0, "")
    assert result.stdout.endswith(
        "5 messages left out for lack of bounds, see `shmgen list`:\n  demo_msgs/Go_Reply\n  demo_msgs/Go_Request\n"
        "  demo_msgs/Go_Response\n  demo_msgs/Holder\n  demo_msgs/Open\n"
    )
    assert generated_names(folder) == {"plain", "held"}
    assert {path.stem for path in (folder / "generated/c").rglob("srv/*[!m].h")} == {
        "stop_request",
        "stop_response",
        "stop_reply",
        "stop_service",
    }
    assert "skip_unbounded = true\n" in (folder / "generated/layout.lock").read_text()
    check_result = shmgen(folder, "check")
    assert (check_result.code, check_result.stderr) == (0, "")
    put({"msgs/demo_msgs/msg/Open.msg": "uint8[<=3] data\n"}, folder)
    assert "demo_msgs/Open is new" in shmgen(folder, "check").stderr


def test_bounded_message_is_generated_in_the_next_run(folder: Path) -> None:
    assert shmgen(folder, "generate --skip-unbounded -q").code == 0
    put({"shmgen.toml": f'{SETTINGS}[bounds]\n"demo_msgs/Open.data" = 3\n'}, folder)
    result = shmgen(folder, "generate --skip-unbounded")
    assert "3 messages left out" in result.stdout
    assert generated_names(folder) == {"plain", "held", "open", "holder", "used"}
    put({"shmgen.toml": f'{SETTINGS}[bounds]\n"demo_msgs" = 3\n'}, folder)
    assert shmgen(folder, "generate -q").code == 0
    assert "skip_unbounded" not in (folder / "generated/layout.lock").read_text()
    before = tree(folder / "generated")
    assert "left out" not in shmgen(folder, "generate --skip-unbounded").stdout
    assert {path for path, text in tree(folder / "generated").items() if text != before[path]} == {"layout.lock"}


def test_skip_unbounded_keeps_messages_of_topics(folder: Path) -> None:
    topic = '[[topics]]\ntopic = "/a"\ntype = "demo_msgs/Open"\n'
    put({"shmgen.toml": f"{SETTINGS}{topic}"}, folder)
    result = shmgen(folder, "generate --skip-unbounded")
    assert (result.code, result.stderr.count("error[SHM101]")) == (1, 1)
    assert "msgs/demo_msgs/msg/Open.msg" in result.stderr


def test_skip_unbounded_fails_if_no_message_remains(folder: Path) -> None:
    result = shmgen(folder, "generate demo_msgs/Open --skip-unbounded")
    assert result.code == 1
    assert "error[SHM101]" in result.stderr
    assert not (folder / "generated").exists()


def test_skip_unbounded_with_sensor_msgs(tmp_path: Path) -> None:
    assert "--skip-unbounded" in shmgen(tmp_path, "generate sensor_msgs").stderr
    result = shmgen(tmp_path, "generate sensor_msgs --skip-unbounded")
    assert (result.code, result.stderr) == (0, "")
    assert {"imu", "temperature", "nav_sat_fix"} < generated_names(tmp_path)
    assert shmgen(tmp_path, "check").code == 0
    assert shmgen(tmp_path, "generate std_msgs/Bool -q").code == 0  # adds to the existing files
    assert {"imu", "bool"} < generated_names(tmp_path)
    assert shmgen(tmp_path, "check").code == 0
    includes = "".join(
        f'#include "{path.relative_to(tmp_path / "generated/c")}"\n'
        for path in sorted((tmp_path / "generated/c").rglob("*.h"))
    )
    command = ["gcc", "-xc", "-std=c11", "-Wall", "-Werror", "-fsyntax-only", f"-I{tmp_path}/generated/c", "-"]
    subprocess.run(command, input=includes, text=True, check=True, stdout=sys.stderr)
