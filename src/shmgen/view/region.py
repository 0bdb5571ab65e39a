"""The screen of one region: its fields with values, curves, a hex dump, and a form to publish a sample."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, ClassVar, NamedTuple

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
from shmgen.tools.messages import format
from shmgen.tools.messages.paths import Getter, getter
from shmgen.view.curves import Curves
from shmgen.view.memory import Memory
from shmgen.view.source import Source

_LOOK, _DRAW = 0.05, 0.25
"""Seconds between two reads of the region, and between two redraws of the screen."""
_SHORT = 8
"""Number of elements in the line of an array that is collapsed in the tree."""
_PAGE = 100
"""Number of elements that an array shows when it is expanded. Enter on its last line adds the same number."""


class Item(NamedTuple):
    """A line in the tree of fields. The line shows the value at `path`.

    If `is_more` is true, the line offers further elements of the array at `path` instead.
    """

    path: str
    is_more: bool = False


class Fields(Tree[Item]):
    """A tree of the newest message's fields with their values. At first, messages are expanded and arrays collapsed.

    The elements of an array get lines only when the user expands the array.
    """

    def __init__(self, topic: str) -> None:
        super().__init__(plain(topic))
        self._getters: dict[str, Getter] = {}
        self._most: dict[str, int] = {}

    def show_kind(self, kind: type[Message]) -> None:
        """Replace the tree with the fields of this type."""
        self.clear()
        self._getters.clear()
        self._most.clear()
        self._kind = kind
        self.root.expand()
        self._grow(self.root, kind(), "")

    def show_more(self, path: str) -> None:
        """Let the next show_values() add another page of elements to the array at `path`."""
        self._most[path] += _PAGE

    def show_values(self, message: Message, is_drawn: Callable[[str], bool]) -> None:
        """Write the values of `message` into the visible lines. Adjust expanded arrays to their number of elements.

        If `is_drawn` returns True for the path of a field, the field has a curve: mark the line of the field.
        """
        self._fill_below(self.root, message)
        first = int(self.scroll_offset.y)
        for line in range(first, first + self.size.height):
            node = self.get_node_at_line(line)
            if node is not None and (item := node.data) and not item.is_more:
                mark = "● " if is_drawn(item.path) else ""
                label = f"{mark}{self._label(item.path, message, is_open=node.is_expanded)}"
                if str(node.label) != label:
                    node.set_label(Text(label))

    def _label(self, path: str, message: Message, *, is_open: bool) -> str:
        name = path[path.rfind("[") :] if path.endswith("]") else path.rpartition(".")[2]
        try:
            value = self._value(path, message)
            if isinstance(value, Message):
                return name
            text = in_short(value)
            if is_array(value):
                text = f"{counted(len(value), 'element')}{f', {text}' if len(value) and not is_open else ''}"
        except CountExceeded as error:
            text = f"damaged: {error}"
        return f"{name}: {legible(text)}"

    def _value(self, path: str, message: Message) -> Any:
        if path not in self._getters:
            self._getters[path] = getter(self._kind, path)
        return self._getters[path](message)

    def _grow(self, node: TreeNode[Item], value: Message, within: str) -> None:
        for member in value._names_:
            name = format.ros_name(member)
            self._add(node, name, f"{within}.{name}" if within else name, getattr(value, member), expand=True)

    def _add(self, node: TreeNode[Item], name: str, path: str, value: Any, *, expand: bool = False) -> None:
        if isinstance(value, Message):
            # A new message has the same fields, and no count that can be damaged.
            self._grow(node.add(plain(name), data=Item(path), expand=expand), type(value)(), path)
        elif is_array(value):
            node.add(plain(name), data=Item(path))
        else:
            node.add_leaf(plain(name), data=Item(path))

    def _fill_below(self, node: TreeNode[Item], message: Message) -> None:
        """Update the lines of the expanded arrays below `node`: one line for each element."""
        for child in node.children:
            if child.data and child.is_expanded:
                with suppress(CountExceeded):
                    value = self._value(child.data.path, message)
                    if is_array(value):
                        self._fill(child, child.data.path, value)
                    self._fill_below(child, message)

    def _fill(self, node: TreeNode[Item], path: str, value: Any) -> None:
        new_count = min(len(value), self._most.setdefault(path, _PAGE))
        lines = [child for child in node.children if child.data and not child.data.is_more]
        left = len(value) - new_count
        more = f"… {left:,} more: Enter shows {min(left, _PAGE)} of them"
        if len(lines) == new_count and (
            str(node.children[-1].label) == more if left else len(node.children) == new_count
        ):
            return
        for child in [*lines[new_count:], *node.children[len(lines) :]]:
            child.remove()
        for index in range(len(lines), new_count):
            self._add(node, f"[{index}]", f"{path}[{index}]", value[index])
        if left:
            node.add_leaf(Text(more), data=Item(path, is_more=True))


class Draft(TextArea):
    """The text box for a sample to publish. Ctrl+A selects all text, as in a browser."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("ctrl+a", "select_all", "Select all")]


class RegionScreen(Screen[None]):
    """The current values, curves and bytes of one region."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "app.pop_screen", "All regions"),
        Binding("p,space", "pause", "Pause", key_display="p"),
        Binding("plus,equals_sign", "zoom(0.5)", "Zoom in", key_display="+"),
        Binding("minus", "zoom(2)", "Zoom out", key_display="-"),
        Binding("left_square_bracket", "shift(-0.25)", "Earlier", key_display="["),
        Binding("right_square_bracket", "shift(0.25)", "Later", key_display="]"),
        Binding("q", "leave", "Quit"),
    ]
    CSS = """
    RegionScreen #about { height: 2; padding: 0 1; color: $text-muted; }
    RegionScreen Tree { width: 2fr; min-width: 24; }
    RegionScreen TabbedContent { width: 5fr; }
    RegionScreen TextArea { height: 1fr; }
    RegionScreen #result { height: auto; max-height: 6; padding: 0 1; }
    """

    def __init__(self, source: Source, *, allow_write: bool, fields: Sequence[str] = ()) -> None:
        super().__init__()
        self.sub_title = legible(source.topic)
        self._source = source
        source.look()
        self._allow_write, self._first_curves = allow_write, fields
        self._paused = False
        self._since = time.monotonic(), source.view.header().newest

    def compose(self) -> ComposeResult:
        yield Header(icon="")
        yield Static(id="about", markup=False)
        with Horizontal():
            yield Fields(self._source.topic)
            with TabbedContent():
                with TabPane("Plot", id="plot"):
                    yield Curves(self._source.curves)
                with TabPane("Memory", id="memory"):
                    yield Memory(self._source)
                if self._allow_write:
                    with TabPane("Publish", id="publish"), Vertical():
                        yield Draft(self._draft(), id="draft")
                        yield Button("Publish one sample", id="send", variant="warning")
                        yield Static(
                            "If another writer has the topic, nothing is published.", id="result", markup=False
                        )
        yield Footer()

    def on_mount(self) -> None:
        fields = self.query_one(Fields)
        fields.show_kind(self._source.kind)
        fields.focus()
        for path in self._first_curves:
            self._toggle(path)
        self.set_interval(_LOOK, self._look)
        self.set_interval(_DRAW, self._draw)

    def on_unmount(self) -> None:
        self._source.close()

    def on_tree_node_selected(self, event: Tree.NodeSelected[Item]) -> None:
        """Start or stop the curve of a number whose line the user selected.

        If the line is the last line of a long array, show more elements of the array instead. Ignore messages and
        arrays: the tree itself expands and collapses them.
        """
        item = event.node.data
        if item is None or event.node.allow_expand:
            return
        if item.is_more:
            self.query_one(Fields).show_more(item.path)
            self._draw()
            return
        self._toggle(item.path)

    def _toggle(self, path: str) -> None:
        is_drawn = self._source.toggle(path)
        self.query_one(Curves).refresh()
        if is_drawn:
            self.query_one(TabbedContent).active = "plot"
        else:
            self.notify(f"{legible(path)} is no longer plotted, or is not a number", markup=False, timeout=3)

    def on_tree_node_expanded(self) -> None:
        self.call_after_refresh(self._draw)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        if self._allow_write and event.button.id == "send":
            self._publish(self.query_one("#draft", TextArea).text)

    def on_descendant_focus(self) -> None:
        self.refresh_bindings()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Turn off single-key actions while the focus is in the text box."""
        return not (isinstance(self.focused, TextArea) and action in ("pause", "zoom", "shift", "leave"))

    def action_leave(self) -> None:
        self.app.exit()

    def action_pause(self) -> None:
        self._paused = not self._paused
        self.query_one(Curves).set_paused(self._paused)
        self._draw()

    def action_zoom(self, factor: float) -> None:
        self.query_one(Curves).zoom(factor)

    def action_shift(self, part: float) -> None:
        self.query_one(Curves).shift(part)

    @work(thread=True, exclusive=True)
    def _publish(self, text: str) -> None:
        """Publish the sample in `text`. This runs in a thread, because taking over a topic from a PLC takes 1 s."""
        try:
            result = self._source.publish(text)
        except (ShmError, Rejected, ValueError, OSError) as error:
            result = f"error: {error}"
        self.app.call_from_thread(self.query_one("#result", Static).update, lines(result))

    def _draft(self) -> str:
        kind = self._source.kind
        try:
            return format.yaml(self._source.message or kind(), None) if kind._names_ else "{}"
        except CountExceeded:
            return format.yaml(kind(), None)

    def _look(self) -> None:
        if self._paused:
            return
        try:
            before = self._source.kind
            self._source.look()
        except (ShmError, Rejected, ValueError, OSError) as error:
            self.query_one("#about", Static).update(lines(str(error)))
            return
        if self._source.kind is not before:  # the region was recreated, possibly with another type
            self.query_one(Fields).show_kind(self._source.kind)

    def _draw(self) -> None:
        if not self.is_current:
            return
        header = self._source.view.header()
        now = time.monotonic()
        since, number = self._since
        if now - since >= 2:
            self._since = now, header.newest
        rate = (header.newest - number) / (now - since) if now > since else 0.0
        newest = self._source.newest
        age = f"{time.time() - newest.stamp / 1e9:.3f} s" if newest and newest.stamp else "-"
        state = "paused" if self._paused else f"{rate:.1f}/s"
        missed = f"   {counted(self._source.reader.missed, 'sample')} not shown (published between screen updates)"
        self.query_one("#about", Static).update(
            f"{legible(header.type_name)}   sample {header.newest:,}   {state}   age {age}\n"
            f"{counted(header.payload_size, 'byte')}   digest 16#{header.digest:016X}{missed}"
        )
        if (message := self._source.message) is not None:
            self.query_one(Fields).show_values(message, self._source.curves.__contains__)
        self.query_one(Curves).draw()
        self.query_one(Memory).refresh()


def plain(text: str) -> Text:
    """Return text from a region or a process without markup or control characters."""
    return Text(legible(text))


def is_array(value: Any) -> bool:
    """Return True if the value is an array or a sequence. A time is a tuple and does not count."""
    return isinstance(value, (ctypes.Array, list))


def in_short(value: Any) -> str:
    """Return the value on one line; show only the first elements of an array.

    Raises CountExceeded if the count of a sequence is damaged.
    """
    if is_array(value):
        few = ", ".join(in_short(item) for item in format.elements(value, _SHORT))
        return f"[{few}]" if len(value) <= _SHORT else f"[{few}, ...]"
    if isinstance(value, Message):
        return ", ".join(f"{format.ros_name(name)}={in_short(format.field(value, name))}" for name in value._names_)
    if hasattr(value, "sec") and hasattr(value, "nanosec"):
        return f"{value.sec}.{value.nanosec:09}"
    return repr(value) if isinstance(value, str) else str(value)
