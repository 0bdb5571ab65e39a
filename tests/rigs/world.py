"""Prints docs/architecture.svg for `make generated`: the nodes, bridge, regions, blocks and task of a user."""

from __future__ import annotations

from xml.sax.saxutils import escape

_STYLE = """\
text { font: 14px system-ui, 'DejaVu Sans', sans-serif; fill: #1f2933; }
.mono { font: 12px ui-monospace, 'DejaVu Sans Mono', monospace; }
.muted { font-size: 12px; fill: #66717d; }
.head { font-weight: bold; }
.ros { fill: #a8d1f5; } .plc { fill: #f9cf9c; } .memory { fill: #b4e0b0; } .tool { fill: #e3bdf0; }
.frame { fill: #fafbfc; stroke: #b8c2cc; } .lock { fill: #ffffff; stroke: #7cc47a; stroke-dasharray: 4 3; }
.arrow { stroke: #52606d; stroke-width: 1.6; fill: none; marker-end: url(#tip); }"""
_REGIONS = (("robot.pose", "Subscriber", True), ("conveyor.speed", "Publisher", False))
"""The file in /dev/shm, its function block, and True if the PLC reads."""


def world() -> str:
    """Return the picture as SVG. It has two topics, one to the PLC and one from the PLC; each region has one writer."""
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" width="980" height="400" viewBox="0 0 980 400" role="img"'
        ' aria-label="ROS nodes, shmgen bridge, regions in /dev/shm, function blocks in a task of the PLC">',
        f"<style>\n{_STYLE}\n</style>",
        '<defs><marker id="tip" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0 10 5 0 10z" fill="#52606d"/></marker></defs>',
        '<rect width="980" height="400" fill="#ffffff"/>',
        *_box(14, 16, 150, 310, "frame", ("ROS graph", "head")),
        *_box(30, 66, 118, 60, "ros", ("planner", ""), ("a node", "muted")),
        *_box(30, 196, 118, 60, "ros", ("dashboard", ""), ("a node", "muted")),
        *_box(184, 16, 782, 310, "frame", ("one Linux machine", "head")),
        *_box(
            210,
            56,
            160,
            230,
            "tool",
            ("shmgen bridge", "head"),
            ("or a node of", "muted"),
            ("your own in C++", "muted"),
        ),
        *_box(670, 32, 280, 278, "plc", ("soft PLC: task, every 10 ms", "head")),
        *_text(24, 352, ("shmgen generates the code on both sides from one memory layout.", "muted")),
        *_text(24, 372, ("Each topic has one region, one lock and one writer.", "muted")),
    ]
    for number, (name, block, to_plc) in enumerate(_REGIONS):
        y = 66 + 130 * number
        middle = y + 30
        parts += _box(424, y, 190, 96, "memory", (f"/dev/shm/{name}", "mono"), ("header, slots", "muted"))
        parts += _box(438, y + 58, 162, 28, "lock", ("lock: a semaphore", "muted"))
        parts += _box(
            690, y, 240, 60, "frame", (f"GVL_Ros.{name.replace('.', '_')}", "mono"), (f"FB_…_{block}", "muted")
        )
        for left, right in ((148, 210), (370, 424), (614, 690)):
            ends = (left + 2, right - 2) if to_plc else (right - 2, left + 2)
            parts.append(f'<path class="arrow" d="M{ends[0]} {middle}H{ends[1]}"/>')
        side = 376 if to_plc else 626
        parts += _text(side, middle - 8, ("writes", "muted"))
        parts += _text(1002 - side, middle - 8, ("reads", "muted"))
    parts += _text(690, 292, ("never waits for the lock", "muted"))
    return "\n".join([*parts, "</svg>"]) + "\n"


def _box(x: int, y: int, width: int, height: int, kind: str, *lines: tuple[str, str]) -> list[str]:
    frame = f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="6" class="{kind}"/>'
    return [frame, *_text(x + 10, y + 20, *lines)]


def _text(x: int, y: int, *lines: tuple[str, str]) -> list[str]:
    return [
        f'<text x="{x}" y="{y + 20 * number}" class="{kind}">{escape(line)}</text>'
        for number, (line, kind) in enumerate(lines)
    ]


if __name__ == "__main__":
    print(world(), end="")
