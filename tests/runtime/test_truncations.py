"""With `overflow = "truncate"`, long texts are truncated, and the publisher counts the truncated texts."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from shmgen.config import Config
from shmgen.core.model import TypeName, TypeOptions
from shmgen.generator import pipeline
from shmgen.runtime import StringTooLong

from ..support.build import module, put
from ..targets.test_python import DEFINITIONS, joint, robot


def generate_module(folder: Path, package: str, options: TypeOptions) -> ModuleType:
    put({f"msgs/demo_msgs/msg/{name}.msg": text for name, text in DEFINITIONS.items()}, folder)
    put({"msgs/demo_msgs/msg/Count.msg": "uint8 data\n"}, folder)
    config = Config(folder, path=(folder / "msgs",), package=package, targets=("python",), types=options)
    put(pipeline.generate(config, ["demo_msgs"]), folder)
    return module(folder, package, TypeName("demo_msgs", "msg", "Robot"))


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> ModuleType:
    return generate_module(tmp_path_factory.mktemp("cut"), "shm_cut", TypeOptions(overflow="truncate"))


CHANGES: dict[str, tuple[dict[str, Any], int]] = {
    "nothing": ({}, 0),
    "at the capacity": ({"label": "0123456789", "sign": "\N{SNOWMAN}" * 4}, 0),
    "text": ({"label": "0123456789a"}, 1),
    "wide": ({"sign": "12345"}, 1),
    "code points": ({"label": "grüngrüngrün", "sign": "123\N{GRINNING FACE}"}, 2),
    "texts": ({"tags": ["abcd", "abcde"]}, 2),
    "nested": ({"arm": joint(name="too long for eight")}, 1),
    "sequence": ({"joints": [joint(name="too long for eight"), joint(), joint(name="123456789")]}, 2),
    "array": ({"wheels": [joint(), joint(name="too long for eight")]}, 1),
    "before a long array": ({"label": "0123456789a", "image": bytes(4500)}, 1),
}


@pytest.mark.parametrize("change", CHANGES)
def test_truncated_texts_are_counted(change: str, demo: ModuleType, topic: str) -> None:
    fields, count = CHANGES[change]
    with demo.RobotPublisher(topic) as publisher, demo.RobotSubscriber(topic) as subscriber:
        publisher.publish(robot(**fields))
        assert publisher.truncations == count
        foreign = subscriber.read()
        publisher.publish(as_generated(demo, robot(**fields)))
        assert publisher.truncations == count, "the text was truncated when it was assigned"
        assert subscriber.read() == foreign
        publisher.publish(robot(**fields))
        assert publisher.truncations == 2 * count


def as_generated(demo: ModuleType, message: Any) -> Any:
    """Copy the message into an object of the generated class, by assignment."""
    kinds = {"arm": demo.Joint, "joints": demo.Joint, "wheels": demo.Joint}
    copy = demo.Robot()
    for name, value in vars(message).items():
        if name in kinds:
            value = [kinds[name](**vars(x)) for x in value] if isinstance(value, list) else kinds[name](**vars(value))
        setattr(copy, name, value)
    return copy


def test_truncation_keeps_whole_code_points(demo: ModuleType) -> None:
    assert demo.Robot(label="grüngrüngrün").label == "grüngrün"
    assert demo.Robot(sign="123\N{GRINNING FACE}").sign == "123"
    assert demo.Robot(label="a" * 9 + "é").label == "a" * 9


def test_long_text_is_rejected_by_default(tmp_path: Path, topic: str) -> None:
    strict = generate_module(tmp_path, "shm_strict", TypeOptions())
    with strict.RobotPublisher(topic) as publisher:
        with pytest.raises(StringTooLong):
            publisher.publish(robot(label="0123456789a"))
        assert publisher.truncations == 0
