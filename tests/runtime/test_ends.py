"""Publishers and subscribers support loans, `for`, coroutines, opening several at once, and repr()."""

from __future__ import annotations

import asyncio
import threading
import time
from types import SimpleNamespace

import pytest

from shmgen import runtime
from shmgen.runtime import reference

from .messages import PosePublisher, PoseSubscriber, pose

pytestmark = pytest.mark.usefixtures("each_engine")


def test_loan_is_published_at_its_end_except_after_an_error(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        with publisher.loan() as message:
            message.position.x = 1.0
            assert subscriber.read() is None
        assert subscriber.read().position.x == 1.0
        with pytest.raises(KeyError), publisher.loan() as message:
            raise KeyError("before it is complete")
        assert (subscriber.read(), publisher.sequence) == (None, 1)


def test_for_loop_yields_the_newest_sample_until_closed(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        publisher.publish(pose(2))
        positions = []
        for message in subscriber:
            positions.append(message.position.x)
            if len(positions) == 2:
                threading.Timer(0.05, subscriber.close).start()
            else:
                publisher.publish(pose(3))
        assert positions == [2.0, 3.0]


def test_waiting_coroutine_lets_other_coroutines_run(topic):
    async def watch(subscriber):
        return [message.position.x async for message in subscriber]

    async def use_coroutines(publisher, subscriber):
        before = time.monotonic()
        assert await subscriber.wait_async(0.05) is None
        assert time.monotonic() - before >= 0.05
        watcher = asyncio.create_task(watch(subscriber))
        for number in (1, 2):
            publisher.publish(pose(number))
            while subscriber.sequence < number:
                await asyncio.sleep(0.001)  # returns only if the watcher does not block the loop
        subscriber.close()
        return await asyncio.wait_for(watcher, 60)

    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert asyncio.run(use_coroutines(publisher, subscriber)) == [1.0, 2.0]


def test_open_all_opens_every_endpoint_or_none(topic):
    endpoints = [(kind, f"{topic}/n{number}") for number in range(8) for kind in (PosePublisher, PoseSubscriber)]
    ends = runtime.open_all(endpoints)
    assert [(type(end), end.topic) for end in ends] == endpoints
    publishers, subscribers = ends[::2], ends[1::2]
    for number, publisher in enumerate(publishers):
        publisher.publish(pose(number))
    assert [subscriber.read().position.x for subscriber in subscribers] == [*range(8)]
    for end in ends[2:]:
        end.close()
    with pytest.raises(runtime.RegionInUse, match=topic) as failed:
        runtime.open_all(reversed(endpoints))  # the first topic, now the last, has a publisher
    for end in runtime.open_all(endpoints[2:]) + ends[:2]:  # open_all() released its claims
        end.close()
    del failed  # its traceback references the unfinished endpoints


def test_reference_polls_every_millisecond(topic, in_python, monkeypatch):
    naps = []
    monkeypatch.setattr(reference, "time", SimpleNamespace(sleep=lambda nap: (naps.append(nap), time.sleep(nap))))
    subscribers = runtime.open_all([(PoseSubscriber, f"{topic}/{which}") for which in "ab"])
    assert runtime.ready_any(subscribers, 0.05) == []
    assert max(naps) == 0.001
    assert 2 <= len(naps) <= 50
    for end in subscribers:
        end.close()


def test_repr_shows_topic_sequence_and_missed(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        for number in range(3):
            publisher.publish(pose(number))
        subscriber.read()
        assert repr(publisher) == f"PosePublisher({topic!r}, sequence=3)"
        assert repr(subscriber) == f"PoseSubscriber({topic!r}, sequence=3, missed=2)"
