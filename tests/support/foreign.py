"""Damaged Structured Text, PLCopen XML and bags. Reading one must return its content or report an error."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from random import Random

from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Footer, Message, Schema

from shmgen.bag import mcap
from shmgen.bag import read as bags
from shmgen.core.diagnostics import Report
from shmgen.plc import messages, sources

ST = """\
{attribute 'pack_mode' := '4'}
(* what *) TYPE ABSTRACT ST_Base : STRUCT a, b AT %I* : LREAL := 1.5e3; END_STRUCT END_TYPE
TYPE ST_One EXTENDS Lib.ST_Base : STRUCT
    n : ARRAY[-1..GVL.MAX - 2 * (1 + E_X.Last), 0..16#F] OF INT (0..9); // [mm]
    s : STRING(80) := 'a$'b'; w : WSTRING[5]; p : POINTER TO ST_One; e : Lib.E_X; x : BIT;
END_STRUCT END_TYPE
TYPE E_X : (A := 1, B, Last := UINT#7) UINT := B; T : ARRAY[0..3] OF ARRAY[1..2] OF E_X; END_TYPE
VAR_GLOBAL CONSTANT MAX : INT := 10; OTHER : DINT := MAX MOD 3; END_VAR
TYPE U : UNION a : INT; b : REAL; END_UNION END_TYPE
"""
XML = """\
<?xml version="1.0" encoding="utf-8"?>
<project xmlns="http://www.plcopen.org/xml/tc6_0200"><types><dataTypes>
<dataType name="E"><baseType><enum><values><value name="A" value="1"/><value name="B"/></values></enum></baseType>
<addData><data name="/attributes"><Attribute Name="pack_mode" Value="1"/></data></addData></dataType>
<dataType name="S"><baseType><struct><variable name="v"><type><array><dimension lower="0" upper="MAX"/><baseType>
<derived name="Lib.E"/></baseType></array></type><initialValue><simpleValue value="2"/></initialValue></variable>
<variable name="t"><type><string length="9"/></type></variable></struct></baseType></dataType>
<dataType name="P"><addData><data name="/interfaceasplaintext"><InterfaceAsPlainText><xhtml>TYPE P : INT; END_TYPE
</xhtml></InterfaceAsPlainText></data></addData></dataType></dataTypes></types>
<globalVars name="GVL" constant="true"><variable name="MAX"><type><INT/></type><initialValue><simpleValue value="3"/>
</initialValue></variable></globalVars>
<DUT Name="D"><Declaration><![CDATA[TYPE D EXTENDS S : STRUCT b : BOOL; END_STRUCT END_TYPE]]></Declaration></DUT>
</project>
"""
KINDS = ("st", "xml", "mcap")
TOKENS = [
    *ST.split(),
    *XML.replace(">", "> ").split(),
    "(*",
    "*)",
    "{",
    "'",
    "$",
    "&#x9b;",
    "&#10;",
    "²",
    "\0",
    "9" * 400,
]
_NUMBERS = (0, 1, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**32 - 1, 2**63, 2**64 - 1)


def bag(compression: str) -> bytes:
    """Return a bag with a schema, a channel and two messages: once in a compressed chunk, once without a chunk."""
    builder = RecordBuilder()
    Schema(1, b"int32 data\n", "ros2msg", "std_msgs/msg/Int32").write(builder)
    Channel(1, "/a", "cdr", {"shmgen_topic": "/a", "shmgen_depth": "3"}, 1).write(builder)
    for number in range(2):
        Message(1, 9 + number, b"\0\1\0\0\5\0\0\0", 9, number).write(builder)
    records = builder.end()
    Chunk(compression, _PACKED[compression](records), 10, 9, 0, len(records)).write(builder)
    builder.write(records)
    Footer(0, 0, 0).write(builder)
    return mcap.MAGIC + builder.end() + mcap.MAGIC


def _lz4(data: bytes) -> bytes:
    from lz4.frame import compress

    return bytes(compress(data))


def _zstd(data: bytes) -> bytes:
    from rosbags.rosbag2 import storage_mcap  # which Python has zstd, it knows

    return bytes(storage_mcap.zstd.compress(data))


_PACKED: dict[str, Callable[[bytes], bytes]] = {"": bytes, "lz4": _lz4, "zstd": _zstd}


def seeds(kind: str) -> list[bytes]:
    return {"st": [ST.encode()], "xml": [XML.encode()], "mcap": [bag(packing) for packing in _PACKED]}[kind]


def damaged(kind: str, seed: bytes, dice: Random) -> bytes:
    """Change, duplicate or remove some bytes, words or numbers."""
    data = bytearray(seed)
    for _ in range(dice.randint(1, 6)):
        at, length = dice.randrange(len(data) + 1), dice.choice((1, 1, 2, 8, 40))
        match dice.randrange(5):
            case 0:
                del data[at : at + length]
            case 1:
                data[at:at] = data[at : at + length] * dice.choice((1, 2, 50))
            case 2:
                data[at : at + 1] = bytes([dice.randrange(256)])
            case 3 if kind == "mcap":
                data[at : at + 8] = struct.pack("<Q", dice.choice(_NUMBERS))[: dice.choice((2, 4, 8))]
            case _:
                data[at : at + dice.choice((0, length))] = dice.choice(TOKENS).encode()
    return bytes(data)


def read(kind: str, data: bytes, folder: Path) -> bool:
    """Return True if shmgen can read the file. An unexpected exception is a bug of shmgen."""
    file = folder / f"foreign.{kind}"
    file.write_bytes(data)
    if kind == "mcap":
        try:
            return bool(list(bags.messages(file)))
        except bags.Unreadable:
            return False
    report = Report()
    imported = messages.messages(sources.read([file], report), "a_msgs", report)
    for path, text in imported.texts.items():
        assert all(line.isprintable() for line in text.split("\n")), json.dumps([path, text])
    assert all(row.message or row.why for row in imported.rows)
    return bool(imported.texts)
