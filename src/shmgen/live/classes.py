"""Turns the type and digest in a region's header into the Python class that can decode it."""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from shmgen import pipeline
from shmgen.config import Config
from shmgen.diagnostics import Rejected
from shmgen.live import locked
from shmgen.model import Layout
from shmgen.runtime import Message, Publisher, Subscriber
from shmgen.runtime.errors import LayoutMismatch

_PACKAGE = "shmgen_live"


@dataclass(frozen=True, slots=True)
class Workshop:
    """What classes are made from: the configuration in force, called `name`, and a layout.lock to fall back on."""

    config: Config
    name: str
    lock: Path | None

    def message(self, request: str, digest: int | None = None) -> type[Message]:
        """The class of `geometry_msgs/Pose`, with that digest if one is given.

        Raises Rejected for a type that is not to be found or laid out, and LayoutMismatch, with every digest
        found, where none is the one wanted.
        """
        tried: list[locked.Known] = []
        rejected: Rejected | None = None
        for config, origin in self._configurations():
            try:
                layout = _one(config, request)
            except Rejected as error:
                rejected = rejected or error
                continue
            if digest in (None, layout.digest):
                return generated(config, [request])[str(layout.name)]
            tried.append(locked.Known(layout.digest, layout.size, origin))
        if tried:
            raise _mismatch(request, digest, tried)
        assert rejected is not None
        raise rejected

    def known(self) -> dict[str, locked.Known]:
        """The layouts of all messages that shmgen.toml and layout.lock name; the former counts. Raises Rejected."""
        lock = locked.layouts(locked.read(self.lock), str(self.lock)) if self.lock else {}
        named = dict.fromkeys([*self.config.messages, *self.config.types_used])
        layouts = pipeline.lay_out(self.config, named) if named else {}
        return lock | {
            str(layout.name): locked.Known(layout.digest, layout.size, self.name) for layout in layouts.values()
        }

    def _configurations(self) -> Iterator[tuple[Config, str]]:
        yield self.config, self.name
        if self.lock and (lock := locked.read(self.lock)):
            yield locked.settings(lock, self.config), str(self.lock)


def generated(config: Config, requests: Iterable[str]) -> dict[str, type[Message]]:
    """The classes of `requests` and all they hold, by `geometry_msgs/msg/Pose`. Raises Rejected.

    Generates the package into a folder that lasts as long as it takes to import it.
    """
    texts = pipeline.generate(
        replace(config, targets=("python",), topics=(), services=(), actions=(), package=_PACKAGE), requests
    )
    with tempfile.TemporaryDirectory(prefix="shmgen-") as folder:
        for path, text in texts.items():
            file = Path(folder, path)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        sys.path.insert(0, f"{folder}/python")
        try:
            importlib.invalidate_caches()
            packages = [Path(path).parent for path in texts if path.endswith("/__init__.py")]
            names = [".".join(package.parts[1:]) for package in packages]
            modules = [importlib.import_module(name) for name in names]
        finally:
            sys.path.remove(f"{folder}/python")
            for name in [name for name in sys.modules if name.partition(".")[0] == _PACKAGE]:
                del sys.modules[name]
    items = [item for module in modules for item in vars(module).values()]
    kinds = [item for item in items if isinstance(item, type) and issubclass(item, Message) and item is not Message]
    return {kind._type_name_: kind for kind in kinds}


def subscriber(kind: type[Message], topic: str, depth: int) -> Subscriber[Message]:
    """Opens the topic's region for reading. Raises what a Subscriber raises."""
    made: type[Subscriber[Message]] = type("LiveSubscriber", (Subscriber,), {"message_type": kind})
    return made(topic, depth=depth)


def publisher(kind: type[Message], topic: str, depth: int) -> Publisher[Message]:
    """Opens the topic's region for writing. Raises what a Publisher raises."""
    made: type[Publisher[Message]] = type("LivePublisher", (Publisher,), {"message_type": kind})
    return made(topic, depth=depth)


def _one(config: Config, request: str) -> Layout:
    found = [layout for layout in pipeline.lay_out(config, [request]).values() if layout.requested]
    if len(found) > 1:
        names = ", ".join(str(layout.name) for layout in found[:10])
        raise ValueError(f"{request} is {len(found)} messages, and a topic carries one: {names}")
    return found[0]


def _mismatch(request: str, digest: int | None, tried: list[locked.Known]) -> LayoutMismatch:
    here = "\n".join(f"  here:  {known}" for known in tried)
    return LayoutMismatch(
        f"{request} has another layout in the region than here\n"
        f"  there: digest 16#{digest:016X}\n{here}\n"
        "  hint: call this in the folder whose shmgen.toml the region was generated from, or name that file with -c "
        "and the folders of your own messages with -I"
    )
