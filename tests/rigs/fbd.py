"""Draws docs/blocks.svg: how a generated subscriber and publisher appear in an IDE's editor for FBD.

The pins, their order and their types are read from the Structured Text, because an IDE also draws a block from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

from shmgen.config import load
from shmgen.core.diagnostics import Report
from shmgen.generator import pipeline
from shmgen.targets.st import reader
from shmgen.targets.st.objects import Unit

WIDTH, _PIN, _HEAD = 1000, 17, 44
CELL = """targets = ["st"]
[[topics]]
topic = "/robot/target"
type = "geometry_msgs/Pose"
[[topics]]
topic = "/conveyor/speed"
type = "std_msgs/Float64"
direction = "from_plc"
"""


class PlacedBlock(NamedTuple):
    """A block in the drawing. `inputs` are the texts at its inputs, and `outputs` the texts at its outputs.

    `x` and `y` are the position of its frame.
    """

    instance: str
    unit: Unit
    x: int
    y: int
    width: int
    inputs: dict[str, str]
    outputs: dict[str, str]

    def pins(self, keyword: str) -> list[str]:
        return [pin.name for part in self.unit.sections if part.keyword == keyword for pin in part.variables]

    @property
    def height(self) -> int:
        return _HEAD + _PIN * max(len(self.pins("VAR_INPUT")), len(self.pins("VAR_OUTPUT"))) + 6

    def at(self, pin: str) -> tuple[int, int]:
        """Return the point at which a wire to the pin meets the frame."""
        left = self.pins("VAR_INPUT")
        number = left.index(pin) if pin in left else self.pins("VAR_OUTPUT").index(pin)
        return self.x + (0 if pin in left else self.width), self.y + _HEAD + _PIN * number + 4


def blocks(folder: Path) -> str:
    """Return a drawing of two function blocks as SVG. Write their configuration into `folder`.

    Raises AssertionError if a pin that the drawing needs no longer exists.
    """
    (folder / "shmgen.toml").write_text(CELL)
    texts = pipeline.generate(load(folder / "shmgen.toml", "shmgen.toml", Report()), [])
    units = {Path(path).stem: text for path, text in texts.items() if Path(path).name.startswith("FB_")}

    def place(instance: str, name: str, x: int, y: int, inputs: dict[str, str], outputs: dict[str, str]) -> PlacedBlock:
        unit = reader.read(name, units[name])
        assert isinstance(unit, Unit)
        return PlacedBlock(instance, unit, x, y, 290, inputs, outputs)

    enabled = {"xEnable": "TRUE"}
    read = place(
        "fbTarget", "FB_geometry_msgs_Pose_Subscriber", 140, 92,
        {**enabled, "sTopic": "'/robot/target'", "tTimeout": "T#200ms"}, {"xStale": "xRobotGone", "Msg": "stTarget"},
    )  # fmt: skip
    sent = place(
        "fbSpeed", "FB_std_msgs_Float64_Publisher", 600, 92,
        {**enabled, "sTopic": "'/conveyor/speed'", "Msg": "stSpeed"}, {"xSent": "", "eErrorID": "eWhy"},
    )  # fmt: skip
    sheet = (read, sent)
    height = max(block.y + block.height for block in sheet) + 40
    return "\n".join([*_head(height), *(line for block in sheet for line in _box(block)), "</svg>", ""])


def _head(height: int) -> Iterator[str]:
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}"'
        ' role="img" aria-label="A generated subscriber and a generated publisher as an editor for FBD shows them">'
    )
    yield "<style>text { font: 12.5px 'DejaVu Sans', sans-serif; fill: #1f2933 } .type { font-weight: bold }"
    yield " .pin { fill: #0b57a4 } .box { fill: #eef4fb; stroke: #33475b } .wire { fill: none; stroke: #33475b }"
    yield " .title { font-size: 16px; font-weight: bold } .note { fill: #66717d }</style>"
    yield f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>'
    yield '<text x="20" y="30" class="title">A function block for each topic, in FBD, LD or CFC</text>'
    yield '<text x="20" y="52" class="note">Drawn from the generated Structured Text, not a screenshot.</text>'


def _box(block: PlacedBlock) -> Iterator[str]:
    middle = block.x + block.width // 2
    yield f'<rect x="{block.x}" y="{block.y}" width="{block.width}" height="{block.height}" class="box"/>'
    yield f'<text x="{middle}" y="{block.y - 7}" text-anchor="middle">{block.instance}</text>'
    yield f'<text x="{middle}" y="{block.y + 18}" text-anchor="middle" class="type">{block.unit.name}</text>'
    for keyword, side, values in (("VAR_INPUT", -1, block.inputs), ("VAR_OUTPUT", 1, block.outputs)):
        assert set(values) <= set(block.pins(keyword)), values
        anchor = "start" if side < 0 else "end"
        for pin in block.pins(keyword):
            x, y = block.at(pin)
            yield f'<text x="{x - 8 * side}" y="{y + 4}" text-anchor="{anchor}">{pin}</text>'
            yield f'<path d="M{x} {y} h{12 * side}" class="wire"/>'
            if value := values.get(pin):
                other = "end" if side < 0 else "start"
                place = f'x="{x + 16 * side}" y="{y + 4}" text-anchor="{other}"'
                yield f'<text {place} class="pin">{escape(value)}</text>'
