"""Fill messages with random values the way the bridge does: from the bytes of a region into the backend's message."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from shmgen.config import Config
from shmgen.config.entries import Bound, Bounds
from shmgen.core.diagnostics import Span
from shmgen.core.model import Layouts, TypeName
from shmgen.generator import pipeline
from shmgen.live.session import Session
from shmgen.runtime import Message

from ..support.schemas import random_message


class Values(NamedTuple):
    """Layouts with every sequence bounded to 3, and their classes by name, such as `geometry_msgs/msg/Pose`."""

    layouts: Layouts
    kinds: dict[str, type[Message]]

    def fill(self, name: TypeName, message: Any, seed: object) -> Any:
        """Fill every field of the empty `message` with a random value, and return the message."""
        layout, kind = self.layouts[name], self.kinds[str(name)]
        sample = kind._from_object(random_message(layout, self.layouts, random.Random(str(seed))))
        kind._decode(bytes(sample), message)
        return message


def values(requests: Iterable[str]) -> Values:
    requests = list(requests)
    config = bounded(requests)
    session = Session(config)
    return Values(session.layouts(requests), session.classes(requests))


def bounded(requests: Iterable[str]) -> Config:
    """Return a configuration that bounds every sequence of the needed packages to 3."""
    plain = Config(Path.cwd())
    packages = {message.name.package for message in pipeline.read(plain, requests).messages}
    bound = Bound(3, Span("shmgen.toml"))
    return dataclasses.replace(plain, bounds=Bounds({}, dict.fromkeys(packages, bound)), package="shm_dds")
