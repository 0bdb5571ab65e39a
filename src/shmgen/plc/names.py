"""ROS names for names of Structured Text."""

from __future__ import annotations

import re
from collections import Counter

_PREFIX = re.compile(r"(ST|E|EN|ENUM|DUT|T|TYP|U)_(?=[A-Za-z])", re.IGNORECASE)
_WORDS = re.compile(r"[A-Z]+(?![a-z])\d*|[A-Z]?[a-z]+\d*|\d+")


def snake(name: str) -> str:
    """`rActPos` -> `r_act_pos`, `nAxisID` -> `n_axis_id`, `IDLE` -> `idle`."""
    words = "_".join(_WORDS.findall(name)).lower() or "x"
    return words if words[0].isalpha() else f"n{words}"


def _camel(name: str) -> str:
    words = re.findall(r"[A-Za-z0-9]+", name)
    whole = "".join(
        word.capitalize() if word.isupper() or word.islower() else word[0].upper() + word[1:] for word in words
    )
    return whole if whole[:1].isalpha() else f"N{whole}"


def of_messages(names: list[str]) -> dict[str, str]:
    """Without the prefix where that is enough to tell them apart."""
    short = {name.upper(): _camel(_PREFIX.sub("", name, count=1)) for name in names}
    often = Counter(it.upper() for it in short.values())
    kept = [it if often[it.upper()] == 1 else _camel(name) for name, it in zip(names, short.values(), strict=True)]
    return dict(zip(short, unique(kept), strict=True))


def unique(names: list[str]) -> list[str]:
    """A number behind each that is there already; ROS tells cases apart, Structured Text does not."""
    seen: set[str] = set()
    counts: Counter[str] = Counter()
    found = []
    for name in names:
        other = name
        while other.upper() in seen:
            counts[name] += 1
            other = f"{name}{'' if name[0].isupper() and '_' not in name else '_'}{counts[name] + 1}"
        seen.add(other.upper())
        found.append(other)
    return found
