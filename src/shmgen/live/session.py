"""Definitions, layouts and classes of a configuration, each made once and then at hand."""

from __future__ import annotations

import importlib
import sys
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path

from shmgen.config import Config
from shmgen.core.model import Layout, Layouts, Schema
from shmgen.definitions import Library
from shmgen.generator import pipeline
from shmgen.runtime import Message

_PACKAGE = "shmgen_live"


class Session:
    """One configuration, `name` to its user, as long as a bridge or a tool runs; nothing of it is made twice."""

    def __init__(self, config: Config, name: str = "shmgen.toml", source_of: Session | None = None) -> None:
        """`source_of` is a session to share the definitions with, where both configurations have the same `source`."""
        self.config = config
        self.name = name
        if source_of and source_of.config.source == config.source:
            self.library = source_of.library
        self._layouts: dict[tuple[str, ...], Layouts] = {}
        self._classes: dict[tuple[tuple[str, ...], str], Mapping[str, type[Message]]] = {}

    @cached_property
    def library(self) -> Library:
        """The definitions in reach. Raises Rejected, and so do all the others."""
        return pipeline.library(self.config)

    def schema(self, requests: Iterable[str]) -> Schema:
        """The definitions as they are written, with all they hold."""
        return pipeline.read(self.config, requests, self.library)

    def layouts(self, requests: Iterable[str]) -> Layouts:
        """The same laid out."""
        key = tuple(requests)
        if key not in self._layouts:
            self._layouts[key] = pipeline.lay_out(self.config, key, self.library) if key else {}
        return self._layouts[key]

    def classes(self, requests: Iterable[str], overflow: str = "") -> Mapping[str, type[Message]]:
        """The same as classes, by `geometry_msgs/msg/Pose`; `overflow` is used instead of that under [strings]."""
        key = tuple(requests)
        overflow = overflow or self.config.types.overflow
        if (key, overflow) not in self._classes:
            types = replace(self.config.types, overflow=overflow)  # type: ignore[arg-type]
            layouts = {name: replace(layout, options=types) for name, layout in self.layouts(key).items()}
            self._classes[key, overflow] = _imported(self.config, layouts)
        return self._classes[key, overflow]

    def layout(self, request: str, part_of: str = "") -> Layout:
        """Of one message; `part_of` names its service, to lay out all parts at once. ValueError: it is several."""
        layouts = self.layouts([part_of or request]).values()
        found = [one for one in layouts if (str(one.name) == request if part_of else one.requested)]
        if len(found) > 1:
            names = ", ".join(str(layout.name) for layout in found[:10])
            raise ValueError(f"{request} is {len(found)} messages, and a topic carries one: {names}")
        return found[0]

    def message(self, request: str, part_of: str = "") -> type[Message]:
        """The class of one message. Raises as layout()."""
        return self.classes([part_of or request])[str(self.layout(request, part_of).name)]


def _imported(config: Config, layouts: Layouts) -> dict[str, type[Message]]:
    """The classes of generated modules, from a folder that lasts as long as it takes to import them."""
    config = replace(config, targets=("python",), topics=(), services=(), actions=(), package=_PACKAGE)
    config = replace(config, distribution="", runtime="installed")
    texts = pipeline.printed(config, layouts)
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
            for place in [place for place in sys.path_importer_cache if place.startswith(folder)]:
                del sys.path_importer_cache[place]  # else a bridge grows with each shmgen.toml that it reads
    items = [item for module in modules for item in vars(module).values()]
    kinds = [item for item in items if isinstance(item, type) and issubclass(item, Message) and item is not Message]
    return {kind._type_name_: kind for kind in kinds}
