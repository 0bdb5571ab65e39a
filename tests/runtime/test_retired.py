"""A region that is removed or replaced under ends that do not reopen it: each call raises that, and one region is left.

Pose stands for a message, Scan for what became of it.
"""

from __future__ import annotations

import logging
import os
import threading
import time

import pytest

from shmgen import runtime
from shmgen.core.abi import REPAIR_LOCK
from shmgen.live.processes import Processes
from shmgen.runtime.region import header as h
from shmgen.runtime.region import record_locks
from shmgen.tools.doctor import clean

from ..support.plc_demo import Memory
from .messages import PosePublisher, PoseSubscriber, Scan, ScanPublisher, ScanSubscriber, pose

pytestmark = pytest.mark.usefixtures("each_engine")
RETIRED = "was removed, or replaced by one of another layout: open this {} anew"


def type_of(topic):
    return runtime.read_header(runtime.region_name(topic)).type_name


def told(call, word):
    """From 0.1 s after the removal on."""
    time.sleep(0.12)
    for _ in range(2):
        with pytest.raises(runtime.RegionRetired, match=RETIRED.format(word)):
            call()


@pytest.mark.parametrize("way", ["clean", "rm"])
def test_who_has_it_open_is_told(topic, file, way):
    """`rm` leaves no mark in the region: the first end that checks the file sets one, also for PLCs."""
    publisher, subscriber, idle = (
        side(topic, reopen=False) for side in (PosePublisher, PoseSubscriber, PoseSubscriber)
    )
    with publisher, subscriber, idle:
        publisher.publish(pose(1))
        memory = Memory(topic)
        if way == "rm":
            file.unlink()
        else:
            clean.remove(clean.leftovers(topic))
        assert bool(memory["retired"]) == (way == "clean")
        assert not file.exists()
        assert subscriber.read().position.x == 1.0, "what is there is read first"
        told(lambda: subscriber.wait(30), "subscriber")
        told(publisher.heartbeat, "publisher")
        assert idle.read().position.x == 1.0
        told(idle.read, "subscriber")
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(2))
        assert subscriber.wait(1).position.x == 2.0


def test_a_publisher_is_told_before_it_publishes(topic):
    with PosePublisher(topic, reopen=False) as publisher:
        clean.remove(clean.leftovers(topic))
        told(lambda: publisher.publish(pose(1)), "publisher")


def test_who_only_looks_whether_the_writer_lives_sees_it_too(topic, file):
    with PosePublisher(topic), PoseSubscriber(topic, reopen=False) as subscriber:
        memory = Memory(topic)
        file.unlink()
        time.sleep(0.12)
        assert subscriber.is_stale(0)
        assert memory["retired"]


def test_who_waits_is_told_at_once(topic, file):
    with PosePublisher(topic), PoseSubscriber(topic, reopen=False) as subscriber:
        threading.Timer(0.1, file.unlink).start()
        before = time.monotonic()
        with pytest.raises(runtime.RegionRetired, match=RETIRED.format("subscriber")):
            subscriber.wait(30)
        assert time.monotonic() - before < 20


def test_clean_leaves_a_region_that_a_reader_out_of_sight_has_open(topic, file):
    """As in a container, whose processes are not seen here; the record lock is."""
    processes = Processes([], False)
    with PoseSubscriber(topic):
        assert clean.in_use(topic, processes) == "a process of another user or in another container uses it"
    assert not clean.in_use(topic, processes)
    assert file.exists()


@pytest.mark.parametrize("side", [ScanPublisher, ScanSubscriber])
def test_what_nobody_has_open_is_replaced(topic, side):
    PosePublisher(topic).close()
    with side(topic):
        assert type_of(topic) == Scan._type_name_
    PoseSubscriber(topic).close()
    assert type_of(topic) == "geometry_msgs/msg/Pose"


def test_another_depth_is_another_layout(topic):
    PosePublisher(topic).close()
    with PosePublisher(topic, depth=8) as publisher, PoseSubscriber(topic, depth=8) as subscriber:
        for x in range(8):
            publisher.publish(pose(x))
        assert [one.position.x for one in subscriber.read_all()] == list(range(8))


@pytest.mark.parametrize("side", [ScanPublisher, ScanSubscriber])
def test_what_a_living_process_writes_is_not(topic, side):
    with PosePublisher(topic) as publisher:
        with pytest.raises(
            runtime.LayoutMismatch, match=f"process {os.getpid()} writes it: update that side, or stop it"
        ):
            side(topic)
        publisher.publish(pose(1))


def test_readers_are_told_by_who_replaces_it_to_write(topic):
    with PoseSubscriber(topic, reopen=False) as subscriber:
        with pytest.raises(
            runtime.LayoutMismatch, match="a reader does not replace it: stop them, or start the publisher"
        ):
            ScanSubscriber(topic)
        with ScanPublisher(topic):
            told(subscriber.read, "subscriber")
            with pytest.raises(runtime.LayoutMismatch, match="writes it"):
                PoseSubscriber(topic)


@pytest.mark.parametrize("side", [ScanPublisher, ScanSubscriber])
def test_a_plc_is_watched_for_a_second(topic, side):
    PosePublisher(topic).close()
    memory = Memory(topic)
    stop = threading.Event()

    def beat():
        while not stop.wait(0.02):
            memory["heartbeat"] += 1

    memory["writer"] = h.PLC
    thread = threading.Thread(target=beat)
    thread.start()
    with pytest.raises(runtime.LayoutMismatch, match="a PLC writes it: update that side, or stop it"):
        side(topic)
    stop.set()
    thread.join()
    assert memory["retired"] == 0
    before = time.monotonic()
    side(topic).close()
    assert time.monotonic() - before >= 1
    assert memory["retired"] == 1, "a PLC that goes on sees it"


def test_who_dies_between_the_mark_and_the_removal(topic, file):
    """Whoever comes next, of either layout, ends it."""
    for side in (PosePublisher, PoseSubscriber, ScanPublisher, ScanSubscriber):
        PosePublisher(topic).close()
        Memory(topic)["retired"] = 1
        before = file.stat().st_ino
        with side(topic):
            assert file.stat().st_ino != before
            assert runtime.read_header(runtime.region_name(topic)).retired == 0


def test_one_waits_while_another_takes_the_name_away(topic, file):
    PosePublisher(topic).close()
    Memory(topic)["retired"] = 1
    with file.open("r+b") as held:
        assert record_locks.lock_byte(held.fileno(), REPAIR_LOCK)
        threading.Timer(0.2, held.close).start()
        with PosePublisher(topic) as publisher:
            assert held.closed
            publisher.publish(pose(1))


@pytest.mark.parametrize(("existing", "depth", "cause"), [(PosePublisher, 4, "depth"), (ScanPublisher, 1, "layout")])
def test_a_subscriber_logs_that_it_replaces_samples(topic, caplog, existing, depth, cause):
    """The sample is lost with its region, so the log names the topic, the cause and the next step."""
    with existing(topic) as publisher:
        publisher.publish(pose(1) if existing is PosePublisher else Scan())
    for _ in range(2):
        with PoseSubscriber(topic, depth=depth) as subscriber:
            assert subscriber.read() is None
    (warning,) = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert warning.startswith(f"{topic}: this subscriber replaced an unused region of another {cause}")
    assert "its samples are lost" in warning
    assert ("same depth" in warning) == (cause == "depth")


def test_nothing_is_logged_for_a_replaced_region_without_samples(topic, caplog):
    PosePublisher(topic).close()
    PoseSubscriber(topic, depth=4).close()
    PosePublisher(topic, depth=1).close()
    assert not caplog.records
