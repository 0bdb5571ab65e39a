"""Definitions nobody would write, and what has to hold for each: a schema, or a diagnostic, and soon."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from hypothesis import strategies as st

from shmgen import pipeline
from shmgen.bounds import Bound, Bounds
from shmgen.config import Config
from shmgen.diagnostics import CODES, Rejected, Span
from shmgen.model import Schema

KINDS = ("msg", "srv", "action")
SOURCES = ("jazzy", "noetic")


class Fuzzed(NamedTuple):
    """A file as it lies on disk, of `kind` and for a distribution, which decides the dialect."""

    data: bytes
    kind: str = "msg"
    source: str = "jazzy"


def read(fuzzed: Fuzzed, folder: Path) -> Schema | None:
    """None where it is refused; every other exception is a fault of shmgen."""
    config, file = put_down(fuzzed, folder)
    try:
        return pipeline.read(config, [file])
    except Rejected as rejected:
        assert_tells(rejected)
        return None


def generated(fuzzed: Fuzzed, folder: Path, targets: tuple[str, ...]) -> dict[str, str] | None:
    """The same through all stages, every open sequence bounded to 2."""
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
    """In words that a terminal can show."""
    assert rejected.diagnostics
    for diagnostic in rejected.diagnostics:
        assert diagnostic.code in CODES
        assert diagnostic.message
        text = str(diagnostic)
        assert len(text) < 4000
        assert all(c.isprintable() or c == "\n" for c in text), ascii(text)


class TooLong(Exception):
    """It would have gone on."""


@contextmanager
def within(seconds: float) -> Iterator[None]:
    """A guard against hanging, no measurement: seconds of CPU, of which a busy machine takes no more."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooLong(f"{seconds} s of CPU were not enough")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


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


@st.composite
def from_grammar(draw: st.DrawFn) -> Fuzzed:
    kind = draw(st.sampled_from(KINDS))
    parts = 1 + KINDS.index(kind)
    return Fuzzed("---\n".join(draw(part()) for _ in range(parts)).encode(), kind, draw(st.sampled_from(SOURCES)))


def part() -> st.SearchStrategy[str]:
    """Seven of eight lines are right."""
    comments = st.sampled_from(COMMENTS)
    right = st.builds("{} {}{}\n".format, st.sampled_from(TYPES), st.sampled_from(NAMES), comments)
    values = st.sampled_from(["", *(sign + value for value in VALUES for sign in " =")])
    odd = [st.sampled_from([*TYPES, *ODD_TYPES]), st.sampled_from([*NAMES, *ODD_NAMES]), values, comments]
    wrong = st.builds("{} {}{}{}\n".format, *odd)
    lines = st.integers(0, 7).flatmap(
        lambda number: wrong if number == 7 else right if number else st.sampled_from(LINES)
    )
    return st.lists(lines, max_size=6, unique_by=lambda line: tuple(line.split()[1:2])).map("".join)


# --- real ones, changed ---------------------------------------------------------------------------------


def from_files(files: list[Path]) -> st.SearchStrategy[Fuzzed]:
    """One of `files` with one to four of its bytes, words or lines changed."""

    @st.composite
    def strategy(draw: st.DrawFn) -> Fuzzed:
        file = draw(st.sampled_from(files))
        data = file.read_bytes()
        for _ in range(draw(st.integers(1, 4))):
            data = changed(data, draw)
        source = "noetic" if "noetic" in file.parts else "jazzy"
        return Fuzzed(data, draw(st.sampled_from([*[file.suffix[1:]] * 3, *KINDS])), source)

    return strategy()


def changed(data: bytes, draw: st.DrawFn) -> bytes:
    start = draw(st.integers(0, len(data)))
    match draw(st.sampled_from(["insert", "insert", "overwrite", "delete", "double", "bytes"])):
        case "insert":
            return data[:start] + draw(st.sampled_from(TOKENS)).encode() + data[start:]
        case "overwrite":
            token = draw(st.sampled_from(TOKENS)).encode()
            return data[:start] + token + data[start + len(token) :]
        case "delete":
            return data[:start] + data[start + draw(st.integers(1, 40)) :]
        case "double":
            end = start + draw(st.integers(1, 200))
            return data[:end] + data[start:end] + data[end:]
        case _:
            return data[:start] + draw(st.binary(min_size=1, max_size=4)) + data[start:]
