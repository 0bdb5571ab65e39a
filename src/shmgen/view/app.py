"""The application `shmgen view` and its first screen: a table of all live regions. A row opens the region's screen."""

from __future__ import annotations

from collections.abc import Sequence
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
from shmgen.core.escape import legible, lines
from shmgen.core.plural import counted
from shmgen.live.classes import ClassRegistry
from shmgen.live.regions import unlisted
from shmgen.runtime import ShmError
from shmgen.tools.watch import overview
from shmgen.view.region import RegionScreen, plain
from shmgen.view.source import Source

_PERIOD = 1.0
"""Seconds between two updates of the table."""
_WIDEST = {"TOPIC": 48, "TYPE": 36, "WRITER": 24}
"""Largest widths of text columns, in characters. A wider column would push the next columns out of the window."""
_COLUMNS = ("HEALTH", "TOPIC", "RATE", "AGE", "TYPE", "WRITER", "SLOTS", "MISSED", "BYTES")


class Table(DataTable[Text]):
    """A table in which one click opens a row. Textual's own table requires two clicks on the same cell."""

    def on_click(self, event: Click) -> None:
        meta = event.style.meta
        if meta.get("row", -1) >= 0:
            self.cursor_coordinate = Coordinate(meta["row"], meta["column"])


class Regions(Screen[None]):
    """The first screen: the table of all regions that `shmgen top` shows. Enter or a click opens a region."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q", "app.quit", "Quit"),
        Binding("s", "sort", "Sort by the next column"),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._past: overview.Past = {}
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
        overview.look(self._past)
        self.look()
        self.set_interval(_PERIOD, self.look)

    def look(self) -> None:
        """Read all regions again and redraw the rows that changed.

        A column becomes wider if needed but never narrower, because Textual must read the whole column to shrink it.
        """
        if self.app.screen is not self:  # is_current is also true for a covered screen
            return
        table = self.query_one(Table)
        rows = overview.ordered(overview.look(self._past), self._column, reverse=False)
        new_topics = [row.topic for row in rows]
        old_topics = [str(key.value) for key in table.rows]
        if new_topics != old_topics:
            at = old_topics[table.cursor_row] if table.cursor_row < len(old_topics) else None
            table.clear()
            for row in rows:
                table.add_row(*_cells(row), key=row.topic)
            if at in new_topics:
                table.move_cursor(row=new_topics.index(at))
        else:
            for row in rows:
                for column, cell in zip(_COLUMNS, _cells(row), strict=True):
                    if table.get_cell(row.topic, column) != cell:
                        wider = cell.cell_len > table.columns[ColumnKey(column)].content_width
                        table.update_cell(row.topic, column, cell, update_width=wider)
        note = f"{counted(len(rows), 'region')}, sorted by {self._column}" if rows else ""
        at = rows[table.cursor_row] if table.cursor_row < len(rows) else None
        whole = legible(f"{at.topic} {at.type}") if at and len(at.topic) > _WIDEST["TOPIC"] else ""
        self.query_one("#note", Static).update("; ".join(filter(None, (whole, note, unlisted(rows)))))

    def action_sort(self) -> None:
        columns = overview.COLUMNS
        self._column = columns[(columns.index(self._column) + 1) % len(columns)]
        self.look()

    def on_data_table_row_selected(self, event: DataTable.RowSelected) -> None:
        self.app.open(str(event.row_key.value))


def tail(text: str, widest: int) -> str:
    """Return a text, shortened to its last `widest` characters if it is longer: names differ at their end."""
    return text if len(text) <= widest else f"…{text[1 - widest :]}"


def health(row: overview.Row) -> str:
    """Return the state of a region in one or two words, such as `ok` or `no writer`."""
    return "damaged" if row.type.startswith("damaged:") else _HEALTH.get(row.writer, "ok")


_HEALTH = {"-": "no writer", "gone": "gone", "PLC, still": "still"}
_STYLES = {"ok": "green", "damaged": "red", "gone": "yellow", "still": "yellow"}


def _cells(row: overview.Row) -> list[Text]:
    state = health(row)
    texts = {"TOPIC": row.topic, "TYPE": row.type, "WRITER": row.writer}
    topic, type_, writer = (plain(tail(text, _WIDEST[column])) for column, text in texts.items())
    numbers = [
        overview.cell("rate", row.rate),
        overview.cell("age", row.age),
        str(row.slots),
        f"{row.missed:,}",
        f"{row.size:,}",
    ]
    rate, age, *others = (Text(number, justify="right") for number in numbers)
    return [Text(state, style=_STYLES.get(state, "")), topic, rate, age, type_, writer, *others]


class Viewer(App[None]):
    """The application behind `shmgen view`."""

    TITLE = "shmgen view"
    ENABLE_COMMAND_PALETTE = False
    CSS = """
    #note { height: 1; color: $text-muted; padding: 0 1; }
    DataTable { height: 1fr; }
    """

    def __init__(
        self, registry: ClassRegistry, *, allow_write: bool, topic: str | None = None, fields: Sequence[str] = ()
    ) -> None:
        """Prepare to show the table of all regions. If `topic` is given, begin with its screen and curves of `fields`.

        `allow_write` lets the user publish samples.
        """
        super().__init__()
        self.registry, self.allow_write, self._first, self._fields = registry, allow_write, topic, fields

    def on_mount(self) -> None:
        self.push_screen(Regions())
        if self._first:
            self.open(self._first, self._fields)

    def open(self, topic: str, fields: Sequence[str] = ()) -> None:
        """Show the screen of one region, with curves of these fields. If that fails, show a notice of the error."""
        try:
            source = Source(topic, self.registry)
        except (ShmError, Rejected, ValueError, OSError) as error:
            self.notify(lines(str(error)), severity="error", timeout=15, markup=False)
            return
        self.push_screen(RegionScreen(source, allow_write=self.allow_write, fields=fields))
