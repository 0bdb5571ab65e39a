"""A writer claims a topic after a PLC. The tests simulate the clock and the PLC's changes to the header."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from shmgen import runtime
from shmgen.runtime import calls, subscriber, wait_any
from shmgen.runtime.reference import claim, lock, reader
from shmgen.runtime.region import access, settings
from shmgen.runtime.region import header as h

from ..rigs.chaos_faults import swap_map
from ..support.region_of import region_of
from .messages import PosePublisher, PoseSubscriber, pose

NUMBER = 41
STOOD_STILL = claim._STOOD_STILL
"""The limit that the fixture in_time replaces with infinity."""


@pytest.fixture
def region(topic):
    """A region of a reader, with a PLC as its writer."""
    PoseSubscriber(topic, depth=3).close()
    region = region_of(topic)
    region.words[h.WRITER] = h.PLC
    region.words[h.COMPLETED0] = NUMBER
    return region


@pytest.fixture
def clock(monkeypatch):
    """A clock that advances 1 ms per step of a claim. `events` are pairs of a time and a function to call then."""
    clock = SimpleNamespace(now=0.0, steps=[], events=[])

    def monotonic():
        while clock.events and clock.events[0][0] <= clock.now:
            clock.events.pop(0)[1]()
        return clock.now

    def claim_topic(region):
        steps = claim.claim("/topic", region)
        while True:
            try:
                clock.steps.append(next(steps))
            except StopIteration as done:
                return done.value
            clock.now += 0.001
            monotonic()

    monkeypatch.setattr(claim, "time", SimpleNamespace(monotonic=monotonic))
    monkeypatch.setattr(claim, "_STOOD_STILL", STOOD_STILL)
    clock.claim_topic = claim_topic
    return clock


def make_setter(region, word, value):
    return lambda: region.words.__setitem__(word, value)


def test_limits_are_those_of_the_protocol():
    assert (claim.WATCHED, claim._CONFIRM, STOOD_STILL) == (1.0, 0.1, 0.05)
    assert (lock.LOCK_TIMEOUT, settings.UNTIL_RECOVERED, lock._DEAD_AFTER, lock._STUCK_AFTER) == (0.01, 1.1, 0.05, 1.0)
    assert (subscriber._POLL, reader._POLL, wait_any._SLICE) == (0.001, 0.001, 0.01)
    assert (calls._FRESH, calls.HEARTBEAT_INTERVAL, access.PEER_TIMEOUT) == (1.0, 0.05, 0.1)


def test_stopped_plc_is_watched_for_a_second_and_keeps_its_lane(region, clock):
    assert clock.claim_topic(region) == (NUMBER + 1, 2, True)
    assert (region.words[h.LEFT], region.words[h.TURN]) == (NUMBER + 1, 2)
    assert 1.1 <= clock.now < 1.104
    watched = clock.steps.index(claim.CONFIRM)
    assert (set(clock.steps[:watched]), set(clock.steps[watched:])) == ({claim.WATCH}, {claim.CONFIRM})
    assert watched == pytest.approx(1000, abs=2)
    assert region.words[h.WRITER] == region.pid


def test_claim_released_by_a_plc_skips_no_number(region, clock):
    clock.events = [(0.5, make_setter(region, h.WRITER, 0))]
    assert clock.claim_topic(region) == (NUMBER, 0, False)
    assert 0.5 <= clock.now < 0.504


@pytest.mark.parametrize("word", [h.HEARTBEAT, h.WRITER])
def test_late_heartbeat_or_other_writer_refuses_the_claim(region, clock, word):
    clock.events = [(0.99, make_setter(region, word, 77))]
    with pytest.raises(runtime.RegionInUse):
        clock.claim_topic(region)
    assert 0.99 <= clock.now < 0.994


def test_plc_id_stored_while_confirming_refuses_the_claim(region, clock):
    clock.events = [(1.05, make_setter(region, h.WRITER, h.PLC))]
    with pytest.raises(runtime.RegionInUse):
        clock.claim_topic(region)
    assert region.words[h.WRITER] == h.PLC


@pytest.mark.parametrize(("pause", "doubtful"), [(0.05, False), (0.0501, True)])
def test_paused_claimant_confirms_its_claim(region, clock, monkeypatch, pause, doubtful):
    """Wait for the confirmation if more than 0.05 s pass between the check of `writer` and the store."""
    monotonic, times = claim.time.monotonic, [0.0]
    clock.now = pause
    monkeypatch.setattr(claim.time, "monotonic", lambda: times.pop() if times else monotonic())
    region.words[h.WRITER] = 12345
    assert clock.claim_topic(region) == ((NUMBER + 1, 2, True) if doubtful else (NUMBER, 0, False))
    assert len(clock.steps) == pytest.approx(100 if doubtful else 0, abs=2)


@pytest.mark.usefixtures("in_python")
def test_topic_lost_while_copying_clears_the_slot_and_lock(topic):
    with PosePublisher(topic, depth=3) as publisher, PoseSubscriber(topic, depth=3) as subscriber:
        region, words = region_of(publisher), region_of(publisher).words
        for number in (1, 2, 3):
            publisher.publish(pose(number))
        swap_map(publisher, make_setter(region, h.WRITER, h.PLC))
        with pytest.raises(runtime.ClaimLost, match="taken the topic over"):
            publisher.publish(pose(4))
        assert [words[region.number_at(number)] for number in (1, 2, 3, 4)] == [1, 2, 3, 0]
        assert (words[h.COMPLETED0], words[h.LOCK_HOLDER], region.semaphore.value) == (3, 0, 1)
        assert subscriber.read().position.x == 3.0
        with pytest.raises(runtime.ClaimLost):
            publisher.heartbeat()
        words[h.WRITER] = 0
        PosePublisher(topic, depth=3).close()  # the record lock is free although the first publisher is open


@pytest.mark.parametrize("use", [lambda publisher: publisher.publish(pose(2.0)), PosePublisher.heartbeat])
@pytest.mark.usefixtures("each_engine")
def test_publisher_writes_nothing_after_it_lost_the_topic(topic, use):
    """Change no byte of the region, except the number of lock acquisitions."""
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1.0))
        region_of(publisher).words[h.WRITER] = h.PLC
        before = bytes(region_of(publisher).map)
        lock_count = 4 * h.LOCK_COUNT
        with pytest.raises(runtime.ClaimLost, match="a PLC has taken the topic over"):
            use(publisher)
        after = bytes(region_of(publisher).map)
        assert after[:lock_count] + after[lock_count + 4 :] == before[:lock_count] + before[lock_count + 4 :]
        region_of(publisher).words[h.WRITER] = region_of(publisher).pid  # now another publisher of this process
        with pytest.raises(runtime.ClaimLost):
            use(publisher)
        assert region_of(publisher).words[h.COMPLETED0] == 1
