"""Shows the newest sample in lines of 16 bytes with the fields in each line. Reads only the visible bytes."""

from __future__ import annotations

from bisect import bisect_right

from rich.segment import Segment
from rich.style import Style
from textual.geometry import Size
from textual.scroll_view import ScrollView
from textual.strip import Strip

from shmgen.core.escape import legible
from shmgen.core.model import Role
from shmgen.runtime.region import header as h
from shmgen.show.table import leaves
from shmgen.view.source import Source

_BYTES = 16
_COLOURS = ("cyan", "green", "yellow", "magenta", "bright_blue", "bright_red")
_WIDTH = 160


class Memory(ScrollView):
    """A hex dump of the newest sample. The first line is the header of the slot; the other lines are the payload.

    The offsets count from the start of the payload, as in `shmgen show`.
    """

    can_focus = True

    def __init__(self, source: Source) -> None:
        super().__init__()
        self._source = source
        self._take()

    def _take(self) -> None:
        self._kind = self._source.kind
        self._rows = leaves(self._source.layout, self._source.layouts)
        self._starts = [row.offset for row in self._rows]
        lines = 1 + -(-self._source.layout.size // _BYTES)
        self.virtual_size = Size(_WIDTH, lines)

    def render_line(self, y: int) -> Strip:
        """Draw the visible line `y`."""
        if self._source.kind is not self._kind:
            self._take()
        across, down = self.scroll_offset
        line = y + int(down)
        if line >= self.virtual_size.height:
            return Strip.blank(self.size.width)
        offset = (line - 1) * _BYTES
        size = min(_BYTES, self._source.layout.size - offset) if line else h.SLOT_HEADER
        data = self._source.memory(h.SLOT_HEADER + offset, size)
        segments = [Segment(f"{offset:>8}  ", Style(dim=True))]
        names = []
        for index in range(_BYTES):
            text = f"{data[index]:02x} " if index < len(data) else "   "
            style = Style(dim=True)
            if line and index < len(data):
                number = bisect_right(self._starts, offset + index) - 1
                style, row = Style(color=_COLOURS[number % len(_COLOURS)]), self._rows[number]
                name = row.path if row.role == Role.DATA.value else f"({row.role})"
                if name not in names:
                    names.append(name)
            segments.append(Segment(text, style))
        signs = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in data)
        names_text = legible(", ".join(names)) if line else "slot: stamp, number"
        segments.append(Segment(f" {signs:<{_BYTES}}  {names_text}"))
        return Strip(segments).crop(int(across), int(across) + self.size.width).extend_cell_length(self.size.width)
