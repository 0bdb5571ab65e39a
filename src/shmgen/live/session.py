"""Compute the definitions, layouts and classes of a configuration, each once."""

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
    """The definitions, layouts and classes of one configuration, each computed once.

    `name` is the name of the configuration in error messages, such as `shmgen.toml`.
    """

    def __init__(self, config: Config, name: str = "shmgen.toml", source_of: Session | None = None) -> None:
        """Create a session for `config`, whose name in error messages is `name`.

        If the configuration of the session `source_of` has the same `source`, reuse the definitions of `source_of`.
        """
        self.config = config
        self.name = name
        if source_of and source_of.config.source == config.source:
            self.library = source_of.library
        self._layouts: dict[tuple[str, ...], Layouts] = {}
        self._classes: dict[tuple[tuple[str, ...], str], Mapping[str, type[Message]]] = {}

    @cached_property
    def library(self) -> Library:
        """All message definitions of the configuration. Raises Rejected, as all methods do."""
        return pipeline.library(self.config)

    def schema(self, requests: Iterable[str]) -> Schema:
        """Return the definitions of the requested messages and of all messages that they contain."""
        return pipeline.read(self.config, requests, self.library)

    def layouts(self, requests: Iterable[str]) -> Layouts:
        """Return the layouts of the requested messages and of all messages that they contain."""
        key = tuple(requests)
        if key not in self._layouts:
            self._layouts[key] = pipeline.lay_out(self.config, key, self.library) if key else {}
        return self._layouts[key]

    def classes(self, requests: Iterable[str], overflow: str = "") -> Mapping[str, type[Message]]:
        """Return the Python classes of the requested messages and of all messages that they contain, by full name.

        `overflow`, if given, replaces the key `overflow` of [strings].
        """
        key = tuple(requests)
        overflow = overflow or self.config.types.overflow
        if (key, overflow) not in self._classes:
            types = self.config.types._replace(overflow=overflow)  # type: ignore[arg-type]
            layouts = {name: layout._replace(options=types) for name, layout in self.layouts(key).items()}
            self._classes[key, overflow] = _import_classes(self.config, layouts)
        return self._classes[key, overflow]

    def layout(self, request: str, part_of: str = "") -> Layout:
        """Return the layout of the message `request`. Raises ValueError if the request stands for several messages.

        `part_of` names the service or action to which the message belongs, if any. All messages of a service or action
        are laid out together.
        """
        layouts = self.layouts([part_of or request]).values()
        matches = [one for one in layouts if (str(one.name) == request if part_of else one.requested)]
        if len(matches) > 1:
            names = ", ".join(str(layout.name) for layout in matches[:10])
            raise ValueError(f"{request} has {len(matches)} messages, but a topic carries one; give one of {names}")
        return matches[0]

    def message(self, request: str, part_of: str = "") -> type[Message]:
        """Return the Python class of the message `request`. `part_of` names its service or action.

        Raises the errors of layout().
        """
        return self.classes([part_of or request])[str(self.layout(request, part_of).name)]


def _import_classes(config: Config, layouts: Layouts) -> dict[str, type[Message]]:
    """Return the Python classes for `layouts`: generate modules in a temporary folder and import them."""
    config = replace(config, targets=("python",), topics=(), services=(), actions=(), package=_PACKAGE)
    config = replace(config, distribution="", runtime="installed")
    texts = pipeline.render_layouts(config, layouts)
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
                del sys.path_importer_cache[place]  # otherwise the memory of a bridge grows with each reload
    items = [item for module in modules for item in vars(module).values()]
    kinds = [item for item in items if isinstance(item, type) and issubclass(item, Message) and item is not Message]
    return {kind._type_name_: kind for kind in kinds}
