"""Messages with nested sequences, and a function that writes a count above its bound."""

from __future__ import annotations

from types import ModuleType
from typing import Any

PACKAGE = "shm_counts"
DEFINITIONS = {
    "msg/Leaf": "uint8 id\nint16[<=2] weights\n",
    "msg/Branch": "Leaf[<=3] leaves\nfloat64 x\n",
    "msg/Tree": "uint32 a\nint32[<=3] tail\nBranch trunk\nBranch[2] pair\nBranch[<=2] crown\nuint32 b\n",
    "srv/Sort": "uint32 id\nint32[<=4] items\n---\nint32[<=4] sorted\n",
    "action/Walk": "int32[<=3] steps\n---\nint32[<=2] left\n---\nint32[<=2] done\nuint32 place\n",
}
MOST = 2**32 - 1


def tree(msg: ModuleType, a: int) -> Any:
    """Return a message in which each count equals its bound, which is valid."""
    leaf = msg.Leaf(weights=[1, 2])
    branch = msg.Branch(leaves=[leaf] * 3)
    return msg.Tree(a=a, b=2 * a, tail=[a, a, a], trunk=branch, pair=[branch] * 2, crown=[branch] * 2)


def spoil(message: Any, path: str, count: int) -> None:
    """Set the count of a sequence such as `crown[1].leaves[2].weights` without any check."""
    *owners, name = path.split(".")
    for owner in owners:
        member, _, index = owner.rstrip("]").partition("[")
        message = getattr(message, member)
        message = message[int(index)] if index else message
    setattr(message, f"_{name}_count", count)


PLACES = [
    ("tail", 4), ("tail", MOST), ("trunk.leaves", 4), ("trunk.leaves[0].weights", 3), ("trunk.leaves[2].weights", MOST),
    ("pair[0].leaves", 4), ("pair[1].leaves", 4), ("pair[1].leaves[2].weights", 3), ("crown", 3), ("crown", MOST),
    ("crown[0].leaves", 2**31), ("crown[1].leaves[2].weights", 3),
]  # fmt: skip
