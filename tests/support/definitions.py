"""Random definitions. shmgen must accept each or report a diagnostic, in a short time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from random import Random
from typing import NamedTuple

from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import CODES, Rejected, Span
from shmgen.core.model import Schema
from shmgen.generator import pipeline

KINDS = ("msg", "srv", "action")
SOURCES = ("jazzy", "noetic")


class Fuzzed(NamedTuple):
    """The bytes of a definition file, its kind, and a distribution, which determines the dialect."""

    data: bytes
    kind: str = "msg"
    source: str = "jazzy"


def read(fuzzed: Fuzzed, folder: Path) -> Schema | None:
    """Return the schema, or None if shmgen rejects the file. Any other exception is a bug."""
    config, file = put_down(fuzzed, folder)
    try:
        return pipeline.read(config, [file])
    except Rejected as rejected:
        assert_tells(rejected)
        return None


def generated(fuzzed: Fuzzed, folder: Path, targets: tuple[str, ...]) -> dict[str, str] | None:
    """Generate files, with a bound of 2 for all unbounded sequences. Return None if shmgen rejects the file."""
    config, file = put_down(fuzzed, folder, targets)
    try:
        return pipeline.generate(config, [file])
    except Rejected as rejected:
        assert_tells(rejected)
        return None


def put_down(fuzzed: Fuzzed, folder: Path, targets: tuple[str, ...] = ("python",)) -> tuple[Config, str]:
    for kind in KINDS:
        (folder / "demo_msgs" / kind).mkdir(parents=True, exist_ok=True)
    (folder / "demo_msgs" / "msg" / "Bar.msg").write_text("int8 b\n")
    file = folder / "demo_msgs" / fuzzed.kind / f"Foo.{fuzzed.kind}"
    file.write_bytes(fuzzed.data)
    bounds = Bounds({}, {"demo_msgs": Bound(2, Span("shmgen.toml"))})
    return Config(folder, source=fuzzed.source, path=(folder,), bounds=bounds, targets=targets), str(file)


def assert_tells(rejected: Rejected) -> None:
    """Check that each diagnostic has a known code, a message, and a printable text of limited length."""
    assert rejected.diagnostics
    for diagnostic in rejected.diagnostics:
        assert diagnostic.code in CODES
        assert diagnostic.message
        text = str(diagnostic)
        assert len(text) < 4000
        assert all(c.isprintable() or c == "\n" for c in text), ascii(text)


# --- made from a grammar, mostly right ------------------------------------------------------------------


def words(text: str) -> list[str]:
    return text.split()


TYPES = words("""
    bool byte char int8 uint8 int16 uint16 int32 uint32 int64 uint64 float32 float64 string Bar demo_msgs/Bar[]
    std_msgs/Header geometry_msgs/Pose int8[3] float64[] string[2] uint8[<=5] string<=5 string<=5[<=2] wstring""")
ODD_TYPES = words("""
    time duration[2] Header Foo geometry_msgs/msg/Point builtin_interfaces/Time int32[0] int32[-1] int8[3][3] int8[
    int8] int8[999999999] int8<=5 string<= int Nobody nobody/Here ../../etc/passwd __import__ int8[٣]""")
NAMES = words("a b c d e f g h k l m n o p q r s t u v w x y z b_c x1 speed mode name ok left right")
ODD_NAMES = words("type class self size end_if count a_count header _pad0 größe x_ x__y __x A Aa aA end 1 x; x[3] ｘ")  # noqa: RUF001
VALUES = words(r"""
    0 1 -1 255 256 0x10 010 1.5 1e999 nan true TRUE 'it' "\\" "\n" '$N' [1,2] [1,2,3] [] [true] ['a',"b"] "#" "a=b"
    9999999999999999999999 [[[[[[[[[[[[[[[[[[[[" """)
COMMENTS = ["", " # about", " # [m/s]", '# *) */ """ ]]> {{ x }} \\', " # µ \u2028 \u202e", "  # angle[rad]"]
LINES = [
    "\n",
    "# heading\n",
    '# """ *)\n',
    "uint8 MODE=1\n",
    "string NAME='$N'\n",
    "float32 g 1.5\n",
    "int8[2] o [1,2]\n",
]
TOKENS = [*TYPES, *ODD_TYPES, *ODD_NAMES, *VALUES, *COMMENTS, *LINES, "---\n", "\r\n", "\t", " ", "=", "#", "@optional"]
TOKENS += ["\ufeff", "\x00", "\x0b", "\x85", "\u2028", "\U0001f916", "а", "٣", "{%", "??/", "\\", "[", "]", "'", '"']  # noqa: RUF001


def from_grammar(dice: Random) -> Fuzzed:
    kind = dice.choice(KINDS)
    parts = 1 + KINDS.index(kind)
    return Fuzzed("---\n".join(part(dice) for _ in range(parts)).encode(), kind, dice.choice(SOURCES))


def part(dice: Random) -> str:
    """Return a random definition in which most lines are valid and most names are unique."""
    lines = [line(dice) for _ in range(dice.randint(0, 6))]
    if dice.randrange(16):
        lines = list({tuple(line.split()[1:2]): line for line in lines}.values())
    return "".join(lines)


def line(dice: Random) -> str:
    match dice.randrange(8):
        case 0:
            return dice.choice(LINES)
        case 7:
            value = dice.choice(["", *(sign + value for value in VALUES for sign in " =")])
            names = dice.choice([*NAMES, *ODD_NAMES])
            return f"{dice.choice([*TYPES, *ODD_TYPES])} {names}{value}{dice.choice(COMMENTS)}\n"
        case _:
            return f"{dice.choice(TYPES)} {dice.choice(NAMES)}{dice.choice(COMMENTS)}\n"


# --- real ones, changed ---------------------------------------------------------------------------------


def from_files(files: Sequence[Path], dice: Random) -> Fuzzed:
    """Choose one of `files` and change one to four of its bytes, words or lines."""
    file = dice.choice(files)
    data = file.read_bytes()
    for _ in range(dice.randint(1, 4)):
        data = changed(data, dice)
    source = "noetic" if "noetic" in file.parts else "jazzy"
    return Fuzzed(data, dice.choice([*[file.suffix[1:]] * 3, *KINDS]), source)


def changed(data: bytes, dice: Random) -> bytes:
    start = dice.randint(0, len(data))
    match dice.choice(["insert", "insert", "overwrite", "delete", "double", "bytes"]):
        case "insert":
            return data[:start] + dice.choice(TOKENS).encode() + data[start:]
        case "overwrite":
            token = dice.choice(TOKENS).encode()
            return data[:start] + token + data[start + len(token) :]
        case "delete":
            return data[:start] + data[start + dice.randint(1, 40) :]
        case "double":
            end = start + dice.randint(1, 200)
            return data[:end] + data[start:end] + data[end:]
        case _:
            return data[:start] + bytes(dice.randrange(256) for _ in range(dice.randint(1, 4))) + data[start:]
