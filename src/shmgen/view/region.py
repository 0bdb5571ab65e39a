"""The screen of one region: its fields with values, curves, the memory with its bytes, a sample by hand."""

from __future__ import annotations

import ctypes
import time
from typing import Any, ClassVar

from rich.text import Text
from textual import work
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.screen import Screen
from textual.widgets import Button, Footer, Header, Static, TabbedContent, TabPane, TextArea, Tree
from textual.widgets.tree import TreeNode

from shmgen.core.diagnostics import Rejected
from shmgen.core.escape import legible, lines
from shmgen.core.plural import counted
from shmgen.runtime import CountExceeded, Message, ShmError
from shmgen.targets.python.names import python_member
from shmgen.tools.messages import format
from shmgen.view.curves import Curves
from shmgen.view.memory import Memory
from shmgen.view.source import Source

_LOOK, _DRAW = 0.05, 0.25
"""Seconds between two looks at the region, and between two drawings of it."""
_SHORT = 8
"""Elements of an array that are shown."""


class RegionScreen(Screen[None]):
    """What a region holds now."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "app.pop_screen", "All regions"),
        Binding("p,space", "pause", "Pause", key_display="p"),
        Binding("plus,equals_sign", "zoom(0.5)", "Zoom in", key_display="+"),
        Binding("minus", "zoom(2)", "Zoom out", key_display="-"),
        Binding("left_square_bracket", "shift(-0.25)", "Earlier", key_display="["),
        Binding("right_square_bracket", "shift(0.25)", "Later", key_display="]"),
        Binding("q", "app.quit", "Quit"),
    ]
    CSS = """
    RegionScreen #about { height: 2; padding: 0 1; color: $text-muted; }
    RegionScreen Tree { width: 2fr; min-width: 24; }
    RegionScreen TabbedContent { width: 5fr; }
    RegionScreen TextArea { height: 1fr; }
    RegionScreen #said { height: auto; max-height: 6; padding: 0 1; }
    """

    def __init__(self, source: Source, *, allow_write: bool) -> None:
        super().__init__()
        self.sub_title = legible(source.topic)
        self._source = source
        source.look()
        self._allow_write = allow_write
        self._paused = False
        self._fields: dict[str, TreeNode[str]] = {}
        self._since = time.monotonic(), source.header().newest

    def compose(self) -> ComposeResult:
        yield Header(icon="")
        yield Static(id="about", markup=False)
        with Horizontal():
            yield Tree(plain(self._source.topic))
            with TabbedContent():
                with TabPane("Plot", id="plot"):
                    yield Curves(self._source.curves)
                with TabPane("Memory", id="memory"):
                    yield Memory(self._source)
                if self._allow_write:
                    with TabPane("Publish", id="publish"), Vertical():
                        yield TextArea(self._draft(), id="draft")
                        yield Button("Publish one sample", id="send", variant="warning")
                        yield Static(
                            "Other writers keep the topic; then nothing is published.", id="said", markup=False
                        )
        yield Footer()

    def on_mount(self) -> None:
        tree = self.query_one(Tree)
        tree.root.expand()
        self._grow(tree.root, self._source.kind(), "")
        tree.focus()
        self.set_interval(_LOOK, self._look)
        self.set_interval(_DRAW, self._draw)

    def on_unmount(self) -> None:
        self._source.close()

    def on_tree_node_selected(self, event: Tree.NodeSelected[str]) -> None:
        """Enter on a number draws it, and again no more."""
        path = event.node.data
        if path and not event.node.children:
            kept = self._source.toggle(path)
            self.query_one(Curves).refresh()
            if kept:
                self.query_one(TabbedContent).active = "plot"
            elif path not in self._source.curves:
                self.notify(f"{path} is no longer drawn, or is not a number", markup=False, timeout=3)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        if self._allow_write and event.button.id == "send":
            self._publish(self.query_one("#draft", TextArea).text)

    def action_pause(self) -> None:
        self._paused = not self._paused
        self.query_one(Curves).hold(self._paused)
        self._draw()

    def action_zoom(self, factor: float) -> None:
        self.query_one(Curves).zoom(factor)

    def action_shift(self, part: float) -> None:
        self.query_one(Curves).shift(part)

    @work(thread=True, exclusive=True)
    def _publish(self, text: str) -> None:
        """To take a topic over from a PLC takes a second."""
        try:
            said = self._source.publish(text)
        except (ShmError, Rejected, ValueError, OSError) as error:
            said = f"error: {error}"
        self.app.call_from_thread(self.query_one("#said", Static).update, lines(said))

    def _draft(self) -> str:
        return format.yaml(self._source.message or self._source.kind(), None) if self._source.kind._names_ else "{}"

    def _grow(self, node: TreeNode[str], value: Message, within: str) -> None:
        for member in value._names_:
            name = format.ros_name(member)
            path = f"{within}.{name}" if within else name
            inner = getattr(value, member)
            if isinstance(inner, Message):
                self._grow(node.add(plain(name), data=path, expand=True), inner, path)
            else:
                self._fields[path] = node.add_leaf(plain(name), data=path)

    def _look(self) -> None:
        if self._paused:
            return
        try:
            before = self._source.kind
            self._source.look()
        except (ShmError, Rejected, ValueError, OSError) as error:
            self.query_one("#about", Static).update(lines(str(error)))
            return
        if self._source.kind is not before:  # the region was made anew, perhaps of another type
            tree = self.query_one(Tree)
            tree.clear()
            self._fields.clear()
            self._grow(tree.root, self._source.kind(), "")

    def _draw(self) -> None:
        if not self.is_current:
            return
        header = self._source.header()
        now = time.monotonic()
        since, number = self._since
        if now - since >= 2:
            self._since = now, header.newest
        rate = (header.newest - number) / (now - since) if now > since else 0.0
        newest = self._source.newest
        age = f"{time.time() - newest.stamp / 1e9:.3f} s" if newest and newest.stamp else "-"
        state = "paused" if self._paused else f"{rate:.1f}/s"
        missed = f"   {counted(self._source.missed, 'sample')} not shown (published between screen updates)"
        self.query_one("#about", Static).update(
            f"{legible(header.type_name)}   sample {header.newest:,}   {state}   age {age}\n"
            f"{counted(header.payload_size, 'byte')}   digest 16#{header.digest:016X}{missed}"
        )
        if not self._paused:
            self._values()
        self.query_one(Curves).draw()
        self.query_one(Memory).refresh()

    def _values(self) -> None:
        message = self._source.message
        if message is None:
            return
        first, last = self._seen()
        for path, node in self._fields.items():
            if not first <= node.line <= last:
                continue
            value: Any = message
            try:
                for name in path.split("."):
                    value = getattr(value, python_member(name))
                text = in_short(value)
            except CountExceeded as error:
                text = f"damaged: {error}"
            marked = "● " if path in self._source.curves else ""
            label = f"{marked}{path.rpartition('.')[2]}: {legible(text)}"
            if str(node.label) != label:
                node.set_label(Text(label))

    def _seen(self) -> tuple[int, int]:
        """The first and the last line of the tree that is to be seen."""
        tree = self.query_one(Tree)
        first = int(tree.scroll_offset.y)
        return first, first + tree.size.height


def plain(text: str) -> Text:
    """Text that a region or a process has chosen: nothing in it is markup or an order to a terminal."""
    return Text(legible(text))


def in_short(value: Any) -> str:
    """One line; of an array the first elements, and how many there are. Raises CountExceeded."""
    if isinstance(value, (ctypes.Array, list)):
        few = ", ".join(in_short(item) for item in value[:_SHORT])
        return f"[{few}]" if len(value) <= _SHORT else f"[{few}, ... {len(value):,} in all]"
    if isinstance(value, Message):
        return ", ".join(f"{format.ros_name(name)}={in_short(getattr(value, name))}" for name in value._names_)
    if hasattr(value, "sec") and hasattr(value, "nanosec"):
        return f"{value.sec}.{value.nanosec:09}"
    return repr(value) if isinstance(value, str) else str(value)
