"""Samples of a publisher arrive at a subscriber in order, and the subscriber counts missed samples."""

from __future__ import annotations

import array
import ctypes
import struct
import threading
import time
from types import SimpleNamespace

import pytest

from shmgen import runtime
from shmgen.runtime.messages import walker
from shmgen.runtime.messages.steps import Step
from shmgen.runtime.reference import lock
from shmgen.runtime.region import header as h
from shmgen.runtime.region.header import after
from tests.support.region_of import region_of

from .messages import (
    LONG,
    Point,
    Pose,
    PosePublisher,
    PoseSubscriber,
    Quaternion,
    Scan,
    ScanPublisher,
    ScanSubscriber,
    is_whole,
    pose,
)


def renumber(publisher, completed):
    """Pretend that `completed` samples were written. The newest sample gets the new number."""
    region = region_of(publisher)
    region.words[h.COMPLETED0] = region.words[region.number_at(completed)] = completed
    publisher._end.sequence = completed


def numbers(messages):
    return [message.position.x for message in messages]


def test_wrong_arguments_raise_helpful_errors(topic):
    with pytest.raises(TypeError, match=r"Point takes its fields by name: Point\(x=3\)"):
        Point(3)
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        with pytest.raises(runtime.OutOfRange, match=r"dict has no attribute 'position'; create a message first"):
            publisher.publish({"position": 3})
        for wait in (subscriber.wait, subscriber.ready):
            with pytest.raises(TypeError, match="timeout must be a number of seconds, not '1'"):
                wait("1")
            assert not wait(0)


# --- two processes -------------------------------------------------------------------------------


def test_reader_may_open_the_topic_first(topic, other):
    reader = other("read", topic)
    with PosePublisher(topic) as publisher:
        for x in (1.5, -2.5):
            publisher.publish(pose(x))
            assert reader.ask("go") == str(x)


def test_writer_may_open_the_topic_first(topic, other):
    writer = other("publish", topic)
    assert writer.ask(1.0) == "1"
    assert writer.ask(2.0) == "2"
    with PoseSubscriber(topic) as subscriber:
        assert subscriber.read().position.x == 2.0
        assert subscriber.read() is None
        assert (subscriber.sequence, subscriber.missed) == (2, 0)
        assert writer.ask(3.0) == "3"
        assert subscriber.read().position.x == 3.0


def test_next_writer_continues_after_a_killed_writer(topic, other):
    writer = other("flood", topic)
    with PoseSubscriber(topic) as subscriber, PoseSubscriber(topic) as second:
        subscriber.wait(20)
        writer.kill()
        until = time.monotonic() + 20
        while (last := second.read()) is None and time.monotonic() < until:
            pass  # if the lock is required and the killed writer held the lock: until the lock is recovered
        assert is_whole(last)
        subscriber.read()
        with PosePublisher(topic) as publisher:
            before = publisher.sequence
            assert before == subscriber.sequence == second.sequence
            publisher.publish(pose(-1.0))
            assert publisher.sequence == before + 1
            assert subscriber.read().position.x == -1.0


def test_flood_tears_no_sample_and_counts_missed_samples(topic, other):
    """Use a reader and a writer that do not wait for the lock, so that the reader does not slow the writer."""
    with PoseSubscriber(topic, depth=4, lock_timeout=0) as subscriber:
        other("flood", topic, 4)
        read = 0
        last = 0.0
        start = time.monotonic()
        while time.monotonic() < start + (1.0 if read > 10 else 15.0):
            for message in subscriber.read_all():
                assert is_whole(message)
                assert message.position.x > last
                last = message.position.x
                read += 1
        assert read > 10
        # The flood numbers its samples from 1, so the last number is their count.
        assert read + subscriber.missed == last == subscriber.sequence


# --- reading -------------------------------------------------------------------------------------


def test_publish_and_read_into_accept_any_class(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert subscriber.read() is None
        publisher.publish(pose(1.0))
        assert subscriber.read() == Pose(position=Point(x=1, y=1, z=1), orientation=Quaternion(x=1, y=1, z=1, w=1))
        original = Pose(position=Point(x=0.25))
        publisher.publish(original)
        original.position.x = 99.0
        assert subscriber.read() == Pose(position=Point(x=0.25))
        target = pose(0.0)
        assert not subscriber.read_into(target)
        publisher.publish(pose(4.0))
        assert subscriber.read_into(target)
        assert target == pose(4.0)
        publisher.publish(pose(5.0))
        second_target = Pose()
        assert subscriber.read_into(second_target)
        assert second_target.position.x == 5.0
        publisher.publish(pose(6.0))
        assert second_target.position.x == 5.0


def test_later_samples_do_not_change_a_read_message(topic):
    with ScanPublisher(topic) as publisher, ScanSubscriber(topic) as subscriber:
        publisher.publish(scan(1))
        first = subscriber.read()
        for id in (2, 3, 4):
            publisher.publish(scan(id))
        assert first.id == 1
        first.id = 77
        assert subscriber.read().id == 4


def test_late_subscriber_gets_the_newest_only(topic):
    with PosePublisher(topic, depth=4) as publisher:
        for x in range(6):
            publisher.publish(pose(x))
        with PoseSubscriber(topic, depth=4) as first, PoseSubscriber(topic, depth=4) as second:
            assert numbers(first.read_all()) == [5.0]
            assert second.read().position.x == 5.0
            assert first.missed == second.missed == 0
            publisher.publish(pose(6))
            assert numbers(first.read_all()) == [6.0]
            assert first.read_all() == []


@pytest.mark.parametrize(("depth", "count"), [(4, 3), (4, 8), (4, 9), (4, 30), (1, 1), (1, 5), (16, 10)])
def test_read_all_keeps_the_order_and_counts_missed_samples(topic, depth, count):
    with PosePublisher(topic, depth=depth) as publisher, PoseSubscriber(topic, depth=depth) as subscriber:
        slots = region_of(publisher).header.slots
        for round in range(3):
            for x in range(count):
                publisher.publish(pose(round * count + x))
            available = min(count, slots)
            end = (round + 1) * count
            assert numbers(subscriber.read_all()) == [float(x) for x in range(end - available, end)]
            assert subscriber.missed == (round + 1) * (count - available)


def test_read_all_skips_a_partly_overwritten_sample(topic):
    """Skip only the oldest sample if a writer stops, or is killed, while it copies a new sample."""
    with PosePublisher(topic, depth=2) as publisher, PoseSubscriber(topic, depth=2) as subscriber:
        for x in range(1, 5):
            publisher.publish(pose(x))
        region_of(publisher).words[region_of(publisher).number_at(5)] = 0
        assert numbers(subscriber.read_all()) == [2.0, 3.0, 4.0]
        assert subscriber.missed == 1
        publisher.publish(pose(5))
        assert numbers(subscriber.read_all()) == [5.0]


def test_reader_checks_the_sample_number_in_the_slot(topic):
    """Ignore a slot with an unexpected sample number, because the sample may be incomplete."""
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        place = region_of(publisher).number_at(1)
        region_of(publisher).words[place] = 3
        assert subscriber.read() is None
        assert subscriber.read_all() == []
        assert subscriber.sequence == 0
        region_of(publisher).words[place] = 1
        assert subscriber.read().position.x == 1.0


def test_read_counts_skipped_samples_as_missed(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        for x in range(5):
            publisher.publish(pose(x))
        assert subscriber.read().position.x == 4.0
        assert subscriber.missed == 4


# --- numbers -------------------------------------------------------------------------------------


def test_sample_number_wraps_to_the_number_of_slots(topic):
    with PosePublisher(topic, depth=2) as publisher, PoseSubscriber(topic, depth=2) as subscriber:
        publisher.publish(pose(0))
        renumber(publisher, 0xFFFFFFFE)
        subscriber._end.last = 0xFFFFFFFD
        for x, number in enumerate((0xFFFFFFFF, 4, 5, 6)):
            publisher.publish(pose(x))
            assert publisher.sequence == number
            assert subscriber.read().position.x == x
            assert subscriber.sequence == number
        # Only sample 0xFFFFFFFE was missed.
        assert subscriber.missed == 1


def test_wrap_of_sample_numbers_counts_nothing_as_missed(topic):
    with PosePublisher(topic, depth=2) as publisher, PoseSubscriber(topic, depth=2) as subscriber:
        publisher.publish(pose(0))
        renumber(publisher, 0xFFFFFFFE)
        subscriber._end.last = 0xFFFFFFFE
        for x in range(3):
            publisher.publish(pose(x))
        # After the wrap, the numbers 0 to slots - 1 are unused, so they do not count as missed.
        assert numbers(subscriber.read_all()) == [0.0, 1.0, 2.0]
        assert subscriber.missed == 0


@pytest.mark.parametrize(
    ("older", "newer", "steps"),
    [(0, 1, 1), (5, 9, 4), (0xFFFFFFFF, 4, 1), (0xFFFFFFFE, 4, 2), (0xFFFFFFFE, 7, 5), (7, 7, 0)],
)
def test_steps_between_sample_numbers(older, newer, steps):
    assert h.steps(older, newer, 4) == steps
    assert after(older, steps, 4) == newer


@pytest.mark.parametrize("method", ["read", "read_all"])
def test_reader_continues_after_sample_numbers_restart(topic, method):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        for x in range(9):
            publisher.publish(pose(x))
        subscriber.read()
        missed = subscriber.missed
        region_of(publisher).words[h.COMPLETED0] = publisher._end.sequence = 0
        publisher.publish(pose(50))
        message = subscriber.read() if method == "read" else subscriber.read_all()[0]
        assert message.position.x == 50.0
        assert (subscriber.sequence, subscriber.missed) == (1, missed)


def test_restarted_region_without_samples_returns_nothing(topic):
    with PoseSubscriber(topic) as subscriber:
        subscriber._end.last = 5
        assert subscriber.read() is None
        assert subscriber.read_all() == []
        assert subscriber.wait(0.01) is None


@pytest.mark.parametrize("before", [1, 2])
@pytest.mark.usefixtures("in_python")
def test_counters_wrap_at_32_bits(topic, before):
    """Let the count of lock acquisitions wrap in the publisher, or in the reader."""
    with PosePublisher(topic) as first:
        region_of(first).words[h.HEARTBEAT] = 0xFFFFFFFE
        region_of(first).words[h.LOCK_COUNT] = 2**32 - before
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        for x in range(2):
            publisher.publish(pose(x))
            subscriber.read()
        publisher.heartbeat()
        words = region_of(publisher).words
        assert (words[h.HEARTBEAT], words[h.LOCK_COUNT]) == (1, 4 - before)
        words[h.MISSED] = 0xFFFFFFFF
        for x in range(3):
            publisher.publish(pose(x))
        subscriber.read()
        assert (words[h.MISSED], subscriber.missed) == (1, 2)


def test_next_writer_continues_numbers_and_heartbeat(topic):
    for expected in (1, 2, 3):
        with PosePublisher(topic) as publisher:
            publisher.publish(pose(expected))
            assert (publisher.sequence, region_of(publisher).words[h.HEARTBEAT]) == (expected, expected)


# --- time ----------------------------------------------------------------------------------------


def test_age_is_the_time_since_the_stamp(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert subscriber.age is None
        publisher.publish(pose(1))
        assert subscriber.age is None
        subscriber.read()
        assert 0 <= subscriber.age < 5
        stamp = region_of(publisher).sample(1).start // 8
        region_of(publisher).quads[stamp] -= 60 * 10**9
        subscriber._end.last = 0
        subscriber.read()
        assert 60 <= subscriber.age < 65
        region_of(publisher).quads[stamp] = 0
        subscriber._end.last = 0
        subscriber.read()
        assert subscriber.age is None


def test_wait_returns_a_sample_or_none_after_the_timeout(topic, other):
    writer = other("publish", topic)
    with PoseSubscriber(topic) as subscriber:
        before = time.monotonic()
        assert subscriber.wait(0.05) is None
        assert time.monotonic() - before >= 0.05
        assert subscriber.wait(0) is None
        writer.tell(3.0)
        assert subscriber.wait(5).position.x == 3.0


def test_late_writer_is_not_stale_at_once(topic):
    with PoseSubscriber(topic) as subscriber:
        time.sleep(0.2)
        with PosePublisher(topic) as publisher:
            publisher.publish(pose(1))
            assert not subscriber.is_stale(0.1), "at the first check"
            time.sleep(0.15)
            assert subscriber.is_stale(0.1)
    with PoseSubscriber(topic) as subscriber:
        assert not subscriber.is_stale(0.1)
        time.sleep(0.15)
        assert subscriber.is_stale(0.1)


def test_ready_sleeps_until_a_sample_arrives(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        threading.Timer(0.1, publisher.publish, [pose(1)]).start()
        before = time.thread_time()
        assert subscriber.ready(20)
        assert time.thread_time() - before < 0.05
        assert subscriber.read().position.x == 1.0


def test_ready_waits_and_reads_nothing(topic, other):
    writer = other("publish", topic)
    with PoseSubscriber(topic) as subscriber:
        before = time.monotonic()
        assert not subscriber.ready(0.05)
        assert time.monotonic() - before >= 0.05
        writer.tell(3.0)
        assert subscriber.ready(5)
        assert subscriber.ready(0)
        assert numbers(subscriber.read_all()) == [3.0]
        assert not subscriber.ready(0)


# --- the lock ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("on_x86")
def test_x86_exchanges_samples_while_the_lock_is_held(topic, other):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        holder = other("hold", topic)
        count = region_of(publisher).words[h.LOCK_COUNT]
        for x in range(2, 30):
            publisher.publish(pose(x))
            assert subscriber.read().position.x == x
        assert publisher.lock_misses == subscriber.lock_misses == 28
        assert region_of(publisher).words[h.LOCK_COUNT] == count
        assert region_of(publisher).words[h.LOCK_HOLDER] == 0
        holder.end()
        publisher.publish(pose(99))
        assert subscriber.read().position.x == 99.0
        assert publisher.lock_misses == subscriber.lock_misses == 28
        assert region_of(publisher).words[h.LOCK_COUNT] == count + 2


@pytest.mark.usefixtures("on_x86", "unhealed")
def test_stuck_lock_delays_only_the_first_call(topic, other, monkeypatch):
    timeouts = []
    try_for = lock.Lock._try_for
    monkeypatch.setattr(lock.Lock, "_try_for", lambda *wait: timeouts.append(wait[1]) or try_for(*wait))
    with PosePublisher(topic, lock_timeout=0.02) as publisher:
        words = region_of(publisher).words
        publisher.publish(pose(0))
        holder = other("hold", topic)
        assert timeouts == []
        for x in range(20):
            publisher.publish(pose(x))
        assert timeouts == [0.02]
        # Another process acquired the lock. The lock is not stuck, so the publisher waits again.
        words[h.LOCK_COUNT] += 1
        for x in range(20):
            publisher.publish(pose(x))
        assert timeouts == [0.02, 0.02]
        assert publisher.lock_misses == 40
        # A subscriber that opens while the lock is busy also waits once.
        with PoseSubscriber(topic, lock_timeout=0.01) as subscriber:
            for x in range(20):
                publisher.publish(pose(x))
                assert subscriber.read().position.x == x
        assert timeouts == [0.02, 0.02, 0.01]
        holder.end()
        publisher.publish(pose(1))
        assert publisher.lock_misses == 60


@pytest.mark.usefixtures("on_arm", "unhealed")
def test_arm_reads_and_writes_nothing_without_the_lock(topic, file, other):
    with PosePublisher(topic, depth=4, lock_timeout=0.01) as publisher, PoseSubscriber(topic, depth=4) as subscriber:
        publisher.publish(pose(1))
        publisher.publish(pose(2))
        holder = other("hold", topic, 4)
        before = file.read_bytes()
        with pytest.raises(runtime.LockTimeout, match=topic):
            publisher.publish(pose(3))
        assert subscriber.read() is None
        assert subscriber.read_all() == []
        assert (subscriber.sequence, subscriber.lock_misses) == (0, 2), "one attempt per call"
        assert subscriber.read_into(Pose()) is False
        assert file.read_bytes() == before
        holder.end()
        publisher.publish(pose(3))
        assert publisher.sequence == 3
        assert numbers(subscriber.read_all()) == [1.0, 2.0, 3.0]
        assert subscriber.missed == 0


@pytest.mark.usefixtures("in_python")
def test_header_names_the_holder_of_the_lock(topic):
    """Read the header during the copy. The explorer checks the same for the engine in C."""
    log = []
    with PosePublisher(topic) as publisher:
        region, map = region_of(publisher), publisher._end.region.map
        words = region.words

        class Spy:
            def __setitem__(self, key, data):
                log.append((words[h.LOCK_HOLDER], words[region.number_at(1)], words[h.COMPLETED0], words[h.HEARTBEAT]))
                map[key] = data

            def close(self):
                map.close()

        publisher._end.region.map = Spy()
        publisher.publish(pose(1))
        publisher.publish(pose(2))
    pid = runtime.read_header(runtime.region_name(topic)).writer
    assert log == [(pid, 0, 0, 1), (pid, 1, 1, 2)]


# --- values that do not fit, and long arrays -----------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value", "path"),
    [("position", SimpleNamespace(x=0.0, y="one", z=0.0), "position.y"), ("orientation", None, "orientation.x")],
)
def test_rejected_value_keeps_the_former_sample(topic, file, field, value, path):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        before = file.read_bytes()
        bad = pose(2)
        setattr(bad, field, value)
        with pytest.raises(runtime.ValueRejected) as caught:
            publisher.publish(bad)
        assert caught.value.path == path
        assert file.read_bytes() == before
        assert subscriber.read().position.x == 1.0
        publisher.publish(pose(3))
        assert subscriber.read() == Pose(position=Point(x=3, y=3, z=3), orientation=Quaternion(x=3, y=3, z=3, w=3))


def scan(id, count=LONG, name="laser"):
    ranges = array.array("d", [float(id)] * LONG)
    return SimpleNamespace(id=id, ranges=ranges, data=bytes([id % 256]) * count, name=name)


def test_bytes_after_the_count_of_a_long_array_are_zero(topic):
    with ScanPublisher(topic) as publisher, ScanSubscriber(topic) as subscriber:
        for id, count, name in ((1, LONG, "a"), (2, 10, "bc"), (3, 5, ""), (4, 0, "x" * 16), (5, LONG, "é")):
            publisher.publish(scan(id, count, name))
            target = SimpleNamespace(id=0, ranges=[], data=b"", name="")
            assert subscriber.read_into(target)
            assert (target.id, target.name, target.data) == (id, name, bytes([id]) * count)
            assert target.ranges == [float(id)] * LONG
        publisher.publish(scan(6, 3, "n"))
        message = subscriber.wait(0)
        # Slot 0 held the ten bytes of sample 2. The bytes after the new count are zero.
        start = Scan.data.step.offset
        assert bytes(message)[start : start + 12] == b"\6\6\6" + bytes(9)


def test_rejected_long_array_changes_no_byte(topic, file):
    with ScanPublisher(topic) as publisher:
        publisher.publish(scan(1))
        before = file.read_bytes()
        for bad, path in (
            (scan(2, LONG + 1), "data"),
            (scan(2, name="x" * 17), "name"),
            (scan(2**32), "id"),
            (SimpleNamespace(id=2, ranges=[0.0] * (LONG - 1) + ["x"], data=b"", name=""), f"ranges[{LONG - 1}]"),
            (SimpleNamespace(id=2, data=b"", name=""), "ranges"),
        ):
            with pytest.raises(runtime.ValueRejected) as caught:
                publisher.publish(bad)
            assert caught.value.path == path
            assert file.read_bytes() == before
        data = bytearray(5)
        publisher.publish(SimpleNamespace(id=2, ranges=[0.0] * LONG, data=data, name=""))
        data.append(1)  # the publisher keeps no view of the array
        with pytest.raises(runtime.ValueRejected):
            publisher.publish(SimpleNamespace(id=3, ranges=[0.0] * LONG, data=data, name="x" * 17))
        data.append(1)


@pytest.mark.usefixtures("in_python")
def test_fences_order_the_copy_and_the_sample_number(topic, monkeypatch):
    with ScanPublisher(topic) as publisher:
        region, fences = region_of(publisher), []
        words, number = region.words, region.number_at(1)
        words[number] = 7
        monkeypatch.setattr(
            "shmgen.runtime.reference.writer.fence", lambda: fences.append((words[number], words[h.COMPLETED0]))
        )
        publisher.publish(Scan())
        assert fences == [(0, 0), (1, 1)]


def test_long_message_is_copied_byte_for_byte(topic):
    original = Scan(id=9, name="whole")
    with ScanPublisher(topic) as publisher, ScanSubscriber(topic) as subscriber:
        publisher.publish(original)
        message = subscriber.read()
        assert bytes(message) == bytes(original)
        publisher.publish(original)
        target = Scan()
        assert subscriber.read_into(target)
        assert bytes(target) == bytes(original)
        place = region_of(publisher).sample(2).start
        assert struct.unpack_from("<II", region_of(publisher).map, place + 8) == (2, 0)


# --- the messages themselves ---------------------------------------------------------------------


def test_list_growing_while_encoded_stays_within_its_bound():
    """Let a property of an element extend the list."""
    points = []

    class GrowingPoint:
        y = z = 0.0

        @property
        def x(self):
            points.extend([Point(x=9.0)] * 5)
            return 1.0

    points += [GrowingPoint(), GrowingPoint()]
    into = bytearray(5 * 24)
    assert walker.encode_array(Step("points", Point, 0, 24, 3, 96), points, into, 0) == (2, 0)
    assert into[48:] == bytes(3 * 24)


def test_message_defaults_fields_equality_and_repr():
    assert repr(Pose(position=Point(x=1.5))) == (
        "Pose(position=Point(x=1.5, y=0.0, z=0.0), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))"
    )
    with pytest.raises(TypeError, match="Pose has no field 'velocity'; it has position, orientation"):
        Pose(velocity=1)
    with pytest.raises(runtime.OutOfRange, match="id: 1099511627781"):
        Scan(id=2**40 + 5)
    assert Scan(id=7, name="n") == Scan(id=7, name="n") != Scan(id=8, name="n")
    assert Point() != Quaternion()
    with pytest.raises(TypeError, match="unhashable"):
        hash(Point())


def test_repr_shortens_long_arrays_and_equality_compares_them():
    class Many(runtime.Message):
        import ctypes

        _pack_ = 1
        _fields_ = [("data", ctypes.c_uint8 * 100)]  # noqa: RUF012
        _names_ = ("data",)

    text = repr(Many())
    assert text == f"Many(data=[{'0, ' * 32}... 100 in all])"
    first, second = Many(), Many()
    assert first == second
    second.data[99] = 1
    assert first != second
    assert (first == 5) is False

    class AllShown(runtime.Message):
        import ctypes

        _fields_ = [("data", ctypes.c_uint8 * 32)]  # noqa: RUF012
        _names_ = ("data",)

    assert repr(AllShown()).count("0") == 32
    assert "..." not in repr(AllShown())


def test_repr_of_a_sequence_is_like_a_list():
    class Bag(runtime.Message):
        _table_version_ = 1
        _size_ = 136
        _steps_ = (
            ("small", "uint8", 4, 1, 40, 0),
            ("floats", "float64", 48, 8, 2),
            ("points", Point, 64, 24, 3),
        )

    bag = Bag(small=[7] * 33, floats=[0.5, 1.0])
    assert repr(bag.small) == f"[{'7, ' * 32}... 33 in all]"
    assert str(bag.floats) == "[0.5, 1.0]"
    assert repr(bag.points[:2]) == "[Point(x=0.0, y=0.0, z=0.0), Point(x=0.0, y=0.0, z=0.0)]"
    assert repr(bag.points) == f"[{', '.join(3 * ['Point(x=0.0, y=0.0, z=0.0)'])}]"


def test_class_without_a_table_accepts_only_its_own_objects(topic):
    class Bare(runtime.Message):
        _fields_ = (("data", ctypes.c_uint8 * 8),)
        _names_ = ("data",)
        _type_name_, _digest_ = "a_msgs/msg/Bare", 5

    class BarePublisher(runtime.Publisher[Bare]):
        message_type = Bare

    class BareSubscriber(runtime.Subscriber[Bare]):
        message_type = Bare

    with BarePublisher(topic) as publisher, BareSubscriber(topic) as subscriber:
        publisher.publish(Bare())
        with pytest.raises(TypeError, match="no table of fields: publish an object of it"):
            publisher.publish(SimpleNamespace(data=b""))
        with pytest.raises(TypeError, match="no table of fields: read into an object of it"):
            subscriber.read_into(SimpleNamespace(data=b""))
