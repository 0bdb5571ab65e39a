"""Each part of the walker encodes and decodes valid values, and rejects invalid values."""

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
from shmgen.runtime.messages import walker
from shmgen.runtime.messages.numbers import boolean, check, decode_numbers, encode_numbers
from shmgen.runtime.messages.steps import CODES, STRUCTS, Step
from shmgen.runtime.messages.strings import TEXTS, decode_text, encode_text
from shmgen.runtime.messages.times import CLOCKS, Duration, Time, decode_clock, encode_clock, set_clock

from ..support import import_or_skip
from .messages import Point

KINDS = {code: kind for kind, code in CODES.items()}


def pack(value, code, size, path, *, exactly=None, at_most=99):
    assert STRUCTS[KINDS[code]].size == size
    return encode_numbers(KINDS[code], value, at_most if exactly is None else exactly, exactly is not None, path)


def unpack(data, code, like):
    return decode_numbers(data, KINDS[code], like)


def encode(kind, value, path):
    """Encode a time, and return its numbers."""
    return CLOCKS[kind].packed.unpack(encode_clock(kind, value, path))


def text(kind, value, capacity, path):
    return encode_text(kind, value, (capacity + 1) * (2 if kind.startswith("utf-16") else 1), path)


def get_error(kind, path, call, *arguments, **options):
    with pytest.raises(runtime.ValueRejected) as caught:
        call(*arguments, **options)
    assert type(caught.value) is kind
    assert caught.value.path == path
    assert str(caught.value).startswith(f"{path}: ")
    return str(caught.value)


# --- errors --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "prefix", "full_path"),
    [("x", "position", "position.x"), ("x", "points[3]", "points[3].x"), ("[2]", "data", "data[2]"), ("", "a", "a")],
)
def test_inside_prefixes_the_path(path, prefix, full_path):
    error = runtime.OutOfRange(path, "why")
    outer = error.inside(prefix)
    assert (type(outer), outer.path, str(outer)) == (runtime.OutOfRange, full_path, f"{full_path}: why")
    assert error.path == path
    copy = pickle.loads(pickle.dumps(outer))
    assert (copy.path, copy.reason) == (full_path, "why")


def test_errors_of_values_are_value_errors():
    for kind in (runtime.StringTooLong, runtime.OutOfRange, runtime.CountExceeded):
        assert issubclass(kind, ValueError)
        assert issubclass(kind, runtime.ShmError)


# --- strings -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("value", ["", "plain", "Grüße"])
def test_text_round_trip(kind, value):
    data, truncated = text(kind, value, 8, "name")
    assert not truncated
    assert decode_text(kind, data) == decode_text(kind, data + b"\0\0stale\0") == value


def test_text_capacity_is_in_bytes_characters_or_code_units():
    assert text("utf-8", "é" * 4, 8, "n") == ("é".encode() * 4, False)
    assert "10 bytes of UTF-8, capacity 8" in get_error(runtime.StringTooLong, "n", text, "utf-8", "é" * 5, 8, "n")
    assert text("latin-1", "é" * 8, 8, "n") == (b"\xe9" * 8, False)
    assert "9 characters, capacity 8" in get_error(runtime.StringTooLong, "n", text, "latin-1", "é" * 9, 8, "n")
    assert text("utf-16", "😀" * 4, 8, "n") == ("😀".encode("utf-16-le") * 4, False)
    assert "9 UTF-16 code units" in get_error(runtime.StringTooLong, "n", text, "utf-16", "a" + "😀" * 4, 8, "n")


@pytest.mark.parametrize("kind", ["utf-8", "latin-1", "utf-16"])
def test_text_of_exact_capacity_is_not_truncated(kind):
    truncating = f"{kind} truncated"
    assert text(truncating, "abc", 3, "") == text(truncating, "abc", 9, "") == text(kind, "abc", 3, "")
    assert text(truncating, "abcd", 3, "") == (text(kind, "abc", 3, "")[0], True)


def test_truncation_keeps_whole_characters():
    assert text("utf-8 truncated", "aé😀", 6, "n")[0].decode() == "aé"
    assert text("utf-8 truncated", "aé😀", 7, "n")[0].decode() == "aé😀"
    assert text("latin-1 truncated", "abc", 2, "n") == (b"ab", True)
    assert text("utf-16 truncated", "a😀", 2, "n") == ("a".encode("utf-16-le"), True)
    assert text("utf-16 truncated", "a😀", 3, "n") == ("a😀".encode("utf-16-le"), False)


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("value", ["a\0b", "\0", b"bytes", None, 5, ["x"]])
def test_invalid_text_is_rejected(kind, value):
    get_error(runtime.OutOfRange, "a.name", text, kind, value, 80, "a.name")


def test_character_outside_the_encoding_is_rejected():
    assert "'€' at 1" in get_error(runtime.OutOfRange, "n", text, "latin-1", "5€", 8, "n")
    get_error(runtime.OutOfRange, "n", text, "utf-8", "\ud800", 8, "n")
    get_error(runtime.OutOfRange, "n", text, "utf-16", "\ud800", 8, "n")


def test_invalid_utf8_and_utf16_are_decoded():
    assert decode_text("utf-8", b"\xe9t\xe9\0") == "été"
    assert decode_text("utf-16", "a".encode("utf-16-le") + b"\0\xd8" + b"\0\0\0\xd8") == "a\ufffd"


def encode_list(kind, size, length, values, *, fixed=False):
    """Return the number of elements of an array, and the bytes of the elements."""
    into = bytearray(size * length)
    step = Step("names", kind, 0, size, length, -1 if fixed else 99)
    return walker.encode_array(step, values, into, 0)[0], bytes(into)


def test_arrays_of_texts_are_encoded_and_decoded():
    count, data = encode_list("utf-8", 4, 3, ["ab", "", "é"])
    assert (count, data) == (3, b"ab\0\0" + bytes(4) + "é".encode() + b"\0\0")
    assert walker.decode_elements(Step("names", "utf-8", 0, 4, 3), data, 0, 3, ()) == ["ab", "", "é"]
    assert encode_list("utf-8", 4, 3, []) == (0, bytes(12))
    get_error(runtime.StringTooLong, "names[1]", encode_list, "utf-8", 4, 3, ["a", "long"])
    get_error(runtime.CountExceeded, "names", encode_list, "utf-8", 4, 3, ["a"] * 4)
    get_error(runtime.CountExceeded, "names", encode_list, "utf-8", 4, 3, ["a"] * 2, fixed=True)
    get_error(runtime.OutOfRange, "names", encode_list, "utf-8", 4, 3, "abc")
    get_error(runtime.OutOfRange, "names", encode_list, "utf-8", 4, 3, None)


# --- times ---------------------------------------------------------------------------------------

ROS1 = SimpleNamespace(secs=12, nsecs=345_678_901)
ROS2 = SimpleNamespace(sec=12, nanosec=345_678_901)


@pytest.mark.parametrize("stamp", [ROS1, ROS2, Time(12, 345_678_901)])
def test_ros1_and_ros2_stamps_are_encoded_alike(stamp):
    assert encode("time ms", stamp, "t") == encode("duration ms", stamp, "t") == (12_345,)
    assert encode("time ns", stamp, "t") == encode("duration ns", stamp, "t") == (12_345_678_901,)
    assert encode("time s+ns", stamp, "t") == (12, 345_678_901)


def test_time_in_milliseconds_is_decoded_near_now():
    now = time.time_ns()
    for days in (-24, -1, 0, 1, 24):
        total = (now // 10**6 + days * 86_400_000) * 10**6
        stamp = Time(*divmod(total, 10**9))
        assert decode_clock("time ms", encode_clock("time ms", stamp, "t")) == stamp


def test_only_an_unset_time_is_encoded_as_zero():
    assert encode("time ms", Time(0, 0), "t") == (0,)
    assert decode_clock("time ms", bytes(4)) == Time(0, 0)
    wrap = 2**32 * 10**6
    for total in (1, 999_999, wrap, 400 * wrap, 400 * wrap + 999_999):
        assert encode("time ms", Time(*divmod(total, 10**9)), "t") == (1,)
    assert encode("time ms", Time(*divmod(wrap + 10**6, 10**9)), "t") == (1,)
    assert encode("time ms", Time(*divmod(wrap - 1, 10**9)), "t") == (2**32 - 1,)


def test_ranges_of_duration_and_time_are_checked():
    assert encode("duration ms", Duration(4294967, 295_999_999), "d") == (2**32 - 1,)
    for value in (Duration(4294967, 296_000_000), Duration(-1, 999_999_999), Duration(-5, 0)):
        get_error(runtime.OutOfRange, "d", encode, "duration ms", value, "d")
    get_error(runtime.OutOfRange, "d", encode, "duration ns", Duration(-1, 999_999_999), "d")
    get_error(runtime.OutOfRange, "t", encode, "time ns", Time(-1, 0), "t")
    assert decode_clock("duration ms", b"\xff" * 4) == Duration(4294967, 295_000_000)
    assert decode_clock("duration ns", struct.pack("<Q", 12_345_678_901)) == Duration(12, 345_678_901)
    assert decode_clock("time ns", b"\xff" * 8) == Time(18446744073, 709551615)
    assert encode("time ns", Time(18446744073, 709551615), "t") == (2**64 - 1,)
    get_error(runtime.OutOfRange, "t", encode, "time ns", Time(18446744073, 709551616), "t")


def test_ranges_of_seconds_and_nanoseconds_are_checked():
    assert encode("duration s+ns", Duration(-5, 7), "d") == (-5, 7)
    assert decode_clock("duration s+ns", struct.pack("<iI", -5, 7)) == Duration(-5, 7)
    assert decode_clock("time s+ns", struct.pack("<iI", 5, 7)) == Time(5, 7)
    for value in (Time(2**31, 0), Time(-(2**31) - 1, 0), Time(0, -1), Time(0, 2**32)):
        get_error(runtime.OutOfRange, "d", encode, "time s+ns", value, "d")


@pytest.mark.parametrize("stamp", [None, 5, SimpleNamespace(sec=1), Time(1.5, 0), SimpleNamespace(secs="1", nsecs=0)])
def test_invalid_stamp_is_rejected(stamp):
    assert "secs" in get_error(runtime.OutOfRange, "header.stamp", encode, "time ms", stamp, "header.stamp")


def test_default_duration_is_zero_and_the_lowest_is_encoded():
    assert Duration() == (0, 0) == Time()
    assert encode("duration s+ns", Duration(-(2**31), 2**32 - 1), "") == (-(2**31), 2**32 - 1)


def test_time_is_immutable_and_has_both_field_names():
    stamp = Time(1, 2)
    assert (stamp.secs, stamp.nsecs, Duration(3, 4).secs, Duration(3, 4).nsecs) == (1, 2, 3, 4)
    assert stamp == Time(sec=1, nanosec=2)
    assert Time() == Time(0, 0)
    with pytest.raises(AttributeError):
        stamp.sec = 5


def test_set_clock_sets_stamps_of_ros1_and_ros2():
    for kind in (SimpleNamespace(sec=0, nanosec=0), SimpleNamespace(secs=0, nsecs=0)):
        before = set(vars(kind))
        assert set_clock(kind, Time(3, 4)) is kind
        assert set_clock(Time(1, 2), Time(3, 4)) == (3, 4)
        assert set(vars(kind)) == before
        assert list(vars(kind).values()) == [3, 4]


@pytest.mark.parametrize(("kind", "size"), [("duration ms", 4), ("duration ns", 8), ("duration s+ns", 8)])
def test_arrays_of_durations_are_encoded_and_decoded(kind, size):
    assert CLOCKS[kind].packed.size == size
    stamps = [Duration(1, 0), Duration(2, 5_000_000)]
    count, data = encode_list(kind, size, 2, stamps, fixed=True)
    step = Step("names", kind, 0, size, 2)
    assert count == 2
    assert walker.decode_array(step, data, 0, []) == stamps
    theirs = walker.decode_array(step, data, 0, [SimpleNamespaceStamp()])
    assert [(type(stamp), stamp.secs, stamp.nsecs) for stamp in theirs] == [
        (SimpleNamespaceStamp, 1, 0),
        (SimpleNamespaceStamp, 2, 5_000_000),
    ]
    get_error(runtime.CountExceeded, "names", encode_list, kind, size, 1, stamps)
    get_error(runtime.OutOfRange, "names[1]", encode_list, kind, size, 2, [Duration(), 5])


class SimpleNamespaceStamp:
    __slots__ = ("nsecs", "secs")

    def __init__(self):
        self.secs = self.nsecs = 0


# --- arrays of numbers ---------------------------------------------------------------------------

SIZES = {"b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8}


@pytest.mark.parametrize(("code", "size"), SIZES.items())
def test_integers_are_packed_and_checked(code, size):
    bits = 8 * size
    lowest, highest = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if code.islower() else (0, 2**bits - 1)
    expected = struct.pack(f"<3{code}", lowest, highest, 1)
    for value in ([lowest, highest, 1], (lowest, highest, 1), array.array(code, [lowest, highest, 1])):
        data = pack(value, code, size, "data", exactly=3)
        assert (data.format, bytes(data)) == ("B", expected)
        assert unpack(bytes(data), code, []) == [lowest, highest, 1]
    for bad in (lowest - 1, highest + 1, 1.0, "1", None):
        text = get_error(runtime.OutOfRange, "data[1]", pack, [1, bad, 2], code, size, "data")
        assert f"{'' if code.islower() else 'u'}int{bits}" in text


def test_floats_are_packed_and_checked():
    assert bytes(pack([1, 2.5], "d", 8, "data")) == struct.pack("<2d", 1, 2.5)
    assert bytes(pack((1, 2.5), "f", 4, "data")) == struct.pack("<2f", 1, 2.5)
    inf = float("inf")
    assert unpack(bytes(pack([inf, -inf], "f", 4, "d")), "f", []) == [inf, -inf]
    assert "float32" in get_error(runtime.OutOfRange, "data[1]", pack, [0, 1e300], "f", 4, "data")
    get_error(runtime.OutOfRange, "data[0]", pack, array.array("d", [1e300]), "f", 4, "data")
    get_error(runtime.OutOfRange, "data[0]", pack, ["x"], "d", 8, "data")


def test_booleans_are_packed_and_checked():
    assert bytes(pack([True, False, 1, 0], "?", 1, "b")) == b"\1\0\1\0"
    assert unpack(b"\1\0\2", "?", None) == [True, False, True]
    for bad in (2, "false", None, 0.5):
        assert "not a valid bool" in get_error(runtime.OutOfRange, "b[1]", pack, [True, bad], "?", 1, "b")
    get_error(runtime.OutOfRange, "b[0]", pack, b"\2", "?", 1, "b")
    for good in (True, False, 0, 1):
        assert boolean(good, "x") is bool(good)
    for bad in ("false", "", 2, None, 1.0):
        get_error(runtime.OutOfRange, "x", boolean, bad, "x")


def test_buffers_are_used_without_a_copy():
    for owner in (bytearray(b"abc"), array.array("B", b"abc"), (ctypes.c_uint8 * 3)(*b"abc")):
        view = pack(owner, "B", 1, "data", at_most=3)
        assert bytes(view) == b"abc"
        owner[0] = 122
        assert bytes(view) == b"zbc"
    assert bytes(pack(b"abc", "B", 1, "data")) == b"abc"
    assert bytes(pack((ctypes.c_int64 * 2)(-1, 5), "q", 8, "d")) == struct.pack("<2q", -1, 5)
    assert bytes(pack((ctypes.c_bool * 2)(True, False), "?", 1, "d")) == b"\1\0"
    assert bytes(pack(ctypes.create_string_buffer(b"ab", 2), "B", 1, "d")) == b"ab"
    assert bytes(pack(array.array("b", [-5]), "b", 1, "d")) == b"\xfb"
    table = pack(memoryview(b"abcdef").cast("B", (2, 3)), "B", 1, "d", exactly=6)
    assert (table.ndim, bytes(table)) == (1, b"abcdef")


def test_other_element_type_is_converted_not_reinterpreted():
    assert bytes(pack(array.array("i", [1, 200]), "B", 1, "d")) == b"\1\xc8"
    get_error(runtime.OutOfRange, "d[1]", pack, array.array("i", [1, 300]), "B", 1, "d")
    assert bytes(pack(b"\1\2\3\4", "f", 4, "d")) == struct.pack("<4f", 1, 2, 3, 4)
    assert bytes(pack(array.array("f", [0.5]), "d", 8, "d")) == struct.pack("<d", 0.5)
    get_error(runtime.OutOfRange, "d[0]", pack, array.array("d", [1.0]), "q", 8, "d")
    get_error(runtime.OutOfRange, "d[0]", pack, array.array("B", [200]), "b", 1, "d")
    get_error(runtime.OutOfRange, "d[0]", pack, array.array("b", [-5]), "B", 1, "d")
    get_error(runtime.OutOfRange, "d[0]", pack, ctypes.create_string_buffer(b"ab", 2), "b", 1, "d")
    table = memoryview(bytes(16)).cast("i", (2, 2))
    get_error(runtime.OutOfRange, "d[0]", pack, table, "d", 8, "d")
    assert bytes(pack(range(3), "H", 2, "d")) == struct.pack("<3H", 0, 1, 2)


def test_count_of_numbers_is_checked():
    for value in ([1, 2, 3], bytearray(3), range(3)):
        assert "exactly 4" in get_error(runtime.CountExceeded, "d", pack, value, "B", 1, "d", exactly=4)
        assert "bound is 2" in get_error(runtime.CountExceeded, "d", pack, value, "B", 1, "d", at_most=2)
    for empty in ([], b"", array.array("d"), ()):
        assert pack(empty, "d", 8, "d", at_most=2).nbytes == 0
    for bad in (None, 5, object()):
        get_error(runtime.OutOfRange, "d", pack, bad, "d", 8, "d", at_most=2)
    get_error(runtime.OutOfRange, "d[0]", pack, "ab", "B", 1, "d")


def test_numpy_arrays_are_packed_and_unpacked():
    np = import_or_skip("numpy")
    for code, kind in {"q": "i8", "Q": "u8", "d": "f8", "f": "f4", "h": "i2", "B": "u1"}.items():
        owner = np.array([1, 2, 3], kind)
        size = owner.itemsize
        view = pack(owner, code, size, "d", exactly=3)
        owner[0] = 9
        assert bytes(view) == struct.pack(f"<3{code}", 9, 2, 3)
        back = unpack(bytes(view), code, np.zeros(3, kind))
        assert (type(back), back.dtype, back.tolist()) == (np.ndarray, owner.dtype, [9, 2, 3])
        back[0] = 1
    six = np.arange(6.0)
    assert bytes(pack(six[::2], "d", 8, "d")) == struct.pack("<3d", 0, 2, 4)
    assert bytes(pack(six.reshape(2, 3), "d", 8, "d", exactly=6)) == struct.pack("<6d", *range(6))
    assert bytes(pack(six.reshape(2, 3).T, "d", 8, "d")) == struct.pack("<6d", 0, 3, 1, 4, 2, 5)
    assert bytes(pack(six.astype(">f8"), "d", 8, "d")) == struct.pack("<6d", *range(6))
    assert bytes(pack(six.reshape(2, 3).astype("f4"), "d", 8, "d")) == struct.pack("<6d", *range(6))
    assert bytes(pack(np.array([True, False]), "?", 1, "d")) == b"\1\0"
    assert bytes(pack([np.bool_(True), np.False_], "?", 1, "d")) == b"\1\0"
    assert bytes(pack([np.float64(1), np.int32(2)], "d", 8, "d")) == struct.pack("<2d", 1, 2)
    assert pack(np.zeros(0), "d", 8, "d", at_most=3).nbytes == 0
    assert pack(np.zeros((4, 0)), "d", 8, "d", at_most=3).nbytes == 0
    assert unpack(struct.pack("<6d", *range(6)), "d", six.reshape(2, 3)).shape == (2, 3)
    get_error(runtime.OutOfRange, "d[1]", pack, np.array([1, 2**40]), "i", 4, "d")
    get_error(runtime.OutOfRange, "d[0]", pack, np.array([1.5]), "i", 4, "d")
    get_error(runtime.OutOfRange, "d", pack, np.float64(1.5), "d", 8, "d")
    get_error(runtime.OutOfRange, "d[0]", pack, np.array([1e300]), "f", 4, "d")


def test_numbers_are_decoded_into_the_type_of_the_field():
    data = struct.pack("<3i", 1, -2, 3)
    assert unpack(data, "i", []) == [1, -2, 3]
    assert unpack(data, "i", ()) == (1, -2, 3)
    for like in (array.array("i"), array.array("d"), None):
        back = unpack(data, "i", like)
        assert (type(back), back.typecode, list(back)) == (array.array, "i", [1, -2, 3])
    back = unpack(struct.pack("<2q", 1, 2), "q", array.array("l"))
    assert back.typecode == ("l" if array.array("l").itemsize == 8 else "q")
    assert unpack(b"ab", "B", b"") == b"ab"
    assert unpack(memoryview(b"ab"), "B", bytearray()) == bytearray(b"ab")
    assert unpack(b"", "d", []) == []
    assert unpack(b"\1\0", "?", ()) == (True, False)


def test_decoding_does_not_import_numpy():
    code = (
        "import sys; from shmgen.runtime.messages.numbers import decode_numbers;"
        "print(decode_numbers(b'ab', 'uint8', None), 'numpy' in sys.modules)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "array('B', [97, 98]) False"


# --- nested messages -----------------------------------------------------------------------------


@dataclass
class ForeignPoint:
    """A point without defaults, like the classes of rosbags."""

    x: float
    y: float
    z: float


class RosPoint:
    def __init__(self):
        self.x = self.y = self.z = 0.0


POINTS = Step("points", Point, 4, 24, 3, 0)


def test_arrays_of_messages_are_encoded_and_decoded():
    scratch = bytearray(100)
    points = [ForeignPoint(1, 2, 3), Point(x=4, y=5, z=6)]
    assert walker.encode_array(POINTS, points, scratch, 10) == (2, 0)
    assert struct.unpack_from("<6d", scratch, 10) == (1, 2, 3, 4, 5, 6)
    assert not any(scratch[:10])
    assert not any(scratch[58:])

    def decode(like, count=2):
        return walker.decode_array(POINTS, struct.pack("<I", count) + bytes(scratch[10:]), 0, like)

    assert decode([]) == [Point(x=1, y=2, z=3), Point(x=4, y=5, z=6)]
    existing = [ForeignPoint(0, 0, 0)] * 2
    assert decode(existing) == [ForeignPoint(1, 2, 3), ForeignPoint(4, 5, 6)]
    assert existing == [ForeignPoint(0, 0, 0)] * 2
    assert [type(p) for p in decode([RosPoint()])] == [RosPoint] * 2
    assert [type(p) for p in decode([Point()], 1)] == [Point]
    assert decode(existing, 0) == []
    assert "4 elements; the bound is 3" in get_error(runtime.CountExceeded, "points", decode, [], 4)


def test_error_names_the_invalid_message_of_an_array():
    def encode(points, **changes):
        walker.encode_array(POINTS._replace(**changes), points, bytearray(100), 4)

    bad = [Point(), Point(), ForeignPoint(0, "y", 0)]
    get_error(runtime.OutOfRange, "points[2].y", encode, bad)
    get_error(runtime.OutOfRange, "points[0].z", encode, [SimpleNamespace(x=1.0, y=2.0)])
    get_error(runtime.CountExceeded, "points", encode, bad, length=2)
    get_error(runtime.CountExceeded, "points", encode, bad, length=4, count_at=-1)
    get_error(runtime.OutOfRange, "points", encode, None)


class Uncertain:
    """A sequence whose len() differs from its number of elements."""

    def __len__(self):
        return 3

    def __iter__(self):
        return iter([1])


@pytest.mark.parametrize("kind", ["uint8", "float64", "utf-8", "time ns", Point])
def test_sequence_with_a_wrong_length_is_rejected(kind):
    step = Step("some", kind, 8, 24 if kind is Point else 8, 5, 0)
    error = get_error(runtime.OutOfRange, "some", walker.encode_array, step, Uncertain(), bytearray(200), 8)
    assert "len() returns 3 elements, but an iteration yields 1" in error


# --- errors of single numbers ----------------------------------------------------------------------


class Good(runtime.Message):
    _table_version_ = 1
    _size_ = 40
    _steps_ = (
        ("a", "int8", 0, 1),
        ("d", "float64", 8, 8),
        ("r", "float32", 16, 4),
        ("from_", "uint32", 20, 4),
        ("list", "int16", 24, 2, 2),
        ("s", "utf-8", 28, 5),
    )


@pytest.mark.parametrize(
    ("path", "value", "error", "reason"),
    [
        ("a", 128, "", "int8 goes from -128 to 127"),
        ("a", "x", "", "'x' is str, not int8"),
        ("a", 1.0, "", "1.0 is float, not int8"),
        ("d", "1", "", "'1' is str, not float64"),
        ("d", 10**400, "", "too large for float64"),
        ("r", 1e39, "", "too large for float32"),
        ("from_", -1, "from", "uint32 goes from 0 to 4294967295"),
        ("list", [1, 2, 3], "", "exactly 2"),
        ("list", [1, 40000], "list[1]", "is not a valid int16"),
        ("s", None, "", "None is NoneType, not str"),
    ],
)
def test_error_names_the_field(path, value, error, reason):
    message = SimpleNamespace(a=1, d=1.0, r=2.0, from_=5, list=[1, 2], s="text")
    assert Good._from_object(message).from_ == 5
    setattr(message, path, value)
    kind = runtime.CountExceeded if reason == "exactly 2" else runtime.OutOfRange
    assert reason in get_error(kind, error or path, Good._from_object, message)
    delattr(message, path)
    missing = path.removesuffix("_")
    assert f"no attribute '{missing}'" in get_error(runtime.OutOfRange, missing, Good._from_object, message)


@pytest.mark.parametrize("code", "bBhHiIqQ")
def test_limits_of_integers_equal_those_of_struct(code):
    bits = 8 * struct.calcsize("<" + code)
    for value in (-(2**bits), -(2 ** (bits - 1)) - 1, -(2 ** (bits - 1)), -1, 0, 2 ** (bits - 1), 2**bits - 1, 2**bits):
        try:
            struct.pack("<" + code, value)
        except struct.error:
            get_error(runtime.OutOfRange, "v", check, KINDS[code], value, "v")
        else:
            check(KINDS[code], value, "v")


def test_table_of_another_version_names_the_next_step():
    body = {"_table_version_": 2, "_size_": 1, "_steps_": ()}
    with pytest.raises(ImportError, match=r"Later was generated by a newer shmgen .* Upgrade shmgen or shmgen-runtime"):
        type("Later", (runtime.Message,), body)
    former = {"_digest_": 1, "_encode": staticmethod(id), "_fields_": ()}
    with pytest.raises(ImportError, match=r"Former was generated by an older shmgen .* Run `shmgen generate` again"):
        type("Former", (runtime.Message,), former)
