"""Turns figures and screens into the pictures of the documentation: docs/latency.svg, top.svg, view.gif.

    make pictures

The latency is that of docs/performance.md, where benchmarks/latency.py's own lines stand. The screens are those of
regions that a second process writes, as Textual and Rich draw them; `view.gif` also needs chromium, which turns such a
drawing into dots, and Pillow, which makes one file of them.
"""

from __future__ import annotations

import asyncio
import io
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from ..conftest import REPOSITORY

DOCS = REPOSITORY / "docs"
_TITLE = re.compile(r"(\d+) bytes at (\d+) Hz")
_ROW = re.compile(r"  (spin|event|poll) +(.+?) +(\d+\.\d) +(\d+\.\d) +\d+\.\d +\d+\.\d\d +\d+")
_FONTS = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)
_LEFT, _WIDE, _LINE = 170, 560, 20
_FILM = 1020
"""Pixels; the width of view.gif."""
_COLOURS = {"shmgen": "#1b7f4d", "by hand, Python": "#7a9e8a", "C": "#7a9e8a"}


def main() -> None:
    with suppress(PermissionError):  # for curves without gaps on a busy machine
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))
    if sys.argv[1:] == ["move"]:
        move()
    (DOCS / "latency.svg").write_text(latency((DOCS / "performance.md").read_text()))
    with moving():
        (DOCS / "top.svg").write_text(top())
        shots = asyncio.run(view())
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    film(shots, DOCS / "view.gif")


def latency(page: str) -> str:
    """Bars to the median, lines to the 99th percentile, in microseconds on a logarithmic axis: 56 bytes, woken."""
    rows = [
        found.groups()
        for found in map(_ROW.match, page[page.rindex("56 bytes at") : page.rindex("320 bytes at")].splitlines())
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


def registry() -> Any:
    """Knows what `move` publishes."""
    from shmgen.config import load
    from shmgen.core.diagnostics import Report
    from shmgen.live.classes import ClassRegistry
    from shmgen.live.session import Session

    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        file.write('[bounds]\n"sensor_msgs/JointState" = 6\n')
        file.flush()
        return ClassRegistry(Session(load(Path(file.name), "shmgen.toml", Report())), None)


def move() -> None:
    """A cell at work: poses, a joint state, a temperature, a speed, each 100 times a second until this is killed."""
    from shmgen.live.classes import publisher
    from shmgen.tools.messages import parse

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

    known = registry()
    with ExitStack() as held:
        made = {
            topic: held.enter_context(publisher(known.message(kind), topic, depth))
            for topic, (kind, depth, _) in values(0.0).items()
        }
        print("moving", flush=True)
        begun = time.monotonic()
        while True:
            for topic, (_, _, data) in values(2 * (time.monotonic() - begun)).items():
                made[topic].publish(parse.build(made[topic].message_type, data))
            time.sleep(0.01 - (time.monotonic() - begun) % 0.01)


@contextmanager
def moving() -> Iterator[None]:
    """Meanwhile another process moves."""
    command = [sys.executable, "-m", "tests.rigs.pictures", "move"]
    with subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "moving\n"
            yield
        finally:
            process.kill()
            for found in Path("/dev/shm").glob("*cell.*"):
                found.unlink()


def top() -> str:
    from rich.console import Console

    from shmgen.tools.watch import top as tool

    past: tool.Past = {}
    for _ in range(4):
        rows = tool.look(past)
        time.sleep(0.5)
    lines = tool.table(tool.ordered(rows, "topic", reverse=False), "topic")
    width = max(map(len, lines))
    console = Console(record=True, width=width, file=io.StringIO())
    console.print(lines[0].ljust(width), style="reverse", highlight=False, markup=False)
    for line in lines[1:]:
        console.print(line, highlight=False, markup=False)
    return _FONTS.sub("", console.export_svg(title="shmgen top", unique_id="top"))


async def view() -> list[tuple[str, int]]:
    """Screens of a visit, and for how many milliseconds each is to be seen."""
    from textual.widgets import TabbedContent, Tree

    from shmgen.view.app import Viewer

    shots: list[tuple[str, int]] = []
    app = Viewer(registry(), allow_write=False)

    def shoot(milliseconds: int) -> None:
        shots.append((_FONTS.sub("", app.export_screenshot(title="shmgen view")), milliseconds))

    async with app.run_test(size=(136, 24)) as pilot:
        await pilot.pause(2.5)
        await pilot.press("down")
        await pilot.pause(0.2)
        shoot(2500)
        await pilot.press("enter")
        await pilot.pause(1)
        shoot(1200)
        tree = app.screen.query_one(Tree)
        for axis in "xyz":
            tree.move_cursor(app.screen._fields[f"pose.position.{axis}"])  # type: ignore[attr-defined]
            await pilot.press("enter")
            for _ in range(3):
                await pilot.pause(0.8)
                shoot(600)
        await pilot.pause(0.6)
        shoot(2500)
        app.screen.query_one(TabbedContent).active = "memory"
        for milliseconds in (800, 2500):
            await pilot.pause(0.6)
            shoot(milliseconds)
    return shots


def film(shots: list[tuple[str, int]], target: Path) -> None:
    """The drawings one after the other, in dots and few colours."""
    from PIL import Image, ImageColor

    frames = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (drawing, _) in enumerate(shots):
            width, height = (float(size) for size in re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', drawing)[0])
            svg, dots = Path(folder, f"{number}.svg"), Path(folder, f"{number}.png")
            svg.write_text(drawing)
            size = f"--window-size={math.ceil(width)},{math.ceil(height)}"
            how = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--screenshot={dots}", size]
            subprocess.run(["chromium", *how, svg.as_uri()], check=True, capture_output=True, timeout=120)
            small = (
                Image.open(dots).convert("RGB").resize((_FILM, round(_FILM * height / width)), Image.Resampling.LANCZOS)
            )
            frames.append(small)
    pure = sorted({found for drawing, _ in shots for found in re.findall(r"fill: ?(#[0-9a-f]{6})", drawing)})
    ground = ImageColor.getrgb("#1e1e1e")  # edges of letters are between their colour and this
    mixed = [
        round(share * value + (1 - share) * below)
        for colour in pure
        for share in (1, 0.66, 0.33)
        for value, below in zip(ImageColor.getrgb(colour), ground, strict=True)
    ]
    palette = Image.new("P", (1, 1))
    palette.putpalette(mixed[: 3 * 256])
    first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    times = [milliseconds for _, milliseconds in shots]
    first.save(target, save_all=True, append_images=others, duration=times, loop=0, optimize=True)


if __name__ == "__main__":
    main()
