"""Read samples with the structures of generated C headers, compiled by gcc."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from shmgen.core.model import Array, Clock, Layout, Layouts, Ref, Role, Scalar, Slot, String, TypeName, TypeOptions
from shmgen.targets.c import names as c_names
from shmgen.targets.c.names import struct_name

C_HEAD = """
#include <stdio.h>
static char *out, *end;
static void s(long long v) { out += snprintf(out, end - out, "%lld\\n", v); }
static void u(unsigned long long v) { out += snprintf(out, end - out, "%llu\\n", v); }
static void f(float v) { out += snprintf(out, end - out, "f%.9g\\n", v); }
static void d(double v) { out += snprintf(out, end - out, "d%.17g\\n", v); }
static void t(shmgen_seconds v) { out += snprintf(out, end - out, "%d s %u ns\\n", v.sec, v.nanosec); }
#define show(v) _Generic((v), shmgen_seconds: t, int8_t: s, int16_t: s, int32_t: s, int64_t: s, \\
    uint8_t: u, uint16_t: u, uint32_t: u, uint64_t: u, float: f, double: d)(v)
static void text(const char *v) { out += snprintf(out, end - out, "%s\\n", v); }
static void wide(const uint16_t *v) { while (*v) u(*v++); out += snprintf(out, end - out, "\\n"); }
static void begin(char *to, unsigned room) { out = to; end = to + room; *out = 0; }
"""


def read_back(folder: Path, layouts: Layouts) -> ctypes.CDLL:
    """Compile a C library with a function for each message that prints its fields."""
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
    member = f"m->{c_names.c_member(slot.name)}"
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
    return str(slot.count) if isinstance(slot.field.type, Array) else f"m->{c_names.c_member(slot.name + '_count')}"


def seen_by_c(library: ctypes.CDLL, layout: Layout, data: bytes) -> list[str]:
    room = 64 * len(data) + 4096
    buffer = ctypes.create_string_buffer(room)
    library[f"print_{struct_name(layout.name)}"](data, buffer, room)
    return buffer.value.decode(layout.options.encoding).splitlines()


def leaves(message: Any, layout: Layout, layouts: Layouts) -> list[str]:
    """Return the expected output of C for `message`, from its values and the definition."""
    lines: list[str] = []
    for slot in layout.slots:
        if slot.role is not Role.DATA:
            continue
        value = getattr(message, slot.name)
        assert slot.field is not None
        if slot.count is not None and not isinstance(slot.field.type, Array):
            lines.append(str(len(value)))
        for item in [value] if slot.count is None else value:
            lines += leaf(item, slot, layout.options, layouts)
    return lines


def leaf(value: Any, slot: Slot, options: TypeOptions, layouts: Mapping[TypeName, Layout]) -> list[str]:
    match slot.type:
        case Ref(name):
            return leaves(value, layouts[name], layouts)
        case Clock() if options.time == "struct":
            return [f"{value.sec} s {value.nanosec} ns"]
        case Clock():
            nanoseconds = value.sec * 10**9 + value.nanosec
            return [str(nanoseconds if options.time == "LTIME" else nanoseconds // 10**6 % 2**32)]
        case Scalar.FLOAT32:
            return [f"f{value:.9g}"]
        case Scalar.FLOAT64:
            return [f"d{value:.17g}"]
        case String(_, True):
            units = value.encode("utf-16-le")
            return [*(str(int.from_bytes(units[at : at + 2], "little")) for at in range(0, len(units), 2)), ""]
        case String():
            return [value]
        case _:
            return [str(int(value))]
