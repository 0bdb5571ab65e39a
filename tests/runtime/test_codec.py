"""The codec in C encodes and decodes each message with the same result as the walker in Python."""

from __future__ import annotations

import array
import copy
import ctypes
import gc
import os
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
from shmgen.runtime import CountExceeded, OutOfRange, Publisher, Subscriber, engine
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


def stub(**attributes: Any) -> Any:
    """Return an object with these attributes, such as special methods."""
    return type("Odd", (SimpleNamespace,), attributes)()


UNUSUAL_VALUES = (
    *(True, False, None, "1", b"1", [1], 1j, Small.ONE, type("Own", (float,), {})(1.5), type("Own", (int,), {})(7)),
    *(numpy.float64(1.5), numpy.float32(1.5), numpy.int64(7), numpy.uint8(200), numpy.bool_(True), numpy.array(3)),
    *(stub(__index__=lambda _: 5), stub(__float__=lambda _: 2.5), stub(__index__=lambda _: 1 // 0)),
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


class Walkers:
    """The walkers of one message class, in C by a publisher and a subscriber. encode() and decode() compare the two."""

    def __init__(self, kind: Any, topic: str) -> None:
        self.kind, self.size = kind, ctypes.sizeof(kind)
        self.foreign = type("Foreign", (kind,), {})  # its objects are encoded; those of `kind` are copied
        topic = f"{topic}/t{kind._digest_:x}"
        self.publisher = type("AnyPublisher", (Publisher,), {"message_type": kind})(topic)
        self.subscriber = type("AnySubscriber", (Subscriber,), {"message_type": kind})(topic)

    def in_python(self, message: Any) -> tuple[bytes, int]:
        """Return the bytes and the number of truncated texts."""
        into = bytearray(self.size)
        truncated = walker.encode(self.kind, message, into)
        return bytes(into), truncated

    def in_c(self, message: Any) -> tuple[bytes, int]:
        before = self.publisher.truncations
        self.publisher.publish(self.foreign.from_buffer_copy(message) if type(message) is self.kind else message)
        return bytes(self.subscriber.read()), self.publisher.truncations - before

    def decode_in_c(self, data: bytes, message: Any) -> None:
        self.publisher.publish(self.kind.from_buffer_copy(data))
        assert self.subscriber.read_into(message)

    def encode(self, message: Any) -> bool:
        """Encode with both walkers. Return True if they raise no error."""
        expected = outcome(self.in_python, message)
        assert outcome(self.in_c, message) == expected
        return isinstance(expected[0], bytes)

    def decode(self, data: bytes, message: Any) -> bool:
        """Decode into copies of `message` with both walkers. Return True if they raise no error."""
        by_c, expected = clone(message), clone(message)
        result = outcome(walker.decode, self.kind, data, expected)
        assert outcome(self.decode_in_c, data, by_c) == result
        if result is None:
            assert_same(by_c, expected)
        return result is None


def outcome(call: Any, *arguments: Any) -> Any:
    """Return the result or the error of a call. Remove addresses from the text, because copies have other addresses."""
    try:
        return call(*arguments)
    except Exception as error:
        return type(error), re.sub("0x[0-9a-f]+", "0x", str(error))


def assert_same(one: Any, other: Any, path: str = "") -> None:
    """Compare the types and the bits of two messages recursively."""
    assert type(one) is type(other), (path, one, other)
    match one:
        case float():
            assert struct.pack("d", one) == struct.pack("d", other), path
        case ctypes.Structure():
            assert bytes(one) == bytes(other), path
        case list():
            assert len(one) == len(other), path
            for index, pair in enumerate(zip(one, other, strict=True)):
                assert_same(*pair, f"{path}[{index}]")
        case SimpleNamespace():
            assert vars(one).keys() == vars(other).keys(), path
            for name in vars(one):
                assert_same(getattr(one, name), getattr(other, name), f"{path}.{name}")
        case numpy.ndarray():
            assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes()), path
        case array.array():
            assert (one.typecode, one.tobytes()) == (other.typecode, other.tobytes()), path
        case _:
            assert repr(one) == repr(other), path


def clone(value: Any) -> Any:
    """Copy an object, with copies of all parts that a decoder may change."""
    if isinstance(value, SimpleNamespace):
        duplicate = type(value)()
        vars(duplicate).update({name: clone(item) for name, item in vars(value).items()})
        return duplicate
    if isinstance(value, ctypes.Structure):
        return copy.deepcopy(value)
    return [clone(item) for item in value] if type(value) is list else value


def make_constructible(value: Any) -> Any:
    """Return the message with classes that need no arguments, like the classes of ROS."""
    if isinstance(value, SimpleNamespace):
        values = {name: make_constructible(item) for name, item in vars(value).items()}

        class Constructible(SimpleNamespace):
            def __init__(self) -> None:
                super().__init__(**{name: clone(item) for name, item in values.items()})

        return Constructible()
    return [make_constructible(item) for item in value] if isinstance(value, list) else value


def vary(value: Any, draw: random.Random) -> Any:
    """Return a copy of the message in which each sequence of numbers has a random type."""
    if isinstance(value, SimpleNamespace):
        duplicate = clone(value)
        vars(duplicate).update({name: vary(item, draw) for name, item in vars(value).items()})
        return duplicate
    if not isinstance(value, list) or not value or not isinstance(value[0], bool | int | float):
        return [vary(item, draw) for item in value] if isinstance(value, list) else value
    code = "d" if isinstance(value[0], float) else "q" if min(value) < 0 else "Q"
    kinds = [list, tuple, numpy.array, lambda items: array.array(code, items)]
    kinds += [bytes, bytearray] if max(value) < 256 and min(value) >= 0 and code == "Q" else []
    return draw.choice(kinds)(value)


@given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
@settings(max_examples=schemas.examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_message_encodes_and_decodes_as_in_python(schema, options, seed, tmp_path_factory, topic):
    folder = tmp_path_factory.mktemp("any")
    layouts = build.layouts_of(schema, options)
    package = f"coded_{folder.name}"
    build.put(build.texts_of(layouts, "python", package), folder)
    draw = random.Random(seed)
    for layout in layouts.values():
        kind, _, _ = build.classes(folder, package, layout.name)
        both = Walkers(kind, topic)
        for _ in range(schemas.messages(4)):
            message, target = (make_constructible(schemas.random_message(layout, layouts, draw)) for _ in "io")
            assert both.encode(message), layout.message
            both.encode(vary(message, draw))
            data, _ = both.in_python(message)
            other = kind.from_buffer_copy(data)
            foreign = type("Foreign", (kind,), {})()
            assert both.encode(other)
            for into in (target, foreign, vary(target, draw)):
                assert both.decode(data, into), layout.message
                both.decode(draw.randbytes(both.size), into)
            both.decode(data, schemas.random_message(layout, layouts, draw))
    build.forget(package)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("gcc"), reason="gcc is not installed")
@given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
@settings(max_examples=schemas.examples(8), suppress_health_check=list(HealthCheck), phases=[Phase.generate])
def test_gcc_structures_hold_the_values_of_the_walker(schema, options, seed, tmp_path_factory):
    """Do not shrink a failing schema, because each attempt runs gcc."""
    folder = tmp_path_factory.mktemp("gcc")
    layouts, package = build.layouts_of(schema, options), f"compiled_{folder.name}"
    for language in ("python", "c"):
        build.put(build.texts_of(layouts, language, package), folder)
    library, draw = c_structs.read_back(folder, layouts), random.Random(seed)
    for layout in layouts.values():
        kind, _, _ = build.classes(folder, package, layout.name)
        for _ in range(schemas.messages(4)):
            message = make_constructible(schemas.random_message(layout, layouts, draw))
            data = bytes(kind._from_object(message))
            walker.decode(kind, data, message)
            seen = c_structs.seen_by_c(library, layout, data)
            assert seen == c_structs.leaves(message, layout, layouts), layout.message
    build.forget(package)


@pytest.fixture(scope="module", params=range(len(OPTIONS)))
def trees(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    return generate_tree_module(tmp_path_factory.mktemp("trees"), f"shm_trees{request.param}", OPTIONS[request.param])


@pytest.fixture(scope="module")
def tree_kind(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return generate_tree_module(tmp_path_factory.mktemp("tree"), "shm_tree", OPTIONS[0]).Tree


def generate_tree_module(folder: Path, package: str, options: TypeOptions) -> ModuleType:
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
    root = SimpleNamespace(one=Leaf(), two=[Leaf(), Leaf(text="two")], some=[Leaf()], texts=["a", ""], wides=["b", "c"])
    vars(root).update(stamps=[time(3)], spans=[time(4), time(5)], data=b"data", long=[0.5] * 600, last=9)
    vars(root).update(changed)
    return root


@pytest.mark.slow
def test_numbers_and_sequences_of_every_kind(tree_kind, topic):
    both, accepted = Walkers(type(tree_kind().one), topic), set()
    for field in NUMBERS:
        for value in (*EDGES, *UNUSUAL_VALUES):
            both.encode(Leaf(**{f"{field}_one": value}))
            both.encode(Leaf(**{f"{field}_three": [1, value, 0]}))
        for value in (*SEQUENCES, *EDGES):
            for suffix in ("three", "some"):
                if both.encode(Leaf(**{f"{field}_{suffix}": value})):
                    accepted.add(type(value))
                both.decode(bytes(both.size), Leaf(**{f"{field}_{suffix}": value}))
    expected = {list, tuple, bytes, bytearray, memoryview, array.array, numpy.ndarray, 3 * ctypes.c_double}
    assert expected <= accepted
    assert not accepted & {type(None), int}


@pytest.mark.family("[0]")
def test_texts_and_times_of_every_kind(trees, topic):
    both = Walkers(trees.Tree, topic)
    for text in TEXTS:
        for changed in ({"text": text}, {"wide": text}):
            both.encode(tree(one=Leaf(**changed)))
        for changed in ({"texts": [text]}, {"texts": ("", text)}, {"texts": text}, {"wides": [text, "a"]}):
            both.encode(tree(**changed))
    kinds = (time, lambda *t: SimpleNamespace(secs=t[0], nsecs=t[1]), lambda *t: t, lambda *t: stub(sec=t[0]))
    for parts in TIMES:
        for kind in kinds:
            time_value = kind(*parts)
            for changed in ({"one": Leaf(stamp=time_value)}, {"one": Leaf(span=time_value)}, {"stamps": [time_value]}):
                message = tree(**changed)
                both.encode(message)
                data, _ = both.in_python(tree())
                both.decode(data, message)
    assert both.encode(tree())
    assert both.in_c(tree(stamps=[trees.Tree().one.stamp], texts=numpy.array(["a"], object)))


@pytest.mark.family("[0]")
def test_invalid_text_bool_and_count_decode_as_in_python(trees, topic):
    """Decode stale text after a NUL, invalid UTF-8, half a surrogate pair, a bool of 2, and too high counts."""
    both, draw = Walkers(trees.Tree, topic), random.Random(3)
    data, _ = both.in_python(tree(one=Leaf(text="\xc3\xa9")))  # its bytes in Latin-1 are another text in UTF-8
    assert both.decode(data, tree())
    data, _ = both.in_python(tree())
    accepted = 0
    for _ in range(200):
        damaged = bytearray(data)
        for _ in range(draw.randrange(1, 40)):
            damaged[draw.randrange(6000 if draw.random() < 0.9 else len(data)) % len(data)] = draw.choice(
                [0, 2, 216, 255]
            )
        accepted += both.decode(bytes(damaged), tree())
        both.encode(trees.Tree.from_buffer_copy(damaged))
    assert 0 < accepted < 200


@pytest.mark.slow
def test_attributes_may_run_any_code(tree_kind, topic):
    """Let attributes raise, change lists during the iteration, encode again, or release objects in use."""
    both, calls = Walkers(tree_kind, topic), []
    expected = both.in_python(tree())

    def tree_with_hook(change: Any) -> Any:
        """Return a tree whose `one.text` first calls `change`."""
        root = tree()

        class HookedLeaf(Leaf):
            @property
            def text(self) -> str:
                calls.append(change(root))
                return "bow"

            @text.setter
            def text(self, value: str) -> None:
                calls.append(change(root))

        root.one, root.two, root.some = HookedLeaf(), [HookedLeaf(), Leaf(text="two")], [HookedLeaf()]
        return root

    def clear(root: Any) -> None:
        root.two[:], root.some[:], root.texts[:], root.long[:] = [Leaf()], [], [], []
        gc.collect()

    def replace(root: Any) -> None:
        vars(root).update({name: value for name, value in vars(tree()).items() if name not in ("one", "two", "some")})

    def encode_again(root: Any) -> None:
        assert both.in_c(tree(last=1)) == both.in_python(tree(last=1))
        both.decode_in_c(expected[0], tree())

    assert both.in_c(tree_with_hook(encode_again)) == both.in_c(tree_with_hook(replace)) == expected
    assert outcome(both.in_c, tree_with_hook(lambda root: 1 // 0))[0] is ZeroDivisionError
    with pytest.raises(CountExceeded, match="two: 1 element"):
        both.in_c(tree_with_hook(clear))
    with pytest.raises(OutOfRange, match="no attribute"):
        both.in_c(tree_with_hook(lambda root: (vars(root).clear(), gc.collect())))
    with pytest.raises(CountExceeded, match="some: 101 elements"):
        both.in_c(tree_with_hook(lambda root: root.some.extend([Leaf()] * 50)))
    for change in (encode_again, replace, clear, lambda root: 1 // 0, lambda root: vars(root).clear()):
        outcome(both.decode_in_c, expected[0], tree_with_hook(change))
    assert len(calls) > 10

    def interrupt(root: Any) -> None:
        raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            both.in_c(tree_with_hook(interrupt))
        with pytest.raises(KeyboardInterrupt):
            both.decode_in_c(expected[0], tree_with_hook(interrupt))


def test_attributes_are_evaluated_once(tree_kind, topic):
    """Evaluate unusual values once as well: the walker in C passes them to Python unchanged."""
    both, seen = Walkers(tree_kind, topic), []

    class Counted(SimpleNamespace):
        def __getattribute__(self, name: str) -> Any:
            if not name.startswith("_"):
                seen.append(name)
            return super().__getattribute__(name)

    one = Counted(**vars(Leaf(bool_one=numpy.bool_(True), int8_one=Small.ONE, int16_some=range(3))))
    one.stamp = Counted(secs=numpy.int64(1), nsecs=numpy.int64(2))
    root = Counted(**vars(tree(data=numpy.arange(3), texts=numpy.array(["a"], object), one=one)))
    seen.clear()
    assert both.in_c(root) == both.in_python(
        tree(one=Leaf(int16_some=[0, 1, 2], stamp=time(1, 2)), data=b"\0\1\2", texts=["a"])
    )
    assert sorted(seen) == sorted([*tree_kind._names_, *type(tree_kind().one)._names_, "secs", "nsecs", "sec"])


def test_number_conversion_may_clear_its_own_list(tree_kind, topic):
    both = Walkers(tree_kind, topic)
    root = tree(long=[0.5] * 600, one=Leaf(int32_three=[1, 2, 3]))

    def clear_lists(_: Any) -> int:
        root.long[:], root.one.int32_three, root.one = [], [], Leaf()
        gc.collect()
        return 7

    root.one.int32_three[0] = stub(__index__=clear_lists)
    with pytest.raises(CountExceeded, match="long: 0 elements"):
        both.in_c(root)
    root = tree()
    root.long[3] = stub(__float__=lambda it: (root.long.clear(), gc.collect(), 0.25)[2])
    data, _ = both.in_c(root)
    assert tree_kind.from_buffer_copy(data).long[2:5] == [0.5, 0.25, 0.5]


def test_long_arrays_are_released_after_encoding(tree_kind, topic):
    """Release buffers after success, a later failure and an interrupt. An array in use as a buffer cannot grow."""
    both = Walkers(tree_kind, topic)
    data, long = bytearray(b"ab"), array.array("d", [0.5] * 600)
    assert both.in_c(tree(data=data, long=long)) == both.in_python(tree(data=data, long=long))
    assert outcome(both.in_c, tree(data=data, long=long, last=256))[0] is OutOfRange
    for last in (stub(__index__=lambda _: data.append(1)), stub(__index__=lambda _: next(iter(())))):
        assert outcome(both.in_c, tree(data=data, long=long, last=last))[0] in (BufferError, OutOfRange, StopIteration)
    data.append(3)
    long.append(0.5)
    assert outcome(both.in_c, tree(long=long))[0] is CountExceeded
    assert (
        both.in_c(tree(data=numpy.arange(200, dtype="u1")[::2], long=numpy.full((20, 30), 0.5)))[0]
        == (both.in_python(tree(data=bytes(range(0, 200, 2))))[0])
    )
    assert both.encode(tree(two=[Leaf(), Leaf()], data=[1, 2, 3]))


@pytest.mark.slow
def test_codec_leaks_no_memory(tree_kind, topic):
    both, codec = Walkers(tree_kind, topic), engine.codec(tree_kind)
    draw = random.Random(1)
    messages = [tree(), tree_kind(), vary(tree(), draw), vary(tree(), draw), tree(last=256), tree(texts=["a", 1])]
    data, _ = both.in_python(tree())

    def repeat(times: int) -> int:
        for _ in range(times):
            for message in messages:
                outcome(both.in_c, message)
                both.decode_in_c(data, message)
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1])

    before = repeat(200)
    references = [sys.getrefcount(kind) for kind in (tree_kind, type(codec))]
    assert repeat(1000) - before < 256, "pages"
    assert engine.codec(tree_kind) is codec, "created once"
    assert [sys.getrefcount(kind) for kind in (tree_kind, type(codec))] == references


HERE, WIRE = "tests/runtime/test_codec.py", "tests/bridge/test_transcode.py"
RUN_TESTS = """
import sys, pytest, shmgen
shmgen.__path__.insert(0, sys.argv[1])
quiet = ["-q", "-s", "--timeout=0", "-p", "no:cacheprovider", "-p", "no:hypothesispytest"]
code = pytest.main([*quiet, "-k", sys.argv[2], *sys.argv[3:]])
from shmgen import _core
assert _core.__file__.startswith(sys.argv[1])
sys.exit(code)
"""
"""A program that runs tests with the extension from a folder."""
FAULTS = {
    "an integer one too large": ("objects.c", "number < INT64_C(1)", "number <= INT64_C(1)", "numbers_and"),
    "a bool of 2": ("objects.c", "number == 0 || number == 1", "number >= 0", "numbers_and"),
    "UTF-8 torn": ("table.c", "& 0xC0) == 0x80", "& 0xC0) == 0x01", "texts_and_times"),
    "UTF-16 torn": ("table.c", "& 0xFC) == 0xD8", "& 0xFC) == 0xDC", "texts_and_times"),
    "Latin-1 read as UTF-8": ("table.c", "step->code == 'u' ? PyUnicode_Decode", "true ? PyUnicode_Decode", "bool_and"),
    "TIME of a set time unset": ("table.c", "words[0] = 1;", "words[0] = 0;", "texts_and_times"),
    "a duration past TIME": ("table.c", "code == 'T' || total / MILLISECOND <", "true || 0 <", "texts_and"),
    "nanoseconds too large": ("table.c", "nanos <= UINT32_MAX;", "nanos <= INT64_MAX;", "texts_and_times"),
    "an error without its path": ("table.c", "!PyErr_ExceptionMatches(self->tools[REJECTED])", "true", "texts_and"),
    "too long a list": ("objects.c", "(size_t)length > step->length || ", "", "numbers_and"),
    "too high a count of a PLC's": ("objects.c", "if (count > step->length)", "if (false)", "invalid_text"),
    "one byte past the end": ("objects.c", "self->size - cleared);", "self->size - cleared + 64);", "texts_and_times"),
    "a long array's rest": ("objects.c", "memset(into, 0, (step", "memset(into, 0, 0 * (step", "long_arrays"),
    "numbers not aligned": ("wire.c", "(size - wire->at % size) % size", "0", "codecs_equal or genpy"),
    "bytes not swapped": ("wire.c", "from[size - 1 - index]", "from[index]", "codecs_equal or genpy"),
    "a text without its end": ("wire.c", "(ends && text[length - 1] != 0)", "false", "refused"),
    "a text past the bytes": ("wire.c", "|| length > wire->room - wire->at)\n", ")\n", "codecs_equal or genpy"),
    "a bool of 2 from ROS": ("wire.c", "memory[index] > 1", "memory[index] > 2", "refused"),
    "seconds past ROS": ("wire.c", "parts[0] > (is_signed ? INT32_MAX : UINT32_MAX)", "false", "codecs_equal or genpy"),
}  # fmt: skip
"""Faults to plant in the extension: the file, the old text, the new text, and the tests that detect the fault."""


def run_sanitized(folder: Path, fault: tuple[str, str, str] | None, selection: str) -> subprocess.CompletedProcess[str]:
    """Run tests with the address and undefined-behaviour sanitizers, which check the bounds of each object."""
    sources = folder / "sources"
    runtime = REPOSITORY / "src/shmgen/runtime"
    shutil.copytree(runtime, sources / "runtime", ignore=shutil.ignore_patterns("*.py", "*pycache*"))
    if fault:
        source = sources / "runtime/extension" / fault[0]
        assert source.read_text().count(fault[1]) == 1
        source.write_text(source.read_text().replace(*fault[1:]))
    environment = sanitizers.environment(folder, sources) | ({"SHMGEN_PLANTED_FAULT": "1"} if fault else {})
    command = [sys.executable, "-c", RUN_TESTS, folder, selection, HERE, WIRE]
    return subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.slow
@pytest.mark.timeout(0 if "SHMGEN_EXAMPLES" in os.environ else 900)  # make fuzz-walkers takes longer
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    done = run_sanitized(tmp_path, None, "not sanitizers and not leaks and not planted")
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]


@pytest.mark.sample("[one byte past the end]", "[a bool of 2]", "[an error without its path]")
@pytest.mark.parametrize("fault", FAULTS)
def test_planted_fault_is_detected(tmp_path: Path, fault: str) -> None:
    *change, selection = FAULTS[fault]
    done = run_sanitized(tmp_path, tuple(change), selection)
    assert done.returncode != 0
    reports = ("ERROR: AddressSanitizer", "runtime error", f"FAILED {HERE}::test_", f"FAILED {WIRE}::test_")
    assert any(report in done.stderr + done.stdout for report in reports), done.stdout[-2000:]
