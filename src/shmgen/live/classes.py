"""The Python class that can decode a region, by the type and digest in its header."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from shmgen.config import Config
from shmgen.core.diagnostics import Diagnostic, Rejected
from shmgen.live import config_of_lock
from shmgen.live.regions import View, depth_of, sound, topic_of
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
)
from shmgen.runtime.errors import LayoutMismatch


class ClassRegistry:
    """What classes are made from: the configuration in force, and a layout.lock to fall back on."""

    def __init__(self, session: Session, lock: Path | None) -> None:
        self.session = session
        self.lock = lock

    @property
    def config(self) -> Config:
        return self.session.config

    def depth_of(self, topic: str) -> int:
        """What shmgen.toml says, or 1."""
        asked = topic.lstrip("/")
        return next((entry.depth for entry in self.config.topics if entry.topic.lstrip("/") == asked), 1)

    def message(self, request: str, digest: int | None = None, part_of: str = "") -> type[Message]:
        """The class of `geometry_msgs/Pose`, with that digest if one is given; `part_of` as in Session.

        Raises as session_of().
        """
        return self.session_of(request, digest, part_of).message(request, part_of)

    def session_of(self, request: str, digest: int | None = None, part_of: str = "") -> Session:
        """The one that lays the message out with that digest.

        Raises Rejected for a type that is not to be found or laid out, and LayoutMismatch, with every digest
        found, where none is the one wanted.
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
        """The layouts of all messages that shmgen.toml and layout.lock name; the former counts. Raises Rejected.

        And what is wrong with the lock, of which nothing is taken then.
        """
        wrong: tuple[Diagnostic, ...] = ()
        try:
            lock = config_of_lock.layouts(config_of_lock.read(self.lock), str(self.lock)) if self.lock else {}
        except Rejected as damaged:
            lock, wrong = {}, damaged.diagnostics
        layouts = self.session.layouts(dict.fromkeys([*self.config.messages, *self.config.types_used]))
        name = self.session.name
        ours = {str(layout.name): config_of_lock.Known(layout.digest, layout.size, name) for layout in layouts.values()}
        return lock | ours, wrong

    def _sessions(self) -> Iterator[Session]:
        yield self.session
        if self._former:
            yield self._former

    @cached_property
    def _former(self) -> Session | None:
        lock = config_of_lock.read(self.lock) if self.lock else {}
        return Session(config_of_lock.settings(lock, self.config), str(self.lock), self.session) if lock else None


def subscriber(
    kind: type[Message], topic: str, depth: int, *, passive: bool = False, history: bool = False
) -> Subscriber[Message]:
    """Opens the topic's region for reading. Raises what a Subscriber raises."""
    made: type[Subscriber[Message]] = type("LiveSubscriber", (Subscriber,), {"message_type": kind})
    return made(topic, depth=depth, passive=passive, history=history)


def watcher(
    view: View, kind: type[Message] | None = None, *, passive: bool = True, history: bool = False
) -> Subscriber[Message]:
    """Opens the region in `view`; without `kind` only for numbers and stamps, its messages have no fields.

    Raises RegionUnusable for a damaged one, and what a Subscriber raises.
    """
    header = sound(view)
    kind = kind or _without_fields(header)
    return subscriber(kind, topic_of(view.name), depth_of(header), passive=passive, history=history)


def publisher(kind: type[Message], topic: str, depth: int) -> Publisher[Message]:
    """Opens the topic's region for writing. Raises what a Publisher raises."""
    made: type[Publisher[Message]] = type("LivePublisher", (Publisher,), {"message_type": kind})
    return made(topic, depth=depth)


def client(request: type[Message], reply: type[Message]) -> type[ServiceClient[Any, Any]]:
    """The class that calls a service of these."""
    ends = {
        "request_publisher": type("LivePublisher", (Publisher,), {"message_type": request}),
        "reply_subscriber": type("LiveSubscriber", (Subscriber,), {"message_type": reply}),
    }
    return type("LiveClient", (ServiceClient,), ends)


def server(request: type[Message], reply: type[Message]) -> type[ServiceServer[Any]]:
    """The class that serves it."""
    ends = {
        "request_subscriber": type("LiveSubscriber", (Subscriber,), {"message_type": request}),
        "reply_publisher": type("LivePublisher", (Publisher,), {"message_type": reply}),
    }
    return type("LiveServer", (ServiceServer,), ends)


def action_client(kinds: Mapping[str, type[Message]]) -> type[ActionClient[Any, Any, Any]]:
    """The class that sends goals of the action that has these parts, by their endings."""
    ends = {
        "command_publisher": type("LivePublisher", (Publisher,), {"message_type": kinds["_Command"]}),
        "progress_subscriber": type("LiveSubscriber", (Subscriber,), {"message_type": kinds["_Progress"]}),
        "outcome_subscriber": type("LiveSubscriber", (Subscriber,), {"message_type": kinds["_Outcome"]}),
    }
    return type("LiveActionClient", (ActionClient,), ends)


def action_server(kinds: Mapping[str, type[Message]]) -> type[ActionServer[Any]]:
    """The class that serves it."""
    ends = {
        "command_subscriber": type("LiveSubscriber", (Subscriber,), {"message_type": kinds["_Command"]}),
        "progress_publisher": type("LivePublisher", (Publisher,), {"message_type": kinds["_Progress"]}),
        "outcome_publisher": type("LivePublisher", (Publisher,), {"message_type": kinds["_Outcome"]}),
    }
    return type("LiveActionServer", (ActionServer,), ends)


def _without_fields(header: Header) -> type[Message]:
    """One of the same size. What is in it is nothing that a lock would have to order."""
    about = {"_type_name_": header.type_name, "_digest_": header.digest, "_regions_": RegionOptions(sync="sequence")}
    return type("Opaque", (Message,), {"_fields_": [("bytes", ctypes.c_uint8 * header.payload_size)], **about})


def _mismatch(request: str, digest: int | None, tried: list[config_of_lock.Known]) -> LayoutMismatch:
    here = "\n".join(f"  here:  {known}" for known in tried)
    return LayoutMismatch(
        f"{request} has another layout in the region than here\n"
        f"  there: digest 16#{digest:016X}\n{here}\n"
        "  hint: call this in the folder whose shmgen.toml the region was generated from, or name that file with -c "
        "and the folders of your own messages with -I"
    )
