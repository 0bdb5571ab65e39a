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


def import_st(folder: Path, text: str, *arguments: str) -> Result:
    (folder / "plant.st").write_text(text)
    (folder / "shmgen.toml").write_text(TOML)
    return run(["import", "plant.st", "-p", "some_msgs", *arguments], folder)


def read_offsets(folder: Path, name: str) -> dict[str, int]:
    """Return the offset of each field of an imported message, and the message's size."""
    (description,) = json.loads(run(["show", f"some_msgs/{name}", "--json"], folder).stdout)
    places = {it["path"]: it["offset"] for it in description["slots"] if it["role"] == "data" and it["depth"] == 0}
    return places | {"size": description["size"]}


def struct_(name: str, *members: str, pack: str = "", base: str = "") -> str:
    attribute = f"{{attribute 'pack_mode' := '{pack}'}}\n" if pack else ""
    extends = f" EXTENDS {base}" if base else ""
    inner = "".join(f"  {member};\n" for member in members)
    return f"{attribute}TYPE {name}{extends} :\nSTRUCT\n{inner}END_STRUCT\nEND_TYPE\n"


PADDED = struct_("ST_Base", "a : LREAL", "b : BOOL")
INSIDE = struct_("ST_D", "c : ARRAY[0..7] OF BOOL", "d : LREAL", base="ST_Base")


def test_first_own_member_follows_the_padding_of_the_base(tmp_path: Path) -> None:
    """Compare offsets, because the size is 32 bytes with or without the padding."""
    result = import_st(tmp_path, PADDED + INSIDE)
    assert result.stdout.splitlines()[:2] == ["ST_Base  some_msgs/Base, 16 bytes", "ST_D     some_msgs/D, 32 bytes"]
    assert read_offsets(tmp_path, "D") == {"a": 0, "b": 8, "c": 16, "d": 24, "size": 32}
    assert "bool[8] c  # (PLC: c, align 8)\n" in (tmp_path / "msgs/some_msgs/msg/D.msg").read_text()


def test_size_includes_the_padding_of_the_base(tmp_path: Path) -> None:
    """Import 64 bytes. The size would be 60 bytes without the padding of the base."""
    base = struct_("ST_Base", "r : REAL", "x : BOOL")
    result = import_st(tmp_path, base + struct_("ST_D", "x1 : BOOL", "s : STRING(50)", "r1 : REAL", base="ST_Base"))
    assert "ST_D     some_msgs/D, 64 bytes\n" in result.stdout
    assert read_offsets(tmp_path, "D") == {"r": 0, "x": 4, "x1": 8, "s": 9, "r1": 60, "size": 64}


def test_padding_of_the_base_of_a_base_counts(tmp_path: Path) -> None:
    st = PADDED + struct_("ST_Middle", base="ST_Base") + struct_("ST_D", "c : BOOL", base="ST_Middle")
    done = import_st(tmp_path, st + struct_("ST_E", "e : BOOL", base="ST_D") + struct_("ST_F", "x : BOOL", "e : ST_E"))
    assert "not verified" not in done.stdout
    assert read_offsets(tmp_path, "Middle")["size"] == 16
    assert read_offsets(tmp_path, "E") == {"a": 0, "b": 8, "c": 16, "e": 24, "size": 32}
    assert read_offsets(tmp_path, "F")["size"] == 40


PACKED = {"0": (1, 9), "1": (1, 9), "2": (2, 10), "4": (4, 12), "8": (8, 16)}


@pytest.mark.parametrize("pack", PACKED)
def test_pack_mode_is_imported(pack: str, tmp_path: Path) -> None:
    place, size = PACKED[pack]
    text = struct_("ST_Packed", "b : BOOL", "v : LREAL", pack=pack) + struct_("ST_Outer", "x : BOOL", "p : ST_Packed")
    result = import_st(tmp_path, text)
    assert (result.code, result.stderr) == (0, "")
    assert read_offsets(tmp_path, "Packed") == {"b": 0, "v": place, "size": size}
    alignment = int(pack) or 1
    assert read_offsets(tmp_path, "Outer")["p"] == alignment
    note = "" if pack == "8" else f", pack_mode {alignment}"
    assert (tmp_path / "msgs/some_msgs/msg/Packed.msg").read_text().startswith(f"# (PLC: ST_Packed{note})\n")


def test_packed_structure_is_not_aligned_in_another(tmp_path: Path) -> None:
    text = struct_("ST_Number", "v : LREAL", pack="1") + struct_("ST_Outer", "x : BOOL", "p : ST_Number")
    import_st(tmp_path, text)
    assert read_offsets(tmp_path, "Outer") == {"x": 0, "p": 1, "size": 9}


def test_packed_structure_with_unpacked_member_is_refused(tmp_path: Path) -> None:
    result = import_st(tmp_path, PADDED + struct_("ST_P", "x : BOOL", "b : ST_Base", pack="1"))
    assert result.code == 1
    assert "error[SHM601]: ST_P has pack_mode 1, but the type ST_Base of a member has none\n" in result.stderr
    assert "hint: give ST_Base the attribute too" in result.stderr


def test_base_with_another_pack_mode_is_refused(tmp_path: Path) -> None:
    base = struct_("ST_Base", "x : BOOL", "v : LREAL", pack="1")
    result = import_st(tmp_path, base + struct_("ST_D", "i : DINT", base="ST_Base"))
    assert (result.code, "ST_D and its base have different pack_modes" in result.stderr) == (1, True)
    (tmp_path / "other").mkdir()
    assert import_st(tmp_path / "other", base + struct_("ST_D", "i : DINT", base="ST_Base", pack="1")).code == 0
    assert read_offsets(tmp_path / "other", "D") == {"x": 0, "v": 1, "i": 9, "size": 13}


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
    import_st(tmp_path, text)
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
    output = subprocess.run([program], capture_output=True, check=True)
    assert output.stdout == expected
    assert output.stderr == b'{x: false, v: 2.5, n: [0, -3], s: "day", e: {value: 7}}\n'


def tmc(*types: str) -> str:
    """Return a .tmc file of TwinCAT with the elements that shmgen reads."""
    return f"<TcModuleClass><DataTypes>{''.join(types)}</DataTypes><Modules /></TcModuleClass>"


def tmc_type(name: str, bits: int, *members: tuple[str, int, int], namespace: str = "", extends: str = "") -> str:
    """Return a compiled type of `bits` bits. Each member has a name, an offset and a size in bits."""
    attribute = f' Namespace="{namespace}"' if namespace else ""
    base = f"<ExtendsType>{extends}</ExtendsType>" if extends else ""
    items = "".join(
        f"<SubItem><Name>{member}</Name><Type>X</Type><BitSize>{size}</BitSize><BitOffs>{at}</BitOffs></SubItem>"
        for member, at, size in members
    )
    return f"<DataType><Name{attribute}>{name}</Name><BitSize>{bits}</BitSize>{base}{items}</DataType>"


BASE = tmc_type("ST_Base", 128, ("a", 0, 64), ("b", 64, 8))
D = tmc_type("ST_D", 256, ("c", 128, 64), ("d", 192, 64), extends="ST_Base")


def import_twincat(folder: Path, text: str, layouts: str, *arguments: str) -> Result:
    """Run `shmgen import` on a folder of a TwinCAT project."""
    (folder / "DUTs").mkdir(parents=True)
    (folder / "Plant.plcproj").write_text("<Project />")
    (folder / "Plant.tmc").write_text(layouts)
    (folder / "DUTs" / "types.st").write_text(text)
    (folder / "shmgen.toml").write_text(TOML)
    return run(["import", "DUTs", "-p", "some_msgs", *arguments], folder)


def test_tmc_file_of_the_project_verifies_each_type(tmp_path: Path) -> None:
    packed = struct_("ST_P", "b : BOOL", "v : LREAL", pack="1")
    text = PADDED + INSIDE + packed + "TYPE E_X : (eA, eB) UDINT; END_TYPE\n" + struct_("ST_Z", "z : INT")
    library = tmc_type("ST_Z", 8, ("z", 0, 8), namespace="Tc2_Other")
    layouts = tmc(BASE, D, tmc_type("ST_P", 72, ("b", 0, 8), ("V", 8, 64)), tmc_type("E_X", 32), library)
    result = import_twincat(tmp_path, text, layouts)
    assert (result.code, result.stderr) == (0, "")
    assert result.stdout.splitlines()[:5] == [
        "ST_Base  some_msgs/Base, 16 bytes, verified by Plant.tmc",
        "ST_D     some_msgs/D, 32 bytes, verified by Plant.tmc",
        "ST_P     some_msgs/P, 9 bytes, verified by Plant.tmc",
        "E_X      some_msgs/X, 4 bytes, verified by Plant.tmc",
        "ST_Z     some_msgs/Z, 2 bytes",
    ]


def test_difference_from_a_tmc_file_names_the_member(tmp_path: Path) -> None:
    """Report a member that the .tmc file has in the padding of the base, although the sizes are equal."""
    layouts = tmc(BASE, tmc_type("ST_D", 256, ("c", 72, 64), ("d", 192, 64)))
    result = import_twincat(tmp_path, PADDED + INSIDE + struct_("ST_E", "inner : ST_D"), layouts, "--skip")
    assert "note[SHM603]: ST_D differs from Plant.tmc\n" in result.stderr
    assert "\n  c: 8 bytes at byte 16 here, 8 bytes at byte 9 in Plant.tmc\n  hint: build the project" in result.stderr
    assert "ST_D     left out: ST_D differs from Plant.tmc\n" in result.stdout
    assert "ST_E     left out: it contains ST_D, which is left out\n" in result.stdout


def test_bits_are_refused_despite_a_tmc_file(tmp_path: Path) -> None:
    text = struct_("ST_Bits", "x : BIT", "y : BIT") + struct_("ST_N", "x : BOOL", "y : BOOL")
    layouts = tmc(tmc_type("ST_Bits", 8, ("x", 0, 1), ("y", 1, 1)), tmc_type("ST_N", 8, ("x", 0, 1), ("y", 1, 1)))
    result = import_twincat(tmp_path, text, layouts, "--skip")
    assert "BIT has no equivalent in ROS" in result.stderr
    assert "  y: 1 byte at byte 1 here, 1 bit at bit 1 in Plant.tmc\n" in result.stderr


def test_tmc_argument_is_used_and_a_broken_file_reported(tmp_path: Path) -> None:
    result = import_twincat(tmp_path, PADDED, "<TcModuleClass>")
    assert (result.code, "Plant.tmc:1" in result.stderr, "SHM003" in result.stderr) == (1, True, True)
    (tmp_path / "Other.tmc").write_text(tmc(BASE))
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / "types.st").write_text(PADDED)
    (tmp_path / "Plant.plcproj").unlink()
    result = run(["import", "plain", "Other.tmc", "-p", "some_msgs"], tmp_path)
    assert result.stdout.startswith("ST_Base  some_msgs/Base, 16 bytes, verified by Other.tmc\n")
    result = run(["import", "Other.tmc", "-p", "some_msgs"], tmp_path)
    assert (result.code, "no data types are in it" in result.stderr) == (1, True)
