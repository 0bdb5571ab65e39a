"""A publisher and a subscriber reopen their region automatically after it was removed."""

from __future__ import annotations

import logging
import time

import pytest

from shmgen import runtime

from ..support.machine import slower
from .messages import PosePublisher, PoseSubscriber, ScanPublisher, ScanSubscriber, pose

pytestmark = pytest.mark.usefixtures("each_engine")
SOON = 10.0 * slower
"""Seconds within which data arrives again. A quiet machine needs a tenth of a second."""


def poll(seconds, call):
    """Return the first true result of `call`."""
    deadline = time.monotonic() + seconds
    while not (result := call()) and time.monotonic() < deadline:
        time.sleep(0.001)
    assert result
    return result


READS = {
    "read": lambda subscriber: subscriber.read(),
    "read_into": lambda subscriber: subscriber.read_into(pose(0)),
    "read_all": lambda subscriber: subscriber.read_all(),
    "wait": lambda subscriber: subscriber.wait(0.01),
    "ready": lambda subscriber: subscriber.ready(0.01) and subscriber.read(),
    "ready_any": lambda subscriber: [end.read() for end in runtime.ready_any([subscriber], 0.01)],
    "ready_any_of_two": lambda subscriber: [end.read() for end in runtime.ready_any([subscriber] * 2, 0.01)],
}


def borrow(subscriber):
    with subscriber.borrow() as message:
        return message is not None and message.position.x


READS["borrow"] = borrow


@pytest.mark.parametrize("method", READS)
def test_loop_continues_after_its_region_was_removed(topic, file, method, caplog):
    """Publish between the reads, as the loop of a separate publisher does."""
    read, number = READS[method], 0

    def cycle():
        nonlocal number
        number += 1
        publisher.publish(pose(number))
        result = read(subscriber)
        assert method != "borrow" or result in (False, number), "not a sample of the removed region"
        return result

    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert cycle()
        for count in (1, 2):
            before = file.stat().st_ino
            file.unlink()
            poll(SOON, lambda count=count: cycle() and file.exists() and subscriber.reopen_count == count)
            assert file.stat().st_ino != before
            assert poll(SOON, cycle)
            assert (publisher.reopen_count, subscriber.reopen_count) == (count, count)
        assert subscriber.missed + 2 < number
    logged = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert sorted(logged) == [
        f"{topic}: {file} was removed; this {word} has reopened it. Causes: docs/troubleshooting.md"
        for word in ("publisher", "subscriber")
    ]


def test_reader_recreates_the_region_and_reads_all_its_samples(topic, file):
    with PoseSubscriber(topic, depth=8) as subscriber:
        file.unlink()
        poll(SOON, lambda: subscriber.read_all() == [] and file.exists() and subscriber.reopen_count)
        with PosePublisher(topic, depth=8) as publisher:
            for number in range(5):
                publisher.publish(pose(number))
        assert [message.position.x for message in subscriber.read_all()] == [0, 1, 2, 3, 4]


def test_samples_in_the_removed_region_are_read_first(topic, file):
    with PosePublisher(topic, depth=8) as publisher, PoseSubscriber(topic, depth=8) as subscriber:
        publisher.publish(pose(1))
        file.unlink()
        time.sleep(0.12)
        publisher.publish(pose(2))  # into the new region
        assert publisher.reopen_count == 1
        publisher.publish(pose(3))
        messages = []
        poll(SOON, lambda: (messages.extend(subscriber.read_all()), len(messages) >= 3)[1])
        assert [message.position.x for message in messages] == [1, 2, 3]
        assert subscriber.missed == 0


def test_borrowed_sample_keeps_its_region(topic, file):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        with subscriber.borrow() as message:
            file.unlink()
            time.sleep(0.12)
            assert subscriber.read() is None
            assert (message.position.x, subscriber.reopen_count) == (1, 0)
        publisher.publish(pose(2))
        assert poll(SOON, subscriber.read).position.x == 2


def test_heartbeats_alone_reopen_the_region(topic, file):
    with PosePublisher(topic) as publisher:
        file.unlink()
        poll(SOON, lambda: (publisher.heartbeat(), publisher.reopen_count)[1])
        assert file.exists()


def test_is_stale_raises_nothing_while_the_region_is_reopened(topic, file):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        file.unlink()
        poll(SOON, lambda: (subscriber.is_stale(0), subscriber.unread, subscriber.read(), subscriber.reopen_count)[3])
        poll(SOON, lambda: (publisher.publish(pose(1)), subscriber.read())[1])


def test_other_writer_of_the_new_region_is_an_error_until_closed(topic, file):
    with PosePublisher(topic) as publisher:
        file.unlink()
        with PosePublisher(topic) as other:
            other.publish(pose(1))
            with pytest.raises(runtime.RegionInUse):
                poll(SOON, lambda: publisher.publish(pose(2)))
            with pytest.raises(runtime.RegionInUse):
                publisher.publish(pose(2))
        time.sleep(0.6)
        publisher.publish(pose(3))
        assert (publisher.sequence, publisher.reopen_count) == (2, 1)


def test_other_layout_of_the_new_region_is_an_error(topic, file):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        assert subscriber.read()
        file.unlink()
        with ScanPublisher(topic), ScanSubscriber(topic):
            for call in (lambda: publisher.publish(pose(2)), subscriber.read):
                with pytest.raises(runtime.LayoutMismatch, match="writes the region"):
                    poll(SOON, call and (lambda call=call: (call(), False)[1]))


def test_closed_endpoint_stays_closed(topic, file):
    publisher, subscriber = PosePublisher(topic), PoseSubscriber(topic)
    file.unlink()
    time.sleep(0.12)
    publisher.heartbeat()
    subscriber.read()
    for end in (publisher, subscriber):
        end.close()
    for call in (
        lambda: publisher.publish(pose(1)),
        publisher.heartbeat,
        subscriber.read,
        lambda: subscriber.wait(0.1),
    ):
        with pytest.raises(runtime.Closed):
            call()


def test_history_comes_from_the_new_region(topic, file):
    with PosePublisher(topic, depth=4) as publisher:
        publisher.publish(pose(1))
        with PoseSubscriber(topic, depth=4, history=True) as subscriber:
            assert len(subscriber.read_all()) == 1
            file.unlink()
            time.sleep(0.12)
            publisher.publish(pose(2))
            publisher.publish(pose(3))
            messages = []
            poll(SOON, lambda: (messages.extend(subscriber.read_all()), len(messages) == 2)[1])
