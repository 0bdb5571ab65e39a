"""Who may write a topic after a PLC, to the millisecond: the clock and what the PLC does meanwhile are the test's."""

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
"""Before in_time lets it never come."""


@pytest.fixture
def region(topic):
    """A reader's, with a PLC as the writer."""
    PoseSubscriber(topic, depth=3).close()
    region = region_of(topic)
    region.words[h.WRITER] = h.PLC
    region.words[h.COMPLETED0] = NUMBER
    return region


@pytest.fixture
def clock(monkeypatch):
    """Goes on only between two steps; `events` are (from when on, what happens once)."""
    clock = SimpleNamespace(now=0.0, steps=[], events=[])

    def monotonic():
        while clock.events and clock.events[0][0] <= clock.now:
            clock.events.pop(0)[1]()
        return clock.now

    def claimed(region):
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
    clock.claimed = claimed
    return clock


def says(region, word, value):
    return lambda: region.words.__setitem__(word, value)


def test_limits_are_those_of_the_protocol():
    assert (claim.WATCHED, claim._CONFIRM, STOOD_STILL) == (1.0, 0.1, 0.05)
    assert (lock.LOCK_TIMEOUT, settings.UNTIL_RECOVERED, lock._DEAD_AFTER, lock._STUCK_AFTER) == (0.01, 1.1, 0.05, 1.0)
    assert (subscriber._POLL, reader._POLL, wait_any._SLICE) == (0.001, 0.001, 0.01)
    assert (calls._FRESH, calls._HEARTBEAT, access.PEER_TIMEOUT) == (1.0, 0.05, 0.1)


def test_a_plc_that_stands_still_is_watched_for_a_second_and_its_lane_is_left_to_it(region, clock):
    assert clock.claimed(region) == (NUMBER + 1, 2, True)
    assert (region.words[h.LEFT], region.words[h.TURN]) == (NUMBER + 1, 2)
    assert 1.1 <= clock.now < 1.104
    watched = clock.steps.index(claim.CONFIRM)
    assert (set(clock.steps[:watched]), set(clock.steps[watched:])) == ({claim.WATCH}, {claim.CONFIRM})
    assert watched == pytest.approx(1000, abs=2)
    assert region.words[h.WRITER] == region.pid


def test_a_plc_that_lets_go_leaves_its_numbers_too(region, clock):
    clock.events = [(0.5, says(region, h.WRITER, 0))]
    assert clock.claimed(region) == (NUMBER, 0, False)
    assert 0.5 <= clock.now < 0.504


@pytest.mark.parametrize("word", [h.HEARTBEAT, h.WRITER])
def test_who_moves_at_the_last_moment_is_a_writer(region, clock, word):
    clock.events = [(0.99, says(region, word, 77))]
    with pytest.raises(runtime.RegionInUse):
        clock.claimed(region)
    assert 0.99 <= clock.now < 0.994


def test_whose_name_stands_in_the_end_is_the_writer(region, clock):
    clock.events = [(1.05, says(region, h.WRITER, h.PLC))]
    with pytest.raises(runtime.RegionInUse):
        clock.claimed(region)
    assert region.words[h.WRITER] == h.PLC


@pytest.mark.parametrize(("stop", "doubtful"), [(0.05, False), (0.0501, True)])
def test_who_stands_still_between_look_and_name_makes_sure(region, clock, monkeypatch, stop, doubtful):
    """The second look at the clock comes after the name."""
    monotonic, looks = claim.time.monotonic, [0.0]
    clock.now = stop
    monkeypatch.setattr(claim.time, "monotonic", lambda: looks.pop() if looks else monotonic())
    region.words[h.WRITER] = 12345
    assert clock.claimed(region) == ((NUMBER + 1, 2, True) if doubtful else (NUMBER, 0, False))
    assert len(clock.steps) == pytest.approx(100 if doubtful else 0, abs=2)


@pytest.mark.usefixtures("in_python")
def test_who_loses_the_topic_in_its_copy_voids_the_slot_and_gives_all_back(topic):
    with PosePublisher(topic, depth=3) as publisher, PoseSubscriber(topic, depth=3) as subscriber:
        region, words = region_of(publisher), region_of(publisher).words
        for number in (1, 2, 3):
            publisher.publish(pose(number))
        swap_map(publisher, says(region, h.WRITER, h.PLC))
        with pytest.raises(runtime.ClaimLost, match="taken the topic over"):
            publisher.publish(pose(4))
        assert [words[region.number_at(number)] for number in (1, 2, 3, 4)] == [1, 2, 3, 0]
        assert (words[h.COMPLETED0], words[h.LOCK_HOLDER], region.semaphore.value) == (3, 0, 1)
        assert subscriber.read().position.x == 3.0
        with pytest.raises(runtime.ClaimLost):
            publisher.heartbeat()
        words[h.WRITER] = 0
        PosePublisher(topic, depth=3).close()  # the record lock is free while the loser is still open


@pytest.mark.parametrize("use", [lambda publisher: publisher.publish(pose(2.0)), PosePublisher.heartbeat])
@pytest.mark.usefixtures("each_engine")
def test_who_has_lost_the_topic_writes_not_a_byte(topic, use):
    """But that it was inside the lock."""
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1.0))
        region_of(publisher).words[h.WRITER] = h.PLC
        before = bytes(region_of(publisher).map)
        inside = 4 * h.LOCK_COUNT
        with pytest.raises(runtime.ClaimLost, match="a PLC has taken the topic over"):
            use(publisher)
        after = bytes(region_of(publisher).map)
        assert after[:inside] + after[inside + 4 :] == before[:inside] + before[inside + 4 :]
        region_of(publisher).words[h.WRITER] = region_of(publisher).pid  # another publisher of this process has it now
        with pytest.raises(runtime.ClaimLost):
            use(publisher)
        assert region_of(publisher).words[h.COMPLETED0] == 1
