"""Scenes: the endpoints of one region, the disturbances, and the conditions that must hold afterwards.

search.c explains the settings p, c, s and b. With `crash=1` or `stall=1`, an endpoint may crash or stall. The source of
each endpoint explains its other settings. In names, "C" is a C program, and "PLC" is a PLC with CODESYS.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Scene:
    """A scene: its endpoints, each with settings, and its own settings. `sync` is the setting of shmgen.toml."""

    name: str
    settings: str
    endpoints: tuple[str, ...]
    sync: str = "lock"

    @property
    def arguments(self) -> list[str]:
        return [*self.settings.split(), *self.endpoints]


def _scene(name: str, settings: str, *endpoints: str, sync: str = "lock") -> Scene:
    return Scene(name, settings, endpoints, sync)


_FIRST_C, _FIRST_PLC = "writer n=3 every=100 stays=1 crash=1 stall=1", "plc_writer n=5 crash=1 stall=1"
"""The first writer of a topic, which may stall or crash at any step."""
_THEN_C = "writer start=250 n=1 every=100 stays=1 tries=12 crash=1"
_THEN_PLC = "plc_writer start=250 every=250 n=7 crash=1"
"""The writer that takes the topic over and writes one sample."""
_THIRD_C = "writer start=1800 n=1 every=100 stays=1 tries=30 crash=1"
_THIRD_PLC = "plc_writer start=1800 every=250 n=14 crash=1"


def _takeover(name: str, variant: str, settings: str, samples: int, *others: str) -> Scene:
    """Return a scene with the takeover `name`, in which the second writer writes `samples` samples."""
    first, second = _TAKEOVERS[name]
    n = 1 if second == _THEN_C else 7
    return _scene(f"{name}, {variant}", settings, first, second.replace(f"n={n}", f"n={n + samples - 1}"), *others)


_TAKEOVERS = {
    "a PLC takes over from C": (_FIRST_C, _THEN_PLC),
    "C takes over from a PLC": (_FIRST_PLC, _THEN_C),
    "a PLC takes over from a PLC": (_FIRST_PLC, _THEN_PLC),
}
_READER = "reader start=100 n=25 every=100"
_PLCS = {"plc": "a PLC", "block": "an OpenPLC"}
"""The names of the endpoints in plc.cpp and calls.c."""

QUICK = [
    _scene("a writer and a reader", "p=2 c=1", "writer n=3 crash=1", "reader n=3 crash=1"),
    _scene("a reader of every sample", "p=1 c=1 depth=3", "writer n=6 crash=1", "reader n=4 next=1 crash=1"),
    _scene("a writer and a PLC reader", "p=2 c=1", "writer n=3 crash=1", "plc_reader n=3 crash=1"),
    _scene("a PLC writer and a reader", "p=1 c=1", "plc_writer n=5 crash=1", "reader start=200 n=4 every=100 crash=1"),
    _scene("one reader waits", "p=2 b=1 ms=1000", "writer n=3", "waiter n=3"),
    _scene("one reader waits, sample every 25 ms", "p=1 ms=1000", "writer n=2 every=25", "waiter n=2 all=1"),
    _scene("two readers wait", "p=1 ms=1000", "writer n=4 every=5", *["waiter n=4 all=1"] * 2),
    _scene("two processes acquire the lock", "p=3 c=1", "locker crash=1", "locker crash=1"),
    _scene("two writers claim one topic", "p=1 c=1", "writer n=2 crash=1", "writer n=2 crash=1", "reader n=2"),
    _scene("C takes over from a PLC and dies", "c=1 plc_wrote=1", "writer n=1 crash=1"),
    _scene("C takes over and cancels its sample", "plc_wrote=1", "writer n=1 cancel=1"),
    _scene("a PLC takes over from C", "s=1 c=1", _FIRST_C, _THEN_PLC),
    _scene("C takes over from a PLC", "s=1 c=1", _FIRST_PLC, _THEN_C),
    _scene("a PLC takes over from a PLC", "s=1 c=1", _FIRST_PLC, _THEN_PLC),
    _scene("sample numbers wrap around", "p=1 c=1 c_wrote=1 number=0xFFFFFFFE depth=3", "writer n=6 crash=1",
           "reader n=5 next=1 crash=1"),
    _scene("a writer and a reader create a region", "p=1 c=1 opening=1 empty=1", "writer n=1 crash=1",
           "reader n=1 crash=1"),
]  # fmt: skip
"""The scenes of `make test`, which take some seconds together. The explorer must find no error in any scene."""

FULL = [
    # One writer.
    _scene("unlimited pre-emptions", "p=90 c=1", "writer n=2 crash=1", "reader n=2 crash=1"),
    _scene("a writer and a reader with store buffers", "p=2 c=1 b=2", "writer n=3 crash=1", "reader n=2 crash=1"),
    _scene("a writer and a reader stall", "p=1 c=1 s=1", "writer n=3 crash=1 stall=1", "reader n=3 crash=1 stall=1"),
    _scene("a writer and two readers", "p=1 c=1", "writer n=3 crash=1", "reader n=3 crash=1", "reader n=3 crash=1"),
    _scene("a writer and a reader await the lock", "p=2 c=1 lock_ms=10", "writer n=2 crash=1", "reader n=2 crash=1"),
    _scene("a PLC writer and a PLC reader", "p=2 c=1", "plc_writer n=5 crash=1", "plc_reader n=5 every=100 crash=1"),
    _scene("a PLC writer and a reader of every sample", "p=1 c=1", "plc_writer n=10 crash=1",
           "reader start=200 n=4 every=300 next=1 crash=1"),
    _scene("a PLC writer with store buffers", "p=1 c=1 b=1", "plc_writer n=4 crash=1",
           "reader start=200 n=3 every=100 crash=1"),
    _scene("a PLC reader with store buffers", "p=1 c=1 b=1", "writer n=3 crash=1", "plc_reader n=3 crash=1"),
    _scene("blocks for OpenPLC and Beremiz", "p=1 c=1", "block_writer n=6 crash=1", "block_reader n=6 crash=1"),
    # The lock.
    _scene("three processes acquire the lock", "p=1 c=1", *["locker crash=1"] * 3),
    _scene("three processes hold the lock for 700 ms", "p=1", *["locker n=3 hold=700"] * 3),
    _scene("a holder of the lock stalls", "p=1 c=1 s=1", *["locker crash=1 stall=1"] * 2),
    _scene("C stalls before it releases the lock", "s=1 one_token=1", _FIRST_C, _THEN_PLC),
    _scene("a PLC finds a stuck lock", "c=1 sends=1", "locker n=1 crash=1", "plc_writer n=14 every=200", _READER),
    # The wake-up.
    _scene("a PLC wakes one waiting reader", "p=1", "plc_writer n=8 every=25", "waiter n=3 all=1"),
    _scene("a waiting reader dies", "p=1 c=1 b=1 ms=1000", "writer n=2 every=5", "waiter n=2 crash=1"),
    _scene("one reader waits, with store buffers", "p=2 b=3 ms=1000", "writer n=2", "waiter n=2"),
    _scene("one reader waits, writer without the lock", "p=1 b=2 ms=1000", "writer n=2", "waiter n=2",
           "locker n=1 hold=3"),
    _scene("two readers wait, burst of samples", "p=2 ms=1000", "writer n=2", *["waiter n=2"] * 2),
    _scene("two readers wait, one dies", "p=1 c=1 ms=1000", "writer n=3 every=5", "waiter n=3", "waiter n=3 crash=1"),
    _scene("two readers wait, one is busy", "p=1 ms=1000", "writer n=4 every=5", "waiter n=4", "waiter n=4 busy=5"),
    _scene("two readers wait, one ends early", "p=2 ms=1000", "writer n=4 every=5", "waiter n=4 all=1",
           "waiter n=4 until=2"),
    _scene("three readers wait", "p=1 ms=1000", "writer n=3 every=5", *["waiter n=3 all=1"] * 3),
    _scene("two readers wait for a PLC", "p=1 ms=1000", "plc_writer n=3", *["waiter n=2 all=1"] * 2),
    _scene("two readers wait for a fast PLC", "p=1 ms=1000", "plc_writer n=8 every=25", *["waiter n=3 all=1"] * 2),
    # Sample numbers.
    _scene("sample numbers of a PLC wrap around", "p=1 plc_wrote=1 number=0xFFFFFFFE", "plc_writer n=16",
           "reader start=1300 n=4 every=100"),
    _scene("sample numbers wrap around for a PLC reader", "p=1 c=1 c_wrote=1 number=0xFFFFFFFE depth=3",
           "writer n=6 crash=1", "plc_reader n=5 next=1 crash=1"),
    # Opening.
    _scene("a PLC and a reader create a region", "p=1 c=1 opening=1 empty=1", "plc_writer n=4 crash=1",
           "reader n=4 crash=1"),
    _scene("three endpoints create a region", "p=1 c=1 opening=1 empty=1", "writer n=1 crash=1",
           "plc_reader n=4 every=100", "reader n=1"),
    # Endpoints with different layouts.
    _scene("two writers with different layouts", "p=1 c=1 opening=1", "holder writes=1 crash=1",
           "holder writes=1 depth=3 crash=1"),
    _scene("two readers with different layouts", "p=1 c=1 opening=1 unreplaced=1", "holder crash=1",
           "holder depth=3 crash=1"),
    _scene("a writer and a reader with different layouts", "p=1 c=1 opening=1", "holder writes=1 depth=3 crash=1",
           "holder crash=1"),
    _scene("a writer and a PLC with different layouts", "p=1 c=1 opening=1", "holder writes=1 depth=3 crash=1",
           "plc_writer n=10 every=200 crash=1"),
    _scene("three endpoints replace a region", "p=1 c=1 opening=1", *["holder writes=1 depth=3 crash=1"] * 2,
           "holder depth=3"),
    _scene("a PLC reader reopens a replaced region", "p=1 opening=1", "plc_reader n=40 every=100 reads_newest=1",
           "holder writes=1 depth=3", "writer start=1500 n=2 every=600"),
    # Without the lock.
    _scene("a writer and a reader, no lock", "p=2 c=1 b=1 sequence=1", "writer n=3 crash=1", "reader n=3 crash=1",
           sync="sequence"),
    _scene("a PLC writer and a reader, no lock", "p=1 c=1 sequence=1", "plc_writer n=5 crash=1",
           "reader start=200 n=4 every=100 crash=1", sync="sequence"),
    _scene("a writer and a PLC reader, no lock", "p=1 c=1 sequence=1", "writer n=3 crash=1", "plc_reader n=3 crash=1",
           sync="sequence"),
    # Takeovers from a writer that never stalls.
    _scene("C takes over from C", "p=1 c=1", "writer n=2 crash=1", "writer n=2 tries=3 crash=1", "reader n=2"),
    _scene("C claims a running PLC's topic", "p=1", "plc_writer n=6", _THEN_C),
    _scene("a PLC claims a running C writer's topic", "p=1", "writer n=6 every=100 stays=1",
           "plc_writer start=50 every=50 n=8"),
    # Takeovers from a writer that may stall or crash at any step, by a writer that may crash.
    *(_takeover(name, "three samples", "s=1 c=1", 3) for name in _TAKEOVERS),
    *(_takeover(name, "all slots", "s=1 c=1", 6) for name in _TAKEOVERS),
    *(_takeover(name, "one pre-emption", "p=1 s=1 c=1", 2) for name in _TAKEOVERS),
    *(_takeover(name, "with a reader", "p=1 s=1", 1, _READER) for name in _TAKEOVERS),
    *(_takeover(name, "with a PLC reader", "p=1 s=1", 1, "plc_reader n=45 every=100 reads_newest=1")
      for name in _TAKEOVERS),
    _scene("three writers: C, PLC, C", "s=1 c=1", _FIRST_C, _THEN_PLC + " stall=1", _THIRD_C),
    _scene("three writers: PLC, C, C", "s=1 c=1", _FIRST_PLC, _THEN_C, _THIRD_C),
    _scene("three writers: PLC, C, PLC", "s=1 c=1", _FIRST_PLC, _THEN_C + " stall=1", _THIRD_PLC),
    _scene("three writers, two die", "c=2", _FIRST_C, _THEN_PLC, _THIRD_C),
    *(_takeover(name, "numbers wrap", "s=1 c=1 c_wrote=1 number=0xFFFFFFFD", 3) for name in _TAKEOVERS),
    # Two writers that both run, or that start at the same time.
    _scene("a PLC takes over and writes a sample", "c_wrote=1", "plc_writer every=250 n=9 sends=1"),
    _scene("a PLC watches a running C writer", "p=1", "writer n=16 every=100 stays=1",
           "plc_writer start=50 every=200 n=9"),
    _scene("C watches a running PLC", "p=1", "plc_writer n=16", "writer start=50 n=1 every=100 stays=1"),
    _scene("two PLCs start at the same time", "p=1", *["plc_writer every=50 n=6"] * 2, "reader start=100 n=8 every=50"),
    _scene("a PLC and C claim a topic, C dies", "p=1 c=1", "plc_writer every=100 n=22 sends=1",
           "writer start=100 n=1 crash=1"),
    _scene("a PLC finds a held lock", "p=1", "locker n=2 hold=700", "plc_writer n=20 every=50"),
    # Services.
    *(_scene(f"{_PLCS[client]} client calls {_PLCS[server]} server", "p=1 c=1 service=1 answers=1",
             f"{server}_server n=12 crash=1", f"{client}_client start=500 n=6 crash=1")
      for client in _PLCS for server in _PLCS),
    _scene("an OpenPLC client replaces a PLC client", "s=1 service=1", "block_server n=6 stall=1",
           "plc_client start=500 n=4 timeout=300", "block_client start=700 n=20 timeout=300"),
    _scene("a PLC client replaces an OpenPLC client", "s=1 service=1", "plc_server n=6 stall=1",
           "block_client start=500 n=4 timeout=300 stall=1", "plc_client start=700 n=20 timeout=300"),
    *(_scene(f"{_PLCS[client]} client recreates {_PLCS[server]} server's request region", "s=1 service=1",
             f"{server}_server n=14 stall=1", "block_client start=500 n=5 timeout=300",
             f"{client}_client start=1000 n=28 timeout=2800 removes=1") for client in _PLCS for server in _PLCS),
]  # fmt: skip
"""The scenes that `make test-all` adds. They take a minute together with the quick scenes."""

LARGE = [
    _scene("a writer and two readers, larger", "p=2 c=1", "writer n=3 crash=1", "reader n=3 crash=1",
           "reader n=2 crash=1"),
    _scene("two writers claim one topic, larger", "p=2 c=1", "writer n=2 crash=1", "writer n=2 crash=1", "reader n=2"),
    _scene("three processes acquire the lock, larger", "p=2 c=1", *["locker crash=1"] * 3),
    _scene("a writer and a reader with store buffers, larger", "p=3 c=1 b=2", "writer n=3 crash=1",
           "reader n=3 crash=1"),
    _scene("a writer and a PLC create a region", "p=2 c=1 opening=1 empty=1", "writer n=1 crash=1",
           "plc_writer n=4 crash=1"),
    _scene("one reader waits, larger", "p=3 b=2 ms=1000", "writer n=3", "waiter n=3"),
    _scene("two readers wait, burst of samples, larger", "p=3 ms=1000", "writer n=2", *["waiter n=2"] * 2),
    _scene("two readers wait, with store buffers", "p=2 b=2 ms=1000", "writer n=2", *["waiter n=2"] * 2),
    _scene("two readers wait for a PLC, larger", "p=1 ms=4000", "plc_writer n=6", *["waiter n=3 all=1"] * 2),
    _scene("three readers wait, burst of samples", "p=2 ms=1000", "writer n=2", *["waiter n=2"] * 3),
    *(_takeover(name, "with store buffers", "p=1 s=1 c=1 b=1", 1) for name in _TAKEOVERS),
    *(_takeover(name, "with a reader of every sample", "p=1 s=1", 2, _READER + " next=1") for name in _TAKEOVERS),
    _takeover("a PLC takes over from a PLC", "two pre-emptions", "p=2 s=1", 1, _READER),
    _scene("an OpenPLC server replaces a PLC server", "s=1 service=1", "plc_server n=6 stall=1",
           "block_server start=600 n=20", "plc_client start=500 n=26 timeout=300"),
]  # fmt: skip
"""The scenes that only `make explore` adds."""

SCENES = {scene.name: scene for scene in [*QUICK, *FULL, *LARGE]}
