"""Draws the pictures of the documentation: docs/latency.svg, blocks.svg, top.svg and view.gif.

    make pictures

The latencies are those that benchmarks/latency.py has printed into docs/performance.md. top.svg shows `shmgen top` on a
terminal. view.gif shows the page of `shmgen view` in chromium during a visit; Pillow combines the pictures. The regions
belong to three programs that run meanwhile.
"""

from __future__ import annotations

import asyncio
import fcntl
import io
import math
import os
import pty
import re
import select
import struct
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import pyte

from ..support import REPOSITORY
from ..view.browser import Page
from . import fbd

DOCS = REPOSITORY / "docs"
_ROW = re.compile(r"  (spin|event|poll) +(.+?) +(\d+\.\d) +(\d+\.\d) +\d+\.\d +\d+\.\d\d +\d+")
_FONTS = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)
_LEFT, _WIDE, _LINE = 190, 530, 20
_WINDOW = 1234, 436
"""The size of the page and of view.gif in pixels."""
_NAMES = {"C": "by hand, C", "C++": "shmgen, C++", "shmgen": "shmgen, Python", "by hand": "by hand, Python"}
"""The label of each row of the page's table."""
_COLOURS = {**dict.fromkeys(("shmgen", "C++"), "#1b7f4d"), **dict.fromkeys(("by hand", "C"), "#7a9e8a")}


def main() -> None:
    with suppress(PermissionError):  # for curves without gaps on a busy machine
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))
    (DOCS / "latency.svg").write_text(latency((DOCS / "performance.md").read_text()))
    with tempfile.TemporaryDirectory() as name:
        (DOCS / "blocks.svg").write_text(fbd.blocks(Path(name)))
    with running_cell() as folder:
        (DOCS / "top.svg").write_text(top(folder))
        shots = asyncio.run(view(folder))
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    film(shots, DOCS / "view.gif")


def latency(page: str) -> str:
    """Return a drawing of the latencies in `page` as SVG, on a logarithmic axis in microseconds.

    It shows messages of 56 bytes to a reader that sleeps: bars to the median, and lines to the 99th percentile.
    """
    rows = [
        match.groups()
        for match in map(_ROW.match, page[page.rindex("\n56 bytes at") :].partition("\n```")[0].splitlines())
        if match
    ]
    rows = [(way, float(median), float(most)) for mode, way, median, most in rows if mode == "event"]
    height = 58 + _LINE * len(rows) + 40
    powers = math.ceil(math.log10(max(most for _, _, most in rows)))

    def at(value: float) -> float:
        return round(_LEFT + _WIDE * math.log10(max(1.0, value)) / powers, 1)

    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif" font-size="13"'
        f' width="780" height="{height}">',
        f'<rect width="780" height="{height}" fill="#ffffff"/>',
        '<text x="16" y="24" font-size="15">Age of 56 bytes when a waiting reader has them, 1 kHz, one way</text>',
        '<text x="16" y="42" fill="#555555">bar, number: median; line: to the 99th percentile; µs, logarithmic</text>',
    ]
    for decade in range(powers + 1):
        x = at(10**decade)
        parts.append(f'<line x1="{x}" y1="52" x2="{x}" y2="{height - 34}" stroke="#dddddd"/>')
        parts.append(f'<text x="{x}" y="{height - 16}" text-anchor="middle" fill="#555555">{10**decade}</text>')
    for number, (way, median, most) in enumerate(rows):
        y = 58 + _LINE * number
        width = round(at(median) - _LEFT, 1)
        middle = y + 7
        parts += [
            f'<text x="{_LEFT - 8}" y="{y + 12}" text-anchor="end">{escape(_NAMES.get(way, way))}</text>',
            f'<rect x="{_LEFT}" y="{y}" width="{width}" height="14" fill="{_COLOURS.get(way, "#7d8fb3")}"/>',
            f'<line x1="{at(median)}" y1="{middle}" x2="{at(most)}" y2="{middle}" stroke="#333333"/>',
            f'<text x="{at(most) + 6}" y="{y + 12}" fill="#333333">{median:.1f}</text>',
        ]
    return "\n".join([*parts, "</svg>"]) + "\n"


def move(program: str) -> None:
    """Publish the topics of a part of the cell, such as the arm, 100 times a second until the process is killed."""
    from shmgen.config import load
    from shmgen.core.diagnostics import Report
    from shmgen.live.classes import ClassRegistry, publisher
    from shmgen.live.session import Session
    from shmgen.tools.messages import parse

    def values(angle: float) -> dict[str, tuple[str, int, Any]]:
        pose = {"position": {"x": math.sin(angle), "y": math.cos(angle), "z": 0.5 + 0.3 * math.sin(3 * angle)}}
        stamped = {"header": {"stamp": "now", "frame_id": "base"}, "pose": pose}
        joints = {
            "name": [f"joint_{number}" for number in range(1, 7)],
            "position": [math.sin(angle + number) for number in range(6)],
        }
        heat = {"temperature": 180 + 5 * math.sin(angle)}
        return {
            "arm": {
                "/cell/arm/pose": ("geometry_msgs/msg/PoseStamped", 3, stamped),
                "/cell/arm/joints": ("sensor_msgs/msg/JointState", 7, joints),
            },
            "oven": {"/cell/oven/temperature": ("sensor_msgs/msg/Temperature", 1, heat)},
            "conveyor": {"/cell/conveyor/speed": ("std_msgs/msg/Float64", 1, {"data": 0.25})},
        }[program]

    registry = ClassRegistry(Session(load(Path("shmgen.toml"), "shmgen.toml", Report())), None)
    with ExitStack() as stack:
        publishers = {
            topic: stack.enter_context(publisher(registry.message(kind), topic, depth))
            for topic, (kind, depth, _) in values(0.0).items()
        }
        print("moving", flush=True)
        begun = time.monotonic()
        while True:
            for topic, (_, _, data) in values(2 * (time.monotonic() - begun)).items():
                publishers[topic].publish(parse.build(publishers[topic].message_type, data))
            time.sleep(0.01 - (time.monotonic() - begun) % 0.01)


@contextmanager
def running_cell() -> Iterator[Path]:
    """Run the programs of a cell while the `with` block runs. Yield their folder, which contains a shmgen.toml."""
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    with tempfile.TemporaryDirectory() as name, ExitStack() as running:
        folder = Path(name)
        folder.joinpath("shmgen.toml").write_text('[bounds]\n"sensor_msgs/JointState" = 6\n')
        running.callback(lambda: [file.unlink() for file in Path("/dev/shm").glob("*cell.*")])
        for program in ("arm", "oven", "conveyor"):
            (folder / f"{program}.py").write_text(f"from tests.rigs.pictures import move\n\nmove({program!r})\n")
            process = running.enter_context(
                subprocess.Popen(
                    [sys.executable, f"{program}.py"], cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
                )
            )
            running.callback(process.kill)
            assert process.stdout is not None
            assert process.stdout.readline() == "moving\n"
        yield folder


def top(folder: Path) -> str:
    """Return a drawing of `shmgen top` after four seconds, on a terminal with 136 columns and 8 lines."""
    from rich.console import Console

    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 8, 136, 0, 0))
    screen = pyte.Screen(136, 8)
    terminal, until = pyte.ByteStream(screen), time.monotonic() + 4
    command = [sys.executable, "-m", "shmgen", "top"]
    with subprocess.Popen(command, cwd=folder, stdin=follower, stdout=follower, env={**os.environ, "TERM": "xterm"}):
        while time.monotonic() < until:
            if select.select([leader], [], [], 0.1)[0]:
                terminal.feed(os.read(leader, 65536))
        os.write(leader, b"q")
    for end in (leader, follower):
        os.close(end)
    console = Console(record=True, width=136, file=io.StringIO())
    for number, line in enumerate(screen.display):
        style = "reverse" if screen.buffer[number][0].reverse else None
        console.print(line, style=style, highlight=False, markup=False)
    return _FONTS.sub("", console.export_svg(title="robot@cell", unique_id="top"))


async def view(folder: Path) -> list[tuple[bytes, int]]:
    """Return pictures of a visit to the page of `shmgen view`, each with the milliseconds for which to show it."""
    shots: list[tuple[bytes, int]] = []
    command = [sys.executable, "-m", "shmgen", "view", "--port", "0", "--allow-write"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        try:
            async with Page() as page:

                async def take_picture(seconds: float, milliseconds: int) -> None:
                    await asyncio.sleep(seconds)
                    shots.append((await page.picture(), milliseconds))

                await page.resize(*_WINDOW)
                await page.open(server.stdout.readline().strip())
                await page.until("/cell/oven/temperature")
                await take_picture(5, 2500)
                await page.click_on("/cell/arm/joints")
                await page.until("position: 6 elements")
                await take_picture(1, 1200)
                await page.click_on("position: 6 elements")
                for element in range(3):
                    await page.click_on(f" [{element}]: ")
                    for _ in range(3):
                        await take_picture(0.8, 600)
                await take_picture(5, 2500)
                for tab in ("Memory", "Publish"):
                    await page.click_on(tab)
                    await take_picture(1.5, 2500)
        finally:
            server.terminate()
    return shots


def film(shots: list[tuple[bytes, int]], target: Path) -> None:
    """Write an animation with the pictures, one after the other, in 128 colours."""
    from PIL import Image

    frames = [Image.open(io.BytesIO(shot)).convert("RGB") for shot, _ in shots]
    width, height = frames[0].size
    whole = Image.new("RGB", (width, height * len(frames)))
    for number, frame in enumerate(frames):
        whole.paste(frame, (0, height * number))
    palette = whole.quantize(colors=128, dither=Image.Dither.NONE)
    first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    times = [milliseconds for _, milliseconds in shots]
    first.save(target, save_all=True, append_images=others, duration=times, loop=0, optimize=True)


if __name__ == "__main__":
    main()
