"""Python, C, Structured Text and the docs all define the header and the numbers of the ABI as the tables here do."""

from __future__ import annotations

import ctypes
import itertools
import re
import struct
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pytest

from shmgen.core import abi
from shmgen.core.abi import HeaderField
from shmgen.generator.render import render
from shmgen.runtime import engine, region_name
from shmgen.runtime.region import header as h
from shmgen.targets.c import region
from shmgen.targets.st import common

from .conftest import REPOSITORY
from .runtime.messages import PosePublisher, pose
from .softplc import compile_st
from .support import new_word, region_page

# These tables are written by hand. Do not edit them together with abi.py, because existing regions have this layout.
HEADER = {
    "magic": (0, 4, "dwMagic"),
    "abi": (4, 2, "uiAbi"),
    "header_size": (6, 2, "uiHeaderSize"),
    "digest": (8, 8, "lwDigest"),
    "payload_size": (16, 4, "udiPayloadSize"),
    "slot_size": (20, 4, "udiSlotSize"),
    "writer": (24, 4, "udiWriter"),
    "slots": (28, 4, "udiSlots"),
    "type_name": (32, 96, "abyTypeName"),
    "completed0": (128, 4, "udiCompleted0"),
    "completed1": (132, 4, "udiCompleted1"),
    "turn": (136, 4, "udiTurn"),
    "left": (140, 4, "udiLeft"),
    "retired": (144, 4, "udiRetired"),
    "ordered": (148, 4, "udiOrdered"),
    "heartbeat": (152, 4, "udiHeartbeat"),
    "lock_holder": (156, 4, "udiLockHolder"),
    "recoveries": (160, 4, "udiRecoveries"),
    "armed": (164, 4, "udiArmed"),
    "lock_count": (168, 4, "udiLockCount"),
    "missed": (172, 4, "udiMissed"),
    "bell": (176, 4, "udiBell"),
}
SLOT = {"stamp_ns": (0, 8, "lwStamp"), "number": (8, 4, "udiNumber")}
NUMBERS = {
    "MAGIC": 0x474D4853, "ABI": 2, "HEADER_SIZE": 192, "SLOT_HEADER": 16, "SLOT_STEP": 64, "LANES": 2,
    "PAGE": 4096,
    "PLC": 0xFFFFFFFF, "LAST": 0xFFFFFFFF, "RESTART_GAP": 0x80000000, "FORGET": 1 << 28, "LEFT_OUT": 2,
    "MAX_DEPTH": 65535, "MAX_TYPE_NAME": 95, "MAX_NAME": 74, "MAX_CALL_NAME": 65, "WRITER_LOCK": 0, "REPAIR_LOCK": 1,
    "READER_LOCK": 2,
    "RETRY_MS": 500, "CLAIM_MS": 1000, "CONFIRM_MS": 100, "RECOVER_MS": 1000, "DEAD_MS": 50, "LOCK_MS": 10,
    "WAKE_MS": 10, "POLL_MS": 1, "HEARTBEAT_MS": 50, "PEER_MS": 100, "REMOVED_MS": 100,
}  # fmt: skip
IN_PLC = {
    "MAGIC", "ABI", "HEADER_SIZE", "SLOT_HEADER", "SLOT_STEP", "LANES", "PAGE", "PLC", "LAST", "RESTART_GAP",
    "FORGET", "LEFT_OUT", "MAX_DEPTH", "MAX_TYPE_NAME", "MAX_NAME", "RETRY_MS", "CLAIM_MS", "CONFIRM_MS", "RECOVER_MS",
}  # fmt: skip

Places = dict[str, tuple[int, int]]
AGREED: Places = {name: (offset, size) for name, (offset, size, _) in HEADER.items()}
AGREED_SLOT: Places = {name: (offset, size) for name, (offset, size, _) in SLOT.items()}

# --- The offsets of header fields, read from each language ---------------------------------------------
# Each function takes several tables at once, because compiling one table takes as long as compiling eighty.


def in_python(tables: Sequence[Sequence[HeaderField]], folder: Path) -> list[Places]:
    """Return the offsets and sizes that Python reads with. Each byte of the data has its own offset as its value."""
    return [dict(read_in_python(words)) for words in tables]


def read_in_python(words: Sequence[HeaderField]) -> Iterator[tuple[str, tuple[int, int]]]:
    for word, value in zip(words, struct.unpack(h.codes(words, 192), bytes(range(192))), strict=True):
        data = value if isinstance(value, bytes) else value.to_bytes((value.bit_length() + 7) // 8, "little")
        yield word.name, (data[0], len(data))


def in_c(tables: Sequence[Sequence[HeaderField]], folder: Path) -> list[Places]:
    """Return the offsets and sizes that gcc computes. The preprocessor adds a number to each name in `shmgen.h`."""
    lines, prints = ["#include <stdio.h>"], []
    for number, words in enumerate(tables):
        (text,) = render([region.plan("p", words)]).values()
        (folder / f"h{number}.h").write_text(text)
        renamed = [f"#define shmgen_{name} {name}{number}" for name in ("region", "slot", "seconds")]
        lines += ["#undef SHMGEN_H", *renamed, f'#include "h{number}.h"']
        lines += [line.replace("#define", "#undef").rpartition(" ")[0] for line in renamed]
        place = 'printf("{0} {1} %zu %zu\\n", offsetof(region{0}, {1}), sizeof(((region{0} *)0)->{1}));'
        prints += [place.format(number, word.name) for word in words]
    result: list[Places] = [{} for _ in tables]
    for line in run_c(folder, [*lines, "int main(void) {", *prints, "}"]):
        number, name, offset, size = line.split()
        result[int(number)][name] = int(offset), int(size)
    return result


def run_c(folder: Path, lines: Sequence[str]) -> list[str]:
    """Compile and run a C program. Return the lines that it prints."""
    (folder / "main.c").write_text("\n".join(lines) + "\n")
    subprocess.run(["gcc", "-std=c11", "-Wall", "-Werror", "-o", folder / "main", folder / "main.c"], check=True)
    return subprocess.run([folder / "main"], check=True, capture_output=True, text=True).stdout.splitlines()


def in_st(tables: Sequence[Sequence[HeaderField]], folder: Path) -> list[Places]:
    """Return the offsets and sizes that the soft PLC computes, by the names in C, which the same table contains."""
    outputs = [
        common.header_structure(f"ST_Header{number}", ("//",), words, 192) for number, words in enumerate(tables)
    ]
    plc = compile_st(render(outputs))
    places = [plc.offsets[f"ST_HEADER{number}"] for number in range(len(tables))]
    return [{word.name: part[word.st.upper()] for word in words} for words, part in zip(tables, places, strict=True)]


def in_docs(tables: Sequence[Sequence[HeaderField]], folder: Path) -> list[Places]:
    return [read_in_docs(next(region_page.tables(words))) for words in tables]


def read_in_docs(lines: Sequence[str]) -> Places:
    sizes = {"u16": 2, "u32": 4, "u64": 8, "char[96]": 96}
    cells = [line.strip("| ").split(" | ") for line in lines[2:]]
    return {name: (int(offset), sizes[type_]) for offset, type_, name, *_ in cells}


LANGUAGES = {"Python": in_python, "C": in_c, "Structured Text": in_st, "docs": in_docs}
each_language = pytest.mark.parametrize("language", LANGUAGES)


@each_language
def test_header_fields_have_the_agreed_offsets(language: str, tmp_path: Path) -> None:
    (places,) = LANGUAGES[language]([abi.HEADER], tmp_path)
    assert places == AGREED


@each_language
@pytest.mark.family("[C]")
def test_swapped_or_moved_header_fields_are_detected(language: str, tmp_path: Path) -> None:
    """Swap any two fields of equal size, or move a field into free bytes: the offsets change in each language."""
    wrong = [*with_swapped_fields(), *with_moved_field()]
    assert len(wrong) > 80
    for places, words in zip(LANGUAGES[language](wrong, tmp_path), wrong, strict=True):
        assert places == {word.name: (word.offset, word.size) for word in words}
        assert places != AGREED


def with_swapped_fields() -> Iterator[list[HeaderField]]:
    for one, other in itertools.combinations(range(len(abi.HEADER)), 2):
        a, b = abi.HEADER[one], abi.HEADER[other]
        if a.type == b.type:
            words = list(abi.HEADER)
            words[one], words[other] = b._replace(offset=a.offset), a._replace(offset=b.offset)
            yield words


def with_moved_field() -> Iterator[list[HeaderField]]:
    for place, word in enumerate(abi.HEADER):
        words = list(abi.HEADER)
        words[place] = word._replace(offset=word.offset + abi.SIZES[word.element])
        try:
            list(abi.with_reserved(words, 192))
        except ValueError:
            continue  # the moved field overlaps another field
        yield words


# --- Numbers, and values of header fields -------------------------------------------------------------


def test_abi_module_matches_the_agreed_tables() -> None:
    assert {word.name: (word.offset, word.size, word.st) for word in abi.HEADER} == HEADER
    assert {word.name: (word.offset, word.size, word.st) for word in abi.SLOT} == SLOT
    assert {number.name: number.value for number in abi.NUMBERS} == NUMBERS
    assert {number.name: getattr(abi, number.name) for number in abi.NUMBERS} == NUMBERS
    assert abi.EVENT == "-event"


@pytest.mark.parametrize(
    ("offset", "type_", "reason"),
    [(178, "u32", "at 178 is misaligned"), (170, "u16", "before byte 172"), (192, "u32", "end at 192 is")],
)
def test_overlapping_header_fields_are_rejected(offset: int, type_: str, reason: str) -> None:
    words = sorted([*abi.HEADER, HeaderField(offset, type_, "more", "udiMore", "", "")])
    with pytest.raises(ValueError, match=reason):
        list(abi.with_reserved(words, 192))


class Header(ctypes.LittleEndianStructure):
    """The header, written by hand as in a program without shmgen."""

    _pack_ = 1
    _fields_ = (
        ("magic", ctypes.c_uint32), ("abi", ctypes.c_uint16), ("header_size", ctypes.c_uint16),
        ("digest", ctypes.c_uint64), ("payload_size", ctypes.c_uint32), ("slot_size", ctypes.c_uint32),
        ("writer", ctypes.c_uint32), ("slots", ctypes.c_uint32), ("type_name", ctypes.c_char * 96),
        ("completed0", ctypes.c_uint32), ("completed1", ctypes.c_uint32), ("turn", ctypes.c_uint32),
        ("left", ctypes.c_uint32), ("retired", ctypes.c_uint32), ("ordered", ctypes.c_uint32),
        ("heartbeat", ctypes.c_uint32), ("lock_holder", ctypes.c_uint32), ("recoveries", ctypes.c_uint32),
        ("armed", ctypes.c_uint32), ("lock_count", ctypes.c_uint32), ("missed", ctypes.c_uint32),
        ("bell", ctypes.c_uint32), ("_zero1", ctypes.c_char * 12),
    )  # fmt: skip


def test_runtime_packs_the_header_like_ctypes() -> None:
    numbers = {name: number for number, name in enumerate(HEADER, 1) if name != "type_name"}
    theirs = Header(type_name=b"geometry_msgs/msg/Pose", **numbers)
    ours = h.unpack(bytes(theirs), 4096)
    assert ours._asdict() == {"size": 4096, **numbers, "type_name": "geometry_msgs/msg/Pose"}
    assert h.pack(ours) == bytes(theirs)
    assert ours.fixed == (4096, *(getattr(ours, name) for name in list(HEADER)[:9] if name != "writer"))


def test_runtime_finds_the_fields_that_change() -> None:
    """Compare the runtime's indexes of these fields with the table. An index counts units of four or eight bytes."""
    changing = ["writer", *list(HEADER)[9:]]
    assert {name: 4 * getattr(h, name.upper()) for name in changing} == {name: HEADER[name][0] for name in changing}
    assert (SLOT["stamp_ns"][0], SLOT["number"][0]) == (8 * h.STAMP, 8 * h.NUMBER)
    constant = [HEADER[name][:2] for name in list(HEADER)[:9] if name != "writer"]
    assert [(place.start, place.stop - place.start) for place in h.MADE] == constant


def test_publisher_writes_what_ctypes_reads(topic: str) -> None:
    with PosePublisher(topic, depth=3) as publisher:
        for number in range(1, 6):
            publisher.publish(pose(float(number)))
        publisher.heartbeat()
        data = Path(f"/dev/shm/{region_name(topic)}").read_bytes()
    header = Header.from_buffer_copy(data)
    assert (header.magic, header.abi, header.header_size) == (0x474D4853, 2, 192)
    assert (header.payload_size, header.slot_size, header.slots) == (56, 128, 4)
    assert (header.completed0, header.completed1, header.turn, header.left) == (5, 0, 0, 0)
    assert (header.heartbeat, header.lock_count) == (6, 5)
    assert (header.lock_holder, header.recoveries, header.armed, header.missed, header.bell) == (0, 0, 0, 0, 0)
    assert struct.unpack_from("<II7d", data, 192 + 5 % 4 * 128 + 8) == (5, 0, *7 * [5.0])


def test_c_has_the_agreed_sizes_and_numbers(tmp_path: Path) -> None:
    (text,) = render([region.plan("p")]).values()
    (tmp_path / "shmgen.h").write_text(text)
    sizes = {"shmgen_region": 192, "shmgen_slot": 16}
    prints = [f'printf("{name} %lld\\n", (long long)SHMGEN_{name});' for name in NUMBERS]
    prints += [f'printf("{name} %zu\\n", sizeof({name}));' for name in sizes]
    prints += [f'printf("{name} %zu\\n", offsetof(shmgen_slot, {name}));' for name in SLOT]
    lines = ["#include <stdio.h>", '#include "shmgen.h"', "int main(void) {", *prints, "}"]
    printed = {name: int(value) for name, value in map(str.split, run_c(tmp_path, lines))}
    assert printed == {**NUMBERS, **sizes, **{name: offset for name, (offset, *_) in SLOT.items()}}
    assert set(re.findall(r"#define SHMGEN_(\w+) +[\dU]", text)) == set(NUMBERS)


def test_structured_text_has_the_agreed_sizes_and_numbers() -> None:
    plc = compile_st(common_texts())
    assert (plc.sizes["ST_SHMHEADER"], plc.sizes["ST_SHMSLOT"]) == (192, 16)
    assert {name: plc.offsets["ST_SHMSLOT"][st.upper()] for name, (*_, st) in SLOT.items()} == AGREED_SLOT
    constants = plc.globals("GVL_Shm")
    assert {name: getattr(constants, name) for name in IN_PLC} == {name: NUMBERS[name] for name in IN_PLC}
    assert plc.offsets["GVL_SHM"].keys() == IN_PLC | {"LOCKS"}


def common_texts() -> Mapping[str, str]:
    texts = render(common.plan(locks=True, struct_time=False))
    return {path: text for path, text in texts.items() if "/ST_" in path or "/GVL_" in path}


# --- Docs, and other texts with numbers ----------------------------------------------------------------

PAGE = REPOSITORY / "docs" / "protocol.md"


def test_docs_contain_the_tables_of_the_abi(update_golden: bool) -> None:
    text = PAGE.read_text()
    updated = region_page.with_tables(text, region_page.tables())
    if update_golden:
        PAGE.write_text(updated)
    assert text == updated, "run `pytest --update-golden tests/test_abi.py`"
    header, slot, numbers = region_page.tables()
    assert read_in_docs(header) == AGREED
    assert read_in_docs(slot) == AGREED_SLOT
    rows = re.findall(r"\| `(\w+)` \| (16#)?(\w+)", "\n".join(numbers))
    assert {name: int(value, 16 if base else 10) for name, base, value in rows} == NUMBERS


SENTENCES = {
    "templates/st/E_ShmError.st": [
        "The block retries every {RETRY_MS} ms", "not in 1..{MAX_DEPTH}",
        "a topic has {MAX_NAME} characters at most after the first slash, a service or an action {MAX_CALL_NAME}",
    ],
    "docs/codesys.md": [
        "at most {MAX_NAME} characters after the first slash, {MAX_CALL_NAME} for a service or an action",
        "Set `udiDepth` to a value from 1 to {MAX_DEPTH}",
    ],
    "docs/protocol.md": [
        "unchanged for {DEAD_MS} ms", "After 16#{LAST:08X}, the numbers", "is unchanged, {WAKE_MS} ms at a time",
    ],
}  # fmt: skip


@pytest.mark.parametrize("path", SENTENCES)
def test_sentences_state_the_agreed_numbers(path: str) -> None:
    text = " ".join((REPOSITORY / path).read_text().replace("//", " ").split())
    for sentence in SENTENCES[path]:
        assert sentence.format(**NUMBERS) in text


def test_strings_of_blocks_hold_the_longest_names() -> None:
    for path in sorted((REPOSITORY / "templates" / "st").glob("FB_*.st")):
        for name, length in re.findall(r"^    (_?s\w+) +: STRING\((\d+)\)", path.read_text(), re.MULTILINE):
            if name.endswith(("Type", "TypeName")):
                assert int(length) == NUMBERS["MAX_TYPE_NAME"], f"{path.name}: {name}"
            elif name in ("_sRegion", "_sEvent", "sTopic", "sName"):
                assert int(length) == NUMBERS["MAX_NAME"] + len("-event"), f"{path.name}: {name}"


def test_source_code_contains_no_bare_number_of_the_abi() -> None:
    """Reject bare numbers as indexes of header fields in Python, and numbers of the ABI in hand-written blocks."""
    for path in (REPOSITORY / "src" / "shmgen").rglob("*.py"):
        words = r"\b(words|quads|head)" if "runtime" in path.parts else r"\b(_words|\w\.words|quads)"
        assert not re.search(words + r"\[\d", path.read_text()), path
    ours = {str(value) for value in NUMBERS.values() if value >= 50} | {f"16#{NUMBERS['LAST']:08X}", "16#80000000"}
    for path in (REPOSITORY / "templates" / "st").glob("*.st"):
        code = re.sub(r"//.*|STRING\(\d+\)|:= \d+,", "", path.read_text())
        assert not ours & set(re.findall(r"[\w#]+", code)), path


# --- A new counter ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_adding_a_counter_takes_one_line(tmp_path: Path, topic: str) -> None:
    """Add a header field in a copy of the project. Each endpoint counts its reads there, and all read the counts."""
    new_word.copy(tmp_path)
    ends = {"python": new_word.in_python(tmp_path, pure=True), "c": new_word.in_c(tmp_path)}
    ends["st"] = new_word.in_st(tmp_path)
    topics = [f"{topic}/{name}" for name in ends]
    for name, end in ends.items():
        assert end(f"{topic}/{name}", ()) == []
    for count, end in enumerate(ends.values(), 1):
        assert end("", topics) == [count] * len(topics)
    if engine.IN_C:
        extended = new_word.in_python(tmp_path, pure=False)
        assert extended(f"{topic}/extension", [f"{topic}/extension"]) == [1]
        assert extended("", topics) == [len(ends) + 1] * len(topics)
    docs = new_word.python(tmp_path, "-c", new_word.DOCS)
    assert "| 180 | u32 | refused | readers | samples they refused |" in docs
