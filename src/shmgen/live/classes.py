"""Make Python classes for live regions, from the type name and the digest in the header of a region."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from shmgen.config import Config
from shmgen.core.diagnostics import Diagnostic, Rejected
from shmgen.drift.lockfile import Lock
from shmgen.live import config_of_lock
from shmgen.live.regions import View, depth_of, live, sound, topic_of
from shmgen.live.session import Session
from shmgen.runtime import (
    ActionClient,
    ActionServer,
    Header,
    Message,
    Publisher,
    RegionOptions,
    ServiceClient,
    ServiceServer,
    Subscriber,
    region_name,
)
from shmgen.runtime.errors import LayoutMismatch, RegionMissing, ShmError
from shmgen.runtime.region.resource import CallEnd

C = TypeVar("C", bound=CallEnd)


class ClassRegistry:
    """Finds or makes the Python class for the name and the digest of a message.

    The layout comes from the current configuration, or from layout.lock if only layout.lock has the digest.
    """

    def __init__(self, session: Session, lock: Path | None) -> None:
        self.session = session
        self.lock = lock

    @property
    def config(self) -> Config:
        return self.session.config

    def depth_of(self, topic: str) -> int:
        """Return the depth of a topic in shmgen.toml, or 1 if shmgen.toml does not list the topic."""
        bare = topic.lstrip("/")
        return next((entry.depth for entry in self.config.topics if entry.topic.lstrip("/") == bare), 1)

    def message(self, request: str, digest: int | None = None, part_of: str = "") -> type[Message]:
        """Return the class of the message `request`, such as `geometry_msgs/Pose`, whose layout has this digest.

        If `digest` is None, any layout matches. `part_of` names the service or action that contains the message. Raises
        the errors of session_of().
        """
        return self.session_of(request, digest, part_of).message(request, part_of)

    def message_of_topic(self, topic: str, request: str, part_of: str = "") -> tuple[type[Message], int]:
        """Return the class of the message `request` for a topic, and the depth with which to open the topic.

        If the topic has a region with messages of this type, the layout and the depth are those of the region.
        Otherwise, both come from shmgen.toml. `part_of` and the errors are those of message().
        """
        with suppress(RegionMissing), View(region_name(topic)) as view:
            header = view.header()
            package, _, bare = header.type_name.partition("/")
            if request in (header.type_name, f"{package}/{bare.rpartition('/')[2]}"):
                return self.message(request, header.digest, part_of), depth_of(header)
        return self.message(request, part_of=part_of), self.depth_of(topic)

    def session_of(self, request: str, digest: int | None = None, part_of: str = "") -> Session:
        """Return the session (the layouts of one configuration) in which the message `request` has this digest.

        If `digest` is None, any digest matches. `part_of` names the service or action that contains the message. Raises
        Rejected if the type is unknown or has no layout. If no layout has this digest, raises LayoutMismatch, which
        lists all known digests.
        """
        tried: list[config_of_lock.Known] = []
        rejected: Rejected | None = None
        for session in self._sessions():
            try:
                layout = session.layout(request, part_of)
            except Rejected as error:
                rejected = rejected or error
                continue
            if digest in (None, layout.digest):
                return session
            tried.append(config_of_lock.Known(layout.digest, layout.size, session.name))
        if tried:
            raise _mismatch(request, digest, tried)
        assert rejected is not None
        raise rejected

    def known(self) -> tuple[dict[str, config_of_lock.Known], tuple[Diagnostic, ...]]:
        """Return the layouts of all messages that shmgen.toml and layout.lock name, by message name.

        If both files name a message, its layout comes from shmgen.toml. A damaged layout.lock is ignored, and the
        second value then contains its diagnostics. Raises Rejected if a message in shmgen.toml has errors.
        """
        recorded: dict[str, config_of_lock.Known] = {}
        wrong: tuple[Diagnostic, ...] = ()
        try:
            if lock := self._read_lock():
                recorded = config_of_lock.layouts(lock, str(self.lock))
        except Rejected as damaged:
            wrong = damaged.diagnostics
        layouts = self.session.layouts(dict.fromkeys([*self.config.messages, *self.config.types_used]))
        name = self.session.name
        ours = {str(layout.name): config_of_lock.Known(layout.digest, layout.size, name) for layout in layouts.values()}
        return recorded | ours, wrong

    def find(self, digest: int) -> tuple[Session, str] | None:
        """Return the name of the message whose layout has this digest, and the session with this layout, or None.

        Raises Rejected if the definitions of the configuration cannot be read, or its messages have no layout.
        """
        for name in dict.fromkeys(self._likely(digest)):
            with suppress(Rejected, ShmError, ValueError):
                return self.session_of(name, digest), name
        return None

    def _likely(self, digest: int) -> Iterator[str]:
        """Yield names of messages for a search by digest, the most likely first.

        First come messages of live regions and known layouts with this digest, then all other messages.
        """
        for region in live():
            with suppress(ShmError, OSError), View(region) as view:
                header = view.header()
                if header.digest == digest:
                    yield header.type_name
        layouts, _ = self.known()
        yield from (name for name, known in layouts.items() if known.digest == digest)
        yield from map(str, self.session.library.known())

    def _sessions(self) -> Iterator[Session]:
        yield self.session
        if self._former:
            yield self._former

    @cached_property
    def _former(self) -> Session | None:
        lock = self._read_lock()
        return Session(config_of_lock.settings(lock, self.config), str(self.lock), self.session) if lock else None

    def _read_lock(self) -> Lock | None:
        return config_of_lock.read(self.lock) if self.lock else None


def subscriber(
    kind: type[Message],
    topic: str,
    depth: int,
    *,
    passive: bool = False,
    history: bool = False,
    reopen: bool = True,
) -> Subscriber[Message]:
    """Open the region of a topic for reading messages of the class `kind`.

    The other parameters and the errors are those of Subscriber.
    """
    end: type[Subscriber[Message]] = type("LiveSubscriber", (Subscriber,), {"message_type": kind})
    return end(topic, depth=depth, passive=passive, history=history, reopen=reopen)


def watcher(
    view: View, kind: type[Message] | None = None, *, passive: bool = True, history: bool = False
) -> Subscriber[Message]:
    """Open the region of `view` for reading messages of the class `kind`. Without `kind`, a message has no fields.

    `passive` and `history` are those of Subscriber. Raises RegionUnusable if the region is damaged, and the errors of
    Subscriber.
    """
    header = sound(view)
    kind = kind or _without_fields(header)
    return subscriber(kind, topic_of(view.name), depth_of(header), passive=passive, history=history, reopen=False)


def publisher(kind: type[Message], topic: str, depth: int) -> Publisher[Message]:
    """Open the region of a topic for writing messages of the class `kind`. Raises the errors of Publisher."""
    end: type[Publisher[Message]] = type("LivePublisher", (Publisher,), {"message_type": kind})
    return end(topic, depth=depth)


_ENDS = {
    ServiceClient: ("request_publisher", "reply_subscriber"),
    ServiceServer: ("request_subscriber", "reply_publisher"),
    ActionClient: ("command_publisher", "progress_subscriber", "outcome_subscriber"),
    ActionServer: ("command_subscriber", "progress_publisher", "outcome_publisher"),
}
"""The attributes of each class that contain the classes of its publishers and subscribers."""


def call_class(base: type[C], kinds: Mapping[str, type[Message]]) -> type[C]:
    """Make a subclass of `base`, a client or server of the runtime, for one service or action.

    `kinds` maps the endings of its messages, such as "_Command", to their classes.
    """
    ends: dict[str, type] = {}
    for name in _ENDS[base]:
        part, _, role = name.partition("_")
        parent = Publisher if role == "publisher" else Subscriber
        ends[name] = type(f"Live{parent.__name__}", (parent,), {"message_type": kinds[f"_{part.capitalize()}"]})
    return type(f"Live{base.__name__}", (base,), ends)


def _without_fields(header: Header) -> type[Message]:
    """Make a message class for a region of unknown layout. The only field, `bytes`, contains the whole payload.

    Reading such a message takes no lock.
    """
    about = {"_type_name_": header.type_name, "_digest_": header.digest, "_regions_": RegionOptions(sync="sequence")}
    return type("Opaque", (Message,), {"_fields_": [("bytes", ctypes.c_uint8 * header.payload_size)], **about})


def _mismatch(request: str, digest: int | None, tried: list[config_of_lock.Known]) -> LayoutMismatch:
    here = "\n".join(f"  here:   {known}" for known in tried)
    return LayoutMismatch(
        f"the region has another layout of {request} than this folder\n"
        f"  region: digest 16#{digest:016X}\n{here}\n"
        "  hint: run this in the folder whose shmgen.toml the other program was generated from, or give that file "
        "with -c, and the folders of your own messages with -I"
    )
