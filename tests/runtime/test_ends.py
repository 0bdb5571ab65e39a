"""What makes the ends comfortable: a loan, `for`, coroutines, many opened at once, and how they show themselves."""

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


def test_a_loan_is_published_at_its_end_and_not_after_an_exception(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        with publisher.loan() as message:
            message.position.x = 1.0
            assert subscriber.read() is None
        assert subscriber.read().position.x == 1.0
        with pytest.raises(KeyError), publisher.loan() as message:
            raise KeyError("before it is whole")
        assert (subscriber.read(), publisher.sequence) == (None, 1)


def test_for_gives_the_newest_each_time_until_it_is_closed(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        publisher.publish(pose(2))
        found = []
        for message in subscriber:
            found.append(message.position.x)
            if len(found) == 2:
                threading.Timer(0.05, subscriber.close).start()
            else:
                publisher.publish(pose(3))
        assert found == [2.0, 3.0]


def test_coroutines_wait_and_the_others_go_on(topic):
    async def watch(subscriber):
        return [message.position.x async for message in subscriber]

    async def all_of_it(publisher, subscriber):
        before = time.monotonic()
        assert await subscriber.wait_async(0.05) is None
        assert time.monotonic() - before >= 0.05
        watching = asyncio.create_task(watch(subscriber))
        for number in (1, 2):
            publisher.publish(pose(number))
            while subscriber.sequence < number:
                await asyncio.sleep(0.001)  # comes back only while the watcher does not hold the loop
        subscriber.close()
        return await asyncio.wait_for(watching, 60)

    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert asyncio.run(all_of_it(publisher, subscriber)) == [1.0, 2.0]


def test_all_are_opened_or_none(topic):
    wanted = [(kind, f"{topic}/n{number}") for number in range(8) for kind in (PosePublisher, PoseSubscriber)]
    ends = runtime.open_all(wanted)
    assert [(type(end), end.topic) for end in ends] == wanted
    publishers, subscribers = ends[::2], ends[1::2]
    for number, publisher in enumerate(publishers):
        publisher.publish(pose(number))
    assert [one.read().position.x for one in subscribers] == [*range(8)]
    for end in ends[2:]:
        end.close()
    with pytest.raises(runtime.RegionInUse, match=topic) as failed:
        runtime.open_all(reversed(wanted))  # of the first topic, the last here, somebody is the publisher
    for end in runtime.open_all(wanted[2:]) + ends[:2]:  # nobody has kept a claim
        end.close()
    del failed  # whose traceback holds what was begun


def test_the_reference_sleeps_a_millisecond_between_two_looks(topic, in_python, monkeypatch):
    naps = []
    monkeypatch.setattr(reference, "time", SimpleNamespace(sleep=lambda nap: (naps.append(nap), time.sleep(nap))))
    subscribers = runtime.open_all([(PoseSubscriber, f"{topic}/{which}") for which in "ab"])
    assert runtime.ready_any(subscribers, 0.05) == []
    assert max(naps) == 0.001
    assert 2 <= len(naps) <= 50
    for end in subscribers:
        end.close()


def test_they_say_who_and_where_they_are(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        for number in range(3):
            publisher.publish(pose(number))
        subscriber.read()
        assert repr(publisher) == f"PosePublisher({topic!r}, sequence=3)"
        assert repr(subscriber) == f"PoseSubscriber({topic!r}, sequence=3, missed=2)"
