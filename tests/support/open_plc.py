"""The parts of the open PLC compilers that generated files need: stubs, a program, and its blocks.

For Beremiz and OpenPLC v3, the structures behind `data__` are derived from the Structured Text, as iec2c does. For
STruC++, they come from the chunks of the `.stlib` file. docs/openplc.md describes tests with the real compilers.
"""

from __future__ import annotations

import _ctypes
import ctypes
import json
import re
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

HERE = Path(__file__).parents[1] / "openplc"
COMPILERS = {
    "beremiz": ("gcc", "-std=gnu99", "-DSHMGEN_TEST_LENGTH=uint8_t", "-DSHMGEN_TEST_SECONDS=long"),
    "openplc-v3": ("g++", "-std=gnu++11", "-DSHMGEN_TEST_LENGTH=int8_t", "-DSHMGEN_TEST_SECONDS=int32_t"),
    "openplc-v4": ("g++", "-std=c++17"),
}
"""Each dialect's compiler, and the macros with the types that differ between the variants of matiec."""


class Variable(NamedTuple):
    name: str
    type: str
    value: str


class Block(NamedTuple):
    name: str
    variables: tuple[Variable, ...]
    body: str


class Source(NamedTuple):
    """The content of a file for matiec."""

    header: str
    types: dict[str, tuple[Variable, ...]]
    blocks: tuple[Block, ...]


_VARIABLE = re.compile(r"(\w+) : (ARRAY\[0\.\.\d+\] OF \w+|\w+)(?: := (.+))?;")
_TYPE = re.compile(r"(\w+) : STRUCT\n(.*?)\n\s*END_STRUCT;", re.DOTALL)
_BLOCK = re.compile(r"^FUNCTION_BLOCK (\w+)\n(.*?)\n\{\{\n(.*?)\n\}\}\nEND_FUNCTION_BLOCK", re.DOTALL | re.MULTILINE)
_TAKEN = re.compile(r"_$|__|^(type|step|time|int|en|eno|array|string|action|end)$", re.IGNORECASE)


def read(text: str) -> Source:
    """Parse a file by the rules of matiec for names and types. Read FILE lines as OpenPLC v3 does."""
    header = []
    for line in text.split("\n"):
        if line.startswith("(*FILE:") and line.endswith("*)"):
            assert line.count("(*") == line.count("*)") == 1, line
            path, _, content = line[7:-2].strip().partition(" ")
            assert path == "c_blocks.h"
            header.append(content)
    plain = re.sub(r"\(\*.*?\*\)", "", text)
    types = {match[1]: tuple(_variables(match[2])) for match in _TYPE.finditer(plain.partition("END_TYPE")[0])}
    blocks = tuple(Block(match[1], tuple(_variables(match[2])), match[3]) for match in _BLOCK.finditer(plain))
    known = {*types, *ELEMENTARY}
    for variable in (one for group in (*types.values(), *(block.variables for block in blocks)) for one in group):
        assert not _TAKEN.search(variable.name), variable
        assert variable.type.rpartition(" ")[2] in known, variable
    assert all("}}" not in block.body and "{{" not in block.body for block in blocks)
    assert all(len(block.body) < 12_000 for block in blocks), "iec2c's buffer has 16 KiB"
    return Source("\n".join(header), types, blocks)


ELEMENTARY = [
    "BOOL",
    "SINT",
    "INT",
    "DINT",
    "LINT",
    "USINT",
    "UINT",
    "UDINT",
    "ULINT",
    "REAL",
    "LREAL",
    "TIME",
    "STRING",
]


def _variables(text: str) -> Iterator[Variable]:
    for line in text.splitlines():
        stripped = line.strip()
        if stripped and stripped not in ("VAR_INPUT", "VAR_OUTPUT", "VAR", "END_VAR"):
            match = _VARIABLE.fullmatch(stripped)
            assert match, f"no declaration: {line}"
            yield Variable(match[1], match[2], match[3] or "")


# --- matiec ---------------------------------------------------------------------------------------------------


def matiec(source: Source) -> str:
    """Return one C file as iec2c would generate it, with the functions of _calls()."""
    lines = ['#include "matiec.h"']
    for name, members in source.types.items():
        lines.append("typedef struct {")
        lines += [f"    {_declared(member)}" for member in members]
        lines.append(f"}} {name.upper()};")
    for block in source.blocks:
        name = block.name.upper()
        lines.append("typedef struct {")
        lines += [
            f"    struct {{ {_declared(one, 'value')} uint8_t flags; }} {one.name.upper()};" for one in block.variables
        ]
        lines += [
            f"}} {name};",
            f"static void {name}_init__({name} *data__) {{",
            "    memset(data__, 0, sizeof *data__);",
        ]
        for one in block.variables:
            if one.value:
                lines.append(f"    data__->{one.name.upper()}.value = {_literal(one)};")
        lines += ["}", f"static void {name}_body__({name} *data__) {{", block.body, "}"]
        lines += _defaults(block, source.types)
        lines += _calls(block, source.types, f"((({name} *)block)->{{}}.value)", f"{name}_body__(({name} *)block)")
        lines += [
            f"SHMGEN_TEST_EXPORT void *new_{name}(void) {{",
            f"    {name} *made = ({name} *)malloc(sizeof *made);",
        ]
        lines += [f"    {name}_init__(made); {name}_defaults(made);", "    return made;", "}"]
    return "\n".join([*lines, *_moves(source.blocks, ".value"), ""])


def _defaults(block: Block, types: Mapping[str, tuple[Variable, ...]]) -> Iterator[str]:
    """Yield the initial values of structures as iec2c generates them."""

    def of(owner: str, type_: str) -> Iterator[str]:
        for member in types[type_]:
            place = f"{owner}.{member.name.upper()}"
            if member.type in types:
                yield from of(place, member.type)
            elif member.value.startswith("["):
                values = member.value.strip("[]").split(", ")
                unsigned = "ULL" if _array(member.type)[1] == "ULINT" else ""
                yield from (f"    {place}.table[{number}] = {value}{unsigned};" for number, value in enumerate(values))
            elif member.value:
                yield f"    {place} = {_literal(member)};"

    name = block.name.upper()
    yield f"static void {name}_defaults({name} *data__) {{"
    yield "    (void)data__;"
    for one in block.variables:
        if one.type in types:
            yield from of(f"data__->{one.name.upper()}.value", one.type)
    yield "}"


def _declared(variable: Variable, name: str = "") -> str:
    name = name or variable.name.upper()
    if variable.type.startswith("ARRAY"):
        last, element = _array(variable.type)
        return f"struct {{ {element.upper()} table[{last + 1}]; }} {name};"
    return f"{variable.type.upper()} {name};"


def _array(spelled: str) -> tuple[int, str]:
    match = re.fullmatch(r"ARRAY\[0\.\.(\d+)\] OF (\w+)", spelled)
    assert match
    return int(match[1]), match[2]


def _literal(variable: Variable) -> str:
    known = {"TRUE": "1", "FALSE": "0", "T#1s": "seconds(1)", "T#10s": "seconds(10)"}
    return known.get(variable.value, variable.value + ("ULL" if variable.type == "ULINT" else ""))


# --- STruC++ --------------------------------------------------------------------------------------------------


def strucpp(library: Mapping[str, Any]) -> str:
    """Return one C++ file with all chunks, each after the chunks that it needs."""
    chunks = {chunk["name"]: chunk for chunk in library["chunks"]}
    ordered: dict[str, Any] = {}

    def put(name: str) -> None:
        for dep in chunks[name]["deps"]:
            put(dep["name"])
        ordered.setdefault(name, chunks[name])

    for name in chunks:
        put(name)
    lines = ['#include "strucpp.hpp"', *(f'#include "{name}"' for name in library["manifest"]["headers"])]
    lines += ["namespace strucpp {", *(chunk["header"] for chunk in ordered.values())]
    lines += [*(chunk["cpp"] for chunk in ordered.values()), "}", "using namespace strucpp;"]
    types = {one["name"]: tuple(_member(field) for field in one["fields"]) for one in library["manifest"]["types"]}
    blocks = []
    for entry in library["manifest"]["functionBlocks"]:
        members = [_member(one) for one in (*entry["inputs"], *entry["outputs"])]
        block = Block(entry["name"], (*members, Variable("_UDIEND", "UDINT", "")), "")
        name = block.name
        lines += _calls(block, types, f"((({name} *)block)->{{}})", f"(*({name} *)block)()")
        lines += [f"SHMGEN_TEST_EXPORT void *new_{name}(void) {{ return new {name}(); }}"]
        blocks.append(block)
    return "\n".join([*lines, *_moves(blocks, ""), ""])


def _member(entry: Mapping[str, str]) -> Variable:
    return Variable(entry["name"], entry["type"], "")


# --- both -----------------------------------------------------------------------------------------------------


def _calls(block: Block, types: Mapping[str, tuple[Variable, ...]], place: str, call: str) -> Iterator[str]:
    """Yield C functions that give Python access to a block's variables and their members."""
    name = block.name.upper()
    yield f"SHMGEN_TEST_EXPORT void call_{name}(void *block) {{ {call}; }}"
    for one in block.variables:
        at = place.format(one.name.upper())
        yield from _reached(f"{name}_{one.name.upper()}", one.type.upper(), at)
        for member in types.get(one.type, ()):
            inner = member.name.upper()
            yield from _reached(f"{name}_{one.name.upper()}_{inner}", member.type.upper(), f"{at}.{inner}")


def _reached(name: str, type_: str, at: str) -> Iterator[str]:
    if type_ == "TIME":
        yield f"SHMGEN_TEST_EXPORT void set_{name}(void *block, double v) {{ put_time({at}, v); }}"
    elif type_ == "STRING":
        yield f"SHMGEN_TEST_EXPORT void set_{name}(void *block, const char *v) {{ put_text({at}, v); }}"
    elif type_ in ELEMENTARY:
        yield f"SHMGEN_TEST_EXPORT double get_{name}(void *block) {{ return number({at}); }}"
        yield f"SHMGEN_TEST_EXPORT void set_{name}(void *block, double v) {{ {at} = v; }}"


MOVES = (
    ("SUBSCRIBER", "PUBLISHER", "MSG"),
    ("SERVER", "CLIENT", "REQUEST"),
    ("CLIENT", "SERVER", "RESPONSE"),
    ("ACTIONSERVER", "ACTIONCLIENT", "GOAL"),
    ("ACTIONCLIENT", "ACTIONSERVER", "FEEDBACK"),
    ("ACTIONCLIENT", "ACTIONSERVER", "RESULT"),
)
"""A block with an output, a block with an input, and the variable that passes a message between them."""


def _moves(blocks: Any, tail: str) -> Iterator[str]:
    """Yield C functions for `fbOut.Msg := fbIn.Msg`, one for each pair."""
    names = {block.name.upper() for block in blocks}
    for name in sorted(names):
        stem, _, role = name.rpartition("_")
        for giver, taker, variable in MOVES:
            to = f"{stem}_{taker}"
            if role == giver and to in names:
                places = f"(({to} *)to)->{variable}{tail} = (({name} *)from)->{variable}{tail}"
                yield f"SHMGEN_TEST_EXPORT void move_{name}_{variable}(void *from, void *to) {{ {places}; }}"


class Program:
    """A shared object with blocks, loaded as a PLC runtime does."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.library = ctypes.CDLL(str(path))

    def block(self, name: str, **inputs: object) -> Any:
        return Instance(self.library, name.upper(), inputs)

    def unload(self) -> None:
        _ctypes.dlclose(self.library._handle)


class Instance:
    """A function block: `block.xEnable = True`, `block()`, `block.eErrorID`, `block.Request_on`."""

    def __init__(self, library: ctypes.CDLL, name: str, inputs: Mapping[str, object]) -> None:
        make = getattr(library, f"new_{name}")
        make.restype = ctypes.c_void_p
        vars(self).update(_library=library, _name=name, address=ctypes.c_void_p(make()))
        for key, value in inputs.items():
            setattr(self, key, value)

    def __call__(self, **inputs: object) -> Any:
        for key, value in inputs.items():
            setattr(self, key, value)
        getattr(self._library, f"call_{self._name}")(self.address)
        return self

    def __getattr__(self, name: str) -> int:
        get = getattr(self._library, f"get_{self._name}_{name.upper()}")
        get.restype = ctypes.c_double
        return int(get(self.address))

    def __setattr__(self, name: str, value: object) -> None:
        put = getattr(self._library, f"set_{self._name}_{name.upper()}")
        put(self.address, value.encode() if isinstance(value, str) else ctypes.c_double(value))  # type: ignore[arg-type]

    def move(self, to: Instance, variable: str = "Msg") -> None:
        """Execute `to.Msg := self.Msg`."""
        getattr(self._library, f"move_{self._name}_{variable.upper()}")(self.address, to.address)


def compiled(
    texts: Mapping[str, str], compiler: str, folder: Path, package: str = "shm_msgs", optimised: str = "-O1"
) -> Path:
    """Compile generated files to a shared object."""
    command, *options = COMPILERS[compiler]
    if compiler == "openplc-v4":
        source = strucpp(json.loads(texts[f"openplc/{package}.stlib"]))
    else:
        parsed = read(texts[f"matiec/{package}.st"])
        source = matiec(parsed)
        header = parsed.header if compiler == "openplc-v3" else texts[f"matiec/{package}.h"]
        (folder / "c_blocks.h").write_text(header)
        options += ["-include", str(folder / "c_blocks.h")] if compiler == "beremiz" else ["-D_IEC_STD_LIB_H"]
    suffix = ".c" if compiler == "beremiz" else ".cpp"
    (folder / f"plc{suffix}").write_text(source)
    library = folder / "plc.so"
    warnings = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-function"]
    line = [command, *options, optimised, *warnings, "-fPIC", "-shared", f"-I{HERE}", f"-I{folder}"]
    done = subprocess.run(
        [*line, str(folder / f"plc{suffix}"), "-o", str(library), "-lrt", "-lpthread"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[:4000]
    return library
