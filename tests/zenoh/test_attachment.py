"""Test the attachments of messages (sequence number, time, gid) as each version of rmw_zenoh_cpp writes them."""

from __future__ import annotations

import struct
from pathlib import Path
from queue import Queue
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("zenoh", exc_type=Exception)
pytest.importorskip("xxhash", exc_type=Exception)

import zenoh

from shmgen.bridge.backend import Wire
from shmgen.bridge.plan import closure
from shmgen.bridge.zenoh.backend import Zenoh
from shmgen.bridge.zenoh.graph import Graph, attachment, endpoint_gid, parse_attachment
from shmgen.config import Config
from shmgen.core.model import TypeName
from shmgen.generator import pipeline

WRITER = bytes(range(16))


def test_attachment_is_parsed_with_and_without_labels() -> None:
    """Parse also the layout of 0.2.0 to 0.2.3, which puts the name of each part before the part."""
    labels = [b"sequence_number", b"source_timestamp", b"source_gid"]
    parts = [struct.pack("<q", 42), struct.pack("<q", 7), bytes([16]) + WRITER]
    labelled = b"".join(bytes([len(label)]) + label + part for label, part in zip(labels, parts, strict=True))
    for data in (labelled, attachment(42, WRITER)):
        sample = SimpleNamespace(attachment=SimpleNamespace(to_bytes=lambda data=data: data))
        assert parse_attachment(sample) == (42, WRITER)
    assert parse_attachment(SimpleNamespace(attachment=None)) == (0, b"")


HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
CHATTER = f"%chatter/std_msgs::msg::dds_::String_/{HASH}"


@pytest.mark.parametrize(
    ("token", "gid"),
    [
        ("@ros2_lv/2/a/0/0/NN/%/%/talker", "153554a4e9a7be7af52e645eb430daf4"),
        (
            f"@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/listener/{CHATTER}/::,10:,:,:,,",
            "b1b4eed7bee964648d8d54662e3222cf",
        ),
        ("@ros2_lv/0/" + "ab/" * 150, "9b662a7d5a5817ca3e6b743f0af2b524"),
    ],
)
def test_endpoint_gid_equals_that_of_rmw_zenoh(token: str, gid: str) -> None:
    """Compare with values that rmw_zenoh's own hash function returned, in its byte order."""
    assert endpoint_gid(token).hex() == gid


def test_message_has_the_gid_of_its_publisher(tmp_path: Path) -> None:
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("scouting/multicast/enabled", "false")
    samples: Queue[Any] = Queue()
    schema = pipeline.read(Config(tmp_path), ("std_msgs/Bool",))
    config.insert_json5("transport/shared_memory/enabled", "false")  # its file would remain in /dev/shm
    with zenoh.open(config) as session:
        backend = Zenoh(Graph(session, "%/bridge", 0, print))
        publisher = backend.publisher(Wire("/cell/ready", closure(schema, TypeName("std_msgs", "msg", "Bool"))))
        session.declare_subscriber("0/cell/ready/**", samples.put)
        publisher.send(publisher.new())
        _, gid = parse_attachment(samples.get(timeout=20))
        (token,) = session.liveliness().get("@ros2_lv/0/*/*/*/MP/**")
        assert gid == endpoint_gid(str(token.ok.key_expr))
