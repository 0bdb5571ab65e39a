"""All messages of Jazzy are generated, imported and compiled, and cross a region unchanged."""

from __future__ import annotations

import dataclasses
import random
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy
import pytest
from rosbags.typesys import Stores, get_typestore

from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Span
from shmgen.core.model import Clock, Layout, Layouts, Ref, Role, Scalar, Slot, TypeName
from shmgen.generator import pipeline

from .conftest import REPOSITORY
from .support.build import classes, compile_headers, put
from .support.schemas import plain, random_message
from .test_layout import assert_same_bytes

PACKAGE = "shm_jazzy"
UNBOUNDED = 64
"""The number of messages that need a bound. The other 107 of 171 need none."""


@pytest.fixture(scope="module")
def bounded() -> Config:
    """A configuration that bounds every sequence to 3, with one line for each package."""
    plain = Config(Path.cwd())
    packages = {entry.name.package for entry in pipeline.inventory(plain)}
    bounds = Bounds({}, {package: Bound(3, Span("shmgen.toml")) for package in packages})
    return dataclasses.replace(plain, bounds=bounds, package=PACKAGE)


@pytest.fixture(scope="module")
def store(bounded: Config, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Layouts]:
    """The folder with the generated files of all messages, and their layouts."""
    folder = tmp_path_factory.mktemp("store")
    names = [str(entry.name) for entry in pipeline.inventory(bounded) if entry.name.kind == "msg"]
    put(pipeline.generate(bounded, names), folder)
    return folder, pipeline.lay_out(bounded, names)


def test_inventory_names_the_unbounded_fields() -> None:
    entries = pipeline.inventory(Config(Path.cwd()))
    unbounded = [entry for entry in entries if entry.size is None]
    assert (len(entries), len(unbounded)) == (171, UNBOUNDED)
    assert all(entry.unbounded for entry in unbounded)
    assert all(not entry.unbounded for entry in entries if entry.size is not None)
    (joint_state,) = [entry for entry in entries if entry.name.short == "sensor_msgs/JointState"]
    assert joint_state.unbounded[0] == "sensor_msgs/JointState.name"


DISTRIBUTIONS = re.findall(
    r"^\| (\w+) \| (\d+) messages", (REPOSITORY / "docs" / "ros-wire.md").read_text(), re.MULTILINE
)


@pytest.mark.parametrize(("source", "count"), DISTRIBUTIONS)
@pytest.mark.family("[Jazzy")
def test_all_definitions_of_a_distribution_are_generated(source: str, count: str) -> None:
    """Generate as many messages as docs/ros-wire.md states."""
    plain = Config(Path.cwd(), source=source.lower())
    names = [str(entry.name) for entry in pipeline.inventory(plain)]
    bounds = Bounds({}, {name.split("/")[0]: Bound(3, Span("shmgen.toml")) for name in names})
    texts = pipeline.generate(dataclasses.replace(plain, bounds=bounds), names)
    assert len(names) == int(count)
    for name in names:
        package, _, short = name.split("/")
        assert any(f"ST_{package}_{short}.st" in path for path in texts), name


def test_page_lists_all_distributions() -> None:
    assert [name for name, _ in DISTRIBUTIONS] == ["Humble", "Jazzy", "Kilted", "Lyrical"]


def test_default_bound_gives_every_message_a_size(bounded: Config) -> None:
    assert [entry for entry in pipeline.inventory(bounded) if entry.size is None] == []


def test_ctypes_has_the_computed_layout_of_all_messages(store: tuple[Path, Layouts]) -> None:
    folder, layouts = store
    assert len(layouts) == 162
    for name, layout in layouts.items():
        assert_same_bytes(classes(folder, PACKAGE, name)[0], layout)


@pytest.mark.parametrize("language", ["c", "c++"])
def test_all_headers_compile(store: tuple[Path, Layouts], language: str) -> None:
    compile_headers(store[0], language)


def test_every_message_crosses_a_region(store: tuple[Path, Layouts], topic: str) -> None:
    folder, layouts = store
    types = get_typestore(Stores.ROS2_JAZZY).types
    for number, (name, layout) in enumerate(layouts.items()):
        message = random_message(layout, layouts, random.Random(str(name)))
        expected = plain(message)
        foreign = as_rosbags(message, layout, layouts, types)
        assert cross_region(folder, name, f"{topic}/m{number}", foreign) == expected, name


def as_rosbags(message: Any, layout: Layout, layouts: Layouts, types: Mapping[str, Any]) -> Any:
    """Convert a message to a dataclass of rosbags, which has no default constructor and keeps numbers in ndarrays."""
    stamps = {
        Clock.TIME: types["builtin_interfaces/msg/Time"],
        Clock.DURATION: types["builtin_interfaces/msg/Duration"],
    }

    def converted(slot: Slot, value: Any) -> Any:
        match slot.type:
            case Clock():
                return stamps[slot.type](sec=value.sec, nanosec=value.nanosec)
            case Ref(name):
                return as_rosbags(value, layouts[name], layouts, types)
            case _:
                return value

    fields: dict[str, Any] = {}
    for slot in layout.slots:
        if slot.role is Role.DATA:
            value = getattr(message, slot.name)
            if slot.count is None:
                fields[slot.name] = converted(slot, value)
            elif isinstance(slot.type, Scalar):
                fields[slot.name] = numpy.array(value, dtype=slot.type.value)
            else:
                fields[slot.name] = [converted(slot, item) for item in value]
    return types[str(layout.name)](**fields)


def cross_region(folder: Path, name: TypeName, topic: str, message: Any) -> Any:
    """Publish a foreign object and then our structure. Return the fields that read and read_into return alike."""
    kind, publisher_kind, subscriber_kind = classes(folder, PACKAGE, name)
    with publisher_kind(topic) as publisher, subscriber_kind(topic) as subscriber:
        publisher.publish(message)
        read = subscriber.read()
        publisher.publish(read)
        second = kind()
        assert subscriber.read_into(second)
        assert second == read
        assert not subscriber.read_into(second)
        publisher.publish(read)
        assert subscriber.read_into(message)  # read_into also fills the foreign object
        assert plain(message) == plain(read)
        return plain(read)
