"""Scenes: which ends meet, what may happen to them, and what then has to hold."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Scene:
    """`settings` and `ends` are the words of search.c and of the ends; `sync` is that of shmgen.toml."""

    name: str
    settings: str
    ends: tuple[str, ...]
    sync: str = "lock"

    @property
    def arguments(self) -> list[str]:
        return [*self.settings.split(), *self.ends]


@dataclass(frozen=True)
class Known:
    """What today's code is known to do wrong: how the first word of the verdict reads, and why it is not mended yet."""

    scene: Scene
    found: str
    why: str


def _scene(name: str, settings: str, *ends: str, sync: str = "lock") -> Scene:
    return Scene(name, settings, ends, sync)


QUICK = [
    # One writer and what goes on beside it.
    _scene("a writer and a reader", "p=2 c=1", "writer n=3 crash=1", "reader n=3 crash=1"),
    _scene("a writer and a reader of all", "p=2 c=1 depth=3", "writer n=4 crash=1", "reader n=3 next=1 crash=1"),
    _scene("one waits", "p=2 b=1 ms=1000", "writer n=3", "waiter n=3"),
    _scene("one of two holds the lock and dies", "p=3 c=1", "locker crash=1", "locker crash=1"),
    _scene("a PLC writes", "p=1 c=1", "plc_writer n=3 crash=1", "reader start=100 n=4 every=100 crash=1"),
    _scene("a PLC reads", "p=1 c=1", "writer n=3 crash=1", "plc_reader n=3 crash=1"),
]
"""Some seconds: `make test`. Nothing may be found in these and the next."""

FULL: list[Scene] = []
"""A minute: `make test-all`."""

LARGE: list[Scene] = []
"""`make explore` goes through these as well."""

_SEAMS = "the protocol at its seams is to be mended as a whole"
KNOWN = [
    Known(_scene("two wait", "p=2 ms=1000", *("writer n=4 every=5", *["waiter n=4 bound_us=1000 all=1"] * 2)), "LATE",
          f"two readers that wait share one event: {_SEAMS}"),
]
"""Found today. When one is mended it moves up."""

SCENES = {scene.name: scene for scene in [*QUICK, *FULL, *LARGE, *(known.scene for known in KNOWN)]}
