"""`shmgen record`: what is in a region is in the bag, for others too, whatever becomes of the recorder."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader as RosbagsReader

from shmgen.bag import read
from shmgen.bag.kinds import kind_of
from shmgen.live.classes import publisher
from shmgen.live.regions import View
from shmgen.runtime import region_name
from shmgen.tools.messages import parse

from ..support.ros2 import prefix
from ..support.schemas import plain
from .conftest import wait_for

FULL = {
    "flags": [True, False, True],
    "small": -5,
    "at": {"sec": 1_700_000_000, "nanosec": 5_000_000},
    "pauses": [{"sec": 1, "nanosec": 0}],
    "name": "\u00fcber",
    "words": ["a", "bc"],
    "numbers": [1.5, -2.25],
    "points": [{"x": 1.0, "y": 2.0, "z": 3.0}],
    "last": 255,
}


def writer_of(registry, topic, kind="demo_msgs/msg/Full", depth=15):
    return publisher(registry.message(kind), topic, depth)


def full(registry, **values):
    return parse.build(registry.message("demo_msgs/msg/Full"), FULL | values)


def bags(folder):
    return sorted(folder.glob("*.mcap"))


def decoded(*files):
    """All messages, by PyPI's mcap and mcap-ros2-support: the name of the type, what the file says, the message."""
    found = []
    for file in files:
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            found += [
                SimpleNamespace(type=schema.name, topic=channel.topic, at=message, ros=ros)
                for schema, channel, message, ros in reader.iter_decoded_messages()
            ]
    return found


def as_plain(message):
    """What PyPI's mcap-ros2-support makes of a message."""
    if hasattr(message, "__slots__"):
        return {name: as_plain(getattr(message, name)) for name in message.__slots__}
    return [as_plain(item) for item in message] if isinstance(message, list) else message


def test_every_sample_in_order_with_both_stamps_and_equal_values(topic, registry, recording, tmp_path):
    with writer_of(registry, topic) as writer:
        writer.publish(full(registry, small=-1))
        with recording(topic) as recorder:
            for number in range(100):
                before = time.time_ns()
                writer.publish(full(registry, small=number))
                wait_for(lambda number=number: recorder.figures.samples == number + 2)
    assert (recorder.figures.missed, recorder.figures.damaged, recorder.logged) == (0, 0, [])
    (file,) = bags(tmp_path / "bag")
    found = decoded(file)
    assert [one.ros.small for one in found] == [-1, *range(100)]
    assert [one.at.sequence for one in found] == list(range(1, 102))
    assert 0 <= found[-1].at.publish_time - before < 10**9
    assert 0 < found[-1].at.log_time - found[-1].at.publish_time < 10**9
    assert [one.at.log_time for one in found] == sorted(one.at.log_time for one in found)
    wanted = full(registry, small=99)
    assert as_plain(found[-1].ros) == plain(wanted)
    assert found[-1].topic == topic
    with RosbagsReader(tmp_path / "bag") as reader:
        (connection,) = reader.connections
        assert (reader.message_count, connection.msgtype) == (101, "demo_msgs/msg/Full")
        raw = [data for _, _, data in reader.messages()]
    kind = kind_of(registry, "demo_msgs/msg/Full", None)
    assert plain(kind.codec.decode(raw[-1])) == plain(wanted)


def test_rclpy_reads_what_is_recorded(topic, registry, recording, tmp_path):
    python = prefix("jazzy") / "bin" / "python"
    data = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}}}
    kind = registry.message("geometry_msgs/msg/PoseStamped")
    with publisher(kind, topic, 1) as writer:
        writer.publish(parse.build(kind, data))
        with recording(topic):
            pass
    (message,) = (one for one in read.messages(tmp_path / "bag") if isinstance(one, read.Message))
    code = (
        "import sys; from rclpy.serialization import deserialize_message; from geometry_msgs.msg import PoseStamped\n"
        "m = deserialize_message(sys.stdin.buffer.read(), PoseStamped); print(m.header.frame_id, m.pose.position.x)"
    )
    environment = {**os.environ, "AMENT_PREFIX_PATH": str(prefix("jazzy"))}
    said = subprocess.run([python, "-c", code], input=message.data, capture_output=True, env=environment, timeout=60)
    assert said.stdout.split() == [b"map", b"1.5"], said.stderr


def test_regions_that_come_and_go_and_what_was_missed(topic, registry, recording, tmp_path, shmgen):
    """From its first sample on, with the number of what was overwritten; the next region of the topic as well."""
    with recording(topic, count=0) as recorder:
        for life in (1, 2):
            with writer_of(registry, topic, depth=3) as writer:
                wait_for(lambda: recorder.figures.topics == 1)
                for number in range(3):
                    writer.publish(full(registry, small=number))
                wait_for(
                    lambda life=life: sum(map(recorder.figures.__getattribute__, ("samples", "missed"))) >= 3 * life
                )
            assert shmgen("clean", topic, "--force").code == 0  # the recorder has it open
            wait_for(lambda: not recorder._sources)
    assert recorder.figures.samples + recorder.figures.missed == 6
    (file,) = bags(tmp_path / "bag")
    with file.open("rb") as stream:
        (record,) = (one for one in make_reader(stream).iter_metadata() if one.name == "shmgen")
    assert json.loads(record.metadata["missed"]) == {topic: recorder.figures.missed}


def test_what_comes_after_the_last_look_was_missed(topic, registry, recording):
    """Of a region that goes while the recorder looks at it."""
    with writer_of(registry, topic) as writer:
        with recording(topic, count=1) as recorder:
            writer.publish(full(registry))
            wait_for(lambda: recorder.figures.samples == 1)
            recorder._sources[region_name(topic)].reader.samples = list
            for _ in range(3):
                writer.publish(full(registry))
        with View(region_name(topic)) as view:
            assert view.header().missed == 0
    assert (recorder.figures.samples, recorder.figures.missed) == (1, 3)


def test_services_and_actions_by_their_regions(topic, registry, recording, tmp_path, shmgen):
    put = tmp_path / "msgs" / "demo_msgs" / "srv" / "Start.srv"
    put.parent.mkdir()
    put.write_text("bool on\n---\nbool success\n")
    assert shmgen("call", topic, "demo_msgs/Start", "{on: true}", "--timeout", "0.1").code == 1  # nobody serves
    kind = registry.message("demo_msgs/srv/Start_Request", part_of="demo_msgs/srv/Start")
    with recording(topic, count=2) as recorder, publisher(kind, f"{topic}-request", 1) as writer:
        writer.publish(kind(on=True))
        wait_for(lambda: recorder.figures.samples == 1)
    (found,) = decoded(bags(tmp_path / "bag")[0])
    assert (found.topic, found.type, found.ros.on) == (
        f"{topic}/_request",
        "demo_msgs/srv/Start_Request",
        True,
    )


def test_a_new_file_after_so_much(topic, registry, recording, tmp_path):
    kind = registry.message("std_msgs/msg/Int32")
    with publisher(kind, topic, 15) as writer, recording(topic, most=1) as recorder:
        for number in range(3):
            writer.publish(kind(data=number))
            wait_for(lambda number=number: recorder._bag.samples > number)
    files = bags(tmp_path / "bag")
    assert [file.name for file in files] == ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap"]
    assert [one.ros.data for one in decoded(*files)] == [0, 1, 2]
    with RosbagsReader(tmp_path / "bag") as reader:
        assert (reader.message_count, len(list(reader.messages()))) == (3, 3)


def count(file):
    """Messages, also while it is written."""
    return sum(isinstance(one, read.Message) for one in read.messages(file)) if file.stat().st_size else 0


def test_a_topic_that_never_came_is_an_error(topic, registry, tmp_path, shmgen):
    """The bag would be empty, and who mistyped a name would learn that when he needs it."""
    with writer_of(registry, topic) as writer:
        writer.publish(full(registry))
        good = shmgen("record", topic, "-o", str(tmp_path / "good"), "-d", "0.5", "-q")
        wrong = shmgen("record", topic, topic[:-1], "-o", str(tmp_path / "wrong"), "-d", "0.5", "-q")
    assert (good.code, good.stderr) == (0, "")
    assert wrong.code == 1
    assert f"{topic[:-1]}: error[SHM701]: no such region" in wrong.stderr
    assert f"did you mean {topic}?" in wrong.stderr


def test_killed_and_still_readable(topic, registry, tmp_path):
    kind = registry.message("std_msgs/msg/Int32")
    with publisher(kind, topic, 15) as writer:
        writer.publish(kind(data=0))
        command = [sys.executable, "-m", "shmgen", "record", topic, "-o", "bag"]
        with subprocess.Popen(command, cwd=tmp_path) as recorder:
            wait_for(lambda: bags(tmp_path / "bag") and count(bags(tmp_path / "bag")[0]) == 1)
            writer.publish(kind(data=1))
            wait_for(lambda: count(bags(tmp_path / "bag")[0]) == 2)
            recorder.kill()
    (file,) = bags(tmp_path / "bag")
    assert [one.ros.data for one in decoded(file)] == [0, 1]
    with RosbagsReader(tmp_path / "bag") as reader:
        assert len(list(reader.messages())) == 2
    whole = file.read_bytes()
    for end in range(len(whole) - 50, 300, -7):  # killed within write(), or a file that was copied too early
        file.write_bytes(whole[:end])
        found = [one for one in read.messages(file) if isinstance(one, read.Message)]
        assert [one.data[4] for one in found] == [0, 1][: len(found)]
    assert found == []


@pytest.mark.slow
def test_a_full_disk_is_told_and_leaves_a_readable_bag(topic, registry, tmp_path):
    kind = registry.message("geometry_msgs/msg/PoseStamped")

    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    with publisher(kind, topic, 255) as writer:
        writer.publish(kind())
        command = [sys.executable, "-m", "shmgen", "record", topic, "-o", "bag"]
        with subprocess.Popen(command, cwd=tmp_path, preexec_fn=limited, stderr=subprocess.PIPE, text=True) as recorder:
            while recorder.poll() is None:
                writer.publish(kind())
                time.sleep(0.002)
            said = recorder.stderr.read()
    assert recorder.returncode == 1
    assert "bag: error[SHM007]: cannot write: File too large; " in said
    kept = int(said.partition("large; ")[2].partition(" sample")[0].replace(",", ""))
    found = decoded(bags(tmp_path / "bag")[0])
    assert len(found) == kept > 0


def test_what_cannot_be_recorded_is_told_once_and_the_rest_is(topic, registry, recording, tmp_path, shmgen):
    from ..runtime.messages import PosePublisher

    with PosePublisher(topic + "x"), writer_of(registry, topic) as writer:
        writer.publish(full(registry))
        with recording(topic, topic + "x", count=1) as recorder:
            time.sleep(0.6)  # it looks for others four times a second
    assert recorder.failed
    (logged,) = recorder.logged
    assert logged.startswith(
        f"{topic}x: not recorded: geometry_msgs/msg/Pose has another layout in the region than here"
    )
    assert recorder.figures.samples == 1


def test_the_command(topic, registry, tmp_path, shmgen):
    assert shmgen("record").code == 2
    assert shmgen("record", "-a", "--max-size", "5X").code == 2
    with writer_of(registry, topic) as writer:
        writer.publish(full(registry))
        done = shmgen("record", topic, "-o", "bag", "-d", "0.3")
        assert (done.code, done.stderr) == (0, "")
        assert done.stdout.startswith("bag: 1 file, 1 sample of 1 topic, 0 missed, 0.0 MB")
        again = shmgen("record", topic, "-o", "bag", "-d", "0.3")
        assert (again.code, again.stderr.partition("\n")[0]) == (1, "bag: error[SHM007]: the folder exists already")
