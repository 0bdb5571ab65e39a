"""Endpoints that do not reopen raise RegionRetired after their region was removed or replaced.

Pose is the former layout of a message, and Scan is its new layout.
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
RETIRED = "was removed, or replaced by a region of another layout: .*open a new {}"


def read_type_name(topic):
    return runtime.read_header(runtime.region_name(topic)).type_name


def check_retired(call, word):
    """Check that the call raises RegionRetired, from 0.1 s after the removal on."""
    time.sleep(0.12)
    for _ in range(2):
        with pytest.raises(runtime.RegionRetired, match=RETIRED.format(word)):
            call()


@pytest.mark.parametrize("method", ["clean", "rm"])
def test_calls_raise_after_the_region_was_removed(topic, file, method):
    """Mark the region. After `rm`, the first endpoint that checks the file sets the mark, which PLCs read as well."""
    publisher, subscriber, idle = (
        side(topic, reopen=False) for side in (PosePublisher, PoseSubscriber, PoseSubscriber)
    )
    with publisher, subscriber, idle:
        publisher.publish(pose(1))
        memory = Memory(topic)
        if method == "rm":
            file.unlink()
        else:
            clean.remove(clean.leftovers(topic))
        assert bool(memory["retired"]) == (method == "clean")
        assert not file.exists()
        assert subscriber.read().position.x == 1.0, "the existing sample is read first"
        check_retired(lambda: subscriber.wait(30), "subscriber")
        check_retired(publisher.heartbeat, "publisher")
        assert idle.read().position.x == 1.0
        check_retired(idle.read, "subscriber")
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(2))
        assert subscriber.wait(1).position.x == 2.0


def test_publisher_raises_before_it_publishes(topic):
    with PosePublisher(topic, reopen=False) as publisher:
        clean.remove(clean.leftovers(topic))
        check_retired(lambda: publisher.publish(pose(1)), "publisher")


def test_is_stale_marks_a_removed_region(topic, file):
    with PosePublisher(topic), PoseSubscriber(topic, reopen=False) as subscriber:
        memory = Memory(topic)
        file.unlink()
        time.sleep(0.12)
        assert subscriber.is_stale(0)
        assert memory["retired"]


def test_waiting_subscriber_raises_at_once(topic, file):
    with PosePublisher(topic), PoseSubscriber(topic, reopen=False) as subscriber:
        threading.Timer(0.1, file.unlink).start()
        before = time.monotonic()
        with pytest.raises(runtime.RegionRetired, match=RETIRED.format("subscriber")):
            subscriber.wait(30)
        assert time.monotonic() - before < 20


def test_clean_keeps_a_region_of_an_invisible_reader(topic, file):
    """Discover a reader in another container by its record lock, because its process is invisible."""
    processes = Processes([], False)
    with PoseSubscriber(topic):
        assert clean.in_use(topic, processes) == "a process of another user or in another container uses it"
    assert not clean.in_use(topic, processes)
    assert file.exists()


@pytest.mark.parametrize("side", [ScanPublisher, ScanSubscriber])
def test_unused_region_of_another_layout_is_replaced(topic, side):
    PosePublisher(topic).close()
    with side(topic):
        assert read_type_name(topic) == Scan._type_name_
    PoseSubscriber(topic).close()
    assert read_type_name(topic) == "geometry_msgs/msg/Pose"


def test_another_depth_is_another_layout(topic):
    PosePublisher(topic).close()
    with PosePublisher(topic, depth=8) as publisher, PoseSubscriber(topic, depth=8) as subscriber:
        for x in range(8):
            publisher.publish(pose(x))
        assert [message.position.x for message in subscriber.read_all()] == list(range(8))


@pytest.mark.parametrize("side", [ScanPublisher, ScanSubscriber])
def test_region_with_a_live_writer_is_not_replaced(topic, side):
    with PosePublisher(topic) as publisher:
        with pytest.raises(runtime.LayoutMismatch, match=f"process {os.getpid()} writes the region: update or stop it"):
            side(topic)
        publisher.publish(pose(1))


def test_readers_raise_after_a_writer_replaced_the_region(topic):
    with PoseSubscriber(topic, reopen=False) as subscriber:
        with pytest.raises(
            runtime.LayoutMismatch, match="other subscribers use the region: stop these subscribers, or start"
        ):
            ScanSubscriber(topic)
        with ScanPublisher(topic):
            check_retired(subscriber.read, "subscriber")
            with pytest.raises(runtime.LayoutMismatch, match="writes the region"):
                PoseSubscriber(topic)


@pytest.mark.parametrize("side", [ScanPublisher, ScanSubscriber])
def test_plc_is_watched_for_a_second_before_a_replacement(topic, side):
    PosePublisher(topic).close()
    memory = Memory(topic)
    stop = threading.Event()

    def beat():
        while not stop.wait(0.02):
            memory["heartbeat"] += 1

    memory["writer"] = h.PLC
    thread = threading.Thread(target=beat)
    thread.start()
    with pytest.raises(runtime.LayoutMismatch, match="a PLC writes the region: update or stop it"):
        side(topic)
    stop.set()
    thread.join()
    assert memory["retired"] == 0
    before = time.monotonic()
    side(topic).close()
    assert time.monotonic() - before >= 1
    assert memory["retired"] == 1, "a PLC that continues finds the mark"


def test_next_endpoint_replaces_a_marked_region(topic, file):
    """Replace a region whose remover died between the mark and the removal."""
    for side in (PosePublisher, PoseSubscriber, ScanPublisher, ScanSubscriber):
        PosePublisher(topic).close()
        Memory(topic)["retired"] = 1
        before = file.stat().st_ino
        with side(topic):
            assert file.stat().st_ino != before
            assert runtime.read_header(runtime.region_name(topic)).retired == 0


def test_opening_waits_while_another_removes_the_file(topic, file):
    PosePublisher(topic).close()
    Memory(topic)["retired"] = 1
    with file.open("r+b") as stream:
        assert record_locks.lock_byte(stream.fileno(), REPAIR_LOCK)
        threading.Timer(0.2, stream.close).start()
        with PosePublisher(topic) as publisher:
            assert stream.closed
            publisher.publish(pose(1))


@pytest.mark.parametrize(("existing", "depth", "cause"), [(PosePublisher, 4, "depth"), (ScanPublisher, 1, "layout")])
def test_subscriber_logs_that_it_replaces_samples(topic, caplog, existing, depth, cause):
    """Log the topic, the cause and the next step, because the sample is lost with its region."""
    with existing(topic) as publisher:
        publisher.publish(pose(1) if existing is PosePublisher else Scan())
    for _ in range(2):
        with PoseSubscriber(topic, depth=depth) as subscriber:
            assert subscriber.read() is None
    (warning,) = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert warning.startswith(f"{topic}: this subscriber replaced an unused region of another {cause}")
    assert "its samples are lost" in warning
    assert ("same depth" in warning) == (cause == "depth")


def test_replaced_region_without_samples_logs_nothing(topic, caplog):
    PosePublisher(topic).close()
    PoseSubscriber(topic, depth=4).close()
    PosePublisher(topic, depth=1).close()
    assert not caplog.records
