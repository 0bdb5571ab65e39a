"""Proof by bytes: every message of the corpus from Python through generated ST and back, and into the C header."""

from __future__ import annotations

import ctypes
import random
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from shmgen import definitions, pipeline
from shmgen.bounds import Bound, Bounds
from shmgen.config import Config
from shmgen.diagnostics import Span
from shmgen.model import Array, Clock, Layout, Layouts, Ref, Role, Scalar, Slot, String, TypeName
from shmgen.targets import naming
from shmgen.targets.c import struct_name

from .definitions.test_corpus import REJECTED
from .softplc import Plc, compile_st, iec
from .support.build import classes, put
from .support.schemas import plain, random_message

BOUND = 3
"""Elements of every sequence that the definitions leave open."""


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


@pytest.mark.parametrize(("distribution", "count"), [("noetic", 221), ("jazzy", 624)])
def test_every_message(
    distribution: str, count: int, corpus: Path, tmp_path_factory: pytest.TempPathFactory, topic: str
) -> None:
    """One test for all of a distribution: compiling it takes 20 s, and 50 s for the larger one."""
    proof = make(distribution, corpus, tmp_path_factory.mktemp(distribution))
    messages = list(proof.requested())
    assert len(messages) == count
    for name, layout in proof.layouts.items():
        assert_compiled_as_laid_out(proof.plc, name, layout)
    for place, name, layout in messages:
        kinds = classes(proof.folder, proof.package, name)
        assert_same_defaults(proof.plc, layout, proof.layouts, kinds[0])
        message = random_message(layout, proof.layouts, random.Random(str(name)))
        echoed, data = echo(proof.plc, name, kinds, f"{topic}/{place}", message)
        assert plain(echoed) == plain(message), name
        assert seen_by_c(proof.c, name, data) == leaves(message, layout, proof.layouts), name


def make(distribution: str, corpus: Path, folder: Path) -> Proof:
    """All of a distribution that can be mapped, every open sequence bounded."""
    packages = sorted(path.name for path in (corpus / distribution).iterdir())
    bounds = Bounds({}, {package: Bound(BOUND, Span("shmgen.toml")) for package in packages})
    path = (corpus / distribution,)
    config = Config(corpus, source=distribution, path=path, package=f"shm_{distribution}", bounds=bounds)
    sources = definitions.Sources(config.path, config.source, config.root)
    names = [str(name) for name in definitions.available(sources) if name.package in packages]
    names = [name for name in names if distribution == "noetic" or name not in REJECTED]
    texts = pipeline.generate(config, names)
    layouts = pipeline.lay_out(config, names)
    put(texts, folder)
    st = {path: text for path, text in texts.items() if path.endswith(".st")}
    c = read_back(folder, config.package, layouts)
    return Proof(folder, config.package, layouts, compile_st(st | echoes(layouts)), c)


IEC = {
    Scalar.BOOL: "USINT", Scalar.INT8: "SINT", Scalar.UINT8: "USINT", Scalar.INT16: "INT", Scalar.UINT16: "UINT",
    Scalar.INT32: "DINT", Scalar.UINT32: "UDINT", Scalar.INT64: "LINT", Scalar.UINT64: "ULINT", Scalar.FLOAT32: "REAL",
    Scalar.FLOAT64: "LREAL", Clock.TIME: "TIME", Clock.DURATION: "TIME",
}  # fmt: skip
"""Bytes that only pass through show no wrong sign, so the types are looked at too."""


def assert_compiled_as_laid_out(plc: Plc, name: TypeName, layout: Layout) -> None:
    structure = naming.st_type(name).upper()
    expected = {naming.st_member(slot.name).upper(): (slot.offset, slot.size) for slot in layout.slots}
    assert plc.offsets[structure] == expected, name
    assert plc.sizes[structure] == layout.size, name
    for slot in layout.slots:
        type_ = plc.types[structure][naming.st_member(slot.name).upper()]
        element = type_.of if isinstance(type_, iec.Array) else type_
        if isinstance(slot.type, Scalar | Clock):
            assert element == iec.Elementary(IEC[slot.type]), f"{name}.{slot.name}"


def assert_same_defaults(plc: Plc, layout: Layout, layouts: Layouts, kind: Any) -> None:
    """All but those of whole arrays, which ST has as a comment only."""
    fresh = plain(kind.from_buffer_copy(plc.structure(naming.st_type(layout.name)).bytes()))
    expected = plain(kind())
    for slot in layout.slots:
        if slot.role is Role.DATA and not array_default(slot, layouts):
            assert fresh[slot.name] == expected[slot.name], f"{layout.name}.{slot.name}"


def array_default(slot: Slot, layouts: Layouts) -> bool:
    held = layouts[slot.type.name].slots if isinstance(slot.type, Ref) else ()
    own = slot.field is not None and isinstance(slot.field.default, tuple)
    return own or any(array_default(inner, layouts) for inner in held)


def echoes(layouts: Layouts) -> dict[str, str]:
    """For each message a block, in ST, that sends back whatever comes."""
    texts = {}
    for name, layout in layouts.items():
        if layout.requested:
            block = f"{naming.st_type(name)}_Echo"
            texts[f"{block}.st"] = (
                f"FUNCTION_BLOCK {block}\n"
                "VAR_INPUT\n    sFrom : STRING(80);\n    sTo : STRING(80);\nEND_VAR\n"
                "VAR\n"
                f"    fbIn : {naming.subscriber_block(name)};\n"
                f"    fbOut : {naming.publisher_block(name)};\n"
                "END_VAR\n"
                "fbIn(xEnable := TRUE, sTopic := sFrom);\n"
                "fbOut(xEnable := TRUE, sTopic := sTo, xSend := fbIn.xNewData, Msg := fbIn.Msg);\n"
                "END_FUNCTION_BLOCK\n"
            )
    return texts


def echo(plc: Plc, name: TypeName, kinds: tuple[Any, Any, Any], topic: str, message: Any) -> tuple[Any, bytes]:
    """What Python reads of the answer, and the answer's bytes."""
    _, publisher_kind, subscriber_kind = kinds
    with publisher_kind(f"{topic}/to") as publisher, subscriber_kind(f"{topic}/from") as subscriber:
        publisher.publish(message)
        block = plc.block(f"{naming.st_type(name)}_Echo")(sFrom=f"{topic}/to", sTo=f"{topic}/from")
        assert (block.fbIn.eErrorID, block.fbOut.eErrorID) == ("NO_ERROR", "NO_ERROR"), name
        answer = subscriber.read()
        assert answer is not None, name
        return answer, bytes(answer)


# --- the C header -------------------------------------------------------------------------------------

C_HEAD = """
#include <stdio.h>
static char *out, *end;
static void s(long long v) { out += snprintf(out, end - out, "%lld\\n", v); }
static void u(unsigned long long v) { out += snprintf(out, end - out, "%llu\\n", v); }
static void f(float v) { out += snprintf(out, end - out, "f%.9g\\n", v); }
static void d(double v) { out += snprintf(out, end - out, "d%.17g\\n", v); }
#define show(v) _Generic((v), int8_t: s, int16_t: s, int32_t: s, int64_t: s, \\
    uint8_t: u, uint16_t: u, uint32_t: u, uint64_t: u, float: f, double: d)(v)
static void text(const char *v) { out += snprintf(out, end - out, "%s\\n", v); }
static void wide(const uint16_t *v) { while (*v) u(*v++); out += snprintf(out, end - out, "\\n"); }
static void begin(char *to, unsigned room) { out = to; end = to + room; *out = 0; }
"""


def read_back(folder: Path, package: str, layouts: Layouts) -> ctypes.CDLL:
    """A library with a function for each message that prints what it sees through the generated header."""
    headers = sorted(path.relative_to(folder / "c") for path in (folder / "c").rglob("*.h"))
    lines = [f'#include "{header}"' for header in headers] + [C_HEAD]
    for name, layout in layouts.items():
        struct = struct_name(name)
        lines.append(f"static void show_{struct}(const {struct} *m) {{ (void)m;")
        lines += [line for slot in layout.slots for line in c_lines(slot)]
        lines.append(f"}}\nvoid print_{struct}(const void *m, char *to, unsigned room) {{")
        lines.append(f"begin(to, room); show_{struct}(m); }}")
    library = folder / "read_back.so"
    command = [
        "gcc",
        "-std=gnu11",
        "-O0",
        "-Wall",
        "-Wno-unused-function",
        "-Wno-address-of-packed-member",
        "-Werror",
        "-fPIC",
        "-shared",
    ]
    command += [f"-I{folder / 'c'}", "-xc", "-", "-o", str(library)]
    done = subprocess.run(command, input="\n".join(lines), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:4000]
    return ctypes.CDLL(str(library))


def c_lines(slot: Slot) -> Iterator[str]:
    member = f"m->{naming.c_member(slot.name)}"
    if slot.role is Role.COUNT:
        yield f"show({member});"
    if slot.role is not Role.DATA:
        return
    index = "" if slot.count is None else "[i]"
    match slot.type:
        case String(_, wide):
            line = f"{'wide' if wide else 'text'}({member}{index});"
        case Ref(name):
            line = f"show_{struct_name(name)}(&{member}{index});"
        case _:
            line = f"show({member}{index});"
    yield line if slot.count is None else f"for (unsigned i = 0; i < {c_count(slot)}; i++) {line}"


def c_count(slot: Slot) -> str:
    assert slot.field is not None
    return str(slot.count) if isinstance(slot.field.type, Array) else f"m->{naming.c_member(slot.name + '_count')}"


def seen_by_c(library: ctypes.CDLL, name: TypeName, data: bytes) -> list[str]:
    room = 64 * len(data) + 4096
    buffer = ctypes.create_string_buffer(room)
    library[f"print_{struct_name(name)}"](data, buffer, room)
    return buffer.value.decode().splitlines()


def leaves(message: Any, layout: Layout, layouts: Layouts) -> list[str]:
    """What C must print for `message`, by its values and the definition alone."""
    lines: list[str] = []
    for slot in layout.slots:
        if slot.role is not Role.DATA:
            continue
        value = getattr(message, slot.name)
        assert slot.field is not None
        if slot.count is not None and not isinstance(slot.field.type, Array):
            lines.append(str(len(value)))
        for item in [value] if slot.count is None else value:
            lines += leaf(item, slot, layouts)
    return lines


def leaf(value: Any, slot: Slot, layouts: Mapping[TypeName, Layout]) -> list[str]:
    match slot.type:
        case Ref(name):
            return leaves(value, layouts[name], layouts)
        case Clock():
            return [str((value.sec * 1000 + value.nanosec // 10**6) % 2**32)]
        case Scalar.FLOAT32:
            return [f"f{value:.9g}"]
        case Scalar.FLOAT64:
            return [f"d{value:.17g}"]
        case String(_, True):
            return [*(str(ord(char)) for char in value), ""]
        case String():
            return [value]
        case _:
            return [str(int(value))]
