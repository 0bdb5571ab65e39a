"""Subscriber.samples() returns number, stamp and message, also with passive=True and history=True."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from shmgen import runtime
from shmgen.runtime.reference import lock, opening, reader
from shmgen.runtime.reference.memory_order import keeps_order
from shmgen.runtime.region import header as h
from tests.support.region_of import region_of

from .messages import POSE, Pose, PosePublisher, PoseSubscriber, ScanPublisher, ScanSubscriber, is_whole, pose
from .test_exchange import renumber, scan

needs_no_lock = pytest.mark.skipif(not keeps_order(), reason="a passive subscriber takes the lock here")
MODES = {
    "active": {},
    "passive": {"passive": True},
    "passive, with the lock": {"passive": True},
}


@pytest.fixture(params=MODES)
def mode(request, monkeypatch):
    """Arguments of a subscriber. The last mode pretends a machine that needs the lock."""
    if "lock" in request.param:
        request.getfixturevalue("in_python")
        for module in (opening, lock):
            monkeypatch.setattr(module, "keeps_order", lambda: False)
    return MODES[request.param]


def summarize(samples):
    return [(number, message.position.x) for number, _, message in samples]


def read_header(file):
    return h.unpack(file.read_bytes(), file.stat().st_size)


def test_samples_have_number_stamp_and_message_in_order(topic, mode):
    with PosePublisher(topic, depth=4) as publisher, PoseSubscriber(topic, depth=4, **mode) as subscriber:
        assert subscriber.samples() == []
        before = time.time_ns()
        for x in (1, 2, 3):
            publisher.publish(pose(x))
        assert subscriber.unread == 3
        samples = subscriber.samples()
        assert summarize(samples) == [(1, 1.0), (2, 2.0), (3, 3.0)]
        assert all(isinstance(sample.message, Pose) and is_whole(sample.message) for sample in samples)
        stamps = [sample.stamp for sample in samples]
        assert before <= stamps[0] <= stamps[1] <= stamps[2] <= time.time_ns()
        assert [sample.number for sample in samples] == [1, 2, 3]
        assert (subscriber.samples(), subscriber.unread, subscriber.sequence) == ([], 0, 3)
        assert subscriber.age is not None
        publisher.publish(pose(4))
        region_of(publisher).quads[region_of(publisher).sample(4).start // 8 + h.STAMP] = 0  # of a PLC without a clock
        ((number, stamp, message),) = subscriber.samples()
        assert (number, stamp, message.position.x) == (4, 0, 4.0)


def test_only_active_readers_count_missed_samples_in_the_region(topic, file, mode):
    with PosePublisher(topic, depth=3) as publisher:
        readers = [PoseSubscriber(topic, depth=3, **kind) for kind in (mode, mode, {})]
        for start in (0, 10):
            for x in range(start + 1, start + 11):
                publisher.publish(pose(x))
            assert [reader.unread for reader in readers] == [10] * 3
            expected = [(number, float(number)) for number in range(start + 7, start + 11)]
            assert [summarize(reader.samples()) for reader in readers] == [expected] * 3
        assert [reader.missed for reader in readers] == [12] * 3
        assert read_header(file).missed == 12 * (1 if mode else 3)
        for reader in readers:
            reader.close()


@pytest.mark.usefixtures("on_x86")
def test_reader_slower_than_the_writer_still_gets_samples(topic, monkeypatch):
    """The writer publishes two samples during each copy, so it overwrites the oldest samples one after another."""
    with (
        PosePublisher(topic, depth=8, lock_timeout=0) as publisher,
        PoseSubscriber(topic, depth=8, lock_timeout=0) as subscriber,
    ):
        for x in range(40):
            publisher.publish(pose(x))

        def publish_two():
            for _ in range(2):
                publisher.publish(pose(publisher.sequence))

        monkeypatch.setattr(reader, "fence", publish_two)
        samples = subscriber.samples()
        assert samples
        assert all(sample.message.position.x == sample.number - 1 for sample in samples)


def test_samples_of_long_messages_are_copies(topic, mode):
    with ScanPublisher(topic, depth=2) as publisher, ScanSubscriber(topic, depth=2, **mode) as subscriber:
        for id in (1, 2):
            publisher.publish(scan(id))
        first, second = subscriber.samples()
        publisher.publish(scan(3))
        assert (first.message.id, second.message.id, second.number) == (1, 2, 2)
        assert subscriber.read().id == 3


def test_samples_continue_across_the_wrap_of_numbers(topic, mode):
    with PosePublisher(topic, depth=2) as publisher, PoseSubscriber(topic, depth=2, **mode) as subscriber:
        publisher.publish(pose(0))
        renumber(publisher, 0xFFFFFFFE)
        subscriber._end.last = 0xFFFFFFFE
        for x in range(3):
            publisher.publish(pose(x))
        assert subscriber.unread == 3
        assert summarize(subscriber.samples()) == [(0xFFFFFFFF, 0.0), (4, 1.0), (5, 2.0)]
        assert subscriber.missed == 0


@pytest.mark.parametrize("history", [False, True])
def test_samples_continue_after_numbers_restart(topic, mode, history):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic, history=history, **mode) as subscriber:
        for x in range(9):
            publisher.publish(pose(x))
        assert len(subscriber.samples()) == 2
        missed = subscriber.missed
        region_of(publisher).words[h.COMPLETED0] = publisher._end.sequence = 0
        assert (subscriber.samples(), subscriber.unread) == ([], 0)
        publisher.publish(pose(50))
        assert subscriber.unread == 1
        assert summarize(subscriber.samples()) == [(1, 50.0)]
        assert subscriber.missed == missed


@pytest.mark.parametrize(("count", "expected"), [(0, []), (3, [1, 2, 3]), (9, [6, 7, 8, 9])])
def test_history_contains_all_available_samples(topic, mode, count, expected):
    with PosePublisher(topic, depth=3) as publisher:
        for x in range(count):
            publisher.publish(pose(x))
        with PoseSubscriber(topic, depth=3, history=True, **mode) as subscriber:
            assert subscriber.unread == count
            assert [number for number, _, _ in subscriber.samples()] == expected
            assert subscriber.missed == count - len(expected)
        with PoseSubscriber(topic, depth=3, **mode) as subscriber:
            assert [number for number, _, _ in subscriber.samples()] == expected[-1:]


def test_samples_skip_a_partly_overwritten_slot(topic, mode):
    """Skip a slot without a number. A writer clears the number before it overwrites the sample."""
    with PosePublisher(topic) as publisher, PoseSubscriber(topic, **mode) as subscriber:
        publisher.publish(pose(1))
        number = region_of(publisher).number_at(1)
        region_of(publisher).words[number] = 0  # as if a writer copied sample 3 into the slot of sample 1
        assert subscriber.samples() == []
        region_of(publisher).words[number] = 1
        assert summarize(subscriber.samples()) == [(1, 1.0)]


@needs_no_lock
def test_passive_subscriber_changes_no_byte_and_no_file(topic, file):
    with PosePublisher(topic) as publisher:
        for x in range(5):
            publisher.publish(pose(x))
        pattern, before = f"*{file.name}*", file.read_bytes()
        files = sorted(file.parent.glob(pattern))
        with PoseSubscriber(topic, passive=True, history=True) as watcher:
            assert len(watcher.samples()) == 2
            assert watcher.missed == 3
            assert not watcher.ready(0.01)
            assert watcher.wait(0.01) is None
            assert runtime.ready_any([watcher, watcher], 0.01) == []
            assert sorted(file.parent.glob(pattern)) == files
            assert file.read_bytes() == before


@needs_no_lock
def test_passive_subscriber_does_not_consume_a_wake_up(topic, file):
    """Leave `armed` unset while the passive subscriber waits. It receives the sample despite that."""
    with PosePublisher(topic) as publisher, PoseSubscriber(topic, passive=True) as watcher:
        with ThreadPoolExecutor() as thread:
            future = thread.submit(watcher.wait, 5)
            armed = []
            for _ in range(100):
                armed.append(read_header(file).armed)
                time.sleep(0.0005)
            publisher.publish(pose(1))
            assert future.result().position.x == 1.0
        assert set(armed) == {0}


def test_passive_subscriber_needs_an_existing_region_of_its_type(topic, file, mode):
    if mode:
        with pytest.raises(runtime.RegionMissing, match=str(file)):
            PoseSubscriber(topic, **mode)
        assert not file.exists()
    with ScanPublisher(topic), pytest.raises(runtime.LayoutMismatch, match="another layout"):
        PoseSubscriber(topic, **mode)


@needs_no_lock
def test_passive_subscriber_needs_only_read_permission(topic, file):
    """Read a file that is read-only, as for a user without write permission."""
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1))
    file.chmod(0o444)
    with PoseSubscriber(topic, passive=True) as watcher:
        assert summarize(watcher.samples()) == [(1, 1.0)]
    with pytest.raises(runtime.Closed, match="subscriber is closed"):
        watcher.samples()


@pytest.mark.usefixtures("unhealed", "in_python")
def test_samples_are_empty_without_a_required_lock(topic, other, monkeypatch):
    for module in (opening, lock):
        monkeypatch.setattr(module, "keeps_order", lambda: False)
    with PosePublisher(topic, depth=4) as publisher:
        publisher.publish(pose(1))
        with PoseSubscriber(topic, depth=4, passive=True, lock_timeout=0.01) as watcher:
            holder = other("hold", topic, 4)
            assert (watcher.samples(), watcher.lock_misses) == ([], 1)
            holder.end()
            assert summarize(watcher.samples()) == [(1, 1.0)]


def test_flood_tears_no_sample_and_counts_missed_samples(topic, other, mode):
    with PoseSubscriber(topic, depth=4):
        writer = other("flood", topic, 4)
        with PoseSubscriber(topic, depth=4, history=True, **mode) as subscriber:
            read, last, start = 0, 0, time.monotonic()
            while time.monotonic() < start + (0.5 if read > 10 else 15.0):
                for number, _, message in subscriber.samples():
                    assert number > last
                    assert len(set(POSE.unpack(bytes(message)))) == 1
                    assert message.position.x == number
                    read, last = read + 1, number
            assert read > 10
            assert read + subscriber.missed == last == subscriber.sequence
        writer.kill()
