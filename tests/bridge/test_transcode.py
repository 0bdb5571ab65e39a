"""The short way from a sample to what ROS sends of it, and back, gives the bytes of the long one."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shmgen.bridge.cdr import codec
from shmgen.bridge.plan import closure
from shmgen.bridge.transcode import Transcoder
from shmgen.model import Schema, TypeOptions
from shmgen.runtime import CountExceeded

from ..support import build, counts, schemas

OPTIONS = [
    TypeOptions(),
    TypeOptions(time="LTIME", encoding="latin-1"),
    TypeOptions(time="struct", bool="BOOL"),
]


class TestAnyMessage:
    @given(schema=schemas.schemas(), options=st.sampled_from(OPTIONS), seed=st.integers(0, 2**32))
    @settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
    def test_as_the_long_way(self, schema, options, seed, tmp_path_factory):
        folder = tmp_path_factory.mktemp("any")
        layouts = build.layouts_of(schema, options)
        package = f"transcoded_{folder.name}"
        build.put(build.texts_of(layouts, "python", package), folder)
        for layout in layouts.values():
            kind, _, _ = build.classes(folder, package, layout.name)
            long = codec(closure(Schema(tuple(one.message for one in layouts.values())), layout.name))
            made = Transcoder(layout, layouts)
            short, back = made.encode, made.decode
            draw = random.Random(seed)
            for _ in range(3):
                sample = bytearray(kind())
                late: list = []
                kind._encode(schemas.random_message(layout, layouts, draw), sample, 0, late)
                for offset, room, array in late:
                    sample[offset : offset + room] = bytes(array).ljust(room, b"\0")
                message = long.new()
                kind._decode(bytes(sample), 0, message)
                try:
                    wanted = long.encode(message)
                except struct.error:  # LTIME goes further than ROS
                    with pytest.raises(struct.error):
                        short(bytes(sample))
                else:
                    assert short(bytes(sample)) == wanted, layout.message
                    assert_back(back, wanted, kind, long)


def assert_back(back, sent: bytes, kind, long) -> None:
    """The payload is that of the long way; what is out of the ordinary has none, and there is ordinary enough."""
    payload = back(sent)
    if payload is None:
        return
    into, late = bytearray(kind()), []
    kind._encode(long.decode(sent), into, 0, late)
    for offset, room, array in late:
        into[offset : offset + room] = bytes(array).ljust(room, b"\0")
    assert payload == into


@pytest.mark.parametrize(("path", "count"), counts.PLACES[:2])
def test_a_count_beyond_its_bound_is_no_message(path, count, tmp_path):
    from shmgen.config import Config
    from shmgen.live.session import Session

    for name, text in counts.DEFINITIONS.items():
        build.put({f"counts_msgs/{name}.{name.partition('/')[0]}": text}, tmp_path)
    session = Session(Config(tmp_path, path=(tmp_path,)))
    layouts = session.layouts(["counts_msgs/Tree"])
    kind = session.message("counts_msgs/Tree")
    import types

    message = counts.tree(
        types.SimpleNamespace(**{k.rpartition("/")[2]: v for k, v in session.classes(["counts_msgs/Tree"]).items()}), 1
    )
    assert isinstance(message, kind)
    encode = Transcoder(session.layout("counts_msgs/Tree"), layouts).encode
    assert encode(bytes(message))
    counts.spoil(message, path, count)
    with pytest.raises(CountExceeded):
        encode(bytes(message))
