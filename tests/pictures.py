"""Turns figures and screens into the pictures of the documentation: docs/latency.svg, top.svg, view.svg.

    python -m tests.pictures

The latency is that of docs/performance.md, where benchmarks/latency.py's own lines stand; the screens are those of
regions that this makes, with Textual's and Rich's drawings of them, which load nothing from anywhere.
"""

from __future__ import annotations

import asyncio
import io
import math
import os
import re
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from .conftest import REPOSITORY

DOCS = REPOSITORY / "docs"
_TITLE = re.compile(r"(\d+) bytes at (\d+) Hz")
_ROW = re.compile(r"  (spin|event|poll) +(.+?) +(\d+\.\d) +(\d+\.\d) +\d+\.\d +\d+\.\d\d +\d+")
_FONTS = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)
_LEFT, _WIDE, _LINE = 170, 560, 20
_COLOURS = {"shmgen": "#1b7f4d", "by hand, Python": "#7a9e8a", "C": "#7a9e8a"}


def main() -> None:
    (DOCS / "latency.svg").write_text(latency((DOCS / "performance.md").read_text()))
    with moving():
        (DOCS / "top.svg").write_text(top())
        (DOCS / "view.svg").write_text(asyncio.run(view()))


def latency(page: str) -> str:
    """Bars to the median, lines to the 99th percentile, in microseconds on a logarithmic axis: 56 bytes, woken."""
    rows = [
        found.groups()
        for found in map(_ROW.match, page[page.index("56 bytes at") : page.index("320 bytes at")].splitlines())
        if found
    ]
    rows = [(way, float(median), float(most)) for mode, way, median, most in rows if mode == "event"]
    height = 58 + _LINE * len(rows) + 40
    decades = range(4)

    def at(value: float) -> float:
        return round(_LEFT + _WIDE * math.log10(max(1.0, value)) / 3, 1)

    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" font-size="13"'
        f' width="780" height="{height}">',
        f'<rect width="780" height="{height}" fill="#ffffff"/>',
        '<text x="16" y="24" font-size="15">Age of 56 bytes when a waiting reader has them, 1 kHz, one way</text>',
        '<text x="16" y="42" fill="#555555">bar: median; line: 99 of 100; us, logarithmic; docs/performance.md</text>',
    ]
    for decade in decades:
        x = at(10**decade)
        parts.append(f'<line x1="{x}" y1="52" x2="{x}" y2="{height - 34}" stroke="#dddddd"/>')
        parts.append(f'<text x="{x}" y="{height - 16}" text-anchor="middle" fill="#555555">{10**decade}</text>')
    for number, (way, median, most) in enumerate(rows):
        y = 58 + _LINE * number
        width = round(at(median) - _LEFT, 1)
        middle = y + 7
        parts += [
            f'<text x="{_LEFT - 8}" y="{y + 12}" text-anchor="end">{escape(way)}</text>',
            f'<rect x="{_LEFT}" y="{y}" width="{width}" height="14" fill="{_COLOURS.get(way, "#7d8fb3")}"/>',
            f'<line x1="{at(median)}" y1="{middle}" x2="{at(most)}" y2="{middle}" stroke="#333333"/>',
            f'<text x="{at(most) + 6}" y="{y + 12}" fill="#333333">{median:g}</text>',
        ]
    return "\n".join([*parts, "</svg>"]) + "\n"


@contextmanager
def moving() -> Iterator[None]:
    """A cell at work: poses, a joint state, a temperature, a service that nobody calls."""
    from shmgen.config import load
    from shmgen.diagnostics import Report
    from shmgen.live.classes import Workshop, publisher
    from shmgen.live.session import Session
    from shmgen.tools import given

    file = Path("/tmp") / f"shmgen-pictures-{os.getpid()}.toml"
    file.write_text('[bounds]\n"sensor_msgs/JointState" = 6\n')
    workshop = Workshop(Session(load(file, "shmgen.toml", Report())), None)
    names = [f"joint_{number}" for number in range(1, 7)]

    def values(angle: float) -> dict[str, tuple[str, int, Any]]:
        pose = {"position": {"x": math.sin(angle), "y": math.cos(angle), "z": 0.5 + 0.3 * math.sin(3 * angle)}}
        joints = [math.sin(angle + number) for number in range(6)]
        return {
            "/cell/arm/pose": (
                "geometry_msgs/msg/PoseStamped",
                3,
                {"header": {"stamp": "now", "frame_id": "base"}, "pose": pose},
            ),
            "/cell/arm/joints": ("sensor_msgs/msg/JointState", 7, {"name": names, "position": joints}),
            "/cell/oven/temperature": ("sensor_msgs/msg/Temperature", 1, {"temperature": 180 + 5 * math.sin(angle)}),
            "/cell/conveyor/speed": ("std_msgs/msg/Float64", 1, {"data": 0.25}),
        }

    over = threading.Event()
    with ExitStack() as held:
        made = {
            topic: held.enter_context(publisher(workshop.message(kind), topic, depth))
            for topic, (kind, depth, _) in values(0.0).items()
        }

        def publish() -> None:
            begun = time.monotonic()
            while not over.wait(0.01):
                for topic, (_, _, data) in values(2 * (time.monotonic() - begun)).items():
                    made[topic].publish(given.build(made[topic].message_type, data))

        thread = threading.Thread(target=publish)
        thread.start()
        moving.workshop = workshop  # type: ignore[attr-defined]
        try:
            yield
        finally:
            over.set()
            thread.join()
            file.unlink()
            for found in Path("/dev/shm").glob("*cell.*"):
                found.unlink()


def top() -> str:
    from rich.console import Console

    from shmgen.tools import top as tool

    past: tool.Past = {}
    for _ in range(4):
        rows = tool.look(past)
        time.sleep(0.5)
    console = Console(record=True, width=142, file=io.StringIO())
    first, *others = tool.table(tool.ordered(rows, "topic", reverse=False), "topic", 140)
    console.print(first, style="reverse", highlight=False, markup=False)
    for line in others:
        console.print(line, highlight=False, markup=False)
    return _FONTS.sub("", console.export_svg(title="shmgen top", unique_id="top"))


async def view() -> str:
    from textual.widgets import Tree

    from shmgen.view.app import Viewer

    app = Viewer(moving.workshop, allow_write=False, topic="/cell/arm/pose")  # type: ignore[attr-defined]
    async with app.run_test(size=(130, 34)) as pilot:
        await pilot.pause(1)
        tree = app.screen.query_one(Tree)
        for axis in "xyz":
            tree.move_cursor(app.screen._fields[f"pose.position.{axis}"])  # type: ignore[attr-defined]
            await pilot.press("enter")
            await pilot.pause(0.2)
        await asyncio.sleep(11)
        await pilot.pause(0.5)
        return _FONTS.sub("", app.export_screenshot(title="shmgen view"))


if __name__ == "__main__":
    main()
