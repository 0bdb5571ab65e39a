"""Read and write serialized messages of ROS 1 with genpy, in a process of a Python that has genpy.

Each request on stdin is pickled: the name of a type, its definition with its dependencies, and serialized messages. The
reply contains the values of each message, and the bytes that genpy writes for the message.
"""

from __future__ import annotations

import io
import pickle
import sys
from types import SimpleNamespace
from typing import Any

import genpy
from genpy.dynamic import generate_dynamic


def plain(value: Any) -> Any:
    """Convert a message of genpy to objects that Python can pickle without the class of the message."""
    if isinstance(value, genpy.TVal):
        return SimpleNamespace(secs=value.secs, nsecs=value.nsecs)
    if isinstance(value, genpy.Message):
        return SimpleNamespace(**{name: plain(getattr(value, name)) for name in value.__slots__})
    return [plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def converted(kind: Any, data: bytes) -> tuple[Any, bytes]:
    message, written = kind(), io.BytesIO()
    message.deserialize(data)
    message.serialize(written)
    return plain(message), written.getvalue()


if __name__ == "__main__":
    while sys.stdin.buffer.peek(1):
        name, text, samples = pickle.load(sys.stdin.buffer)
        kind = generate_dynamic(name, text)[name]
        pickle.dump([converted(kind, data) for data in samples], sys.stdout.buffer)
        sys.stdout.buffer.flush()
