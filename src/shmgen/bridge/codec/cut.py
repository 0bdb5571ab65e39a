"""Shortens the sequences and strings of a message that is too long for its region."""

from __future__ import annotations

from typing import Any

from shmgen.runtime import Message
from shmgen.runtime.messages.strings import TEXTS, encode_text


def cut(message: Any, kind: type[Message]) -> None:
    """Shorten the sequences and strings of `message` to the bounds of `kind`. Fixed arrays stay as they are."""
    for step in kind._steps_:
        value = getattr(message, step.name)
        if step.count_at >= 0 and len(value) > step.length:
            value = value[: step.length]
            setattr(message, step.name, value)
        if step.kind in TEXTS:
            texts = [_truncate_text(text, step) for text in (value if step.length else [value])]
            setattr(message, step.name, texts if step.length else texts[0])
        elif not isinstance(step.kind, str):
            for inner in value if step.length else [value]:
                cut(inner, step.kind)


def _truncate_text(text: str, step: Any) -> str:
    kind = f"{step.kind.partition(' ')[0]} truncated"
    return encode_text(kind, text, step.size, step.path)[0].decode(TEXTS[kind].encoding)
