"""Pass every message type of Jazzy from Cyclone's writer through the backend and a region to Cyclone's reader."""

from __future__ import annotations

import random
from pathlib import Path
from queue import Queue
from typing import Any, get_args

import pytest
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from shmgen.bridge.backend import Wire
from shmgen.bridge.dds import backend
from shmgen.bridge.dds.types import structure, topic_name
from shmgen.bridge.plan import closure
from shmgen.config import Config
from shmgen.core.model import Message
from shmgen.generator import pipeline
from shmgen.live.classes import publisher, subscriber

from ..support.schemas import plain, random_message
from .conftest import Errors
from .values import values

RELIABLE = Qos(Policy.Reliability.Reliable(10**9), Policy.History.KeepLast(10))


@pytest.mark.sample("[0]")
@pytest.mark.parametrize("part", range(4))
def test_every_message_type_passes_dds_and_a_region(graph: backend.Graph, domain: int, topic: str, part: int) -> None:
    all_names = [str(entry.name) for entry in pipeline.inventory(Config(Path.cwd())) if entry.name.kind == "msg"]
    assert len(all_names) == 162
    names = all_names[part::4]
    random_values, schema = values(names), pipeline.read(Config(Path.cwd()), names)
    participant = DomainParticipant(domain)
    for number, name in enumerate(sorted(schema.requested)):
        messages = closure(schema, name)
        to_plc, from_plc = Wire(f"{topic}/there{number}", messages), Wire(f"{topic}/back{number}", messages)
        decoded = Queue[Any]()
        graph.subscribe(to_plc, decoded.put, Errors())
        outlet = graph.publisher(from_plc)
        cyclone_type = cyclone_class(messages)
        writer = DataWriter(participant, Topic(participant, topic_name(to_plc.name), cyclone_type), RELIABLE)
        reader = DataReader(participant, Topic(participant, topic_name(from_plc.name), cyclone_type), RELIABLE)
        kind = random_values.kinds[str(name)]
        with publisher(kind, to_plc.name, 1) as region, subscriber(kind, to_plc.name, 1) as plc:
            for seed in range(2):
                expected = plain(
                    random_message(random_values.layouts[name], random_values.layouts, random.Random(f"{name}{seed}"))
                )
                sent = as_structure(cyclone_type, expected)
                writer.write(sent)
                region.publish(decoded.get(timeout=5))
                message = outlet.new()
                assert plc.read_into(message)
                outlet.send(message)
                assert as_plain(reader.take_one(timeout=5 * 10**9)) == as_plain(sent), name
        assert decoded.empty()


def cyclone_class(messages: tuple[Message, ...]) -> type[Any]:
    """Return the structure with Cyclone's Python codec instead of shmgen's."""
    kind: type[Any] = structure.__wrapped__(messages)
    del kind.serialize, kind.deserialize
    return kind


def as_structure(kind: Any, value: Any) -> Any:
    """Convert the value to the type in a structure's annotation."""
    if isinstance(kind, type) and issubclass(kind, IdlStruct):
        fields = kind.__annotations__
        if list(fields) == ["structure_needs_at_least_one_member_"]:
            return kind(0)
        return kind(**{name: as_structure(type_, value[name.removesuffix("_")]) for name, type_ in fields.items()})
    if isinstance(value, list):
        subtype = get_args(kind)[1].subtype
        return [as_structure(subtype, item) for item in value]
    return value & 0xFF if kind is types.byte else value  # int8 is an octet in DDS


def as_plain(value: Any) -> Any:
    """Convert the value to dicts, lists and numbers."""
    if isinstance(value, IdlStruct):
        names = [name for name in type(value).__annotations__ if not name.startswith("structure_needs")]
        return {name.removesuffix("_"): as_plain(getattr(value, name)) for name in names}
    if isinstance(value, (list, tuple, bytes, bytearray)):
        return [as_plain(item) for item in value]
    return value
