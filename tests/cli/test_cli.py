"""Test the command line: its output, the files that it writes or keeps, and its exit codes."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from shmgen import __version__
from shmgen.config.backends import BACKENDS
from shmgen.core.diagnostics import CODES
from shmgen.runtime import engine

from ..support.command import Result, run, tree

ROBOT = {
    "msgs/demo_msgs/msg/Robot.msg": "Arm arm\nfloat64 speed  # [m/s]\n",
    "msgs/demo_msgs/msg/Arm.msg": "string name\n",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A workspace with a package of two messages."""
    write(tmp_path, ROBOT)
    return tmp_path


def write(folder: Path, files: dict[str, str]) -> None:
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text, encoding="utf-8")


def shmgen(folder: Path, command: str) -> Result:
    return run(command.split(), folder)


def run_ok(folder: Path, command: str) -> str:
    result = shmgen(folder, command)
    assert (result.code, result.stderr) == (0, ""), result.stderr
    return result.stdout


def run_error(folder: Path, command: str) -> str:
    before = tree(folder)
    result = shmgen(folder, command)
    assert (result.code, result.stdout) == (1, "")
    assert tree(folder) == before
    assert "Traceback" not in result.stderr
    return result.stderr


def generated_files(folder: Path, output: str = "generated") -> set[str]:
    """Return the generated files, except files that do not depend on the messages."""
    files = {path for path, content in tree(folder / output).items() if content is not None}
    return {path for path in files if not re.search(r"st/shmgen/|__init__|py\.typed|/shmgen\.", path)}


POINT = {"python/shm_msgs/geometry_msgs/msg/_point.py", "c/shm_msgs/geometry_msgs/msg/point.h", "layout.lock"}


# --- generate -----------------------------------------------------------------------------------------


def test_generate_lists_written_files(tmp_path: Path) -> None:
    lines = run_ok(tmp_path, "generate geometry_msgs/Point").splitlines()
    paths = [path for path, content in tree(tmp_path / "generated").items() if content is not None]
    assert lines[0] == f"generated: {len(paths)} files written, 0 unchanged"
    assert sorted(lines[1:]) == sorted(f"  generated/{path}" for path in paths)
    assert generated_files(tmp_path) >= POINT
    assert run_ok(tmp_path, "generate geometry_msgs/Point") == f"generated: 0 files written, {len(paths)} unchanged\n"


def test_second_run_does_not_touch_files(tmp_path: Path) -> None:
    run_ok(tmp_path, "generate geometry_msgs/Point")
    before = {path: os.stat(path).st_mtime_ns for path in tmp_path.rglob("*")}
    run_ok(tmp_path, "generate geometry_msgs/Point")
    assert {path: os.stat(path).st_mtime_ns for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize(
    "request_",
    ["demo_msgs", "demo_msgs/Arm demo_msgs/Robot", "demo_msgs/msg/Robot demo_msgs/msg/Arm"],
)
def test_generate_accepts_packages_and_messages(folder: Path, request_: str) -> None:
    run_ok(folder, f"generate -I msgs {request_} -o out")
    assert (folder / "out/python/shm_msgs/demo_msgs/msg/_robot.py").is_file()
    assert 'requested = [\n    "demo_msgs/msg/Arm",\n    "demo_msgs/msg/Robot",\n]' in lock(folder, "out")


def test_generate_accepts_a_file(folder: Path) -> None:
    run_ok(folder, "generate msgs/demo_msgs/msg/Robot.msg")
    assert 'requested = [\n    "demo_msgs/msg/Robot",\n]' in lock(folder)
    assert not (folder / "generated/st/demo_msgs/FB_demo_msgs_Arm_Publisher.st").exists()


def lock(folder: Path, output: str = "generated") -> str:
    return (folder / output / "layout.lock").read_text()


def test_generate_uses_the_configuration_without_names(folder: Path) -> None:
    text = 'messages = ["demo_msgs/Arm"]\npath = ["msgs"]\n[[topics]]\ntopic = "/p"\ntype = "geometry_msgs/Point"\n'
    write(folder, {"shmgen.toml": text})
    run_ok(folder, "generate")
    assert 'requested = [\n    "demo_msgs/msg/Arm",\n    "geometry_msgs/msg/Point",\n]' in lock(folder)


def test_configuration_in_another_folder(folder: Path) -> None:
    write(folder, {"there/robot.toml": 'messages = ["../msgs/demo_msgs/msg/Arm.msg"]\npackage = "robot_shm"\n'})
    run_ok(folder, "generate -q -c there/robot.toml")
    assert (folder / "generated/python/robot_shm/demo_msgs/msg/_arm.py").is_file()


def test_second_run_adds_its_message(tmp_path: Path) -> None:
    run_ok(tmp_path, "generate geometry_msgs/Point")
    first = generated_files(tmp_path)
    run_ok(tmp_path, "generate std_msgs/Bool")
    assert generated_files(tmp_path) > first
    both = tree(tmp_path / "generated")
    run_ok(tmp_path, "generate geometry_msgs/Point std_msgs/Bool -o at_once")
    assert tree(tmp_path / "at_once") == both


def test_files_not_in_the_configuration_are_removed(tmp_path: Path) -> None:
    run_ok(tmp_path, "generate geometry_msgs/Point std_msgs/Bool")
    write(tmp_path, {"shmgen.toml": 'messages = ["std_msgs/Bool"]', "generated/c/notes.txt": "ours"})
    output = run_ok(tmp_path, "generate")
    assert re.match(r"generated: \d+ files written, \d+ unchanged, \d+ removed\n", output)
    assert not any("geometry" in path for path in tree(tmp_path / "generated"))
    assert (tmp_path / "generated/c/notes.txt").read_text() == "ours"


def test_files_not_in_the_lock_are_not_removed(tmp_path: Path) -> None:
    run_ok(tmp_path, "generate geometry_msgs/Point std_msgs/Bool")
    (tmp_path / "generated/layout.lock").unlink()
    run_ok(tmp_path, "generate std_msgs/Bool")
    assert generated_files(tmp_path) >= POINT


def test_lock_cannot_remove_files_outside_the_folder(tmp_path: Path) -> None:
    run_ok(tmp_path, "generate std_msgs/Bool")
    write(tmp_path, {"ours.txt": "ours"})
    paths = ["../ours.txt", str(tmp_path / "ours.txt"), "gone.txt"]
    entries = "".join(f'"{path}" = "00"\n' for path in paths)
    (tmp_path / "generated/layout.lock").write_text(lock(tmp_path) + entries)
    assert "removed" not in run_ok(tmp_path, "generate std_msgs/Bool")
    assert (tmp_path / "ours.txt").is_file()


def test_files_of_other_targets_are_removed(tmp_path: Path) -> None:
    run_ok(tmp_path, "generate std_msgs/Bool -t c -t python")
    assert {path.partition("/")[0] for path in generated_files(tmp_path)} == {"c", "python", "layout.lock"}
    run_ok(tmp_path, "generate std_msgs/Bool -t c")
    assert {path.partition("/")[0] for path in tree(tmp_path / "generated")} == {"c", "layout.lock"}


def test_quiet_prints_nothing(tmp_path: Path) -> None:
    assert run_ok(tmp_path, "generate std_msgs/Bool -q") == ""


def test_command_line_folders_precede_configured_folders(folder: Path) -> None:
    write(folder, {"new/demo_msgs/msg/Arm.msg": "int8 new\n", "shmgen.toml": 'path = ["msgs"]'})
    run_ok(folder, "generate -I new demo_msgs/Arm")
    assert '"0 new int8"' in lock(folder)


def test_failed_run_changes_no_file(folder: Path) -> None:
    run_ok(folder, "generate -I msgs demo_msgs/Robot")
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": "Arm arm\nfloat32[] speed\n"})
    assert "SHM101" in run_error(folder, "generate -I msgs demo_msgs/Robot")
    assert "SHM004" in run_error(folder, "generate geometry_msgs/Nothing")
    assert "SHM408" in run_error(with_unknown_lock_version(folder), "generate std_msgs/Bool")


def with_unknown_lock_version(folder: Path) -> Path:
    (folder / "generated/layout.lock").write_text(lock(folder).replace("version = 1", "version = 2"))
    return folder


@pytest.mark.parametrize(
    "obstacle", ["generated/layout.lock/x", "generated/st/std_msgs/GVL_std_msgs_Bool.st/x", "generated/python"]
)
def test_no_file_is_written_if_one_cannot_be_written(tmp_path: Path, obstacle: str) -> None:
    run_ok(tmp_path, "generate geometry_msgs/Point")
    write(tmp_path, {"shmgen.toml": 'messages = ["std_msgs/Bool"]'})
    for path in (tmp_path / obstacle, (tmp_path / obstacle).parent):
        if path.name in ("layout.lock", "python"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    write(tmp_path, {obstacle: ""})
    assert "SHM007" in run_error(tmp_path, "generate")


def test_file_edited_by_hand_is_replaced(tmp_path: Path) -> None:
    run_ok(tmp_path, "generate std_msgs/Bool")
    before = tree(tmp_path)
    write(tmp_path, {"generated/c/shm_msgs/std_msgs/msg/bool.h": "mine"})
    assert "generated: 1 file written" in run_ok(tmp_path, "generate std_msgs/Bool")
    assert tree(tmp_path) == before


def test_files_follow_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        run_ok(tmp_path, "generate std_msgs/Bool")
    finally:
        os.umask(before)
    assert {path.stat().st_mode & 0o777 for path in tmp_path.rglob("*") if path.is_file()} == {0o640}


@pytest.mark.parametrize(
    "environment",
    [
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"TZ": "Pacific/Chatham", "PYTHONHASHSEED": "1"},
        {"PYTHONHASHSEED": "2", "PYTHONOPTIMIZE": "1"},
    ],
    ids=lambda environment: "+".join(environment),
)
def test_output_is_independent_of_the_environment(folder: Path, environment: dict[str, str]) -> None:
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": "# °µ\nArm[2] arms\nint8 TEN=10\nint8 TWO=2\n"})
    run_ok(folder, "generate -I msgs demo_msgs geometry_msgs/PoseStamped")
    other_folder = folder / "there"
    other_folder.mkdir()
    write(folder, {"there/shmgen.toml": ""})
    command = "-m shmgen generate -q -c ../there/../shmgen.toml -I ../msgs geometry_msgs/PoseStamped demo_msgs -o out"
    write(folder, {"shmgen.toml": ""})
    result = subprocess.run(
        [sys.executable, *command.split()],
        cwd=other_folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert tree(other_folder / "out") == tree(folder / "generated")


def test_output_contains_no_path_and_no_version(folder: Path) -> None:
    run_ok(folder, f"generate -I {folder}/msgs demo_msgs geometry_msgs/Point")
    for path, content in tree(folder / "generated").items():
        assert str(folder).encode() not in (content or b""), path
        assert __version__.encode() not in (content or b""), path


# --- show, types, list, explain -----------------------------------------------------------------------


def test_show(folder: Path) -> None:
    lines = run_ok(folder, "show -I msgs demo_msgs/Robot").splitlines()
    assert lines[0].startswith("demo_msgs/msg/Robot: 96 bytes, alignment 8, digest ")
    assert lines[1].startswith("from msgs/demo_msgs/msg/Robot.msg; a region of depth 1 takes 4,096 bytes")
    assert re.fullmatch(r"in ROS 2 RIHS01_[0-9a-f]{64}", lines[2])
    assert lines[4:] == [
        "offset  size  name    ROS            IEC 61131-3",
        "     0    81  arm     demo_msgs/Arm  ST_demo_msgs_Arm",
        "     0    81    name  string<=80     STRING(80)",
        "    81     7  _pad0                  ARRAY[0..6] OF USINT",
        "    88     8  speed   float64        LREAL                 [m/s]",
    ]


def test_show_json_has_a_stable_shape(folder: Path) -> None:
    (data,) = json.loads(run_ok(folder, "show -I msgs demo_msgs/Robot --json"))
    assert list(data) == ["type", "origin", "size", "align", "digest", "type_hash", "region_size", "slots"]
    assert (data["type"], data["size"], data["align"], data["region_size"]) == ("demo_msgs/msg/Robot", 96, 8, 4096)
    assert re.fullmatch("[0-9a-f]{16}", data["digest"])
    assert [slot["path"] for slot in data["slots"]] == ["arm", "arm.name", "_pad0", "speed"]
    assert data["slots"][3] == {
        "offset": 88,
        "size": 8,
        "path": "speed",
        "depth": 0,
        "role": "data",
        "ros": "float64",
        "iec": "LREAL",
        "unit": "m/s",
        "doc": "",
        "nested": False,
    }


def test_show_accepts_a_package(folder: Path) -> None:
    assert [data["type"] for data in json.loads(run_ok(folder, "show -I msgs demo_msgs --json"))] == [
        "demo_msgs/msg/Arm",
        "demo_msgs/msg/Robot",
    ]
    assert run_ok(folder, "show -I msgs demo_msgs").count("digest") == 2
    assert run_usage_error(folder, "show -I msgs demo_msgs --svg").endswith("demo_msgs/msg/Arm, demo_msgs/msg/Robot\n")


def test_show_svg_is_xml(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": "string a  # ]]> <&> \"'\nfloat64[100] long\n"})
    root = ElementTree.fromstring(run_ok(folder, "show -I msgs demo_msgs/Robot --svg"))
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert any("arm.long" in "".join(element.itertext()) for element in root.iter())


def test_show_works_on_an_ascii_terminal(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Arm.msg": "int8 a  # °µ→\n"})
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    for option in ([], ["--svg"], ["--json"]):
        command = [sys.executable, "-m", "shmgen", "show", "-I", "msgs", "demo_msgs/Arm", *option]
        result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=False)
        assert (result.returncode, result.stderr) == (0, b""), option


def test_types(tmp_path: Path) -> None:
    rows = {line.split()[0]: line.split()[1:] for line in run_ok(tmp_path, "types").splitlines()}
    assert rows["bool"] == ["USINT", "uint8_t", "1"]
    assert rows["uint16"] == ["UINT", "uint16_t", "2"]
    assert rows["uint32"] == ["UDINT", "uint32_t", "4"]
    assert rows["time"] == ["TIME", "uint32_t", "4"]
    write(tmp_path, {"shmgen.toml": '[types]\nbool = "BOOL"\ntime = "LTIME"'})
    rows = {line.split()[0]: line.split()[1:] for line in run_ok(tmp_path, "types").splitlines()}
    assert rows["bool"] == ["BOOL", "uint8_t", "1"]
    assert rows["duration"] == ["LTIME", "uint64_t", "8"]


def test_list(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": "".join(f"Arm[] arms{number}\n" for number in range(5))})
    write(folder, {"msgs/demo_msgs/msg/Fleet.msg": "Robot one\n"})
    some = "demo_msgs/Robot.arms0, demo_msgs/Robot.arms1, demo_msgs/Robot.arms2 and 2 more"
    assert run_ok(folder, "list -I msgs demo_msgs").splitlines() == [
        "demo_msgs/Arm           81 bytes",
        f"demo_msgs/Fleet  needs a bound for {some}",
        f"demo_msgs/Robot  needs a bound for {some}",
        "",
        "1 of 3 can be generated.",
        'Add lines under [bounds] in shmgen.toml, such as "demo_msgs/Robot.arms0" = 8',
    ]
    write(folder, {"shmgen.toml": "[bounds]\ndemo_msgs = 2\n"})
    assert run_ok(folder, "list -I msgs demo_msgs").endswith("3 of 3 can be generated.\n")


def test_list_reports_the_faults_that_generate_reports(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Twice.msg": "float64 a\nfloat64 A\n", "shmgen.toml": 'source = "noetic"\n'})
    write(folder, {"msgs/demo_msgs/msg/Holds.msg": "Twice[2] twice\n"})
    write(folder, {"msgs/demo_msgs/msg/Large.msg": "float64[3000000] a\nTwice b\n"})
    twice = "SHM203 demo_msgs/Twice.A: `a` and `A` become the same name in Structured Text, which ignores case"
    large = "demo_msgs/Large needs a region of 96,002,048 bytes, more than 33,554,432"
    assert run_ok(folder, "list -I msgs demo_msgs").splitlines() == [
        "demo_msgs/Arm           81 bytes",
        f"demo_msgs/Holds  {twice}",
        f"demo_msgs/Large  SHM303 demo_msgs/Large.a (24,000,000 bytes): {large}; {twice}",
        "demo_msgs/Robot         96 bytes",
        f"demo_msgs/Twice  {twice}",
        "",
        "2 of 5 can be generated.",
        "Run `shmgen explain SHM203` or `shmgen explain SHM303` for details",
    ]
    holds = json.loads(run_ok(folder, "list -I msgs demo_msgs --json"))[1]
    assert (holds["size"], [fault["code"] for fault in holds["faults"]]) == (32, ["SHM203"])
    for name in ("Holds", "Large", "Twice"):
        assert shmgen(folder, f"generate -I msgs demo_msgs/{name}").code == 1
    write(folder, {"shmgen.toml": 'source = "noetic"\ntargets = ["python", "c"]\nmax_region = 100000000\n'})
    assert "5 of 5" in run_ok(folder, "list -I msgs demo_msgs")
    write(folder, {"msgs/demo_msgs/msg/Arm_publisher.msg": "uint8 x\n"})
    assert "5 of 6" in run_ok(folder, "list -I msgs demo_msgs")
    assert shmgen(folder, "generate -I msgs demo_msgs/Arm demo_msgs/Arm_publisher").code == 1


def test_list_json_has_a_stable_shape(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": "Arm[] arms\n"})
    assert json.loads(run_ok(folder, "list -I msgs demo_msgs --json")) == [
        {"type": "demo_msgs/msg/Arm", "size": 81, "unbounded": [], "faults": [], "defaulted": []},
        {
            "type": "demo_msgs/msg/Robot",
            "size": None,
            "unbounded": ["demo_msgs/Robot.arms"],
            "faults": [],
            "defaulted": [],
        },
    ]


def test_list_continues_after_faults(folder: Path) -> None:
    """List an invalid file, its container, a field of an unknown type, and all valid messages."""
    write(
        folder,
        {
            "msgs/demo_msgs/msg/Broken.msg": "int8 a\nno\nnor this\n",
            "msgs/demo_msgs/msg/Holds.msg": "Broken[2] them\n",
            "msgs/demo_msgs/msg/Lost.msg": "int8 a\nlost_msgs/Foo foo\n",
            "msgs/demo_msgs/srv/Ask.srv": "Lost lost\n",
        },
    )
    lines = run_ok(folder, "list -I msgs demo_msgs").splitlines()
    broken = "SHM003 msgs/demo_msgs/msg/Broken.msg:2: expected a type and a name, found only `no` and 1 more"
    assert lines[:8] == [
        "demo_msgs/Arm                  81 bytes",
        f"demo_msgs/Broken        {broken}",
        f"demo_msgs/Holds         {broken}",
        "demo_msgs/Lost          SHM004 msgs/demo_msgs/msg/Lost.msg:2: unknown message type `lost_msgs/Foo`",
        "demo_msgs/Robot                96 bytes",
        *lines[5:8],
    ]
    assert [line.split()[:2] for line in lines[5:8]] == [
        [f"demo_msgs/Ask_{part}", "SHM003"] for part in ("Reply", "Request", "Response")
    ]
    assert "2 of 8 can be generated." in lines
    assert "109 of" in run_ok(folder, "list -I msgs")


def test_list_marks_default_bounds(folder: Path) -> None:
    write(folder, {"msgs/demo_msgs/msg/Robot.msg": "Arm[] arms\nint8[<=2] a\nint8[] b\n"})
    write(folder, {"shmgen.toml": 'path = ["msgs"]\n[bounds]\ndefault = 32\n"demo_msgs/Robot.b" = 8\n'})
    output = run_ok(folder, "list demo_msgs")
    assert "bytes  * demo_msgs/Robot.arms\n" in output
    assert "2 of 2 can be generated.\n* bound 32 from the key default under [bounds]\n" in output
    assert json.loads(run_ok(folder, "list demo_msgs/Robot --json"))[0]["defaulted"] == ["demo_msgs/Robot.arms"]
    assert "Arm[<=32]" in run_ok(folder, "show demo_msgs/Robot")
    write(folder, {"shmgen.toml": "[bounds]\ndefault = 0\n"})
    assert "shmgen.toml:2:1: error[SHM502]" in run_error(folder, "list demo_msgs")


def test_list_without_names(tmp_path: Path) -> None:
    assert "107 of 171 can be generated." in run_ok(tmp_path, "list")
    assert "SHM004" in run_error(tmp_path, "list nothing_msgs")


@pytest.mark.parametrize("code", CODES)
def test_explain_prints_each_code(tmp_path: Path, code: str) -> None:
    output = run_ok(tmp_path, f"explain {code.lower()}")
    assert output.startswith(f"{code} {CODES[code]}\n")
    assert f"error[{code}]" in output
    assert "## " not in output


# --- exit codes --------------------------------------------------------------------------------------


def run_usage_error(folder: Path, command: str) -> str:
    before = tree(folder)
    result = shmgen(folder, command)
    assert (result.code, result.stdout) == (2, "")
    assert tree(folder) == before
    return result.stderr


@pytest.mark.parametrize(
    "command",
    [
        "nonsense",
        "generate --nonsense",
        "generate std_msgs/Bool -t cobol",
        "generate std_msgs/Bool -o",
        "show",
        "show a/B c/D",
        "show std_msgs/Bool --json --svg",
        "explain SHM999",
        "list a b",
    ],
)
def test_wrong_usage(tmp_path: Path, command: str) -> None:
    output = run_usage_error(tmp_path, command)
    assert "Error: " in output
    assert "Traceback" not in output


def test_output_folder_cannot_be_a_file(tmp_path: Path) -> None:
    write(tmp_path, {"out": ""})
    assert "is a file" in run_usage_error(tmp_path, "generate std_msgs/Bool -o out")


def test_help_and_version(tmp_path: Path) -> None:
    version_line = f"shmgen, version {__version__}; publish and read in {'C' if engine.IN_C else 'Python'}\n"
    assert run_ok(tmp_path, "--version") == version_line
    for command in ("generate", "show", "types", "list", "explain"):
        assert command in run_ok(tmp_path, "-h")
        assert f"shmgen {command} [OPTIONS]" in run_ok(tmp_path, f"{command} --help").splitlines()[0]
    description = run_ok(tmp_path, "bridge --help").partition("Options:")[0]
    assert all(f" {backend.key} " in " ".join(description.split()) for backend in BACKENDS)


def test_only_terminals_get_colour(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "shmgen", "generate", "std_msgs/Nothing"]
    piped = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert b"\x1b" not in piped.stderr
    controller, terminal = os.openpty()
    subprocess.run(command, cwd=tmp_path, stderr=terminal, check=False)
    os.close(terminal)
    terminal_output = os.read(controller, 10_000)
    os.close(controller)
    assert b"\x1b[31m" in terminal_output
    assert re.sub(rb"\x1b\[\d*m|\r", b"", terminal_output) == piped.stderr


def test_shmgen_debug_prints_the_traceback(tmp_path: Path) -> None:
    code = "from shmgen.generator import layout; from shmgen.cli.main import main; layout.check_size = None; main()"
    command = [sys.executable, "-c", code, "generate", "std_msgs/Bool"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (result.returncode, "Traceback" in result.stderr) == (1, False)
    environment = {**os.environ, "SHMGEN_DEBUG": "1"}
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=environment)
    assert (result.returncode, "Traceback" in result.stderr) == (1, True)
