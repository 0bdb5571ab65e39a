"""A Notifier is a file descriptor for event loops. The asyncio methods of subscribers use it."""

from __future__ import annotations

import asyncio
import gc
import os
import select
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from shmgen import runtime
from shmgen.runtime import event_loop, region_name

from .messages import PosePublisher, PoseSubscriber, pose

pytestmark = pytest.mark.usefixtures("each_engine")
SOON = 30.0
"""Seconds within which every event happens, also on a busy machine."""


def is_readable(notifier, seconds=SOON):
    return bool(select.select([notifier], [], [], seconds)[0])


def test_notifier_reports_each_sample_once(topic):
    with ExitStack() as stack:
        publisher = stack.enter_context(PosePublisher(topic))
        subscriber, quiet = (stack.enter_context(PoseSubscriber(name)) for name in (topic, f"{topic}/quiet"))
        publisher.publish(pose(1))
        notifier = stack.enter_context(runtime.Notifier([subscriber, quiet]))
        for number in range(2, 50):
            assert is_readable(notifier)
            assert notifier.ready() == [subscriber]
            assert not is_readable(notifier, 0.01)
            publisher.publish(pose(number))
        notifier.remove(subscriber)
        publisher.publish(pose(50))
        assert notifier.ready() == []
        assert not is_readable(notifier, 0.05)
        assert subscriber.read().position.x == 50
    assert notifier.fileno() == -1


def test_removed_region_is_reported_until_it_is_reopened(topic, each_engine):
    file = Path("/dev/shm") / region_name(topic)
    with ExitStack() as stack:
        publisher, subscriber = (stack.enter_context(kind(topic)) for kind in (PosePublisher, PoseSubscriber))
        notifier = stack.enter_context(runtime.Notifier([subscriber]))
        for number in range(1, 3):
            file.unlink()
            for _ in range(3 if each_engine == "C" else 0):  # without a read; the reference reopens the region itself
                assert is_readable(notifier)
                assert notifier.ready() == [subscriber]
            while publisher.reopen_count < number:
                publisher.heartbeat()
                time.sleep(0.01)
            publisher.publish(pose(number))
            message = None
            while message is None:
                assert is_readable(notifier)
                assert notifier.ready() == [subscriber]
                message = subscriber.read()
            assert message.position.x == number
            for later in range(100, 120):
                while is_readable(notifier, 0.0):
                    notifier.ready()
                subscriber.read()
                publisher.publish(pose(later))
                assert is_readable(notifier, 5.0)
            subscriber.read()


def test_closed_subscriber_or_notifier_is_refused(topic):
    with PoseSubscriber(topic) as subscriber:
        notifier = runtime.Notifier()
    with pytest.raises(runtime.Closed):
        notifier.add(subscriber)
    notifier.close()
    notifier.close()
    with PoseSubscriber(topic) as subscriber, pytest.raises(ValueError, match="closed"):
        notifier.add(subscriber)


def test_forked_child_has_no_notifier(topic):
    with ExitStack() as stack:
        publisher, subscriber = (stack.enter_context(kind(topic)) for kind in (PosePublisher, PoseSubscriber))
        notifier = stack.enter_context(runtime.Notifier([subscriber]))
        child = os.fork()
        if not child:
            os._exit(notifier.fileno() == -1 and notifier.ready() == [])
        assert os.waitpid(child, 0)[1] == 1 << 8
        publisher.publish(pose(1))
        assert is_readable(notifier)


# --- asyncio ----------------------------------------------------------------------------------------


def count_threads():
    return len(os.listdir("/proc/self/task"))


def test_many_coroutines_need_one_thread(topic):
    """Use no threads of the default executor, which other coroutines may need."""

    async def count(subscriber, number):
        positions = []
        while len(positions) < number:
            assert await subscriber.ready_async(SOON)
            positions += [message.position.x for message in subscriber.read_all()]
        return positions

    async def scene(publisher, busy, quiet):
        before = count_threads()
        waiting = [asyncio.create_task(subscriber.wait_async(SOON)) for subscriber in quiet]
        counter = asyncio.create_task(count(busy, 200))
        await asyncio.sleep(0)
        assert count_threads() == before + 1
        for number in range(200):
            publisher.publish(pose(number))
            await asyncio.sleep(0.0005)
        assert await counter == [*range(200)]
        assert busy.missed == 0
        for task in waiting:
            task.cancel()
        assert {type(end) for end in await asyncio.gather(*waiting, return_exceptions=True)} == {asyncio.CancelledError}
        for subscriber in (busy, *quiet):
            subscriber.close()
        await asyncio.sleep(0.01)  # the loop ends the thread after the last subscriber closes
        assert count_threads() <= before  # a thread of an earlier test may have ended since

    with ExitStack() as stack:
        quiet = [stack.enter_context(PoseSubscriber(f"{topic}/t{number}")) for number in range(100)]
        busy = stack.enter_context(PoseSubscriber(topic, depth=255))
        publisher = stack.enter_context(PosePublisher(topic, depth=255))
        asyncio.run(scene(publisher, busy, quiet))


def test_close_in_another_thread_ends_async_for(topic):
    async def watch(subscriber):
        threading.Timer(0.05, subscriber.close).start()
        return [message async for message in subscriber]

    async def wait(subscriber):
        with pytest.raises(runtime.Closed):
            await subscriber.wait_async(SOON)

    with PoseSubscriber(topic) as subscriber:
        assert asyncio.run(watch(subscriber)) == []
    with PoseSubscriber(topic) as subscriber:
        asyncio.run(asyncio.wait_for(gather_both(watch(subscriber), wait(subscriber)), SOON))


async def gather_both(first, second):
    await asyncio.gather(first, second)


@pytest.mark.sample("[C]")
def test_ended_loop_keeps_no_thread_and_no_region(topic):
    """Release the thread, and the region of a subscriber that is no longer referenced."""

    async def scene():
        assert await PoseSubscriber(topic).wait_async(0.01) is None
        gc.collect()
        await asyncio.sleep(0.01)
        assert not event_loop._of_loops

    before = count_threads()
    with PoseSubscriber(f"{topic}/kept") as subscriber:
        for _ in range(3):
            asyncio.run(scene())
            assert asyncio.run(subscriber.wait_async(0.01)) is None
            gc.collect()
        assert count_threads() <= before  # a thread of an earlier test may have ended since


def test_removed_region_ends_a_wait_without_reopen(topic):
    async def scene(subscriber):
        asyncio.get_running_loop().call_later(0.02, (Path("/dev/shm") / region_name(topic)).unlink)
        with pytest.raises(runtime.RegionRetired):
            await subscriber.wait_async(SOON)

    with PoseSubscriber(topic, reopen=False) as subscriber:
        asyncio.run(scene(subscriber))


def test_coroutine_continues_in_the_replacing_region(topic):
    file = Path("/dev/shm") / region_name(topic)

    async def publish(publisher):
        while not publisher.reopen_count:
            await asyncio.sleep(0.02)
            publisher.heartbeat()
        publisher.publish(pose(3))

    async def scene(publisher, subscriber):
        waiting = asyncio.create_task(subscriber.wait_async(SOON))
        await asyncio.sleep(0.02)
        file.unlink()
        await publish(publisher)
        return await waiting

    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        assert asyncio.run(scene(publisher, subscriber)).position.x == 3
