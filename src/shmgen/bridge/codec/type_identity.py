"""Whether a peer means by a type what we do, by the type hash that it announces.

Bytes do not say what they are: an int32 taken from a float32 is a number too, and a wrong one.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from shmgen.core.model import TypeName

TAKES_OURS = "it will misread our messages; DDS offers no way to withhold them"
"""What comes of a subscriber of another definition."""
_NONE = "RIHS01_" + "0" * 64
"""What some say who know nothing of type hashes."""


def type_name(name: TypeName) -> str:
    """`geometry_msgs::msg::dds_::Pose_`."""
    return f"{name.package}::{name.kind}::dds_::{name.name}_"


class Identity:
    """Of one topic, or of one half of a service; its methods may be called from any thread."""

    def __init__(
        self,
        where: str,
        type_: TypeName,
        ours: str,
        tell: Callable[[str], None],
        accepts_other: bool = False,
        *,
        then: str = "",
    ) -> None:
        """`then` is what comes of another definition, where it is not that nothing passes."""
        self.accepts_other = accepts_other
        self._then = then or "nothing passes between us and it"
        self._where = where
        self._type = type_
        self._ours = ours
        self._tell = tell
        self._told: set[str] = set()
        self._lock = threading.Lock()

    def refusal(self, announced: str) -> str:
        """Why nothing may pass between us and a peer of this hash; nothing if it may. Each hash is told of once."""
        if announced == self._ours:
            return ""
        if not announced.startswith("RIHS01_") or announced == _NONE:
            self._once("", f"a peer announces no type hash; its {self._type.short} is assumed to be the same")
            return ""
        why = f"a peer has another {self._type.short}: its type hash is {announced}, ours {self._ours}"
        if self.accepts_other:
            self._once(announced, f'{why}; it is assumed to be the same, because of other_definition = "accept"')
            return ""
        self._once(announced, f"{why}; {self._then}")
        return why

    def _once(self, key: str, text: str) -> None:
        with self._lock:
            known = key in self._told
            self._told.add(key)
        if not known:
            self._tell(f"{self._where}: {text}")
