"""An imported structure has the bytes that the PLC's compiler gives it, also behind a base and with a pack_mode."""

from __future__ import annotations

import json
import struct
import subprocess
from pathlib import Path

import pytest

from shmgen.core.model import TypeName

from ..support import cpp_peer
from ..support.build import classes
from ..support.command import Result, run

TOML = 'path = ["msgs"]\nmessages = ["some_msgs"]\n[types]\nbool = "BOOL"\n'


def imported(folder: Path, text: str, *arguments: str) -> Result:
    (folder / "plant.st").write_text(text)
    (folder / "shmgen.toml").write_text(TOML)
    return run(["import", "plant.st", "-p", "some_msgs", *arguments], folder)


def offsets(folder: Path, name: str) -> dict[str, int]:
    """Offset of each field of an imported message, and its size."""
    (shown,) = json.loads(run(["show", f"some_msgs/{name}", "--json"], folder).stdout)
    places = {it["path"]: it["offset"] for it in shown["slots"] if it["role"] == "data" and it["depth"] == 0}
    return places | {"size": shown["size"]}


def struct_(name: str, *members: str, pack: str = "", base: str = "") -> str:
    attribute = f"{{attribute 'pack_mode' := '{pack}'}}\n" if pack else ""
    extends = f" EXTENDS {base}" if base else ""
    inner = "".join(f"  {member};\n" for member in members)
    return f"{attribute}TYPE {name}{extends} :\nSTRUCT\n{inner}END_STRUCT\nEND_TYPE\n"


PADDED = struct_("ST_Base", "a : LREAL", "b : BOOL")
INSIDE = struct_("ST_D", "c : ARRAY[0..7] OF BOOL", "d : LREAL", base="ST_Base")


def test_the_first_member_stands_behind_the_padding_of_a_base(tmp_path: Path) -> None:
    """Both ways the size is 32, so SIZEOF cannot tell them apart."""
    said = imported(tmp_path, PADDED + INSIDE)
    assert said.stdout.splitlines()[:2] == ["ST_Base  some_msgs/Base, 16 bytes", "ST_D     some_msgs/D, 32 bytes"]
    assert offsets(tmp_path, "D") == {"a": 0, "b": 8, "c": 16, "d": 24, "size": 32}
    assert "bool[8] c  # (PLC: c, align 8)\n" in (tmp_path / "msgs/some_msgs/msg/D.msg").read_text()


def test_a_base_that_ends_in_padding_is_64_bytes(tmp_path: Path) -> None:
    """60 without the padding of the base."""
    base = struct_("ST_Base", "r : REAL", "x : BOOL")
    said = imported(tmp_path, base + struct_("ST_D", "x1 : BOOL", "s : STRING(50)", "r1 : REAL", base="ST_Base"))
    assert "ST_D     some_msgs/D, 64 bytes\n" in said.stdout
    assert offsets(tmp_path, "D") == {"r": 0, "x": 4, "x1": 8, "s": 9, "r1": 60, "size": 64}


def test_a_base_of_a_base_ends_in_padding(tmp_path: Path) -> None:
    text = PADDED + struct_("ST_Middle", base="ST_Base") + struct_("ST_D", "c : BOOL", base="ST_Middle")
    said = imported(tmp_path, text + struct_("ST_E", "e : BOOL", base="ST_D") + struct_("ST_F", "x : BOOL", "e : ST_E"))
    assert "not verified" not in said.stdout
    assert offsets(tmp_path, "Middle")["size"] == 16
    assert offsets(tmp_path, "E") == {"a": 0, "b": 8, "c": 16, "e": 24, "size": 32}
    assert offsets(tmp_path, "F")["size"] == 40


PACKED = {"0": (1, 9), "1": (1, 9), "2": (2, 10), "4": (4, 12), "8": (8, 16)}


@pytest.mark.parametrize("pack", PACKED)
def test_a_pack_mode_is_kept(pack: str, tmp_path: Path) -> None:
    place, size = PACKED[pack]
    text = struct_("ST_Packed", "b : BOOL", "v : LREAL", pack=pack) + struct_("ST_Outer", "x : BOOL", "p : ST_Packed")
    said = imported(tmp_path, text)
    assert (said.code, said.stderr) == (0, "")
    assert offsets(tmp_path, "Packed") == {"b": 0, "v": place, "size": size}
    alignment = int(pack) or 1
    assert offsets(tmp_path, "Outer")["p"] == alignment
    note = "" if pack == "8" else f", pack_mode {alignment}"
    assert (tmp_path / "msgs/some_msgs/msg/Packed.msg").read_text().startswith(f"# (PLC: ST_Packed{note})\n")


def test_a_packed_structure_of_the_same_bytes_moves_in_another(tmp_path: Path) -> None:
    text = struct_("ST_Number", "v : LREAL", pack="1") + struct_("ST_Outer", "x : BOOL", "p : ST_Number")
    imported(tmp_path, text)
    assert offsets(tmp_path, "Outer") == {"x": 0, "p": 1, "size": 9}


def test_a_pack_mode_that_might_reach_into_a_member_is_refused(tmp_path: Path) -> None:
    said = imported(tmp_path, PADDED + struct_("ST_P", "x : BOOL", "b : ST_Base", pack="1"))
    assert said.code == 1
    assert "error[SHM601]: ST_P has pack_mode 1, but its member ST_Base has none\n" in said.stderr
    assert "hint: give ST_Base the attribute too" in said.stderr


def test_a_base_of_another_pack_mode_is_refused(tmp_path: Path) -> None:
    base = struct_("ST_Base", "x : BOOL", "v : LREAL", pack="1")
    said = imported(tmp_path, base + struct_("ST_D", "i : DINT", base="ST_Base"))
    assert (said.code, "ST_D has another pack_mode than its base" in said.stderr) == (1, True)
    (tmp_path / "other").mkdir()
    assert imported(tmp_path / "other", base + struct_("ST_D", "i : DINT", base="ST_Base", pack="1")).code == 0
    assert offsets(tmp_path / "other", "D") == {"x": 0, "v": 1, "i": 9, "size": 13}


VALUES = """\
#include "shm_msgs/some_msgs/msg/outer.hpp"
#include <cstdio>
int main()
{
    shm_msgs::some_msgs::msg::Outer outer;
    outer.v = 2.5;
    outer.n[1] = -3;
    outer.s = u"day";
    auto state = outer.e.get();
    state.value = 7;
    outer.e = state;
    std::fwrite(&outer, 1, sizeof outer, stdout);
    std::cerr << outer << '\\n';
    return outer.v * 2 == 5.0 && outer.n[1] == -3 ? 0 : 1;
}
"""


@pytest.mark.slow
def test_packed_bytes_are_the_same_in_python_c_and_cpp(tmp_path: Path) -> None:
    text = "TYPE E_State : (eIdle, eFault := 7) UINT; END_TYPE\n" + struct_(
        "ST_Outer", "x : BOOL", "v : LREAL", "n : ARRAY[0..1] OF INT", "s : WSTRING(5)", "e : E_State", pack="1"
    )
    imported(tmp_path, text)
    done = run(["generate", "-q", "-t", "python", "-t", "c", "-t", "cpp", "-t", "st", "-o", "."], tmp_path)
    assert (done.code, done.stderr) == (0, "")
    kind, _, _ = classes(tmp_path, "shm_msgs", TypeName("some_msgs", "msg", "Outer"))
    message = kind(v=2.5, n=[0, -3], s="day")
    message.e.value = 7
    expected = struct.pack("<?d2h12sH", False, 2.5, 0, -3, "day".encode("utf-16-le"), 7)
    assert bytes(message) == expected
    (tmp_path / "values.cpp").write_text("#include <iostream>\n" + VALUES)
    (tmp_path / "asserts.c").write_text('#include "shm_msgs/some_msgs/msg/outer.h"\n')
    program = cpp_peer.compiled(tmp_path, "values", tmp_path / "values.cpp", tmp_path / "asserts.c")
    made = subprocess.run([program], capture_output=True, check=True)
    assert made.stdout == expected
    assert made.stderr == b'{x: false, v: 2.5, n: [0, -3], s: "day", e: {value: 7}}\n'


def tmc(*types: str) -> str:
    """A file as TwinCAT writes it, as far as it is read."""
    return f"<TcModuleClass><DataTypes>{''.join(types)}</DataTypes><Modules /></TcModuleClass>"


def compiled(name: str, bits: int, *members: tuple[str, int, int], namespace: str = "", extends: str = "") -> str:
    """A type of so many bits; each member has a name, an offset and a size in bits."""
    attribute = f' Namespace="{namespace}"' if namespace else ""
    base = f"<ExtendsType>{extends}</ExtendsType>" if extends else ""
    items = "".join(
        f"<SubItem><Name>{member}</Name><Type>X</Type><BitSize>{size}</BitSize><BitOffs>{at}</BitOffs></SubItem>"
        for member, at, size in members
    )
    return f"<DataType><Name{attribute}>{name}</Name><BitSize>{bits}</BitSize>{base}{items}</DataType>"


BASE = compiled("ST_Base", 128, ("a", 0, 64), ("b", 64, 8))
D = compiled("ST_D", 256, ("c", 128, 64), ("d", 192, 64), extends="ST_Base")


def twincat(folder: Path, text: str, layouts: str, *arguments: str) -> Result:
    """`shmgen import` of a folder within a TwinCAT project."""
    (folder / "DUTs").mkdir(parents=True)
    (folder / "Plant.plcproj").write_text("<Project />")
    (folder / "Plant.tmc").write_text(layouts)
    (folder / "DUTs" / "types.st").write_text(text)
    (folder / "shmgen.toml").write_text(TOML)
    return run(["import", "DUTs", "-p", "some_msgs", *arguments], folder)


def test_a_tmc_file_of_the_project_verifies_each_type(tmp_path: Path) -> None:
    packed = struct_("ST_P", "b : BOOL", "v : LREAL", pack="1")
    text = PADDED + INSIDE + packed + "TYPE E_X : (eA, eB) UDINT; END_TYPE\n" + struct_("ST_Z", "z : INT")
    library = compiled("ST_Z", 8, ("z", 0, 8), namespace="Tc2_Other")
    layouts = tmc(BASE, D, compiled("ST_P", 72, ("b", 0, 8), ("V", 8, 64)), compiled("E_X", 32), library)
    said = twincat(tmp_path, text, layouts)
    assert (said.code, said.stderr) == (0, "")
    assert said.stdout.splitlines()[:5] == [
        "ST_Base  some_msgs/Base, 16 bytes, verified by Plant.tmc",
        "ST_D     some_msgs/D, 32 bytes, verified by Plant.tmc",
        "ST_P     some_msgs/P, 9 bytes, verified by Plant.tmc",
        "E_X      some_msgs/X, 4 bytes, verified by Plant.tmc",
        "ST_Z     some_msgs/Z, 2 bytes",
    ]


def test_a_tmc_file_that_differs_is_told_by_member(tmp_path: Path) -> None:
    """The size is the same: the first own member lies in the padding of the base, where no compiler puts it."""
    layouts = tmc(BASE, compiled("ST_D", 256, ("c", 72, 64), ("d", 192, 64)))
    said = twincat(tmp_path, PADDED + INSIDE + struct_("ST_E", "inner : ST_D"), layouts, "--skip")
    assert "note[SHM603]: ST_D differs from Plant.tmc\n" in said.stderr
    assert "\n  c: 8 bytes at byte 16 here, 8 bytes at byte 9 in Plant.tmc\n  hint: build the project" in said.stderr
    assert "ST_D     left out: ST_D differs from Plant.tmc\n" in said.stdout
    assert "ST_E     left out: it contains ST_D, which is left out\n" in said.stdout


def test_bits_in_a_tmc_file_stay_refused(tmp_path: Path) -> None:
    text = struct_("ST_Bits", "x : BIT", "y : BIT") + struct_("ST_N", "x : BOOL", "y : BOOL")
    layouts = tmc(compiled("ST_Bits", 8, ("x", 0, 1), ("y", 1, 1)), compiled("ST_N", 8, ("x", 0, 1), ("y", 1, 1)))
    said = twincat(tmp_path, text, layouts, "--skip")
    assert "BIT has no equivalent in ROS" in said.stderr
    assert "  y: 1 byte at byte 1 here, 1 bit at bit 1 in Plant.tmc\n" in said.stderr


def test_a_tmc_file_can_be_named_and_can_be_broken(tmp_path: Path) -> None:
    said = twincat(tmp_path, PADDED, "<TcModuleClass>")
    assert (said.code, "Plant.tmc:1" in said.stderr, "SHM003" in said.stderr) == (1, True, True)
    (tmp_path / "Other.tmc").write_text(tmc(BASE))
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / "types.st").write_text(PADDED)
    (tmp_path / "Plant.plcproj").unlink()
    said = run(["import", "plain", "Other.tmc", "-p", "some_msgs"], tmp_path)
    assert said.stdout.startswith("ST_Base  some_msgs/Base, 16 bytes, verified by Other.tmc\n")
    said = run(["import", "Other.tmc", "-p", "some_msgs"], tmp_path)
    assert (said.code, "no data types are in it" in said.stderr) == (1, True)
