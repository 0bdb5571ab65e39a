"""generated/ is what the tool writes today, byte for byte."""

from __future__ import annotations

from shmgen import config, pipeline
from shmgen.diagnostics import Report

from .conftest import REPOSITORY


def test_generated_is_up_to_date() -> None:
    settings = config.load(REPOSITORY / "shmgen.toml", "shmgen.toml", Report())
    texts = pipeline.generate(settings, [*settings.messages, *(topic.type for topic in settings.topics)])
    folder = REPOSITORY / "generated"
    found = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    found = {path: data for path, data in found.items() if "__pycache__" not in path}
    assert sorted(found) == sorted(texts), "run `make generated`"
    for path, text in texts.items():
        assert found[path] == text.encode(), f"{path}: run `make generated`"


def test_the_pictures_are_up_to_date() -> None:
    from shmgen.model import TypeName
    from shmgen.render import render
    from shmgen.show import memory_map

    settings = config.load(REPOSITORY / "shmgen.toml", "shmgen.toml", Report())
    name = TypeName("sensor_msgs", "msg", "BatteryState")
    layouts = pipeline.lay_out(settings, [str(name)])
    (drawing,) = render([memory_map.plan(layouts[name], layouts)]).values()
    assert (REPOSITORY / "docs" / "memory_map.svg").read_text() == drawing, "run `make generated`"
