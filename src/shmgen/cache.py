"""Says where things are kept that only save time: the user's cache folder."""

from __future__ import annotations

import os


def folder() -> str | None:
    """`$XDG_CACHE_HOME/shmgen`, made if need be; None where nothing can be kept.

    As the XDG base directory specification says, a value that is not absolute is ignored.
    """
    base = os.environ.get("XDG_CACHE_HOME", "")
    if not os.path.isabs(base):
        base = os.path.join(os.path.expanduser("~"), ".cache")
    if not os.path.isabs(base):
        return None
    path = os.path.join(base, "shmgen")
    try:
        os.makedirs(path, mode=0o700, exist_ok=True)
    except OSError:
        return None
    return path if os.access(path, os.W_OK) else None
