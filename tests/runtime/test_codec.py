"""What the walker in C makes of a message, and of its bytes, is what the walker in Python makes of it."""

from __future__ import annotations

import array
import copy
import ctypes
import gc
import random
import re
import shutil
import struct
import subprocess
import sys
from enum import IntEnum
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from shmgen.config import Config
from shmgen.core.model import TypeName, TypeOptions
from shmgen.generator import pipeline
from shmgen.runtime import CountExceeded, OutOfRange, engine
from shmgen.runtime.messages import walker
from tests.conftest import REPOSITORY
from tests.support import build, c_structs, import_or_skip, sanitizers, schemas

from .messages import WHY_NOT

numpy = import_or_skip("numpy")
pytestmark = pytest.mark.skipif(not engine.IN_C, reason=WHY_NOT)

OPTIONS = [
    TypeOptions(),
    TypeOptions(time="LTIME", encoding="latin-1"),
    TypeOptions(time="struct", bool="BOOL", overflow="truncate"),
    TypeOptions(encoding="latin-1", overflow="truncate"),
]
NUMBERS = ["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]
LEAF = "".join(f"{kind} {kind}_one\n{kind}[3] {kind}_three\n{kind}[<=4] {kind}_some\n" for kind in NUMBERS)
DEFINITIONS = {
    "Leaf": f"{LEAF}string<=8 text\nwstring<=8 wide\nbuiltin_interfaces/Time stamp\nbuiltin_interfaces/Duration span\n",
    "Tree": "Leaf one\nLeaf[2] two\nLeaf[<=3] some\nstring<=8[<=3] texts\nwstring<=4[2] wides\n"
    "builtin_interfaces/Time[<=3] stamps\nbuiltin_interfaces/Duration[2] spans\n"
    "uint8[<=6000] data\nfloat64[600] long\nuint8 last\n",
}
EDGES = (
    *(0, 1, 0.0, -0.5, 1e-50, 3.4e38, 3.5e38, 1e300, 10**30, 10**400, float("inf"), float("-inf"), float("nan")),
    *(sign * 2**bits + step for bits in (7, 8, 15, 16, 31, 32, 63, 64) for sign in (1, -1) for step in (-1, 0)),
)


class Small(IntEnum):
    ONE = 1


def odd(**given: Any) -> Any:
    """With whatever attributes, or methods of Python's, it is given."""
    return type("Odd", (SimpleNamespace,), given)()


ODD = (
    *(True, False, None, "1", b"1", [1], 1j, Small.ONE, type("Own", (float,), {})(1.5), type("Own", (int,), {})(7)),
    *(numpy.float64(1.5), numpy.float32(1.5), numpy.int64(7), numpy.uint8(200), numpy.bool_(True), numpy.array(3)),
    *(odd(__index__=lambda _: 5), odd(__float__=lambda _: 2.5), odd(__index__=lambda _: 1 // 0)),
)
SEQUENCES = (
    *([], [1], (1, 0, 1), [1, 0, 1, 0], (1,) * 5, [True, False, True], b"", b"abc", bytearray(b"abcd"), b"abcde"),
    *(
        memoryview(b"abcdef")[::2],
        memoryview(bytes(8)).cast("B", (2, 2, 2)),
        array.array("B"),
        range(3),
        "abc",
        None,
        7,
    ),
    *(array.array(code, [1, 2, 3]) for code in "bBhHiIlLqQfd"),
    *(memoryview(array.array("d", range(6)))[::2], (3 * ctypes.c_double)(1, 2, 3), (3 * ctypes.c_bool)(1, 0, 1)),
    *((4 * ctypes.c_char)(b"a"), ctypes.c_uint8(7), {1: 2, 3: 4, 5: 6}, {1, 2, 3}, [[1], [2], [3]], [1, 2, Small.ONE]),
    *(numpy.array(value) for value in ([[1, 2], [3, 4]], [True, False, True], 7, [], [1.5, 2, 3], [1, 2, 3])),
    *(numpy.array([1, 2, 3]).astype(code) for code in ("f4", "f8", "i4", "u4", "u1", "i8", ">i4", ">f8", "f2", "O")),
    *(
        numpy.arange(12, dtype="u2")[::4],
        numpy.asfortranarray(numpy.arange(4.0).reshape(2, 2)),
        numpy.ma.array([1.0, 2.0, 3.0]),
    ),
)
TEXTS = (
    *("", "bow", "01234567", "012345678", "gr\xfc\xdf", "0123456\xe9", "01234567\xe9", "\N{SNOWMAN}" * 3, "a\0b", "\0"),
    *(
        "\ud800",
        "abc\udfff",
        "\N{GRINNING FACE}" * 2,
        "0123456\N{GRINNING FACE}",
        "\N{GRINNING FACE}" * 5,
        b"abc",
        None,
        7,
    ),
    *(type("Own", (str,), {})("own"), numpy.str_("numpy"), bytearray(b"a"), ["a"]),
)
TIMES = (
    *(
        (0, 0),
        (1, 0),
        (-1, 0),
        (0, 1),
        (4_294_967, 295_999_999),
        (4_294_967, 296_000_000),
        (1_800_000_000, 123_456_789),
    ),
    *((2**31 - 1, 10**9 - 1), (2**31, 0), (-(2**31), 0), (18_446_744_073, 709_551_615), (18_446_744_073, 709_551_616)),
    *((2**62, 0), (2**64, 0), (0, 2**32 - 1), (0, 2**32), (0, -1), (5, -1), (0, 10**12), (1.5, 0), ("1", 0), (None, 0)),
    *((True, False), (numpy.int64(3), numpy.int64(4)), (Small.ONE, 1)),
)


class Ways:
    """Both walkers over one table, and that they agree, in errors too."""

    def __init__(self, kind: Any) -> None:
        self.kind, self.codec = kind, engine.codec(kind)
        assert self.codec is not None
        self.size = ctypes.sizeof(kind)

    def python(self, message: Any) -> tuple[bytes, int]:
        """The bytes, and how many texts were truncated."""
        into = bytearray(self.size)
        truncated = walker.encode(self.kind, message, into)
        return bytes(into), truncated

    def in_c(self, message: Any) -> tuple[bytes, int]:
        into = bytearray(b"\xaa" * self.size)  # of a former message
        cuts = self.codec.encode(message, into)
        return bytes(into), cuts

    def encode(self, message: Any) -> bool:
        """Whether there is nothing wrong with it."""
        wanted = outcome(self.python, message)
        assert outcome(self.in_c, message) == wanted
        return isinstance(wanted[0], bytes)

    def decode(self, data: bytes, message: Any) -> bool:
        """Whether there is nothing wrong with them, into a copy of `message`."""
        quick, wanted = copied(message), copied(message)
        found = outcome(walker.decode, self.kind, data, wanted)
        assert outcome(self.codec.decode, data, quick) == found
        if found is None:
            same(quick, wanted)
        return found is None


def outcome(call: Any, *arguments: Any) -> Any:
    """What it returns, or its error; addresses in it are those of copies."""
    try:
        return call(*arguments)
    except Exception as error:
        return type(error), re.sub("0x[0-9a-f]+", "0x", str(error))


def same(one: Any, other: Any, path: str = "") -> None:
    """Of the same kind all through, and the same bits."""
    assert type(one) is type(other), (path, one, other)
    match one:
        case float():
            assert struct.pack("d", one) == struct.pack("d", other), path
        case ctypes.Structure():
            assert bytes(one) == bytes(other), path
        case list():
            assert len(one) == len(other), path
            for index, pair in enumerate(zip(one, other, strict=True)):
                same(*pair, f"{path}[{index}]")
        case SimpleNamespace():
            assert vars(one).keys() == vars(other).keys(), path
            for name in vars(one):
                same(getattr(one, name), getattr(other, name), f"{path}.{name}")
        case numpy.ndarray():
            assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes()), path
        case array.array():
            assert (one.typecode, one.tobytes()) == (other.typecode, other.tobytes()), path
        case _:
            assert repr(one) == repr(other), path


def copied(value: Any) -> Any:
    """Of all that a decoder may set something in."""
    if isinstance(value, SimpleNamespace):
        made = type(value)()
        vars(made).update({name: copied(item) for name, item in vars(value).items()})
        return made
    if isinstance(value, ctypes.Structure):
        return copy.deepcopy(value)
    return [copied(item) for item in value] if type(value) is list else value


def constructible(value: Any) -> Any:
    """The same message where those in lists are of classes that can be called without arguments, as ROS's are."""
    if isinstance(value, SimpleNamespace):
        values = {name: constructible(item) for name, item in vars(value).items()}

        class Made(SimpleNamespace):
            def __init__(self) -> None:
                super().__init__(**{name: copied(item) for name, item in values.items()})

        return Made()
    return [constructible(item) for item in value] if isinstance(value, list) else value


def among(value: Any, draw: random.Random) -> Any:
    """The same message with each sequence of numbers in some kind of sequence."""
    if isinstance(value, SimpleNamespace):
        made = copied(value)
        vars(made).update({name: among(item, draw) for name, item in vars(value).items()})
        return made
    if not isinstance(value, list) or not value or not isinstance(value[0], bool | int | float):
        return [among(item, draw) for item in value] if isinstance(value, list) else value
    code = "d" if isinstance(value[0], float) else "q" if min(value) < 0 else "Q"
    kinds = [list, tuple, numpy.array, lambda items: array.array(code, items)]
    kinds += [bytes, bytearray] if max(value) < 256 and min(value) >= 0 and code == "Q" else []
    return draw.choice(kinds)(value)


@given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
@settings(max_examples=schemas.examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_message_goes_both_ways(schema, options, seed, tmp_path_factory):
    folder = tmp_path_factory.mktemp("any")
    layouts = build.layouts_of(schema, options)
    package = f"coded_{folder.name}"
    build.put(build.texts_of(layouts, "python", package), folder)
    draw = random.Random(seed)
    for layout in layouts.values():
        kind, _, _ = build.classes(folder, package, layout.name)
        ways = Ways(kind)
        for _ in range(schemas.messages(4)):
            message, target = (constructible(schemas.random_message(layout, layouts, draw)) for _ in "io")
            assert ways.encode(message), layout.message
            ways.encode(among(message, draw))
            data, _ = ways.python(message)
            other = kind.from_buffer_copy(data)
            foreign = type("Foreign", (kind,), {})()
            assert ways.encode(other)
            for into in (target, foreign, among(target, draw)):
                assert ways.decode(data, into), layout.message
                ways.decode(draw.randbytes(ways.size), into)
            ways.decode(data, schemas.random_message(layout, layouts, draw))
    build.forget(package)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("gcc"), reason="gcc is not installed")
@given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
@settings(max_examples=schemas.examples(8), suppress_health_check=list(HealthCheck), phases=[Phase.generate])
def test_the_structures_of_gcc_hold_the_values_of_the_walker(schema, options, seed, tmp_path_factory):
    """A failing schema is not shrunk, because each attempt runs gcc."""
    folder = tmp_path_factory.mktemp("gcc")
    layouts, package = build.layouts_of(schema, options), f"compiled_{folder.name}"
    for language in ("python", "c"):
        build.put(build.texts_of(layouts, language, package), folder)
    library, draw = c_structs.read_back(folder, layouts), random.Random(seed)
    for layout in layouts.values():
        kind, _, _ = build.classes(folder, package, layout.name)
        for _ in range(schemas.messages(4)):
            message = constructible(schemas.random_message(layout, layouts, draw))
            data, _ = Ways(kind).python(message)
            walker.decode(kind, data, message)
            seen = c_structs.seen_by_c(library, layout, data)
            assert seen == c_structs.leaves(message, layout, layouts), layout.message
    build.forget(package)


@pytest.fixture(scope="module", params=range(len(OPTIONS)))
def trees(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    return generated(tmp_path_factory.mktemp("trees"), f"shm_trees{request.param}", OPTIONS[request.param])


@pytest.fixture(scope="module")
def tree_kind(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return generated(tmp_path_factory.mktemp("tree"), "shm_tree", OPTIONS[0]).Tree


def generated(folder: Path, package: str, options: TypeOptions) -> ModuleType:
    build.put({f"msgs/tree_msgs/msg/{name}.msg": text for name, text in DEFINITIONS.items()}, folder)
    config = Config(folder, path=(folder / "msgs",), package=package, targets=("python",), types=options)
    build.put(pipeline.generate(config, ["tree_msgs"]), folder)
    return build.module(folder, package, TypeName("tree_msgs", "msg", "Tree"))


class Leaf(SimpleNamespace):
    def __init__(self, **changed: Any) -> None:
        for kind in NUMBERS:
            vars(self).update({f"{kind}_one": 1, f"{kind}_three": [1, 1, 1], f"{kind}_some": [1]})
        super().__init__(**{"text": "bow", "wide": "sun", "stamp": time(1), "span": time(2)} | changed)


def time(seconds: Any = 0, nanos: Any = 0) -> SimpleNamespace:
    return SimpleNamespace(sec=seconds, nanosec=nanos)


def tree(**changed: Any) -> SimpleNamespace:
    made = SimpleNamespace(one=Leaf(), two=[Leaf(), Leaf(text="two")], some=[Leaf()], texts=["a", ""], wides=["b", "c"])
    vars(made).update(stamps=[time(3)], spans=[time(4), time(5)], data=b"data", long=[0.5] * 600, last=9)
    vars(made).update(changed)
    return made


@pytest.mark.slow
def test_numbers_and_sequences_of_every_kind(tree_kind):
    ways, taken = Ways(type(tree_kind().one)), set()
    for field in NUMBERS:
        for value in (*EDGES, *ODD):
            ways.encode(Leaf(**{f"{field}_one": value}))
            ways.encode(Leaf(**{f"{field}_three": [1, value, 0]}))
        for value in (*SEQUENCES, *EDGES):
            for end in ("three", "some"):
                if ways.encode(Leaf(**{f"{field}_{end}": value})):
                    taken.add(type(value))
                ways.decode(bytes(ways.size), Leaf(**{f"{field}_{end}": value}))
    wanted = {list, tuple, bytes, bytearray, memoryview, array.array, numpy.ndarray, 3 * ctypes.c_double}
    assert wanted <= taken
    assert not taken & {type(None), int}


@pytest.mark.family("[0]")
def test_texts_and_times_of_every_kind(trees):
    ways = Ways(trees.Tree)
    for text in TEXTS:
        for changed in ({"text": text}, {"wide": text}):
            ways.encode(tree(one=Leaf(**changed)))
        for changed in ({"texts": [text]}, {"texts": ("", text)}, {"texts": text}, {"wides": [text, "a"]}):
            ways.encode(tree(**changed))
    kinds = (time, lambda *of: SimpleNamespace(secs=of[0], nsecs=of[1]), lambda *of: of, lambda *of: odd(sec=of[0]))
    for parts in TIMES:
        for kind in kinds:
            found = kind(*parts)
            for changed in ({"one": Leaf(stamp=found)}, {"one": Leaf(span=found)}, {"stamps": [found]}):
                message = tree(**changed)
                ways.encode(message)
                data, _ = ways.python(tree())
                ways.decode(data, message)
    assert ways.encode(tree())
    assert ways.in_c(tree(stamps=[trees.Tree().one.stamp], texts=numpy.array(["a"], object)))


@pytest.mark.family("[0]")
def test_bytes_of_no_text_and_no_bool(trees):
    """Stale text behind a NUL, no UTF-8, half a pair, a bool of 2, and counts past their bounds."""
    ways, draw = Ways(trees.Tree), random.Random(3)
    data, _ = ways.python(tree(one=Leaf(text="\xc3\xa9")))  # in Latin-1 the bytes of another text in UTF-8
    assert ways.decode(data, tree())
    data, _ = ways.python(tree())
    done = 0
    for _ in range(200):
        spoiled = bytearray(data)
        for _ in range(draw.randrange(1, 40)):
            spoiled[draw.randrange(6000 if draw.random() < 0.9 else len(data)) % len(data)] = draw.choice(
                [0, 2, 216, 255]
            )
        done += ways.decode(bytes(spoiled), tree())
        ways.encode(trees.Tree.from_buffer_copy(spoiled))
    assert 0 < done < 200


@pytest.mark.slow
def test_attributes_that_are_any_code(tree_kind):
    """They raise, change lists while these are gone through, encode once more, or let go of what is held."""
    ways, calls = Ways(tree_kind), []
    wanted = ways.python(tree())

    def seen(change: Any) -> Any:
        """A tree in which `one.text` does something first."""
        made = tree()

        class Seen(Leaf):
            @property
            def text(self) -> str:
                calls.append(change(made))
                return "bow"

            @text.setter
            def text(self, value: str) -> None:
                calls.append(change(made))

        made.one, made.two, made.some = Seen(), [Seen(), Leaf(text="two")], [Seen()]
        return made

    def clear(made: Any) -> None:
        made.two[:], made.some[:], made.texts[:], made.long[:] = [Leaf()], [], [], []
        gc.collect()

    def replace(made: Any) -> None:
        vars(made).update({name: value for name, value in vars(tree()).items() if name not in ("one", "two", "some")})

    def once_more(made: Any) -> None:
        assert ways.in_c(tree(last=1)) == ways.python(tree(last=1))
        ways.codec.decode(wanted[0], tree())

    assert ways.in_c(seen(once_more)) == ways.in_c(seen(replace)) == wanted
    assert outcome(ways.in_c, seen(lambda made: 1 // 0))[0] is ZeroDivisionError
    with pytest.raises(CountExceeded, match="two: 1 element"):
        ways.in_c(seen(clear))
    with pytest.raises(OutOfRange, match="no attribute"):
        ways.in_c(seen(lambda made: (vars(made).clear(), gc.collect())))
    with pytest.raises(CountExceeded, match="some: 101 elements"):
        ways.in_c(seen(lambda made: made.some.extend([Leaf()] * 50)))
    for change in (once_more, replace, clear, lambda made: 1 // 0, lambda made: vars(made).clear()):
        outcome(ways.codec.decode, wanted[0], seen(change))
    assert len(calls) > 10

    def interrupt(made: Any) -> None:
        raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            ways.codec.encode(seen(interrupt), bytearray(ways.size))
        with pytest.raises(KeyboardInterrupt):
            ways.codec.decode(wanted[0], seen(interrupt))


def test_each_attribute_is_evaluated_once(tree_kind):
    """Of values out of the ordinary too: the walker in C hands them to Python as they are."""
    ways, seen = Ways(tree_kind), []

    class Counted(SimpleNamespace):
        def __getattribute__(self, name: str) -> Any:
            if not name.startswith("_"):
                seen.append(name)
            return super().__getattribute__(name)

    one = Counted(**vars(Leaf(bool_one=numpy.bool_(True), int8_one=Small.ONE, int16_some=range(3))))
    one.stamp = Counted(secs=numpy.int64(1), nsecs=numpy.int64(2))
    made = Counted(**vars(tree(data=numpy.arange(3), texts=numpy.array(["a"], object), one=one)))
    seen.clear()
    assert ways.in_c(made) == ways.python(
        tree(one=Leaf(int16_some=[0, 1, 2], stamp=time(1, 2)), data=b"\0\1\2", texts=["a"])
    )
    assert sorted(seen) == sorted([*tree_kind._names_, *type(tree_kind().one)._names_, "secs", "nsecs", "sec"])


def test_numbers_that_let_go_of_what_they_are_in(tree_kind):
    ways = Ways(tree_kind)
    made = tree(long=[0.5] * 600, one=Leaf(int32_three=[1, 2, 3]))

    def gone(_: Any) -> int:
        made.long[:], made.one.int32_three, made.one = [], [], Leaf()
        gc.collect()
        return 7

    made.one.int32_three[0] = odd(__index__=gone)
    with pytest.raises(CountExceeded, match="long: 0 elements"):
        ways.in_c(made)
    made = tree()
    made.long[3] = odd(__float__=lambda it: (made.long.clear(), gc.collect(), 0.25)[2])
    found, _ = ways.in_c(made)
    assert tree_kind.from_buffer_copy(found).long[2:5] == [0.5, 0.25, 0.5]


def test_long_arrays_are_let_go_of(tree_kind):
    """A buffer that is still held cannot grow: after success, after a later failure and after an interrupt."""
    ways = Ways(tree_kind)
    data, long = bytearray(b"ab"), array.array("d", [0.5] * 600)
    assert ways.in_c(tree(data=data, long=long)) == ways.python(tree(data=data, long=long))
    assert outcome(ways.in_c, tree(data=data, long=long, last=256))[0] is OutOfRange
    for last in (odd(__index__=lambda _: data.append(1)), odd(__index__=lambda _: next(iter(())))):
        assert outcome(ways.in_c, tree(data=data, long=long, last=last))[0] in (BufferError, OutOfRange, StopIteration)
    data.append(3)
    long.append(0.5)
    assert outcome(ways.in_c, tree(long=long))[0] is CountExceeded
    assert (
        ways.in_c(tree(data=numpy.arange(200, dtype="u1")[::2], long=numpy.full((20, 30), 0.5)))[0]
        == (ways.python(tree(data=bytes(range(0, 200, 2))))[0])
    )
    assert ways.encode(tree(two=[Leaf(), Leaf()], data=[1, 2, 3]))


@pytest.mark.slow
def test_nothing_stays_behind(tree_kind):
    ways = Ways(tree_kind)
    draw = random.Random(1)
    messages = [tree(), tree_kind(), among(tree(), draw), among(tree(), draw), tree(last=256), tree(texts=["a", 1])]
    data, _ = ways.python(tree())

    def work(times: int) -> int:
        for _ in range(times):
            for message in messages:
                outcome(ways.in_c, message)
                ways.codec.decode(data, message)
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1])

    before = work(200)
    held = [sys.getrefcount(kind) for kind in (tree_kind, type(ways.codec))]
    assert work(1000) - before < 256, "pages"
    assert engine.codec(tree_kind) is ways.codec, "made once"
    assert [sys.getrefcount(kind) for kind in (tree_kind, type(ways.codec))] == held


HERE, WIRE = "tests/runtime/test_codec.py", "tests/bridge/test_transcode.py"
LOADED = """
import sys, pytest, shmgen
shmgen.__path__.insert(0, sys.argv[1])
quiet = ["-q", "-s", "--timeout=0", "-p", "no:cacheprovider", "-p", "no:hypothesispytest"]
code = pytest.main([*quiet, "-k", sys.argv[2], *sys.argv[3:]])
from shmgen import _core
assert _core.__file__.startswith(sys.argv[1])
sys.exit(code)
"""
"""Runs tests with the extension in a folder."""
FAULTS = {
    "an integer one too large": ("objects.c", "number < INT64_C(1)", "number <= INT64_C(1)", "numbers_and"),
    "a bool of 2": ("objects.c", "number == 0 || number == 1", "number >= 0", "numbers_and"),
    "UTF-8 torn": ("table.c", "& 0xC0) == 0x80", "& 0xC0) == 0x01", "texts_and_times"),
    "UTF-16 torn": ("table.c", "& 0xFC) == 0xD8", "& 0xFC) == 0xDC", "texts_and_times"),
    "Latin-1 read as UTF-8": ("table.c", "step->code == 'u' ? PyUnicode_Decode", "true ? PyUnicode_Decode", "no_text"),
    "TIME of a set time unset": ("table.c", "words[0] = 1;", "words[0] = 0;", "texts_and_times"),
    "a duration past TIME": ("table.c", "code == 'T' || total / MILLISECOND <", "true || 0 <", "texts_and"),
    "nanoseconds too large": ("table.c", "nanos <= UINT32_MAX;", "nanos <= INT64_MAX;", "texts_and_times"),
    "an error without its path": ("table.c", "!PyErr_ExceptionMatches(self->tools[REJECTED])", "true", "texts_and"),
    "too long a list": ("objects.c", "(size_t)length > step->length || ", "", "numbers_and"),
    "too high a count of a PLC's": ("objects.c", "if (count > step->length)", "if (false)", "bytes_of_no_text"),
    "one byte behind": ("objects.c", "self->size - cleared);", "self->size - cleared + 64);", "texts_and_times"),
    "a long array's rest": ("objects.c", "memset(into, 0, (step", "memset(into, 0, 0 * (step", "long_arrays"),
    "numbers not aligned": ("wire.c", "(size - wire->at % size) % size", "0", "any_message"),
    "bytes not swapped": ("wire.c", "from[size - 1 - index]", "from[index]", "any_message"),
    "a text without its end": ("wire.c", "(ends && text[length - 1] != 0)", "false", "refused"),
    "a text past the bytes": ("wire.c", "|| length > wire->room - wire->at)\n", ")\n", "any_message"),
    "a bool of 2 from ROS": ("wire.c", "into[index] > 1", "into[index] > 2", "refused"),
    "seconds past ROS": ("wire.c", "parts[0] > (is_signed ? INT32_MAX : UINT32_MAX)", "false", "any_message"),
}  # fmt: skip
"""Planted in the extension: the file, what stands there, what then does, and who minds."""


def sanitized(folder: Path, fault: tuple[str, str, str] | None, chosen: str) -> subprocess.CompletedProcess[str]:
    """Tests of the walkers under the address and undefined-behaviour sanitizers, each object with bounds of its own."""
    sources = folder / "sources"
    runtime = REPOSITORY / "src/shmgen/runtime"
    shutil.copytree(runtime, sources / "runtime", ignore=shutil.ignore_patterns("*.py", "*pycache*"))
    if fault:
        source = sources / "runtime/extension" / fault[0]
        assert source.read_text().count(fault[1]) == 1
        source.write_text(source.read_text().replace(*fault[1:]))
    environment = sanitizers.environment(folder, sources) | ({"SHMGEN_PLANTED_FAULT": "1"} if fault else {})
    command = [sys.executable, "-c", LOADED, folder, chosen, HERE, WIRE]
    return subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_sanitizers_find_nothing(tmp_path: Path) -> None:
    done = sanitized(tmp_path, None, "not sanitizers and not behind and not planted")
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_found(tmp_path: Path, fault: str) -> None:
    *planted, chosen = FAULTS[fault]
    done = sanitized(tmp_path, tuple(planted), chosen)
    assert done.returncode != 0
    said = ("ERROR: AddressSanitizer", "runtime error", f"FAILED {HERE}::test_", f"FAILED {WIRE}::test_")
    assert any(one in done.stderr + done.stdout for one in said), done.stdout[-2000:]
