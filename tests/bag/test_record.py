"""Tests of `shmgen record`: a bag has all samples of its regions, and stays readable if the recorder is killed."""

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
from shmgen.bag.kinds import Kind
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


def open_writer(registry, topic, kind="demo_msgs/msg/Full", depth=15):
    return publisher(registry.message(kind), topic, depth)


def build_full(registry, **values):
    return parse.build(registry.message("demo_msgs/msg/Full"), FULL | values)


def list_bags(folder):
    return sorted(folder.glob("*.mcap"))


def decode(*files):
    """Decode all messages with PyPI's mcap and mcap-ros2-support. `at` is the record in the file."""
    messages = []
    for file in files:
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            messages += [
                SimpleNamespace(type=schema.name, topic=channel.topic, at=message, ros=ros)
                for schema, channel, message, ros in reader.iter_decoded_messages()
            ]
    return messages


def to_plain(message):
    """Convert a message of PyPI's mcap-ros2-support to plain Python values."""
    if hasattr(message, "__slots__"):
        return {name: to_plain(getattr(message, name)) for name in message.__slots__}
    return [to_plain(item) for item in message] if isinstance(message, list) else message


def test_bag_has_all_samples_in_order_with_stamps_and_values(topic, registry, recording, tmp_path):
    with open_writer(registry, topic) as writer:
        writer.publish(build_full(registry, small=-1))
        with recording(topic) as recorder:
            for number in range(100):
                before = time.time_ns()
                writer.publish(build_full(registry, small=number))
                wait_for(lambda number=number: recorder.figures.samples == number + 2)
    assert (recorder.figures.missed, recorder.figures.damaged, recorder.logged) == (0, 0, [])
    (file,) = list_bags(tmp_path / "bag")
    messages = decode(file)
    assert [item.ros.small for item in messages] == [-1, *range(100)]
    assert [item.at.sequence for item in messages] == list(range(1, 102))
    assert 0 <= messages[-1].at.publish_time - before < 10**9
    assert 0 < messages[-1].at.log_time - messages[-1].at.publish_time < 10**9
    assert [item.at.log_time for item in messages] == sorted(item.at.log_time for item in messages)
    expected = build_full(registry, small=99)
    assert to_plain(messages[-1].ros) == plain(expected)
    assert messages[-1].topic == topic
    with RosbagsReader(tmp_path / "bag") as reader:
        (connection,) = reader.connections
        assert (reader.message_count, connection.msgtype) == (101, "demo_msgs/msg/Full")
        raw = [data for _, _, data in reader.messages()]
    kind = Kind(registry.session_of("demo_msgs/msg/Full"), "demo_msgs/msg/Full")
    assert plain(kind.codec.decode(raw[-1])) == plain(expected)


def test_rclpy_deserializes_a_recorded_message(topic, registry, recording, tmp_path):
    python = prefix("jazzy") / "bin" / "python"
    data = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1.5}}}
    kind = registry.message("geometry_msgs/msg/PoseStamped")
    with publisher(kind, topic, 1) as writer:
        writer.publish(parse.build(kind, data))
        with recording(topic):
            pass
    (message,) = (item for item in read.messages(tmp_path / "bag") if isinstance(item, read.Message))
    code = (
        "import sys; from rclpy.serialization import deserialize_message; from geometry_msgs.msg import PoseStamped\n"
        "m = deserialize_message(sys.stdin.buffer.read(), PoseStamped); print(m.header.frame_id, m.pose.position.x)"
    )
    environment = {**os.environ, "AMENT_PREFIX_PATH": str(prefix("jazzy"))}
    result = subprocess.run([python, "-c", code], input=message.data, capture_output=True, env=environment, timeout=60)
    assert result.stdout.split() == [b"map", b"1.5"], result.stderr


def test_recorder_counts_missed_samples_over_two_regions(topic, registry, recording, tmp_path, shmgen):
    """Record each region of the topic from its first sample on, and count samples that were overwritten."""
    with recording(topic, count=0) as recorder:
        for life in (1, 2):
            with open_writer(registry, topic, depth=3) as writer:
                wait_for(lambda: recorder.figures.topics == 1)
                for number in range(3):
                    writer.publish(build_full(registry, small=number))
                wait_for(
                    lambda life=life: sum(map(recorder.figures.__getattribute__, ("samples", "missed"))) >= 3 * life
                )
            assert shmgen("clean", topic, "--force").code == 0  # the recorder has the region open
            wait_for(lambda: not recorder._sources)
    assert recorder.figures.samples + recorder.figures.missed == 6
    (file,) = list_bags(tmp_path / "bag")
    with file.open("rb") as stream:
        (record,) = (item for item in make_reader(stream).iter_metadata() if item.name == "shmgen")
    assert json.loads(record.metadata["missed"]) == {topic: recorder.figures.missed}


def test_sample_after_the_last_poll_counts_as_missed(topic, registry, recording):
    """Count samples of a region that closes while the recorder polls it."""
    with open_writer(registry, topic) as writer:
        with recording(topic, count=1) as recorder:
            writer.publish(build_full(registry))
            wait_for(lambda: recorder.figures.samples == 1)
            recorder._sources[region_name(topic)].reader.samples = list
            for _ in range(3):
                writer.publish(build_full(registry))
        with View(region_name(topic)) as view:
            assert view.header().missed == 0
    assert (recorder.figures.samples, recorder.figures.missed) == (1, 3)


def test_request_region_of_a_service_is_recorded(topic, registry, recording, tmp_path, shmgen):
    definition = tmp_path / "msgs" / "demo_msgs" / "srv" / "Start.srv"
    definition.parent.mkdir()
    definition.write_text("bool on\n---\nbool success\n")
    assert shmgen("call", topic, "demo_msgs/Start", "{on: true}", "--timeout", "0.1").code == 1  # no server
    kind = registry.message("demo_msgs/srv/Start_Request", part_of="demo_msgs/srv/Start")
    with recording(topic, count=2) as recorder, publisher(kind, f"{topic}-request", 1) as writer:
        writer.publish(kind(on=True))
        wait_for(lambda: recorder.figures.samples == 1)
    (message,) = decode(list_bags(tmp_path / "bag")[0])
    assert (message.topic, message.type, message.ros.on) == (
        f"{topic}/_request",
        "demo_msgs/srv/Start_Request",
        True,
    )


def test_recorder_starts_a_new_file_at_the_size_limit(topic, registry, recording, tmp_path):
    kind = registry.message("std_msgs/msg/Int32")
    with publisher(kind, topic, 15) as writer, recording(topic, most=1) as recorder:
        for number in range(3):
            writer.publish(kind(data=number))
            wait_for(lambda number=number: recorder._bag.samples > number)
    files = list_bags(tmp_path / "bag")
    assert [file.name for file in files] == ["bag_0.mcap", "bag_1.mcap", "bag_2.mcap"]
    assert [item.ros.data for item in decode(*files)] == [0, 1, 2]
    with RosbagsReader(tmp_path / "bag") as reader:
        assert (reader.message_count, len(list(reader.messages()))) == (3, 3)


def count_messages(file):
    """Return the number of messages in a file, which may still grow."""
    return sum(isinstance(item, read.Message) for item in read.messages(file)) if file.stat().st_size else 0


def test_topic_without_a_region_is_an_error(topic, registry, tmp_path, shmgen):
    """Reject a mistyped name: the bag would be empty, and its user would notice only later."""
    with open_writer(registry, topic) as writer:
        writer.publish(build_full(registry))
        complete = shmgen("record", topic, "-o", str(tmp_path / "good"), "-d", "0.5", "-q")
        incomplete = shmgen("record", topic, topic[:-1], "-o", str(tmp_path / "wrong"), "-d", "0.5", "-q")
    assert (complete.code, complete.stderr) == (0, "")
    assert incomplete.code == 1
    assert f"{topic[:-1]}: error[SHM701]: no such region" in incomplete.stderr
    assert f"did you mean {topic}?" in incomplete.stderr


def test_bag_of_a_killed_recorder_is_readable(topic, registry, tmp_path):
    kind = registry.message("std_msgs/msg/Int32")
    with publisher(kind, topic, 15) as writer:
        writer.publish(kind(data=0))
        command = [sys.executable, "-m", "shmgen", "record", topic, "-o", "bag"]
        with subprocess.Popen(command, cwd=tmp_path) as recorder:
            wait_for(lambda: list_bags(tmp_path / "bag") and count_messages(list_bags(tmp_path / "bag")[0]) == 1)
            writer.publish(kind(data=1))
            wait_for(lambda: count_messages(list_bags(tmp_path / "bag")[0]) == 2)
            recorder.kill()
    (file,) = list_bags(tmp_path / "bag")
    assert [item.ros.data for item in decode(file)] == [0, 1]
    with RosbagsReader(tmp_path / "bag") as reader:
        assert len(list(reader.messages())) == 2
    whole = file.read_bytes()
    for end in range(len(whole) - 50, 300, -7):  # as if killed within write(), or copied too early
        file.write_bytes(whole[:end])
        messages = [item for item in read.messages(file) if isinstance(item, read.Message)]
        assert [item.data[4] for item in messages] == [0, 1][: len(messages)]
    assert messages == []


@pytest.mark.slow
def test_full_disk_is_reported_and_leaves_a_readable_bag(topic, registry, tmp_path):
    kind = registry.message("geometry_msgs/msg/PoseStamped")

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))

    with publisher(kind, topic, 255) as writer:
        writer.publish(kind())
        command = [sys.executable, "-m", "shmgen", "record", topic, "-o", "bag"]
        with subprocess.Popen(command, cwd=tmp_path, preexec_fn=limit, stderr=subprocess.PIPE, text=True) as recorder:
            while recorder.poll() is None:
                writer.publish(kind())
                time.sleep(0.002)
            stderr = recorder.stderr.read()
    assert recorder.returncode == 1
    assert "bag: error[SHM007]: cannot write: File too large; " in stderr
    sample_count = int(stderr.partition("large; ")[2].partition(" sample")[0].replace(",", ""))
    messages = decode(list_bags(tmp_path / "bag")[0])
    assert len(messages) == sample_count > 0


def test_unrecordable_topic_is_logged_once_and_others_recorded(topic, registry, recording, tmp_path, shmgen):
    from ..runtime.messages import PosePublisher

    with PosePublisher(topic + "x"), open_writer(registry, topic) as writer:
        writer.publish(build_full(registry))
        with recording(topic, topic + "x", count=1) as recorder:
            time.sleep(0.6)  # the recorder looks for new regions four times a second
    assert recorder.failed
    (logged,) = recorder.logged
    assert logged.startswith(
        f"{topic}x: not recorded: the region has another layout of geometry_msgs/msg/Pose than this"
    )
    assert recorder.figures.samples == 1


def test_record_checks_its_options_and_prints_a_summary(topic, registry, tmp_path, shmgen):
    assert shmgen("record").code == 2
    assert shmgen("record", "-a", "--max-size", "5X").code == 2
    with open_writer(registry, topic) as writer:
        writer.publish(build_full(registry))
        result = shmgen("record", topic, "-o", "bag", "-d", "0.3")
        assert (result.code, result.stderr) == (0, "")
        assert result.stdout.startswith("bag: 1 file, 1 sample of 1 topic, 0 missed, 0.0 MB")
        second = shmgen("record", topic, "-o", "bag", "-d", "0.3")
        assert (second.code, second.stderr.partition("\n")[0]) == (1, "bag: error[SHM007]: the folder exists already")
