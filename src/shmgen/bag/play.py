"""Plays a bag into regions, at the recorded speed or at another speed."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from shmgen.bag.kinds import Kind
from shmgen.bag.mcap import Channel
from shmgen.bag.read import Message, Unreadable, messages
from shmgen.core.diagnostics import Rejected
from shmgen.drift import lockfile
from shmgen.drift.compare import compare
from shmgen.live.classes import ClassRegistry, publisher
from shmgen.live.regions import View, depth_of
from shmgen.runtime import Publisher, region_name
from shmgen.runtime.errors import LayoutMismatch, RegionMissing
from shmgen.runtime.messages.message import Message as Sample
from shmgen.runtime.region.names import HALVES

_HEARTBEAT = 0.05
"""Seconds between two heartbeats while no message is due."""
_APART = 10**9
"""Largest plausible difference in ns between stamp and time of recording. If exceeded, the stamp is ignored."""

Tell = Callable[[str], None]


@dataclass(slots=True)
class _Outlet:
    """A topic on which a bag is played. `has_refused` is True after a value of a message did not fit into a sample."""

    topic: str
    kind: Kind
    writer: Publisher[Sample]
    has_refused: bool = False


class Player:
    """Publishes the messages of a bag, as a substitute for the robot or the PLC."""

    def __init__(self, path: Path, registry: ClassRegistry, topics: Collection[str] | None, tell: Tell) -> None:
        """Read the whole bag and check all topics, then open all regions.

        If `topics` is None, play all topics except those of services and actions. Before a region is opened, raises:

        * Unreadable, if the bag cannot be read.
        * ValueError, if there is nothing to play.
        * LayoutMismatch with the differing fields, or Rejected, if a type does not match.

        Opening a region raises the errors of Publisher. `tell` receives lines for the user.
        """
        self._path, self._tell = path, tell
        self.played = self.refused = 0
        """The numbers of published messages, and of messages that were skipped because a value did not fit."""
        channels, self.first, self.last, self.total = _looked_through(path)
        chosen = {channel.topic: channel for channel in channels if _is_chosen(topic_in(channel), topics)}
        if topics is not None and (missing := _not_in(topics, channels)):
            there = ", ".join(sorted({topic_in(channel) for channel in channels})) or "none"
            raise ValueError(f"{path}: the bag has no topic {', '.join(missing)}; its topics: {there}")
        if not chosen:
            halves = " except those of services and actions; give them with --topics" if channels else ""
            raise ValueError(f"{path}: the bag has no topics{halves}")
        kinds = {topic: _check_channel(channel, registry, path) for topic, channel in chosen.items()}
        self._outlets: dict[str, _Outlet] = {}
        try:
            for name, channel in chosen.items():
                topic = topic_in(channel)
                writer = publisher(kinds[name].message, topic, _depth(channel, topic, registry))
                self._outlets[name] = _Outlet(topic, kinds[name], writer)
        except BaseException:
            self.close()
            raise

    @property
    def topics(self) -> list[str]:
        return [outlet.topic for outlet in self._outlets.values()]

    def play(self, rate: float = 1.0, start: float = 0.0) -> Iterator[float]:
        """Publish all messages from `start` seconds on, `rate` times as fast as recorded.

        After each message, yield the seconds from the bag's earliest message to this message. A message with a value
        that does not fit is skipped and counted in `refused`. Raises ValueError if the bag is shorter than `start`, and
        the errors of Publisher.publish() except ValueRejected.
        """
        length = (self.last - self.first) / 1e9
        if start > length or not self.total:
            raise ValueError(
                f"{self._path}: the bag has {self.total} messages in {length:.3f} s, none after {start:g} s"
            )
        begun = time.monotonic()
        for message in messages(self._path):
            if not isinstance(message, Message):
                continue
            into = (_when(message) - self.first) / 1e9
            outlet = self._outlets.get(message.channel.topic)
            if outlet is None or into < start:
                continue
            self._wait(begun + (into - start) / rate)
            self._publish(outlet, message)
            yield into

    def close(self) -> None:
        for outlet in self._outlets.values():
            outlet.writer.close()

    def _publish(self, outlet: _Outlet, message: Message) -> None:
        try:
            outlet.writer.publish(outlet.kind.codec.decode(message.data))
        except (ValueError, struct.error) as error:  # ValueRejected is a ValueError; other errors of the runtime pass
            if not outlet.has_refused:
                self._tell(f"{outlet.topic}: skipped a message, because a value does not fit: {error}")
            outlet.has_refused = True
            self.refused += 1
        else:
            self.played += 1

    def _wait(self, due: float) -> None:
        while (left := due - time.monotonic()) > 0:
            time.sleep(min(left, _HEARTBEAT))
            if left > _HEARTBEAT:
                for outlet in self._outlets.values():
                    outlet.writer.heartbeat()


def topic_in(channel: Channel) -> str:
    """Return the shmgen topic on which to play a channel of a bag.

    If shmgen recorded the bag, the channel names this topic. Otherwise, derive the topic from the ROS topic.
    """
    if topic := channel.metadata.get("shmgen_topic"):
        return topic
    full, _, half = channel.topic.rpartition("/_")
    return f"{full}-{half}" if half in HALVES else channel.topic


def _looked_through(path: Path) -> tuple[list[Channel], int, int, int]:
    """Read a whole bag. Return its channels, the times of the earliest and latest message, and the message count.

    The times are in ns. Raises Unreadable if a topic has two types.
    """
    first, last, total = 0, 0, 0
    seen: dict[str, Channel] = {}
    for one in messages(path):
        if isinstance(one, Message):
            when = _when(one)
            first, last = min(first or when, when), max(last, when)
            total += 1
        elif _identity(former := seen.setdefault(one.topic, one)) != _identity(one):
            raise Unreadable(f"{path}: {one.topic} changes its type or layout, from {former.type} to {one.type}")
    return list(seen.values()), first, last, total


def _identity(channel: Channel) -> tuple[str | None, ...]:
    return channel.type, channel.text, channel.metadata.get("shmgen_digest")


def _is_chosen(topic: str, topics: Collection[str] | None) -> bool:
    """Return True if `topics` contains the topic, or the service or action that uses the topic.

    None chooses all topics except the parts of services and actions.
    """
    if topics is None:
        return "-" not in topic
    return not {topic, topic.partition("-")[0]}.isdisjoint("/" + name.removeprefix("/") for name in topics)


def _not_in(topics: Collection[str], channels: Collection[Channel]) -> list[str]:
    return [name for name in topics if not any(_is_chosen(topic_in(channel), [name]) for channel in channels)]


def _when(message: Message) -> int:
    apart = abs(message.logged - message.published)
    return message.published if apart < _APART else message.logged


def _check_channel(channel: Channel, registry: ClassRegistry, path: Path) -> Kind:
    """Check the type of a channel against this configuration, and return the Kind of its messages.

    Raises LayoutMismatch if the bag has another layout or definition of the type, and Rejected if the type is unknown.
    """
    digest = channel.metadata.get("shmgen_digest")
    try:
        kind = Kind(registry.session_of(channel.type, int(digest, 16) if digest else None), channel.type)
    except LayoutMismatch as error:
        differences = "\n".join(_differences(channel, registry)) or str(error)
        raise LayoutMismatch(
            f"{path}: {topic_in(channel)} was recorded with another layout of {channel.type}\n{differences}\n"
            "  hint: play the bag in the folder of the shmgen.toml that it was recorded with, or name that file with -c"
        ) from None
    if not digest and _plain(channel.text) != _plain(kind.text):
        raise LayoutMismatch(
            f"{path}: {topic_in(channel)}: {channel.type} has another definition in the bag\n"
            f"  bag:\n{_indent(channel.text)}\n  here:\n{_indent(kind.text)}\n"
            "  hint: give the folder with the definitions of the bag with -I"
        )
    return kind


def _differences(channel: Channel, registry: ClassRegistry) -> Iterator[str]:
    """Yield one line for each field that differs between the bag and this configuration."""
    try:
        before = lockfile.read(channel.metadata.get("shmgen_layout", ""), "the bag")
        kind = Kind(registry.session_of(channel.type), channel.type)
    except Rejected:
        return
    for finding in compare(before, lockfile.read(kind.lock, "here"), "here"):
        if finding.changes:
            yield f"  {finding.diagnostic.message}"
            yield from (f"    {change.field}: {change.text}" for change in finding.changes)


def _depth(channel: Channel, topic: str, registry: ClassRegistry) -> int:
    """Return the depth with which to publish a channel of a bag.

    Prefer the depth of the existing region, then the recorded depth, then the depth in shmgen.toml, then 1.
    """
    try:
        with View(region_name(topic)) as view:
            return depth_of(view.header())
    except RegionMissing:
        pass
    if depth := channel.metadata.get("shmgen_depth"):
        return int(depth)
    return registry.depth_of(topic)


def _plain(text: str) -> list[list[str]]:
    """Return the type and name of each field in a definition, sorted, so that two definitions can be compared.

    The result omits comments, constants, defaults, bounds and package names.
    """
    lines = [line.partition("#")[0].split() for line in text.splitlines()]
    fields = [line for line in lines if len(line) >= 2 and "=" not in "".join(line[1:]) and line[0] != "MSG:"]
    return sorted([line[0].rpartition("/")[2].partition("<=")[0], line[1]] for line in fields)


def _indent(text: str) -> str:
    return "\n".join(f"    {line}" for line in text.splitlines() if line)
