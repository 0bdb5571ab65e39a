"""What is asked for by half a name, by a number, or by a package of which only a part can be had."""

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


def listed(folder: Path) -> set[str]:
    return {path.stem for path in (folder / "generated/c").rglob("*/msg/*.h") if not path.stem.endswith("_shm")}


# --- names ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "hint"),
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
def test_what_was_meant_is_suggested(tmp_path: Path, command: str, asked: str, hint: str) -> None:
    put({"msgs/demo_msgs/srv/Stop.srv": "---\n"}, tmp_path)
    said = shmgen(tmp_path, f"{command} {asked} -I msgs")
    assert said.code == 1
    assert said.stderr.startswith(f"{asked}: error[SHM004]")
    assert f"  hint: {hint}\n" in said.stderr


@pytest.mark.parametrize("code", ["SHM101", "shm101", "101"])
def test_a_code_may_be_its_number(tmp_path: Path, code: str) -> None:
    said = shmgen(tmp_path, f"explain {code}")
    assert said.code == 0
    assert said.stdout.startswith("SHM101 unbounded sequence\n")


def test_the_first_codes_have_a_number_too(tmp_path: Path) -> None:
    assert shmgen(tmp_path, "explain 7").stdout.startswith("SHM007 cannot write output\n")
    said = shmgen(tmp_path, "explain shm11")
    assert (said.code, "shm11 is not a diagnostic code" in said.stderr) == (2, True)


def test_a_list_of_one(tmp_path: Path) -> None:
    assert shmgen(tmp_path, "list geometry_msgs/Pose").stdout == (
        "geometry_msgs/Pose         56 bytes\n\n1 of 1 can be generated.\n"
    )
    assert shmgen(tmp_path, "list sensor_msgs/msg/JointState").stdout.startswith(
        "sensor_msgs/JointState  needs a bound for sensor_msgs/JointState.name, "
    )
    put({"msgs/demo_msgs/srv/Stop.srv": "---\n"}, tmp_path)
    names = [entry["type"] for entry in json.loads(shmgen(tmp_path, "list demo_msgs/Stop -I msgs --json").stdout)]
    assert names == [f"demo_msgs/srv/Stop_{part}" for part in ("Reply", "Request", "Response")]


def test_a_name_that_is_none_stops_no_list(tmp_path: Path) -> None:
    put({"msgs/demo_msgs/msg/Arm.v2.msg": "int8 a\n", "msgs/demo_msgs/msg/Arm.msg": "int8 a\n"}, tmp_path)
    said = shmgen(tmp_path, "list -I msgs")
    assert said.code == 0
    assert "SHM202 msgs/demo_msgs/msg/Arm.v2.msg: `Arm.v2` is not a message name" in said.stdout
    assert "demo_msgs/Arm " in said.stdout
    assert "108 of 173 can be generated." in said.stdout


def test_one_is_one(tmp_path: Path) -> None:
    """Not `1 bytes`, wherever it is printed."""
    texts = shmgen(tmp_path, "show std_msgs/Bool").stdout + shmgen(tmp_path, "list std_msgs/Bool").stdout
    texts += shmgen(tmp_path, "show std_msgs/Bool --svg").stdout
    assert shmgen(tmp_path, "generate std_msgs/Bool -q").code == 0
    texts += "".join(path.read_text() for path in (tmp_path / "generated").rglob("*") if path.is_file())
    assert texts.count("1 byte") >= 5
    assert "1 bytes" not in texts.replace("11 bytes", "").replace("21 bytes", "")


# --- what can be had --------------------------------------------------------------------------------------

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


def test_the_way_round_is_told(folder: Path) -> None:
    said = shmgen(folder, "generate")
    assert said.code == 1
    assert said.stderr.endswith(
        "  hint: 5 of 10 requested messages need no more bounds: "
        "`shmgen generate` with --skip-unbounded leaves out the others\n"
    )
    assert not (folder / "generated").exists()
    assert "--skip-unbounded" not in shmgen(folder, "generate demo_msgs/Open").stderr


def test_what_needs_a_bound_is_left_out_and_check_knows(folder: Path) -> None:
    said = shmgen(folder, "generate --skip-unbounded")
    assert (said.code, said.stderr) == (0, "")
    assert said.stdout.endswith(
        "5 messages left out for want of a bound, see `shmgen list`:\n  demo_msgs/Go_Reply\n  demo_msgs/Go_Request\n"
        "  demo_msgs/Go_Response\n  demo_msgs/Holder\n  demo_msgs/Open\n"
    )
    assert listed(folder) == {"plain", "held"}
    assert {path.stem for path in (folder / "generated/c").rglob("srv/*[!m].h")} == {
        "stop_request",
        "stop_response",
        "stop_reply",
        "stop_service",
    }
    assert "skip_unbounded = true\n" in (folder / "generated/layout.lock").read_text()
    checked = shmgen(folder, "check")
    assert (checked.code, checked.stderr) == (0, "")
    put({"msgs/demo_msgs/msg/Open.msg": "uint8[<=3] data\n"}, folder)
    assert "demo_msgs/Open is new" in shmgen(folder, "check").stderr


def test_what_gets_its_bound_comes_in(folder: Path) -> None:
    assert shmgen(folder, "generate --skip-unbounded -q").code == 0
    put({"shmgen.toml": f'{SETTINGS}[bounds]\n"demo_msgs/Open.data" = 3\n'}, folder)
    said = shmgen(folder, "generate --skip-unbounded")
    assert "3 messages left out" in said.stdout
    assert listed(folder) == {"plain", "held", "open", "holder", "used"}
    put({"shmgen.toml": f'{SETTINGS}[bounds]\n"demo_msgs" = 3\n'}, folder)
    assert shmgen(folder, "generate -q").code == 0
    assert "skip_unbounded" not in (folder / "generated/layout.lock").read_text()
    before = tree(folder / "generated")
    assert "left out" not in shmgen(folder, "generate --skip-unbounded").stdout
    assert {path for path, text in tree(folder / "generated").items() if text != before[path]} == {"layout.lock"}


def test_what_the_configuration_uses_by_name_is_not_left_out(folder: Path) -> None:
    topic = '[[topics]]\ntopic = "/a"\ntype = "demo_msgs/Open"\n'
    put({"shmgen.toml": f"{SETTINGS}{topic}"}, folder)
    said = shmgen(folder, "generate --skip-unbounded")
    assert (said.code, said.stderr.count("error[SHM101]")) == (1, 1)
    assert "msgs/demo_msgs/msg/Open.msg" in said.stderr


def test_where_nothing_is_left_it_is_an_error(folder: Path) -> None:
    said = shmgen(folder, "generate demo_msgs/Open --skip-unbounded")
    assert said.code == 1
    assert "error[SHM101]" in said.stderr
    assert not (folder / "generated").exists()


def test_a_real_package(tmp_path: Path) -> None:
    assert "--skip-unbounded" in shmgen(tmp_path, "generate sensor_msgs").stderr
    said = shmgen(tmp_path, "generate sensor_msgs --skip-unbounded")
    assert (said.code, said.stderr) == (0, "")
    assert {"imu", "temperature", "nav_sat_fix"} < listed(tmp_path)
    assert shmgen(tmp_path, "check").code == 0
    assert shmgen(tmp_path, "generate std_msgs/Bool -q").code == 0  # joins what is there
    assert {"imu", "bool"} < listed(tmp_path)
    assert shmgen(tmp_path, "check").code == 0
    compiled = "".join(
        f'#include "{path.relative_to(tmp_path / "generated/c")}"\n'
        for path in sorted((tmp_path / "generated/c").rglob("*.h"))
    )
    command = ["gcc", "-xc", "-std=c11", "-Wall", "-Werror", "-fsyntax-only", f"-I{tmp_path}/generated/c", "-"]
    subprocess.run(command, input=compiled, text=True, check=True, stdout=sys.stderr)
