"""The first screen: a table of all live regions, each of which leads to a screen of its own."""

from __future__ import annotations

from typing import ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.coordinate import Coordinate
from textual.events import Click
from textual.screen import Screen
from textual.widgets import DataTable, Footer, Header, Static
from textual.widgets.data_table import ColumnKey

from shmgen.core.diagnostics import Rejected
from shmgen.core.escape import lines
from shmgen.core.plural import counted
from shmgen.live.classes import ClassRegistry
from shmgen.live.regions import unlisted
from shmgen.runtime import ShmError
from shmgen.tools.watch import top
from shmgen.view.region import RegionScreen, plain
from shmgen.view.source import Source

_PERIOD = 1.0
"""Seconds between two looks at all regions."""
_COLUMNS = ("HEALTH", "TOPIC", "RATE", "AGE", "TYPE", "WRITER", "SLOTS", "MISSED", "BYTES")


class Table(DataTable[Text]):
    """A click opens a row. Textual's own table wants two, both in the same cell."""

    def on_click(self, event: Click) -> None:
        meta = event.style.meta
        if meta.get("row", -1) >= 0:
            self.cursor_coordinate = Coordinate(meta["row"], meta["column"])


class Regions(Screen[None]):
    """What `shmgen top` shows; Enter or a click opens a region."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q", "app.quit", "Quit"),
        Binding("s", "sort", "Sort by the next column"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._past: top.Past = {}
        self._column = "topic"

    def compose(self) -> ComposeResult:
        yield Header(icon="")
        yield Table(cursor_type="row", zebra_stripes=True)
        yield Static(id="note", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        table = self.query_one(Table)
        for column in _COLUMNS:
            table.add_column(column, key=column)
        top.look(self._past)
        self.look()
        self.set_interval(_PERIOD, self.look)

    def look(self) -> None:
        """Only what is another one than before is drawn anew. Columns only grow: to shrink one reads it whole."""
        if self.app.screen is not self:  # is_current is true also for the screen below another
            return
        table = self.query_one(Table)
        rows = top.ordered(top.look(self._past), self._column, reverse=False)
        wanted = [row.topic for row in rows]
        there = [str(key.value) for key in table.rows]
        if wanted != there:
            at = there[table.cursor_row] if table.cursor_row < len(there) else None
            table.clear()
            for row in rows:
                table.add_row(*_cells(row), key=row.topic)
            if at in wanted:
                table.move_cursor(row=wanted.index(at))
        else:
            for row in rows:
                for column, cell in zip(_COLUMNS, _cells(row), strict=True):
                    if table.get_cell(row.topic, column) != cell:
                        wider = cell.cell_len > table.columns[ColumnKey(column)].content_width
                        table.update_cell(row.topic, column, cell, update_width=wider)
        note = f"{counted(len(rows), 'region')}, sorted by {self._column}" if rows else ""
        self.query_one("#note", Static).update("; ".join(filter(None, (note, unlisted(rows)))))

    def action_sort(self) -> None:
        columns = top.COLUMNS
        self._column = columns[(columns.index(self._column) + 1) % len(columns)]
        self.look()

    def on_data_table_row_selected(self, event: DataTable.RowSelected) -> None:
        self.app.open(str(event.row_key.value))


def health(row: top.TopicRow) -> str:
    """One word."""
    return "damaged" if row.type.startswith("damaged:") else _HEALTH.get(row.writer, "ok")


_HEALTH = {"-": "no writer", "gone": "gone", "PLC, still": "still"}
_STYLES = {"ok": "green", "damaged": "red", "gone": "yellow", "still": "yellow"}


def _cells(row: top.TopicRow) -> list[Text]:
    said = health(row)
    topic, type_, writer = (plain(text) for text in (row.topic, row.type, row.writer))
    numbers = [top.cell("rate", row.rate), top.cell("age", row.age), str(row.slots), f"{row.missed:,}", f"{row.size:,}"]
    rate, age, *others = (Text(number, justify="right") for number in numbers)
    return [Text(said, style=_STYLES.get(said, "")), topic, rate, age, type_, writer, *others]


class Viewer(App[None]):
    """`shmgen view`."""

    TITLE = "shmgen view"
    ENABLE_COMMAND_PALETTE = False
    CSS = """
    #note { height: 1; color: $text-muted; padding: 0 1; }
    DataTable { height: 1fr; }
    """

    def __init__(self, registry: ClassRegistry, *, allow_write: bool, topic: str | None = None) -> None:
        super().__init__()
        self.registry, self.allow_write, self._first = registry, allow_write, topic

    def on_mount(self) -> None:
        self.push_screen(Regions())
        if self._first:
            self.open(self._first)

    def open(self, topic: str) -> None:
        """Shows one region, or says why that cannot be."""
        try:
            source = Source(topic, self.registry)
        except (ShmError, Rejected, ValueError, OSError) as error:
            self.notify(lines(str(error)), severity="error", timeout=15, markup=False)
            return
        self.push_screen(RegionScreen(source, allow_write=self.allow_write))
