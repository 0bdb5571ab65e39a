"""Send messages of a whole distribution from Python through ST and back, and read them in C."""

from __future__ import annotations

import ctypes
import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from shmgen import definitions
from shmgen.config import Config
from shmgen.core.diagnostics import Report
from shmgen.core.model import Clock, Layout, Layouts, Ref, Role, Scalar, String, TypeName, TypeOptions
from shmgen.definitions.catalogue import WRAPPERS
from shmgen.generator import pipeline
from shmgen.targets.st import names as st_names
from tests.definitions.test_corpus import NEEDS_IDL, REJECTED
from tests.softplc import Plc, compile_st, iec

from .build import classes, put
from .c_structs import leaves, read_back, seen_by_c
from .plc_demo import CLAIM, ready
from .plcopen import imported
from .schemas import arriving, plain, random_message


@dataclass(frozen=True)
class Proof:
    """One distribution, generated, compiled and loaded."""

    folder: Path
    package: str
    layouts: Layouts
    plc: Plc
    c: ctypes.CDLL

    def requested(self) -> Iterator[tuple[str, TypeName, Layout]]:
        for number, (name, layout) in enumerate(self.layouts.items()):
            if layout.requested:
                yield f"m{number}", name, layout


def corpus_names(config: Config) -> list[str]:
    """Return all messages of a corpus distribution that can be mapped, the same with or without rosidl_parser."""
    sources = definitions.Sources(config.path, config.source, config.root)
    packages = {path.name for path in config.path[0].iterdir()}
    left_out = NEEDS_IDL | REJECTED.keys() if config.source != "noetic" else set()
    return [
        str(name)
        for name in definitions.open_library(sources, Report()).known()
        if name.package in packages and str(name) not in left_out and not name.name.endswith(WRAPPERS[name.kind])
    ]


def make(config: Config, names: list[str], folder: Path) -> Proof:
    """Generate the messages into `folder`, with a PLC that echoes each message and C code that prints it."""
    texts = pipeline.generate(config, names)
    layouts = pipeline.lay_out(config, names)
    put(texts, folder)
    st = {path: text for path, text in texts.items() if path.endswith(".st")}
    assert_same_in_xml(st, texts["plcopen/shmgen.xml"])
    c = read_back(folder, layouts)
    return Proof(folder, config.package, layouts, compile_st(st | echoes(layouts)), c)


def assert_same_in_xml(files: Mapping[str, str], xml: str) -> None:
    """Check that the XML contains the compiled Structured Text, except for blanks."""
    objects = imported(xml)
    for path, text in files.items():
        assert objects.pop(PurePath(path).stem).split() == text.split(), path
    assert objects == {}


def prove(proof: Proof, topic: str) -> None:
    """Check layouts, defaults, and each field of a random message of each type."""
    for name, layout in proof.layouts.items():
        assert_compiled_as_laid_out(proof.plc, name, layout)
    for place, name, layout in proof.requested():
        kinds = classes(proof.folder, proof.package, name)
        assert_same_defaults(proof.plc, layout, kinds[0])
        message = random_message(layout, proof.layouts, random.Random(str(name)))
        expected = arriving(message, layout, proof.layouts)
        echoed, data = echo(proof.plc, name, kinds, f"{topic}/{place}", message)
        assert plain(echoed) == plain(expected), name
        assert seen_by_c(proof.c, layout, data) == leaves(expected, layout, proof.layouts), name


IEC = {
    Scalar.INT8: "SINT", Scalar.UINT8: "USINT", Scalar.INT16: "INT", Scalar.UINT16: "UINT", Scalar.INT32: "DINT",
    Scalar.UINT32: "UDINT", Scalar.INT64: "LINT", Scalar.UINT64: "ULINT", Scalar.FLOAT32: "REAL",
    Scalar.FLOAT64: "LREAL",
}  # fmt: skip
"""The IEC type of each number. Copied bytes do not reveal a wrong sign, so the tests also compare the types."""


def iec_type(type_: Scalar | Clock | String, options: TypeOptions) -> iec.Type:
    match type_:
        case Scalar.BOOL:
            return iec.Elementary(options.bool)
        case Scalar():
            return iec.Elementary(IEC[type_])
        case Clock():
            return iec.Named("ST_SHMGEN_TIME") if options.time == "struct" else iec.Elementary(options.time)
        case String(capacity, wide):
            assert capacity is not None
            return iec.Text(capacity, wide)


def assert_compiled_as_laid_out(plc: Plc, name: TypeName, layout: Layout) -> None:
    structure = st_names.st_type(name).upper()
    expected = {st_names.st_member(slot.name).upper(): (slot.offset, slot.size) for slot in layout.slots}
    assert plc.offsets[structure] == expected, name
    assert plc.sizes[structure] == layout.size, name
    for slot in layout.slots:
        type_ = plc.types[structure][st_names.st_member(slot.name).upper()]
        element = type_.of if isinstance(type_, iec.Array) else type_
        if not isinstance(slot.type, Ref):
            assert element == iec_type(slot.type, layout.options), f"{name}.{slot.name}"


def assert_same_defaults(plc: Plc, layout: Layout, kind: Any) -> None:
    fresh = plain(kind.from_buffer_copy(plc.structure(st_names.st_type(layout.name)).bytes()))
    expected = plain(kind())
    for slot in layout.slots:
        if slot.role is Role.DATA:
            assert fresh[slot.name] == expected[slot.name], f"{layout.name}.{slot.name}"


def echoes(layouts: Layouts) -> dict[str, str]:
    """Return a block in ST for each message that sends each sample back."""
    texts = {}
    for name, layout in layouts.items():
        if layout.requested:
            block = f"{st_names.st_type(name)}_Echo"
            texts[f"{block}.st"] = (
                f"FUNCTION_BLOCK {block}\n"
                "VAR_INPUT\n    sFrom : STRING(80);\n    sTo : STRING(80);\nEND_VAR\n"
                "VAR\n"
                f"    fbIn : {st_names.block_name(name, 'Subscriber')};\n"
                f"    fbOut : {st_names.block_name(name, 'Publisher')};\n"
                "END_VAR\n"
                "fbIn(xEnable := TRUE, sTopic := sFrom);\n"
                "fbOut(xEnable := TRUE, sTopic := sTo, xSend := fbIn.xNewData, Msg := fbIn.Msg);\n"
                "END_FUNCTION_BLOCK\n"
            )
    return texts


def echo(plc: Plc, name: TypeName, kinds: tuple[Any, Any, Any], topic: str, message: Any) -> tuple[Any, bytes]:
    """Send a message to the PLC. Return the echoed message and its bytes."""
    _, publisher_kind, subscriber_kind = kinds
    with publisher_kind(f"{topic}/to") as publisher, subscriber_kind(f"{topic}/from") as subscriber:
        block = plc.block(f"{st_names.st_type(name)}_Echo")
        block.sFrom, block.sTo = f"{topic}/to", f"{topic}/from"
        ready(block, CLAIM)
        publisher.publish(message)
        block()
        assert (block.fbIn.eErrorID, block.fbOut.eErrorID) == ("NO_ERROR", "NO_ERROR"), name
        answer = subscriber.read()
        assert answer is not None, name
        return answer, bytes(answer)
