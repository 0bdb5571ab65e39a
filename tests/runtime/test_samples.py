"""Subscriber.samples(), with number and stamp, and those that only watch: passive=True, history=True."""

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

needs_no_lock = pytest.mark.skipif(not keeps_order(), reason="for x86: here who watches takes the lock")
WAYS = {
    "active": {},
    "passive": {"passive": True},
    "passive, with the lock": {"passive": True},
}


@pytest.fixture(params=WAYS)
def way(request, monkeypatch):
    """Arguments of a subscriber; the last as where the lock keeps the order."""
    if "lock" in request.param:
        request.getfixturevalue("in_python")
        for module in (opening, lock):
            monkeypatch.setattr(module, "keeps_order", lambda: False)
    return WAYS[request.param]


def seen(samples):
    return [(number, message.position.x) for number, _, message in samples]


def header(file):
    return h.unpack(file.read_bytes(), file.stat().st_size)


def test_number_stamp_and_message_in_order(topic, way):
    with PosePublisher(topic, depth=4) as publisher, PoseSubscriber(topic, depth=4, **way) as subscriber:
        assert subscriber.samples() == []
        before = time.time_ns()
        for x in (1, 2, 3):
            publisher.publish(pose(x))
        assert subscriber.unread == 3
        samples = subscriber.samples()
        assert seen(samples) == [(1, 1.0), (2, 2.0), (3, 3.0)]
        assert all(isinstance(one.message, Pose) and is_whole(one.message) for one in samples)
        stamps = [one.stamp for one in samples]
        assert before <= stamps[0] <= stamps[1] <= stamps[2] <= time.time_ns()
        assert [one.number for one in samples] == [1, 2, 3]
        assert (subscriber.samples(), subscriber.unread, subscriber.sequence) == ([], 0, 3)
        assert subscriber.age is not None
        publisher.publish(pose(4))
        region_of(publisher).quads[region_of(publisher).sample(4).start // 8 + h.STAMP] = 0  # of a PLC without a clock
        ((number, stamp, message),) = subscriber.samples()
        assert (number, stamp, message.position.x) == (4, 0, 4.0)


def test_several_readers_each_have_all_and_only_the_active_count_what_they_missed(topic, file, way):
    with PosePublisher(topic, depth=3) as publisher:
        readers = [PoseSubscriber(topic, depth=3, **kind) for kind in (way, way, {})]
        for start in (0, 10):
            for x in range(start + 1, start + 11):
                publisher.publish(pose(x))
            assert [reader.unread for reader in readers] == [10] * 3
            wanted = [(number, float(number)) for number in range(start + 7, start + 11)]
            assert [seen(reader.samples()) for reader in readers] == [wanted] * 3
        assert [reader.missed for reader in readers] == [12] * 3
        assert header(file).missed == 12 * (1 if way else 3)
        for reader in readers:
            reader.close()


@pytest.mark.usefixtures("on_x86")
def test_a_reader_that_is_slower_than_the_writer_still_gets_samples(topic, monkeypatch):
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


def test_long_messages(topic, way):
    with ScanPublisher(topic, depth=2) as publisher, ScanSubscriber(topic, depth=2, **way) as subscriber:
        for id in (1, 2):
            publisher.publish(scan(id))
        first, second = subscriber.samples()
        publisher.publish(scan(3))
        assert (first.message.id, second.message.id, second.number) == (1, 2, 2)
        assert subscriber.read().id == 3


def test_across_the_last_number(topic, way):
    with PosePublisher(topic, depth=2) as publisher, PoseSubscriber(topic, depth=2, **way) as subscriber:
        publisher.publish(pose(0))
        renumber(publisher, 0xFFFFFFFE)
        subscriber._end.last = 0xFFFFFFFE
        for x in range(3):
            publisher.publish(pose(x))
        assert subscriber.unread == 3
        assert seen(subscriber.samples()) == [(0xFFFFFFFF, 0.0), (4, 1.0), (5, 2.0)]
        assert subscriber.missed == 0


@pytest.mark.parametrize("history", [False, True])
def test_a_region_begun_anew(topic, way, history):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic, history=history, **way) as subscriber:
        for x in range(9):
            publisher.publish(pose(x))
        assert len(subscriber.samples()) == 2
        missed = subscriber.missed
        region_of(publisher).words[h.COMPLETED0] = publisher._end.sequence = 0
        assert (subscriber.samples(), subscriber.unread) == ([], 0)
        publisher.publish(pose(50))
        assert subscriber.unread == 1
        assert seen(subscriber.samples()) == [(1, 50.0)]
        assert subscriber.missed == missed


@pytest.mark.parametrize(("written", "there"), [(0, []), (3, [1, 2, 3]), (9, [6, 7, 8, 9])])
def test_history_is_all_that_was_published(topic, way, written, there):
    with PosePublisher(topic, depth=3) as publisher:
        for x in range(written):
            publisher.publish(pose(x))
        with PoseSubscriber(topic, depth=3, history=True, **way) as subscriber:
            assert subscriber.unread == written
            assert [number for number, _, _ in subscriber.samples()] == there
            assert subscriber.missed == written - len(there)
        with PoseSubscriber(topic, depth=3, **way) as subscriber:
            assert [number for number, _, _ in subscriber.samples()] == there[-1:]


def test_a_sample_being_overwritten_is_not_there(topic, way):
    """A writer that begins to overwrite it clears its number."""
    with PosePublisher(topic) as publisher, PoseSubscriber(topic, **way) as subscriber:
        publisher.publish(pose(1))
        number = region_of(publisher).number_at(1)
        region_of(publisher).words[number] = 0  # as if sample 3 were on its way into the slot of 1
        assert subscriber.samples() == []
        region_of(publisher).words[number] = 1
        assert seen(subscriber.samples()) == [(1, 1.0)]


@needs_no_lock
def test_watching_leaves_every_byte_and_file_as_it_is(topic, file):
    with PosePublisher(topic) as publisher:
        for x in range(5):
            publisher.publish(pose(x))
        mine, before = f"*{file.name}*", file.read_bytes()
        files = sorted(file.parent.glob(mine))
        with PoseSubscriber(topic, passive=True, history=True) as watcher:
            assert len(watcher.samples()) == 2
            assert watcher.missed == 3
            assert not watcher.ready(0.01)
            assert watcher.wait(0.01) is None
            assert runtime.ready_any([watcher, watcher], 0.01) == []
            assert sorted(file.parent.glob(mine)) == files
            assert file.read_bytes() == before


@needs_no_lock
def test_who_watches_takes_the_wake_up_from_nobody(topic, file):
    """While it waits the word that says who is to be woken stays free, and it has each sample all the same."""
    with PosePublisher(topic) as publisher, PoseSubscriber(topic, passive=True) as watcher:
        with ThreadPoolExecutor() as thread:
            waiting = thread.submit(watcher.wait, 5)
            armed = []
            for _ in range(100):
                armed.append(header(file).armed)
                time.sleep(0.0005)
            publisher.publish(pose(1))
            assert waiting.result().position.x == 1.0
        assert set(armed) == {0}


def test_watching_needs_a_region_of_the_type(topic, file, way):
    if way:
        with pytest.raises(runtime.RegionMissing, match=str(file)):
            PoseSubscriber(topic, **way)
        assert not file.exists()
    with ScanPublisher(topic), pytest.raises(runtime.LayoutMismatch, match="another layout"):
        PoseSubscriber(topic, **way)


@needs_no_lock
def test_only_reading_is_allowed_and_enough(topic, file):
    """A file that nobody may write any more, as of a user who may only look."""
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1))
    file.chmod(0o444)
    with PoseSubscriber(topic, passive=True) as watcher:
        assert seen(watcher.samples()) == [(1, 1.0)]
    with pytest.raises(runtime.Closed, match="subscriber is closed"):
        watcher.samples()


@pytest.mark.usefixtures("unhealed", "in_python")
def test_without_the_lock_where_it_is_needed_there_is_nothing(topic, other, monkeypatch):
    for module in (opening, lock):
        monkeypatch.setattr(module, "keeps_order", lambda: False)
    with PosePublisher(topic, depth=4) as publisher:
        publisher.publish(pose(1))
        with PoseSubscriber(topic, depth=4, passive=True, lock_timeout=0.01) as watcher:
            holder = other("hold", topic, 4)
            assert (watcher.samples(), watcher.lock_misses) == ([], 1)
            holder.end()
            assert seen(watcher.samples()) == [(1, 1.0)]


def test_nothing_torn_and_everything_counted_under_a_flood(topic, other, way):
    with PoseSubscriber(topic, depth=4):
        writer = other("flood", topic, 4)
        with PoseSubscriber(topic, depth=4, history=True, **way) as subscriber:
            read, last, begun = 0, 0, time.monotonic()
            while time.monotonic() < begun + (0.5 if read > 10 else 15.0):
                for number, _, message in subscriber.samples():
                    assert number > last
                    assert len(set(POSE.unpack(bytes(message)))) == 1
                    assert message.position.x == number
                    read, last = read + 1, number
            assert read > 10
            assert read + subscriber.missed == last == subscriber.sequence
        writer.kill()
