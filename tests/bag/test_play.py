"""Tests of `shmgen play`: it publishes a bag's samples at their pace, and refuses a bag of another layout."""

from __future__ import annotations

import os
import resource
import struct
import time

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from shmgen.bag import mcap, read
from shmgen.bag.play import Player
from shmgen.live.classes import publisher, subscriber
from shmgen.tools.messages import parse

from .conftest import shop
from .test_record import FULL, build_full, open_writer


def record_samples(topic, registry, recording, values=range(5), pause=0.0):
    with open_writer(registry, topic) as writer, recording(topic):
        for number in values:
            writer.publish(build_full(registry, small=number))
            time.sleep(pause)


def test_play_publishes_all_samples_again(topic, registry, recording, tmp_path, shmgen):
    record_samples(topic, registry, recording)
    assert shmgen("clean", topic).code == 0
    with subscriber(registry.message("demo_msgs/msg/Full"), topic, 15) as reader:
        result = shmgen("play", "bag", "--rate", "100")
        assert (result.code, result.stdout, result.stderr) == (0, "bag: 5 samples on 1 topic\n", "")
        samples = reader.read_all()
    assert [sample.small for sample in samples] == [0, 1, 2, 3, 4]
    assert samples[-1] == build_full(registry, small=4)


def test_play_keeps_the_pace_and_starts_at_an_offset(topic, registry, recording, tmp_path):
    record_samples(topic, registry, recording, pause=0.1)
    for rate, start, samples, shortest in ((1, 0, 5, 0.4), (2, 0, 5, 0.2), (1, 0.25, 2, 0.15)):
        player = Player(tmp_path / "bag", registry, None, print)
        started_at = time.monotonic()
        assert len(list(player.play(rate, start))) == samples
        assert shortest <= time.monotonic() - started_at + 0.01 < shortest + 2
        if rate == 2:
            assert len(list(player.play(100))) == 5  # as --loop does
            assert player.played == 10
        player.close()


def test_play_publishes_only_the_selected_topics(topic, registry, recording, tmp_path, shmgen):
    kind = registry.message("std_msgs/msg/Int32")
    with publisher(kind, topic, 3) as first, publisher(kind, topic + "b", 3) as second, recording(topic, topic + "b"):
        first.publish(kind(data=1))
        second.publish(kind(data=2))
    result = shmgen("play", "bag", "--topics", topic)
    assert (result.code, result.stdout) == (0, "bag: 1 sample on 1 topic\n")
    result = shmgen("play", "bag", "--topics", topic + "c")
    assert result.code == 1
    assert f"[SHM704]: the bag has no topic {topic}c; its topics: {topic}, {topic}b\n" in result.stderr
    assert "none after 5 s" in shmgen("play", "bag", "--start", "5").stderr


def test_bag_of_another_layout_is_refused(topic, registry, recording, tmp_path, shmgen):
    record_samples(topic, registry, recording)
    assert shmgen("clean", topic).code == 0
    toml = tmp_path / "shmgen.toml"
    toml.write_text(toml.read_text().replace("= 6", "= 9"))
    result = shmgen("play", "bag")
    assert (result.code, result.stdout) == (1, "")
    assert f"bag: error[SHM702]: {topic} was recorded with another layout of demo_msgs/msg/Full" in result.stderr
    assert "  layout of demo_msgs/Full changed\n" in result.stderr
    assert "    numbers: count 6 -> 9\n" in result.stderr
    assert shmgen("doctor", topic).code == 1  # play created no region


def test_play_reads_bags_of_ros_2(topic, registry, tmp_path, shmgen):
    """Read compressed and SQLite bags that rosbags wrote. Refuse a bag with another definition."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    Point = store.types["geometry_msgs/msg/Point"]
    for name, plugin in (("packed", StoragePlugin.MCAP), ("sqlite", StoragePlugin.SQLITE3)):
        bag = Writer(tmp_path / name, version=9, storage_plugin=plugin)
        if plugin is StoragePlugin.MCAP:
            bag.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with bag as writer:
            channel = writer.add_connection(topic, "geometry_msgs/msg/Point", typestore=store)
            writer.write(channel, 10**18, store.serialize_cdr(Point(1.0, 2.0, 3.0), "geometry_msgs/msg/Point"))
        result = shmgen("play", name)
        assert (result.code, result.stderr) == (0, "")
        assert shmgen("echo", topic, "--once").stdout == "x: 1.0\ny: 2.0\nz: 3.0\n---\n"
        assert shmgen("clean", topic).code == 0
    with Writer(tmp_path / "other", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        channel = writer.add_connection(topic, "geometry_msgs/msg/Point", msgdef="float32 x\n", rihs01="RIHS01_0")
        writer.write(channel, 10**18, bytes(8))
    result = shmgen("play", "other")
    assert result.code == 1
    assert "geometry_msgs/msg/Point has another definition in the bag" in result.stderr
    (tmp_path / "no.mcap").write_bytes(b"nothing of the kind")
    assert shmgen("play", "no.mcap").stderr.startswith("no.mcap: error[SHM705]: not an MCAP file\n  hint: ")


def test_bag_records_topic_definition_and_digest(topic, registry, recording, tmp_path):
    record_samples(topic, registry, recording)
    channel, *messages = read.messages(tmp_path / "bag")
    assert channel.metadata["shmgen_topic"] == topic
    assert 'string WORD="a b"\n' in channel.text
    assert len(messages) == 5
    assert shop(tmp_path).message("demo_msgs/msg/Full", int(channel.metadata["shmgen_digest"], 16))
    assert parse.build(registry.message("demo_msgs/msg/Full"), FULL)


def test_damaged_bag_is_refused_with_little_memory(tmp_path, shmgen):
    """Refuse chunks that unpack to more than they announce, records longer than their file, and a FIFO."""
    from rosbags.rosbag2 import storage_mcap

    def file(record):
        builder = RecordBuilder()
        record.write(builder)
        return mcap.MAGIC + builder.end()

    def chunk(size, compressed, compression="zstd"):
        return file(records.Chunk(compression, compressed, 0, 0, 0, size))

    bomb = storage_mcap.zstd.compress(bytes(1 << 28))
    bags = {
        "bomb": (chunk(1000, bomb), "a chunk of 1,000 bytes has another length or checksum"),
        "large": (chunk(1 << 40, bomb), "the limit is 268,435,456"),
        "noise": (chunk(1000, b"noise"), "damaged: a chunk cannot be unpacked"),
        "lz4": (chunk(1000, b"noise", "lz4"), "damaged: a chunk"),
        "short": (mcap.MAGIC + struct.pack("<BQ", Opcode.CHANNEL, 2) + b"ab", "a record ends before its last field"),
        "announced": (mcap.MAGIC + struct.pack("<BQ", Opcode.SCHEMA, (1 << 32) - 1), "the bag has no topics"),
        "escape": (file(records.Channel(1, "/a\x1b[2J\nb", "abc", {}, 1)), "/a\\u001b[2J\\u000ab"),
    }
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for name, (data, expected) in bags.items():
        (tmp_path / f"{name}.mcap").write_bytes(data)
        result = shmgen("play", f"{name}.mcap")
        assert (result.code, expected in result.stderr, "\x1b[2J" in result.stderr) == (1, True, False), result.stderr
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 400 << 10
    os.mkfifo(tmp_path / "fifo.mcap")
    assert "not a file" in shmgen("play", "fifo.mcap").stderr
