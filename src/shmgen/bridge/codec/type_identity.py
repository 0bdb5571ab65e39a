"""Compares the type hashes of peers with the bridge's, because serialized bytes do not contain their type."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from shmgen.core.model import TypeName

TAKES_OURS = "it will misread the bridge's messages, because DDS cannot exclude one subscriber"
"""The log text for a subscriber whose definition of the type differs from the bridge's."""
_NONE = "RIHS01_" + "0" * 64
"""The type hash that some peers without support for type hashes announce."""


def type_name(name: TypeName) -> str:
    """Return the DDS name of a type, for example `geometry_msgs::msg::dds_::Pose_`."""
    return f"{name.package}::{name.kind}::dds_::{name.name}_"


@dataclass(slots=True, eq=False)
class Identity:
    """Compares the type hashes of peers with the bridge's, for one topic or one direction of a service. Thread-safe.

    `ours` is the type hash of the bridge. `where` begins each log line. If `accepts_other` is True, a peer with another
    type hash is accepted and logged. If not, the log line ends with `then`, the consequence for the user.
    """

    where: str
    type: TypeName
    ours: str
    log: Callable[[str], None]
    accepts_other: bool = False
    then: str = "no messages pass between it and the bridge until both use one definition"
    _logged_keys: set[str] = field(default_factory=set, init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)

    def refusal(self, announced: str) -> str:
        """Return why the type hash `announced` is incompatible, or `""`. A peer without a type hash is compatible."""
        if announced == self.ours:
            return ""
        if not announced.startswith("RIHS01_") or announced == _NONE:
            self._once("", f"a peer announces no type hash; its {self.type.short} is assumed to be the same")
            return ""
        why = f"a peer uses another definition of {self.type.short}: its type hash is {announced}, not {self.ours}"
        if self.accepts_other:
            self._once(announced, f'{why}; the bridge accepts it, because of other_definition = "accept"')
            return ""
        self._once(announced, f"{why}; {self.then}")
        return why

    def _once(self, key: str, text: str) -> None:
        with self._lock:
            known = key in self._logged_keys
            self._logged_keys.add(key)
        if not known:
            self.log(f"{self.where}: {text}")
