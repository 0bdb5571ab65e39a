"""What stands in the files for open PLCs: a library's chunks, what each needs, and what goes into an upload."""

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

Made = tuple[Path, dict[str, str], Layouts]


def test_a_library_says_what_it_holds_and_needs(generated: Made) -> None:
    """Keys of STruC++ 0.6.1; a program gets a chunk and those it names, and they must be enough for it."""
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
    named = [name for one in manifest["types"] for name in (one["name"], *(field["name"] for field in one["fields"]))]
    assert all(name == name.upper() for name in named)
    for name, chunk in chunks.items():
        needed = {dep["name"] for dep in chunk["deps"]}
        used = set(re.findall(r"\b(?:ST|FB)_[A-Z0-9_]+\b", chunk["header"])) & set(chunks)
        used |= {"ST_" + found.upper() for found in re.findall(r"\bshmgen_type_of_shm_(\w+)\(\)", chunk["cpp"])}
        assert used - {name} == needed - {"SHMGEN_PROTOCOL"}, name
        assert "#include" not in chunk["header"] + chunk["cpp"], name


@pytest.mark.slow
def test_a_chunk_alone_compiles_with_what_it_names(generated: Made, tmp_path: Path) -> None:
    """As a program gets it that uses one block only."""
    library = json.loads(generated[1]["openplc/shm_msgs.stlib"])
    block = "FB_DEMO_MSGS_PART_SUBSCRIBER"
    chunks = {chunk["name"]: chunk for chunk in library["chunks"]}
    wanted, left = {block}, [block]
    while left:
        left = [dep["name"] for name in left for dep in chunks[name]["deps"]]
        wanted |= set(left)
    library["chunks"] = [chunk for chunk in library["chunks"] if chunk["name"] in wanted]
    blocks = library["manifest"]["functionBlocks"]
    library["manifest"]["functionBlocks"] = [one for one in blocks if one["name"] in wanted]
    assert len(wanted) == 3
    open_plc.compiled({"openplc/shm_msgs.stlib": json.dumps(library)}, "openplc-v4", tmp_path)


def test_the_lines_of_an_upload_are_the_header(generated: Made) -> None:
    """As OpenPLC v3 reads them back, but for blanks between a bracket and a star, and for empty lines."""
    header = generated[1]["matiec/shm_msgs.h"].partition("*/\n")[2]
    found = open_plc.read(generated[1]["matiec/shm_msgs.st"]).header
    assert found.replace("( *", "(*").replace("* )", "*)").split() == header.replace("( *", "(*").split()


@pytest.mark.slow
def test_the_program_gives_each_topic_its_structure(tmp_path: Path) -> None:
    """And all of it is the library's, since STruC++ prints a program's own types before those."""
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


def test_a_topic_and_a_service_are_as_expected(tmp_path: Path, update_golden: bool) -> None:
    """Without the protocol, which is the same in all and has tests of its own; so have actions (test_calls.py)."""
    build.put({"shmgen.toml": CELL.partition("[[actions]]")[0], **DEFINITIONS}, tmp_path)
    texts = pipeline.generate(config.load(tmp_path / "shmgen.toml", "shmgen.toml", Report()), [])
    open_plc.read(texts["matiec/upload.st"])
    upload, word, program = texts["matiec/upload.st"].partition("PROGRAM")
    assert texts["openplc/PRG_Ros.st"].endswith(word + program)
    found = {
        "PRG_Ros.st": texts["openplc/PRG_Ros.st"],
        "upload.st": re.sub(r"(?m)^\(\*FILE:.*\n", "", upload),
        "library.txt": as_text(json.loads(texts["openplc/shm_msgs.stlib"])),
    }
    if update_golden:
        build.put(found, GOLDEN)
    for name, text in found.items():
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


def test_own_sources_stand_in_the_upload_and_are_called(tmp_path: Path) -> None:
    """Behind PRG_Ros, in the order of their files, by the same task; a CODESYS project's files do not change."""
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
    ("text", "said"),
    [
        ("PROGRAM Prg_Ros\nEND_PROGRAM\n", "cell.st:1:9: error[SHM203]: two programs are called Prg_Ros"),
        ("\n  PROGRAM A\nEND_PROGRAM\nPROGRAM a\n", "cell.st:4:9: error[SHM203]: two programs are called a"),
        (
            "CONFIGURATION Mine\nEND_CONFIGURATION\n",
            "cell.st:1:15: error[SHM203]: Mine is a CONFIGURATION, and shmgen generates one",
        ),
        ("(* caf\xe9 *)\n", "cell.st:1:7: error[SHM002]: byte 0xE9 is not UTF-8"),
        (None, "cell.st: error[SHM001]: cannot read: No such file or directory"),
    ],
)
def test_own_sources_that_cannot_be_taken_are_said(text: str | None, said: str, tmp_path: Path) -> None:
    build.put({"shmgen.toml": CELL + '[plc]\nsources = ["cell.st"]\n', **DEFINITIONS}, tmp_path)
    if text is not None:
        (tmp_path / "cell.st").write_text(text, encoding="latin-1")
    command = [sys.executable, "-m", "shmgen", "generate", "--no-cache"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr.splitlines()[0]) == (1, said)


@pytest.mark.slow
def test_a_check_sees_that_an_own_source_changed(tmp_path: Path) -> None:
    """Also where the check before found nothing, which is remembered."""
    build.put({"shmgen.toml": CELL + '[plc]\nsources = ["cell.st"]\n', "cell.st": OWN, **DEFINITIONS}, tmp_path)

    def shmgen(*words: str) -> int:
        environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")}
        command = [sys.executable, "-m", "shmgen", *words]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False).returncode

    assert shmgen("generate") == 0
    time.sleep(0.1)  # what was touched just now is not remembered
    assert [shmgen("check"), shmgen("check")] == [0, 0]
    (tmp_path / "cell.st").write_text(OWN.replace("1.0", "2.0"))
    assert shmgen("check") != 0


def as_text(library: dict[str, Any]) -> str:
    """Return the library without the protocol, and with one message, as all look like that of target c."""
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
