"""Scenes: the ends that meet, the disturbances, and the conditions that must hold afterwards.

Settings are explained in search.c (p, c, s, b, ...), or in the source of the end that reads them: `told("every", 0)`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Scene:
    """A scene: the endpoints that meet, the disturbances, and what must hold afterwards.

    `sync` is the setting of shmgen.toml.
    """

    name: str
    settings: str
    ends: tuple[str, ...]
    sync: str = "lock"

    @property
    def arguments(self) -> list[str]:
        return [*self.settings.split(), *self.ends]


def _scene(name: str, settings: str, *ends: str, sync: str = "lock") -> Scene:
    return Scene(name, settings, ends, sync)


_C, _PLC = "writer n=3 every=100 stays=1 crash=1 stall=1", "plc_writer n=5 crash=1 stall=1"
"""The first writers of a topic, which may stall or die at any step."""
_THEN_C = "writer start=250 n=1 every=100 stays=1 tries=12 crash=1"
_THEN_PLC = "plc_writer start=250 every=250 n=7 crash=1"
"""The writers that take the topic over, and write one sample."""
_THIRD_C = "writer start=1800 n=1 every=100 stays=1 tries=30 crash=1"
_THIRD_PLC = "plc_writer start=1800 every=250 n=14 crash=1"


def _takeover(name: str, more: str, settings: str, samples: int, *others: str) -> Scene:
    """Return a scene with the takeover `name`, in which the second writer writes `samples` samples."""
    first, then = _TAKEOVERS[name]
    usual = 1 if then == _THEN_C else 7
    return _scene(f"{name}, {more}", settings, first, then.replace(f"n={usual}", f"n={usual + samples - 1}"), *others)


_TAKEOVERS = {
    "a PLC after C": (_C, _THEN_PLC),
    "C after a PLC": (_PLC, _THEN_C),
    "a PLC after a PLC": (_PLC, _THEN_PLC),
}
_LOOKS = "reader start=100 n=25 every=100"
_SERVED = "start=500 n=6 crash=1"

QUICK = [
    _scene("a writer and a reader", "p=2 c=1", "writer n=3 crash=1", "reader n=3 crash=1"),
    _scene("a writer and a reader of all", "p=1 c=1 depth=3", "writer n=6 crash=1", "reader n=4 next=1 crash=1"),
    _scene("a writer and a PLC that reads", "p=2 c=1", "writer n=3 crash=1", "plc_reader n=3 crash=1"),
    _scene("a PLC and a reader", "p=1 c=1", "plc_writer n=5 crash=1", "reader start=200 n=4 every=100 crash=1"),
    _scene("one waits", "p=2 b=1 ms=1000", "writer n=3", "waiter n=3"),
    _scene("one waits at a pace", "p=1 ms=1000", "writer n=2 every=25", "waiter n=2 all=1"),
    _scene("two wait", "p=1 ms=1000", "writer n=4 every=5", *["waiter n=4 all=1"] * 2),
    _scene("two want the lock", "p=3 c=1", "locker crash=1", "locker crash=1"),
    _scene("two write", "p=1 c=1", "writer n=2 crash=1", "writer n=2 crash=1", "reader n=2"),
    _scene("C after a PLC dies", "c=1 plc_wrote=1", "writer n=1 crash=1"),
    _scene("C after a PLC gives up", "plc_wrote=1", "writer n=1 cancel=1"),
    _scene("a PLC after C", "s=1 c=1", _C, _THEN_PLC),
    _scene("C after a PLC", "s=1 c=1", _PLC, _THEN_C),
    _scene("a PLC after a PLC", "s=1 c=1", _PLC, _THEN_PLC),
    _scene("the numbers wrap around", "p=1 c=1 c_wrote=1 number=0xFFFFFFFE depth=3", "writer n=6 crash=1",
           "reader n=5 next=1 crash=1"),
    _scene("a region comes to be", "p=1 c=1 opening=1 bare=1", "writer n=1 crash=1", "reader n=1 crash=1"),
]  # fmt: skip
"""The scenes of `make test`, which take some seconds together. The explorer must find no error in any scene."""

FULL = [
    # One writer.
    _scene("without a bound on pre-emptions", "p=90 c=1", "writer n=2 crash=1", "reader n=2 crash=1"),
    _scene("with store buffers", "p=2 c=1 b=2", "writer n=3 crash=1", "reader n=2 crash=1"),
    _scene("with stalls", "p=1 c=1 s=1", "writer n=3 crash=1 stall=1", "reader n=3 crash=1 stall=1"),
    _scene("two readers", "p=1 c=1", "writer n=3 crash=1", "reader n=3 crash=1", "reader n=3 crash=1"),
    _scene("who waits for the lock", "p=2 c=1 lock_ms=10", "writer n=2 crash=1", "reader n=2 crash=1"),
    _scene("a PLC and a PLC", "p=2 c=1", "plc_writer n=5 crash=1", "plc_reader n=5 every=100 crash=1"),
    _scene("a PLC and a reader of all", "p=1 c=1", "plc_writer n=10 crash=1",
           "reader start=200 n=4 every=300 next=1 crash=1"),
    _scene("a PLC with store buffers", "p=1 c=1 b=1", "plc_writer n=4 crash=1",
           "reader start=200 n=3 every=100 crash=1"),
    _scene("a PLC that reads, with store buffers", "p=1 c=1 b=1", "writer n=3 crash=1", "plc_reader n=3 crash=1"),
    _scene("blocks of an open PLC", "p=1 c=1", "block_writer n=6 crash=1", "block_reader n=6 crash=1"),
    # The lock.
    _scene("three want the lock", "p=1 c=1", *["locker crash=1"] * 3),
    _scene("the lock is held for long", "p=1", *["locker n=3 hold=700"] * 3),
    _scene("who holds the lock stands still", "p=1 c=1 s=1", *["locker crash=1 stall=1"] * 2),
    _scene("who stands still in front of the post", "s=1 one_token=1", _C, _THEN_PLC),
    _scene("a PLC meets a lock left behind", "c=1 sends=1", "locker n=1 crash=1", "plc_writer n=14 every=200", _LOOKS),
    # The wake-up.
    _scene("a PLC wakes one who waits", "p=1", "plc_writer n=8 every=25", "waiter n=3 all=1"),
    _scene("who waits dies", "p=1 c=1 b=1 ms=1000", "writer n=2 every=5", "waiter n=2 crash=1"),
    _scene("one waits, with store buffers", "p=2 b=3 ms=1000", "writer n=2", "waiter n=2"),
    _scene("one waits, and the writer has no lock", "p=1 b=2 ms=1000", "writer n=2", "waiter n=2", "locker n=1 hold=3"),
    _scene("two wait for a burst", "p=2 ms=1000", "writer n=2", *["waiter n=2"] * 2),
    _scene("two wait, one dies", "p=1 c=1 ms=1000", "writer n=3 every=5", "waiter n=3", "waiter n=3 crash=1"),
    _scene("two wait, one works", "p=1 ms=1000", "writer n=4 every=5", "waiter n=4", "waiter n=4 busy=5"),
    _scene("two wait, one leaves", "p=2 ms=1000", "writer n=4 every=5", "waiter n=4 all=1", "waiter n=4 leave=2"),
    _scene("three wait", "p=1 ms=1000", "writer n=3 every=5", *["waiter n=3 all=1"] * 3),
    _scene("two wait for a PLC", "p=1 ms=1000", "plc_writer n=3", *["waiter n=2 all=1"] * 2),
    _scene("two wait for a PLC with a short cycle", "p=1 ms=1000", "plc_writer n=8 every=25",
           *["waiter n=3 all=1"] * 2),
    # Numbers.
    _scene("a PLC's numbers wrap around", "p=1 plc_wrote=1 number=0xFFFFFFFE", "plc_writer n=16",
           "reader start=1300 n=4 every=100"),
    _scene("numbers wrap around for a PLC", "p=1 c=1 c_wrote=1 number=0xFFFFFFFE depth=3", "writer n=6 crash=1",
           "plc_reader n=5 next=1 crash=1"),
    # Opening.
    _scene("a region comes to be by a PLC", "p=1 c=1 opening=1 bare=1", "plc_writer n=4 crash=1", "reader n=4 crash=1"),
    _scene("three make a region", "p=1 c=1 opening=1 bare=1", "writer n=1 crash=1", "plc_reader n=4 every=100",
           "reader n=1"),
    # A layout changes.
    _scene("two layouts, to write", "p=1 c=1 opening=1", "holder writes=1 crash=1", "holder writes=1 depth=3 crash=1"),
    _scene("two layouts, to read", "p=1 c=1 opening=1 kept=1", "holder crash=1", "holder depth=3 crash=1"),
    _scene("two layouts, to write and to read", "p=1 c=1 opening=1", "holder writes=1 depth=3 crash=1",
           "holder crash=1"),
    _scene("two layouts and a PLC", "p=1 c=1 opening=1", "holder writes=1 depth=3 crash=1",
           "plc_writer n=10 every=200 crash=1"),
    _scene("three that replace a region", "p=1 c=1 opening=1", *["holder writes=1 depth=3 crash=1"] * 2,
           "holder depth=3"),
    _scene("a PLC reads on in the next region", "p=1 opening=1", "plc_reader n=40 every=100 sees=1",
           "holder writes=1 depth=3", "writer start=1500 n=2 every=600"),
    # Without the lock.
    _scene("sequence", "p=2 c=1 b=1 sequence=1", "writer n=3 crash=1", "reader n=3 crash=1", sync="sequence"),
    _scene("sequence and a PLC", "p=1 c=1 sequence=1", "plc_writer n=5 crash=1",
           "reader start=200 n=4 every=100 crash=1", sync="sequence"),
    _scene("sequence and a PLC that reads", "p=1 c=1 sequence=1", "writer n=3 crash=1", "plc_reader n=3 crash=1",
           sync="sequence"),
    # Takeovers without a stalled writer.
    _scene("C after C", "p=1 c=1", "writer n=2 crash=1", "writer n=2 tries=3 crash=1", "reader n=2"),
    _scene("C after a PLC that lives", "p=1", "plc_writer n=6", _THEN_C),
    _scene("a PLC after C that lives", "p=1", "writer n=6 every=100 stays=1", "plc_writer start=50 every=50 n=8"),
    # Takeovers from a writer that stalls or dies at any step, by a writer that may die.
    *(_takeover(name, "three samples", "s=1 c=1", 3) for name in _TAKEOVERS),
    *(_takeover(name, "round the lane", "s=1 c=1", 6) for name in _TAKEOVERS),
    *(_takeover(name, "interleaved", "p=1 s=1 c=1", 2) for name in _TAKEOVERS),
    *(_takeover(name, "beside a reader", "p=1 s=1", 1, _LOOKS) for name in _TAKEOVERS),
    *(_takeover(name, "beside a PLC that reads", "p=1 s=1", 1, "plc_reader n=45 every=100 sees=1")
      for name in _TAKEOVERS),
    _scene("C after a PLC after C", "s=1 c=1", _C, _THEN_PLC + " stall=1", _THIRD_C),
    _scene("C after C after a PLC", "s=1 c=1", _PLC, _THEN_C, _THIRD_C),
    _scene("a PLC after C after a PLC", "s=1 c=1", _PLC, _THEN_C + " stall=1", _THIRD_PLC),
    _scene("three writers, two die", "c=2", _C, _THEN_PLC, _THIRD_C),
    *(_takeover(name, "across the wrap", "s=1 c=1 c_wrote=1 number=0xFFFFFFFD", 3) for name in _TAKEOVERS),
    # A PLC and C, or two PLCs, that both live or start at the same time.
    _scene("a PLC takes over and sends", "c_wrote=1", "plc_writer every=250 n=9 sends=1"),
    _scene("a PLC watches C that lives", "p=1", "writer n=16 every=100 stays=1", "plc_writer start=50 every=200 n=9"),
    _scene("C watches a PLC that lives", "p=1", "plc_writer n=16", "writer start=50 n=1 every=100 stays=1"),
    _scene("two PLCs begin", "p=1", *["plc_writer every=50 n=6"] * 2, "reader start=100 n=8 every=50"),
    _scene("a PLC gives way to C that dies", "p=1 c=1", "plc_writer every=100 n=22 sends=1",
           "writer start=100 n=1 crash=1"),
    _scene("a PLC waits for a lock that is held", "p=1", "locker n=2 hold=700", "plc_writer n=20 every=50"),
    # Services.
    *(_scene(f"a call from {client} to {server}", "p=1 c=1 service=1 answers=1", f"{server}_server n=12 crash=1",
             f"{client}_client {_SERVED}") for client in ("plc", "block") for server in ("plc", "block")),
    _scene("clients change over", "s=1 service=1", "block_server n=6 stall=1", "plc_client start=500 n=4 patience=300",
           "block_client start=700 n=20 patience=300"),
    _scene("a client comes while one asks", "s=1 service=1", "plc_server n=6 stall=1",
           "block_client start=500 n=4 patience=300 stall=1", "plc_client start=700 n=20 patience=300"),
    *(_scene(f"{client} begins a fresh region while {server} works", "s=1 service=1", f"{server}_server n=14 stall=1",
             "block_client start=500 n=5 patience=300", f"{client}_client start=1000 n=28 patience=2800 removes=1")
      for client in ("plc", "block") for server in ("plc", "block")),
]  # fmt: skip
"""The scenes that `make test-all` adds. They take a minute together with the quick scenes."""

LARGE = [
    _scene("two readers, larger", "p=2 c=1", "writer n=3 crash=1", "reader n=3 crash=1", "reader n=2 crash=1"),
    _scene("two write, larger", "p=2 c=1", "writer n=2 crash=1", "writer n=2 crash=1", "reader n=2"),
    _scene("three want the lock, larger", "p=2 c=1", *["locker crash=1"] * 3),
    _scene("with store buffers, larger", "p=3 c=1 b=2", "writer n=3 crash=1", "reader n=3 crash=1"),
    _scene("a region comes to be, larger", "p=2 c=1 opening=1 bare=1", "writer n=1 crash=1", "plc_writer n=4 crash=1"),
    _scene("one waits, larger", "p=3 b=2 ms=1000", "writer n=3", "waiter n=3"),
    _scene("two wait for a burst, larger", "p=3 ms=1000", "writer n=2", *["waiter n=2"] * 2),
    _scene("two wait, with store buffers", "p=2 b=2 ms=1000", "writer n=2", *["waiter n=2"] * 2),
    _scene("two wait for a PLC, larger", "p=1 ms=4000", "plc_writer n=6", *["waiter n=3 all=1"] * 2),
    _scene("three wait for a burst", "p=2 ms=1000", "writer n=2", *["waiter n=2"] * 3),
    *(_takeover(name, "with store buffers", "p=1 s=1 c=1 b=1", 1) for name in _TAKEOVERS),
    *(_takeover(name, "beside a reader of all", "p=1 s=1", 2, _LOOKS + " next=1") for name in _TAKEOVERS),
    _takeover("a PLC after a PLC", "twice interleaved", "p=2 s=1", 1, _LOOKS),
    _scene("servers change over", "s=1 service=1", "plc_server n=6 stall=1", "block_server start=600 n=20",
           "plc_client start=500 n=26 patience=300"),
]  # fmt: skip
"""The scenes that only `make explore` adds."""

SCENES = {scene.name: scene for scene in [*QUICK, *FULL, *LARGE]}
