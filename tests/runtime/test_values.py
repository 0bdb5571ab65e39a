"""The helpers that generated code calls: every one with values that fit and values that do not."""

from __future__ import annotations

import array
import ctypes
import pickle
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from shmgen import runtime
from shmgen.runtime.messages import values
from shmgen.runtime.messages.values import Duration, Time

from .messages import Point

TEXT_WAYS = [
    (values.text, values.text_cut, values.from_text),
    (values.text_latin1, values.text_latin1_cut, values.from_latin1),
    (values.wide_text, values.wide_text_cut, values.from_wide),
]


def rejected(kind, path, call, *arguments, **options):
    with pytest.raises(runtime.ValueRejected) as caught:
        call(*arguments, **options)
    assert type(caught.value) is kind
    assert caught.value.path == path
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


# --- errors --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "prefix", "whole"),
    [("x", "position", "position.x"), ("x", "points[3]", "points[3].x"), ("[2]", "data", "data[2]"), ("", "a", "a")],
)
def test_inside(path, prefix, whole):
    error = runtime.OutOfRange(path, "why")
    outer = error.inside(prefix)
    assert (type(outer), outer.path, str(outer)) == (runtime.OutOfRange, whole, f"{whole}: why")
    assert error.path == path
    again = pickle.loads(pickle.dumps(outer))
    assert (again.path, again.reason) == (whole, "why")


def test_value_errors_are_value_errors():
    for kind in (runtime.StringTooLong, runtime.OutOfRange, runtime.CountExceeded):
        assert issubclass(kind, ValueError)
        assert issubclass(kind, runtime.ShmError)


# --- strings -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("encode", "cut", "decode"), TEXT_WAYS)
@pytest.mark.parametrize("value", ["", "plain", "Grüße"])
def test_text_round_trip(encode, cut, decode, value):
    data = encode(value, 8, "name")
    assert cut(value, 8, "name") == data
    assert decode(data) == decode(data + b"\0\0stale\0") == value


def test_text_capacity_is_in_bytes_characters_and_units():
    assert values.text("é" * 4, 8, "n") == "é".encode() * 4
    assert "10 bytes of UTF-8, capacity 8" in rejected(runtime.StringTooLong, "n", values.text, "é" * 5, 8, "n")
    assert values.text_latin1("é" * 8, 8, "n") == b"\xe9" * 8
    rejected(runtime.StringTooLong, "n", values.text_latin1, "é" * 9, 8, "n")
    assert values.wide_text("😀" * 4, 8, "n") == "😀".encode("utf-16-le") * 4
    assert "9 UTF-16 code units" in rejected(runtime.StringTooLong, "n", values.wide_text, "a" + "😀" * 4, 8, "n")


@pytest.mark.parametrize("cut", [values.text_cut, values.text_latin1_cut, values.wide_text_cut])
def test_what_fits_exactly_is_not_cut(cut):
    late = []
    assert cut("abc", 3, "", late) == cut("abc", 9, "", late)
    assert late == []
    assert cut("abcd", 3, "", late) == cut("abc", 3, "", late)
    assert len(late) == 1


def test_cut_before_what_would_be_torn():
    assert values.text_cut("aé😀", 6, "n").decode() == "aé"
    assert values.text_cut("aé😀", 7, "n").decode() == "aé😀"
    assert values.text_latin1_cut("abc", 2, "n") == b"ab"
    assert values.wide_text_cut("a😀", 2, "n") == "a".encode("utf-16-le")
    assert values.wide_text_cut("a😀", 3, "n") == "a😀".encode("utf-16-le")


@pytest.mark.parametrize("ways", TEXT_WAYS)
@pytest.mark.parametrize("value", ["a\0b", "\0", b"bytes", None, 5, ["x"]])
def test_no_text(ways, value):
    for call in ways[:2]:
        rejected(runtime.OutOfRange, "a.name", call, value, 80, "a.name")


def test_characters_without_encoding():
    assert "'€' at 1" in rejected(runtime.OutOfRange, "n", values.text_latin1, "5€", 8, "n")
    rejected(runtime.OutOfRange, "n", values.text, "\ud800", 8, "n")
    rejected(runtime.OutOfRange, "n", values.wide_text, "\ud800", 8, "n")


def test_reading_what_is_no_utf8():
    assert values.from_text(b"\xe9t\xe9\0") == "été"
    assert values.from_wide("a".encode("utf-16-le") + b"\0\xd8" + b"\0\0\0\xd8") == "a\ufffd"


def test_texts():
    data = values.texts(["ab", "", "é"], values.text, 3, 4, "names", at_most=3)
    assert data == b"ab\0\0" + bytes(4) + "é".encode() + b"\0\0"
    assert values.from_texts(data, values.from_text, 4) == ["ab", "", "é"]
    assert values.texts([], values.text, 3, 4, "names") == b""
    rejected(runtime.StringTooLong, "names[1]", values.texts, ["a", "long"], values.text, 3, 4, "names")
    rejected(runtime.CountExceeded, "names", values.texts, ["a"] * 4, values.text, 3, 4, "names", at_most=3)
    rejected(runtime.CountExceeded, "names", values.texts, ["a"] * 2, values.text, 3, 4, "names", exactly=3)
    rejected(runtime.OutOfRange, "names", values.texts, "abc", values.text, 3, 4, "names")
    rejected(runtime.OutOfRange, "names", values.texts, None, values.text, 3, 4, "names")


# --- times ---------------------------------------------------------------------------------------

ROS1 = SimpleNamespace(secs=12, nsecs=345_678_901)
ROS2 = SimpleNamespace(sec=12, nanosec=345_678_901)


@pytest.mark.parametrize("stamp", [ROS1, ROS2, Time(12, 345_678_901)])
def test_both_dialects(stamp):
    assert values.milliseconds(stamp, "t") == values.duration_milliseconds(stamp, "t") == 12_345
    assert values.nanoseconds(stamp, "t") == values.duration_nanoseconds(stamp, "t") == 12_345_678_901
    assert values.seconds_nanoseconds(stamp, "t") == (12, 345_678_901)


def test_time_comes_back_to_the_instant_nearest_now():
    now = time.time_ns()
    for days in (-24, -1, 0, 1, 24):
        total = (now // 10**6 + days * 86_400_000) * 10**6
        stamp = Time(*divmod(total, 10**9))
        assert values.time_from_milliseconds(values.milliseconds(stamp, "t")) == stamp


def test_unset_stays_unset_and_nothing_else_becomes_it():
    assert values.milliseconds(Time(0, 0), "t") == 0
    assert values.time_from_milliseconds(0) == Time(0, 0)
    turn = 2**32 * 10**6
    for total in (1, 999_999, turn, 400 * turn, 400 * turn + 999_999):
        assert values.milliseconds(Time(*divmod(total, 10**9)), "t") == 1
    assert values.milliseconds(Time(*divmod(turn + 10**6, 10**9)), "t") == 1
    assert values.milliseconds(Time(*divmod(turn - 1, 10**9)), "t") == 2**32 - 1


def test_duration_range():
    assert values.duration_milliseconds(Duration(4294967, 295_999_999), "d") == 2**32 - 1
    for value in (Duration(4294967, 296_000_000), Duration(-1, 999_999_999), Duration(-5, 0)):
        rejected(runtime.OutOfRange, "d", values.duration_milliseconds, value, "d")
    rejected(runtime.OutOfRange, "d", values.duration_nanoseconds, Duration(-1, 999_999_999), "d")
    rejected(runtime.OutOfRange, "t", values.nanoseconds, Time(-1, 0), "t")
    assert values.duration_from_milliseconds(2**32 - 1) == Duration(4294967, 295_000_000)
    assert values.duration_from_nanoseconds(12_345_678_901) == Duration(12, 345_678_901)
    assert values.time_from_nanoseconds(2**64 - 1) == Time(18446744073, 709551615)
    assert values.nanoseconds(Time(18446744073, 709551615), "t") == 2**64 - 1
    rejected(runtime.OutOfRange, "t", values.nanoseconds, Time(18446744073, 709551616), "t")


def test_seconds_nanoseconds_range():
    assert values.seconds_nanoseconds(Duration(-5, 7), "d") == (-5, 7)
    assert values.duration_from_seconds_nanoseconds(-5, 7) == Duration(-5, 7)
    assert values.time_from_seconds_nanoseconds(5, 7) == Time(5, 7)
    for value in (Time(2**31, 0), Time(-(2**31) - 1, 0), Time(0, -1), Time(0, 2**32)):
        rejected(runtime.OutOfRange, "d", values.seconds_nanoseconds, value, "d")


@pytest.mark.parametrize("stamp", [None, 5, SimpleNamespace(sec=1), Time(1.5, 0), SimpleNamespace(secs="1", nsecs=0)])
def test_no_stamp(stamp):
    assert "secs" in rejected(runtime.OutOfRange, "header.stamp", values.milliseconds, stamp, "header.stamp")


def test_a_duration_of_nothing_and_the_longest_ones_back():
    assert values.Duration() == (0, 0) == values.Time()
    assert values.seconds_nanoseconds(values.Duration(-(2**31), 2**32 - 1), "") == (-(2**31), 2**32 - 1)


def test_time_is_small_and_immutable():
    stamp = Time(1, 2)
    assert (stamp.secs, stamp.nsecs, Duration(3, 4).secs, Duration(3, 4).nsecs) == (1, 2, 3, 4)
    assert stamp == Time(sec=1, nanosec=2)
    assert Time() == Time(0, 0)
    with pytest.raises(AttributeError):
        stamp.sec = 5


def test_set_clock():
    for kind in (SimpleNamespace(sec=0, nanosec=0), SimpleNamespace(secs=0, nsecs=0)):
        before = set(vars(kind))
        assert values.set_clock(kind, Time(3, 4)) is kind
        assert values.set_clock(Time(1, 2), Time(3, 4)) == (3, 4)
        assert set(vars(kind)) == before
        assert list(vars(kind).values()) == [3, 4]


@pytest.mark.parametrize(
    ("code", "encode", "decode", "size"),
    [
        ("I", values.duration_milliseconds, values.duration_from_milliseconds, 4),
        ("Q", values.duration_nanoseconds, values.duration_from_nanoseconds, 8),
        ("iI", values.seconds_nanoseconds, values.duration_from_seconds_nanoseconds, 8),
    ],
)
def test_clocks(code, encode, decode, size):
    assert values.clock_size(code) == size
    stamps = [Duration(1, 0), Duration(2, 5_000_000)]
    data = values.clocks(stamps, code, encode, "times", exactly=2)
    assert len(data) == 2 * size
    assert values.from_clocks(data, code, decode) == stamps
    theirs = values.from_clocks(data, code, decode, [SimpleNamespaceStamp()])
    assert [(type(stamp), stamp.secs, stamp.nsecs) for stamp in theirs] == [
        (SimpleNamespaceStamp, 1, 0),
        (SimpleNamespaceStamp, 2, 5_000_000),
    ]
    rejected(runtime.CountExceeded, "times", values.clocks, stamps, code, encode, "times", at_most=1)
    rejected(runtime.OutOfRange, "times[1]", values.clocks, [Duration(), 5], code, encode, "times")


class SimpleNamespaceStamp:
    __slots__ = ("nsecs", "secs")

    def __init__(self):
        self.secs = self.nsecs = 0


# --- arrays of numbers ---------------------------------------------------------------------------

CODES = {"b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8}


@pytest.mark.parametrize(("code", "size"), CODES.items())
def test_integers(code, size):
    bits = 8 * size
    least, most = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if code.islower() else (0, 2**bits - 1)
    expected = struct.pack(f"<3{code}", least, most, 1)
    for value in ([least, most, 1], (least, most, 1), array.array(code, [least, most, 1])):
        data = values.numbers(value, code, size, "data", exactly=3)
        assert (data.format, bytes(data)) == ("B", expected)
        assert values.from_numbers(bytes(data), code, []) == [least, most, 1]
    for bad in (least - 1, most + 1, 1.0, "1", None):
        text = rejected(runtime.OutOfRange, "data[1]", values.numbers, [1, bad, 2], code, size, "data")
        assert f"{'' if code.islower() else 'u'}int{bits}" in text


def test_floats():
    assert bytes(values.numbers([1, 2.5], "d", 8, "data")) == struct.pack("<2d", 1, 2.5)
    assert bytes(values.numbers((1, 2.5), "f", 4, "data")) == struct.pack("<2f", 1, 2.5)
    inf = float("inf")
    assert values.from_numbers(bytes(values.numbers([inf, -inf], "f", 4, "d")), "f", []) == [inf, -inf]
    assert "float32" in rejected(runtime.OutOfRange, "data[1]", values.numbers, [0, 1e300], "f", 4, "data")
    rejected(runtime.OutOfRange, "data[0]", values.numbers, array.array("d", [1e300]), "f", 4, "data")
    rejected(runtime.OutOfRange, "data[0]", values.numbers, ["x"], "d", 8, "data")


def test_booleans():
    assert bytes(values.numbers([True, False, 1, 0], "?", 1, "b")) == b"\1\0\1\0"
    assert values.from_numbers(b"\1\0\2", "?", None) == [True, False, True]
    for bad in (2, "false", None, 0.5):
        assert "not a valid bool" in rejected(runtime.OutOfRange, "b[1]", values.numbers, [True, bad], "?", 1, "b")
    rejected(runtime.OutOfRange, "b[0]", values.numbers, b"\2", "?", 1, "b")
    for good in (True, False, 0, 1):
        assert values.boolean(good, "x") is bool(good)
    for bad in ("false", "", 2, None, 1.0):
        rejected(runtime.OutOfRange, "x", values.boolean, bad, "x")


def test_buffers_are_taken_without_a_copy():
    for owner in (bytearray(b"abc"), array.array("B", b"abc"), (ctypes.c_uint8 * 3)(*b"abc")):
        view = values.numbers(owner, "B", 1, "data", at_most=3)
        assert bytes(view) == b"abc"
        owner[0] = 122
        assert bytes(view) == b"zbc"
    assert bytes(values.numbers(b"abc", "B", 1, "data")) == b"abc"
    assert bytes(values.numbers((ctypes.c_int64 * 2)(-1, 5), "q", 8, "d")) == struct.pack("<2q", -1, 5)
    assert bytes(values.numbers((ctypes.c_bool * 2)(True, False), "?", 1, "d")) == b"\1\0"
    assert bytes(values.numbers(ctypes.create_string_buffer(b"ab", 2), "B", 1, "d")) == b"ab"
    assert bytes(values.numbers(array.array("b", [-5]), "b", 1, "d")) == b"\xfb"
    table = values.numbers(memoryview(b"abcdef").cast("B", (2, 3)), "B", 1, "d", exactly=6)
    assert (table.ndim, bytes(table)) == (1, b"abcdef")


def test_ctypes_codes_are_understood():
    """ctypes calls int64 `l` where it is a long."""
    code = ctypes.c_int64._type_
    assert bytes(values.numbers([1, -2], code, 8, "d")) == struct.pack("<2q", 1, -2)
    assert "int64" in rejected(runtime.OutOfRange, "d[0]", values.numbers, [2**63], code, 8, "d")


def test_another_element_type_is_converted_never_reinterpreted():
    assert bytes(values.numbers(array.array("i", [1, 200]), "B", 1, "d")) == b"\1\xc8"
    rejected(runtime.OutOfRange, "d[1]", values.numbers, array.array("i", [1, 300]), "B", 1, "d")
    assert bytes(values.numbers(b"\1\2\3\4", "f", 4, "d")) == struct.pack("<4f", 1, 2, 3, 4)
    assert bytes(values.numbers(array.array("f", [0.5]), "d", 8, "d")) == struct.pack("<d", 0.5)
    rejected(runtime.OutOfRange, "d[0]", values.numbers, array.array("d", [1.0]), "q", 8, "d")
    rejected(runtime.OutOfRange, "d[0]", values.numbers, array.array("B", [200]), "b", 1, "d")
    rejected(runtime.OutOfRange, "d[0]", values.numbers, array.array("b", [-5]), "B", 1, "d")
    rejected(runtime.OutOfRange, "d[0]", values.numbers, ctypes.create_string_buffer(b"ab", 2), "b", 1, "d")
    table = memoryview(bytes(16)).cast("i", (2, 2))
    rejected(runtime.OutOfRange, "d[0]", values.numbers, table, "d", 8, "d")
    assert bytes(values.numbers(range(3), "H", 2, "d")) == struct.pack("<3H", 0, 1, 2)


def test_counts_of_numbers():
    for value in ([1, 2, 3], bytearray(3), range(3)):
        assert "exactly 4" in rejected(runtime.CountExceeded, "d", values.numbers, value, "B", 1, "d", exactly=4)
        assert "bound is 2" in rejected(runtime.CountExceeded, "d", values.numbers, value, "B", 1, "d", at_most=2)
    for empty in ([], b"", array.array("d"), ()):
        assert values.numbers(empty, "d", 8, "d", at_most=2).nbytes == 0
    for bad in (None, 5, object()):
        rejected(runtime.OutOfRange, "d", values.numbers, bad, "d", 8, "d", at_most=2)
    rejected(runtime.OutOfRange, "d[0]", values.numbers, "ab", "B", 1, "d")


def test_numpy():
    np = pytest.importorskip("numpy")
    for code, kind in {"q": "i8", "Q": "u8", "d": "f8", "f": "f4", "h": "i2", "B": "u1"}.items():
        owner = np.array([1, 2, 3], kind)
        size = owner.itemsize
        view = values.numbers(owner, code, size, "d", exactly=3)
        owner[0] = 9
        assert bytes(view) == struct.pack(f"<3{code}", 9, 2, 3)
        back = values.from_numbers(bytes(view), code, np.zeros(3, kind))
        assert (type(back), back.dtype, back.tolist()) == (np.ndarray, owner.dtype, [9, 2, 3])
        back[0] = 1
    six = np.arange(6.0)
    assert bytes(values.numbers(six[::2], "d", 8, "d")) == struct.pack("<3d", 0, 2, 4)
    assert bytes(values.numbers(six.reshape(2, 3), "d", 8, "d", exactly=6)) == struct.pack("<6d", *range(6))
    assert bytes(values.numbers(six.reshape(2, 3).T, "d", 8, "d")) == struct.pack("<6d", 0, 3, 1, 4, 2, 5)
    assert bytes(values.numbers(six.astype(">f8"), "d", 8, "d")) == struct.pack("<6d", *range(6))
    assert bytes(values.numbers(six.reshape(2, 3).astype("f4"), "d", 8, "d")) == struct.pack("<6d", *range(6))
    assert bytes(values.numbers(np.array([True, False]), "?", 1, "d")) == b"\1\0"
    assert bytes(values.numbers([np.bool_(True), np.False_], "?", 1, "d")) == b"\1\0"
    assert bytes(values.numbers([np.float64(1), np.int32(2)], "d", 8, "d")) == struct.pack("<2d", 1, 2)
    assert values.numbers(np.zeros(0), "d", 8, "d", at_most=3).nbytes == 0
    assert values.numbers(np.zeros((4, 0)), "d", 8, "d", at_most=3).nbytes == 0
    assert values.from_numbers(struct.pack("<6d", *range(6)), "d", six.reshape(2, 3)).shape == (2, 3)
    rejected(runtime.OutOfRange, "d[1]", values.numbers, np.array([1, 2**40]), "i", 4, "d")
    rejected(runtime.OutOfRange, "d[0]", values.numbers, np.array([1.5]), "i", 4, "d")
    rejected(runtime.OutOfRange, "d", values.numbers, np.float64(1.5), "d", 8, "d")
    rejected(runtime.OutOfRange, "d[0]", values.numbers, np.array([1e300]), "f", 4, "d")


def test_numbers_come_back_as_what_was_there():
    data = struct.pack("<3i", 1, -2, 3)
    assert values.from_numbers(data, "i", []) == [1, -2, 3]
    assert values.from_numbers(data, "i", ()) == (1, -2, 3)
    for like in (array.array("i"), array.array("d"), None):
        back = values.from_numbers(data, "i", like)
        assert (type(back), back.typecode, list(back)) == (array.array, "i", [1, -2, 3])
    back = values.from_numbers(struct.pack("<2q", 1, 2), "q", array.array("l"))
    assert back.typecode == ("l" if array.array("l").itemsize == 8 else "q")
    assert values.from_numbers(b"ab", "B", b"") == b"ab"
    assert values.from_numbers(memoryview(b"ab"), "B", bytearray()) == bytearray(b"ab")
    assert values.from_numbers(b"", "d", []) == []
    assert values.from_numbers(b"\1\0", "?", ()) == (True, False)


def test_ndarray_without_numpy_loaded():
    code = (
        "import sys; from shmgen.runtime.messages import values;"
        "print(values.from_numbers(b'ab', 'B', None), 'numpy' in sys.modules)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "array('B', [97, 98]) False"


# --- nested messages -----------------------------------------------------------------------------


@dataclass
class ForeignPoint:
    """As rosbags makes them: no defaults."""

    x: float
    y: float
    z: float


class RosPoint:
    def __init__(self):
        self.x = self.y = self.z = 0.0


def test_each_and_back():
    scratch = bytearray(100)
    points = [ForeignPoint(1, 2, 3), Point(x=4, y=5, z=6)]
    assert values.each(points, Point._encode, scratch, 10, 24, "points", [], at_most=3) == 2
    assert struct.unpack_from("<6d", scratch, 10) == (1, 2, 3, 4, 5, 6)
    assert not any(scratch[:10])
    assert not any(scratch[58:])
    data = bytes(scratch)
    assert values.each_back(data, 10, 24, 2, Point, []) == [Point(x=1, y=2, z=3), Point(x=4, y=5, z=6)]
    kept = [ForeignPoint(0, 0, 0)] * 2
    assert values.each_back(data, 10, 24, 2, Point, kept) == [ForeignPoint(1, 2, 3), ForeignPoint(4, 5, 6)]
    assert kept == [ForeignPoint(0, 0, 0)] * 2
    assert [type(p) for p in values.each_back(data, 10, 24, 2, Point, [RosPoint()])] == [RosPoint] * 2
    assert [type(p) for p in values.each_back(data, 10, 24, 1, Point, (Point() for _ in ()) and [Point()])] == [Point]
    assert values.each_back(data, 10, 24, 0, Point, kept) == []


def test_each_says_which():
    scratch = bytearray(100)
    bad = [Point(), Point(), ForeignPoint(0, "y", 0)]
    rejected(runtime.OutOfRange, "points[2].y", values.each, bad, Point._encode, scratch, 0, 24, "points", [])
    missing = [SimpleNamespace(x=1.0, y=2.0)]
    rejected(runtime.OutOfRange, "points[0].z", values.each, missing, Point._encode, scratch, 0, 24, "points", [])
    rejected(runtime.CountExceeded, "p", values.each, bad, Point._encode, scratch, 0, 24, "p", [], at_most=2)
    rejected(runtime.CountExceeded, "p", values.each, bad, Point._encode, scratch, 0, 24, "p", [], exactly=4)
    rejected(runtime.OutOfRange, "p", values.each, None, Point._encode, scratch, 0, 24, "p", [])


def test_count_from_memory():
    assert values.count(8, 8, "data") == 8
    assert "9 elements; the bound is 8" in rejected(runtime.CountExceeded, "data", values.count, 9, 8, "data")


# --- explain -------------------------------------------------------------------------------------

ROWS = (("a", "b"), ("b.c", "d"), ("b.r", "f"), ("from", "I"), ("list", "2h"), ("s", ""))


def good():
    inner = SimpleNamespace(c=1.0, r=2.0)
    return SimpleNamespace(a=1, b=inner, from_=5, list=[1, 2], s="text")


@pytest.mark.parametrize(
    ("path", "value", "error", "said"),
    [
        ("a", 128, "", "int8 goes from -128 to 127"),
        ("a", "x", "", "'x' is str, not int8"),
        ("a", 1.0, "", "1.0 is float, not int8"),
        ("b", None, "b.c", "NoneType has no attribute 'c'"),
        ("b", SimpleNamespace(c="1", r=0), "b.c", "'1' is str, not float64"),
        ("b", SimpleNamespace(c=10**400, r=0), "b.c", "too large for float64"),
        ("b", SimpleNamespace(c=0, r=1e39), "b.r", "too large for float32"),
        ("from_", -1, "from", "uint32 goes from 0 to 4294967295"),
        ("list", [1, 2, 3], "", "exactly 2"),
        ("list", [1, 40000], "list[1]", "is not a valid int16"),
    ],
)
def test_explain_names_the_culprit(path, value, error, said):
    message = good()
    setattr(message, path, value)
    text_kind = runtime.CountExceeded if said == "exactly 2" else runtime.OutOfRange
    text = rejected(text_kind, error or path, values.explain, message, ROWS, struct.error("generic"))
    assert said in text


def test_explain_missing_and_unknown():
    message = good()
    del message.s
    assert "no attribute 's'" in rejected(runtime.OutOfRange, "s", values.explain, message, ROWS, AttributeError())
    with pytest.raises(runtime.OutOfRange, match="cannot encode SimpleNamespace: odd") as caught:
        values.explain(good(), ROWS, TypeError("odd"))
    assert isinstance(caught.value.__cause__, TypeError)
    original = runtime.StringTooLong("s", "x")
    with pytest.raises(runtime.StringTooLong) as kept:
        values.explain(good(), ROWS, original)
    assert kept.value is original


@pytest.mark.parametrize("code", "bBhHiIqQ")
def test_explain_agrees_with_struct(code):
    """Whatever pack takes is not blamed, and the first that it refuses is."""
    bits = 8 * struct.calcsize("<" + code)
    for value in (-(2**bits), -(2 ** (bits - 1)) - 1, -(2 ** (bits - 1)), -1, 0, 2 ** (bits - 1), 2**bits - 1, 2**bits):
        try:
            struct.pack("<" + code, value)
            kind = TypeError("not blamed")
        except struct.error as error:
            kind = error
        with pytest.raises(runtime.OutOfRange) as caught:
            values.explain(SimpleNamespace(v=value), [("v", code)], kind)
        assert (caught.value.path == "v") == isinstance(kind, struct.error)
