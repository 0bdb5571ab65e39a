"""The files for open PLCs contain complete library chunks, the expected programs, and the user's own sources."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from shmgen import config
from shmgen.core.diagnostics import Report
from shmgen.core.model import Layouts
from shmgen.generator import pipeline

from ..support import build, open_plc
from .conftest import MESSAGES

Generated = tuple[Path, dict[str, str], Layouts]


def test_stlib_lists_its_chunks_and_their_dependencies(generated: Generated) -> None:
    """Use the keys of STruC++ 0.6.1. Each chunk must list all chunks that it needs: a program gets no others."""
    library = json.loads(generated[1]["openplc/shm_msgs.stlib"])
    assert set(library) == {"formatVersion", "manifest", "chunks", "dependencies"}
    assert (library["formatVersion"], library["dependencies"]) == (1, [])
    manifest = library["manifest"]
    assert {"name", "version", "namespace", "functions", "functionBlocks", "types", "globals", "headers"} < set(
        manifest
    )
    assert manifest["isBuiltin"] is False
    chunks = {chunk["name"]: chunk for chunk in library["chunks"]}
    assert len(chunks) == len(library["chunks"])
    assert all(set(chunk) == {"name", "kind", "header", "cpp", "deps"} for chunk in chunks.values())
    assert all(dep["library"] == "shm_msgs" and dep["name"] in chunks for it in chunks.values() for dep in it["deps"])
    assert {one["name"] for one in manifest["types"]} == set(chunks) - {"SHMGEN_PROTOCOL"} - {
        one["name"] for one in manifest["functionBlocks"]
    }
    names = [name for one in manifest["types"] for name in (one["name"], *(field["name"] for field in one["fields"]))]
    assert all(name == name.upper() for name in names)
    for name, chunk in chunks.items():
        needed = {dep["name"] for dep in chunk["deps"]}
        used = set(re.findall(r"\b(?:ST|FB)_[A-Z0-9_]+\b", chunk["header"])) & set(chunks)
        used |= {"ST_" + message.upper() for message in re.findall(r"\bshmgen_type_of_shm_(\w+)\(\)", chunk["cpp"])}
        assert used - {name} == needed - {"SHMGEN_PROTOCOL"}, name
        assert "#include" not in chunk["header"] + chunk["cpp"], name


@pytest.mark.slow
def test_chunk_compiles_with_only_its_dependencies(generated: Generated, tmp_path: Path) -> None:
    """Compile only the chunks that STruC++ selects for a program with one block."""
    library = json.loads(generated[1]["openplc/shm_msgs.stlib"])
    block = "FB_DEMO_MSGS_PART_SUBSCRIBER"
    chunks = {chunk["name"]: chunk for chunk in library["chunks"]}
    needed, remaining = {block}, [block]
    while remaining:
        remaining = [dep["name"] for name in remaining for dep in chunks[name]["deps"]]
        needed |= set(remaining)
    library["chunks"] = [chunk for chunk in library["chunks"] if chunk["name"] in needed]
    blocks = library["manifest"]["functionBlocks"]
    library["manifest"]["functionBlocks"] = [one for one in blocks if one["name"] in needed]
    assert len(needed) == 3
    open_plc.compiled({"openplc/shm_msgs.stlib": json.dumps(library)}, "openplc-v4", tmp_path)


def test_upload_contains_the_generated_header(generated: Generated) -> None:
    """Read the header from the upload as OpenPLC v3 does. Only blanks in comment marks and empty lines may differ."""
    header = generated[1]["matiec/shm_msgs.h"].partition("*/\n")[2]
    embedded = open_plc.read(generated[1]["matiec/shm_msgs.st"]).header
    assert embedded.replace("( *", "(*").replace("* )", "*)").split() == header.replace("( *", "(*").split()


@pytest.mark.slow
def test_program_has_a_member_of_st_ros_per_topic(tmp_path: Path) -> None:
    """Define ST_Ros in the library, because STruC++ prints a program's own types before the library's types."""
    topics = """[[topics]]
topic = "/cell/number"
type = "demo_msgs/Number"
depth = 3
[[topics]]
topic = "/type"
type = "demo_msgs/All"
direction = "from_plc"
"""
    file = tmp_path / "shmgen.toml"
    file.write_text(f'path = ["."]\nsource = "jazzy"\ntargets = ["matiec", "openplc"]\ntask_interval = 5\n{topics}')
    for name, text in MESSAGES.items():
        path = tmp_path / "demo_msgs" / "msg" / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    texts = pipeline.generate(config.load(file, "shmgen.toml", Report()), [])
    library = json.loads(texts["openplc/shm_msgs.stlib"])
    assert "ST_ROS" in {one["name"] for one in library["manifest"]["types"]}
    open_plc.compiled(texts, "openplc-v4", tmp_path)
    program = texts["openplc/PRG_Ros.st"]
    assert program.partition("PROGRAM")[2] == texts["matiec/upload.st"].partition("PROGRAM")[2]
    assert "TASK RosTask(INTERVAL := T#5ms, PRIORITY := 0);" in program
    for line in (
        "    cell_number : FB_demo_msgs_Number_Subscriber;",
        "    type_0 : FB_demo_msgs_All_Publisher;",
        "    udiDepth := 3,",
        "    Msg := GVL_Ros.type_0.Msg);",
        "    GVL_Ros.cell_number.Msg := cell_number.Msg;",
    ):
        assert line in program.splitlines(), line
    upload = open_plc.read(texts["matiec/upload.st"])
    assert [one.name for one in upload.types["ST_Ros"]] == ["cell_number", "type_0"]


GOLDEN = Path(__file__).parent / "expected"
CELL = """path = ["."]
source = "jazzy"
targets = ["matiec", "openplc"]
[[topics]]
topic = "/cell/speed"
type = "cell_msgs/Speed"
[[services]]
service = "/cell/start"
type = "cell_msgs/Start"
server = "plc"
[[services]]
service = "/cell/ask"
type = "cell_msgs/Start"
server = "ros"
[[actions]]
action = "/arm/move"
type = "cell_msgs/Move"
server = "plc"
"""
DEFINITIONS = {
    "cell_msgs/msg/Speed.msg": "float64 now  # [m/s]\n",
    "cell_msgs/srv/Start.srv": "bool on\n---\nbool success\nstring<=20 message\n",
    "cell_msgs/action/Move.action": "float64[<=2] way\n---\nfloat64 gone\n---\nfloat64 gone\n",
}


def test_files_of_a_topic_and_services_are_as_expected(tmp_path: Path, update_golden: bool) -> None:
    """Leave out the protocol and the actions, which have their own tests (test_calls.py)."""
    build.put({"shmgen.toml": CELL.partition("[[actions]]")[0], **DEFINITIONS}, tmp_path)
    texts = pipeline.generate(config.load(tmp_path / "shmgen.toml", "shmgen.toml", Report()), [])
    open_plc.read(texts["matiec/upload.st"])
    upload, word, program = texts["matiec/upload.st"].partition("PROGRAM")
    assert texts["openplc/PRG_Ros.st"].endswith(word + program)
    actual = {
        "PRG_Ros.st": texts["openplc/PRG_Ros.st"],
        "upload.st": re.sub(r"(?m)^\(\*FILE:.*\n", "", upload),
        "library.txt": as_text(json.loads(texts["openplc/shm_msgs.stlib"])),
    }
    if update_golden:
        build.put(actual, GOLDEN)
    for name, text in actual.items():
        assert text == (GOLDEN / name).read_text(), name


OWN = """(* PROGRAM PRG_Old is gone, and 'PROGRAM PRG_Text' is none. *)
FUNCTION_BLOCK FB_Filter
VAR_INPUT lrIn : LREAL; END_VAR
VAR_OUTPUT lrOut : LREAL; END_VAR
lrOut := lrIn;
END_FUNCTION_BLOCK

PROGRAM PRG_Cell
VAR_EXTERNAL
    GVL_Ros : ST_Ros;
END_VAR
GVL_Ros.cell_speed.Msg.now := 1.0; // PROGRAM PRG_Comment
END_PROGRAM

program prg_second
END_PROGRAM
"""


def test_programs_of_own_sources_are_added_and_called(tmp_path: Path) -> None:
    """Append the sources after PRG_Ros and call their programs in the same task. Keep shm_msgs.st unchanged."""
    more = '[plc]\nsources = ["plc/cell.st"]\n'
    build.put({"shmgen.toml": CELL + more, "plc/cell.st": OWN, **DEFINITIONS}, tmp_path)
    texts = pipeline.generate(config.load(tmp_path / "shmgen.toml", "shmgen.toml", Report()), [])
    for path in ("openplc/PRG_Ros.st", "matiec/upload.st"):
        before, _, configuration = texts[path].partition("\nCONFIGURATION ")
        assert before.endswith("END_PROGRAM\n\n" + OWN), path
        assert re.findall("    PROGRAM (.*);", configuration) == [
            "Ros WITH RosTask : PRG_Ros",
            "Run_PRG_Cell WITH RosTask : PRG_Cell",
            "Run_prg_second WITH RosTask : prg_second",
        ], path
    assert "FB_Filter" not in texts["matiec/shm_msgs.st"]
    open_plc.read(texts["matiec/shm_msgs.st"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("PROGRAM Prg_Ros\nEND_PROGRAM\n", "cell.st:1:9: error[SHM203]: two programs are called Prg_Ros"),
        ("\n  PROGRAM A\nEND_PROGRAM\nPROGRAM a\n", "cell.st:4:9: error[SHM203]: two programs are called a"),
        (
            "CONFIGURATION Mine\nEND_CONFIGURATION\n",
            "cell.st:1:15: error[SHM203]: Mine is a CONFIGURATION, but shmgen generates one",
        ),
        ("(* caf\xe9 *)\n", "cell.st:1:7: error[SHM002]: byte 0xE9 is not UTF-8"),
        (None, "cell.st: error[SHM001]: cannot read: No such file or directory"),
    ],
)
def test_errors_in_own_sources_are_reported(text: str | None, message: str, tmp_path: Path) -> None:
    build.put({"shmgen.toml": CELL + '[plc]\nsources = ["cell.st"]\n', **DEFINITIONS}, tmp_path)
    if text is not None:
        (tmp_path / "cell.st").write_text(text, encoding="latin-1")
    command = [sys.executable, "-m", "shmgen", "generate", "--no-cache"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr.splitlines()[0]) == (1, message)


@pytest.mark.slow
def test_check_detects_a_changed_own_source(tmp_path: Path) -> None:
    """Report the change even after a check without differences, whose result is cached."""
    build.put({"shmgen.toml": CELL + '[plc]\nsources = ["cell.st"]\n', "cell.st": OWN, **DEFINITIONS}, tmp_path)

    def shmgen(*words: str) -> int:
        environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")}
        command = [sys.executable, "-m", "shmgen", *words]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False).returncode

    assert shmgen("generate") == 0
    time.sleep(0.1)  # a result is not cached if a file changed just now
    assert [shmgen("check"), shmgen("check")] == [0, 0]
    (tmp_path / "cell.st").write_text(OWN.replace("1.0", "2.0"))
    assert shmgen("check") != 0


def as_text(library: dict[str, Any]) -> str:
    """Return the library as text, without the protocol and service types. Structures look like those of target c."""
    blocks = [
        f"{one['name']} {role} {', '.join(it['name'] + ' : ' + it['type'] for it in one[role])}\n"
        for one in library["manifest"]["functionBlocks"]
        for role in ("inputs", "outputs")
    ]
    chunks = [
        f"--- {chunk['kind']} {chunk['name']} needs {', '.join(dep['name'] for dep in chunk['deps'])}\n"
        f"{chunk['header']}{chunk['cpp']}"
        for chunk in library["chunks"]
        if not chunk["name"].startswith(("SHMGEN_PROTOCOL", "ST_CELL_MSGS_START"))
    ]
    return "".join([*blocks, *chunks])
