"""Subscriber.borrow() lends the newest sample in place, and raises Overwritten if the writer overwrote the sample."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from shmgen import runtime
from shmgen.config import Config
from shmgen.core.model import TypeName
from shmgen.generator import pipeline
from tests.support import build
from tests.support.region_of import region_of

from .messages import PosePublisher, PoseSubscriber, pose

DEFINITIONS = {
    "Point": "float64 x\nuint8[3] colour\n",
    "Cloud": "uint32 id\nstring name\nPoint first\nPoint[2] two\nPoint[<=3] some\nfloat32[<=4] depths\nbool[2] flags\n"
    "builtin_interfaces/Time at\nuint8[<=4096] data\n",
}
WRITE = """
import os, sys
sys.path.insert(0, sys.argv[1])
from shm_borrow.borrow_msgs.msg import Cloud, CloudPublisher
publisher = CloudPublisher(sys.argv[2])
publisher.publish(Cloud(id=1, data=b"a" * 4096))
print("published", flush=True)
sys.stdin.read()
"""
pytestmark = pytest.mark.usefixtures("each_engine")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("borrow")
    build.put({f"msgs/borrow_msgs/msg/{name}.msg": text for name, text in DEFINITIONS.items()}, folder)
    config = Config(folder, path=(folder / "msgs",), package="shm_borrow", targets=("python",))
    build.put(pipeline.generate(config, ["borrow_msgs"]), folder)
    return folder


@pytest.fixture(scope="module")
def msg(folder):
    return build.module(folder, "shm_borrow", TypeName("borrow_msgs", "msg", "Cloud"))


@pytest.fixture
def pair(topic, msg):
    with msg.CloudPublisher(topic) as publisher, msg.CloudSubscriber(topic) as subscriber:
        yield publisher, subscriber


def test_borrow_reads_the_sample_in_place(msg, pair):
    publisher, subscriber = pair
    with subscriber.borrow() as nothing:
        assert nothing is None
    point = msg.Point(x=2.5, colour=[1, 2, 3])
    publisher.publish(msg.Cloud())
    publisher.publish(
        msg.Cloud(
            id=7, name="hall", first=point, two=[msg.Point(), point], some=[point], depths=[0.5, 1.5],
            flags=[True, False], data=b"abc",
        )
    )  # fmt: skip
    with subscriber.borrow() as cloud:
        assert (cloud.id, cloud.name, cloud.at) == (7, "hall", runtime.Time())
        assert (cloud.first.x, cloud.first.colour.tolist()) == (2.5, [1, 2, 3])
        assert [(point.x, point.colour[2]) for point in cloud.two] == [(0, 0), (2.5, 3)]
        assert [point.x for point in cloud.some] == [2.5]
        assert (cloud.depths.tolist(), cloud.flags.tolist(), bytes(cloud.data)) == ([0.5, 1.5], [True, False], b"abc")
        assert "name='hall'" in repr(cloud)
        region = region_of(publisher)
        place = region.payload(region.sample(2).start).start + msg.Cloud.id.offset
        region.map[place] = 9
        assert cloud.id == 9, "not a copy"
    assert (subscriber.sequence, subscriber.missed, subscriber.read()) == (2, 1, None)


def test_borrowed_sample_is_read_only(msg, pair):
    publisher, subscriber = pair
    publisher.publish(msg.Cloud(id=7, some=[msg.Point()], data=b"abc"))
    with subscriber.borrow() as cloud:
        for change in (
            lambda: setattr(cloud, "id", 1),
            lambda: setattr(cloud.first, "x", 1.0),
            lambda: cloud.data.__setitem__(0, 1),
            lambda: cloud.some[0].colour.__setitem__(0, 1),
        ):
            with pytest.raises((AttributeError, TypeError)):
                change()
    region = region_of(publisher)
    assert bytes(region.map[region.payload(region.sample(1).start)]) == bytes(
        msg.Cloud(id=7, some=[msg.Point()], data=b"abc")
    )


def overwrite_while_borrowed(publisher, subscriber, kind, use):
    """Overwrite the slot of a borrowed sample, and pass the sample to `use`."""
    with subscriber.borrow() as cloud:
        publisher.publish(kind())
        publisher.publish(kind(id=9))
        use(cloud)


def test_overwritten_sample_raises_and_does_not_count(msg, pair):
    publisher, subscriber = pair
    publisher.publish(msg.Cloud(id=1))
    seen = []
    with pytest.raises(runtime.Overwritten, match="read the newest"):
        overwrite_while_borrowed(publisher, subscriber, msg.Cloud, lambda cloud: seen.append(cloud.id))
    assert (seen, subscriber.sequence, subscriber.missed) == ([9], 0, 1)
    with subscriber.borrow() as cloud:
        publisher.publish(msg.Cloud(id=4))  # into the other slot
        assert cloud.id == 9
    assert (subscriber.sequence, subscriber.missed, subscriber.read().id) == (3, 2, 4)


def test_error_while_borrowing_is_raised_unless_overwritten(msg, pair):
    publisher, subscriber = pair
    publisher.publish(msg.Cloud(id=1))
    with pytest.raises(KeyError), subscriber.borrow():
        raise KeyError
    assert subscriber.sequence == 1

    def read_broken_count(cloud):
        region = region_of(publisher)
        place = region.payload(region.sample(publisher.sequence).start).start + vars(msg.Cloud)["data"].step.count_at
        region.map[place : place + 4] = b"\xff" * 4
        assert cloud.data

    def interrupt(cloud):
        raise KeyboardInterrupt

    publisher.publish(msg.Cloud(id=2))
    with pytest.raises(runtime.Overwritten) as raised:
        overwrite_while_borrowed(publisher, subscriber, msg.Cloud, read_broken_count)
    assert isinstance(raised.value.__cause__, runtime.CountExceeded)
    publisher.publish(msg.Cloud(id=5))
    with pytest.raises(KeyboardInterrupt):
        overwrite_while_borrowed(publisher, subscriber, msg.Cloud, interrupt)
    with subscriber.borrow() as cloud:
        assert cloud.id == 9


def test_subscriber_lends_one_sample_at_a_time(msg, pair):
    publisher, subscriber = pair
    publisher.publish(msg.Cloud(id=1))
    with subscriber.borrow() as cloud:
        with pytest.raises(runtime.Reentered, match="borrowed already"), subscriber.borrow():
            pass
        assert cloud.id == 1


def test_borrowed_sample_outlives_its_subscriber(msg, pair):
    """Keep the memory mapped, and raise Closed at the end of the `with`."""
    publisher, subscriber = pair
    publisher.publish(msg.Cloud(id=1, data=b"abc"))
    borrowed = []

    def close_while_borrowed():
        with subscriber.borrow() as cloud:
            subscriber.close()
            borrowed.extend((cloud, cloud.data))

    with pytest.raises(runtime.Closed):
        close_while_borrowed()
    assert (borrowed[0].id, bytes(borrowed[1])) == (1, b"abc")
    with pytest.raises(runtime.Closed), subscriber.borrow():
        pass


def test_writer_may_die_while_its_sample_is_borrowed(folder, topic, msg):
    command = [sys.executable, "-c", WRITE, str(folder / "python"), topic]
    with (
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as writer,
        msg.CloudSubscriber(topic) as subscriber,
    ):
        assert writer.stdout.readline() == "published\n"
        with subscriber.borrow() as cloud:
            os.kill(writer.pid, signal.SIGKILL)
            writer.wait()
            assert bytes(cloud.data) == b"a" * 4096
        assert subscriber.sequence == 1


def test_passive_subscriber_refuses_to_borrow(topic, msg, pair):
    pair[0].publish(msg.Cloud())
    with (
        msg.CloudSubscriber(topic, passive=True) as watcher,
        pytest.raises(ValueError, match=r"use read\(\)"),
        watcher.borrow(),
    ):
        pass


def test_read_while_a_sample_is_borrowed_repeats_no_sample(topic):
    with PosePublisher(topic, depth=3) as publisher, PoseSubscriber(topic, depth=3) as subscriber:
        publisher.publish(pose(1))
        with subscriber.borrow() as lent:
            publisher.publish(pose(2))
            assert (lent.position.x, subscriber.unread, subscriber.read().position.x) == (1, 1, 2)
        assert (subscriber.read(), subscriber.sequence, subscriber.missed) == (None, 2, 0)
