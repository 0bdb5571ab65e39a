"""Finds out how a CI machine can install the same shmgen, from pip's direct_url.json (PEP 610)."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, distribution

from shmgen import __version__


def requirement() -> str | None:
    """Return the requirement for pip: `shmgen[idl]==1.0` or `shmgen[idl] @ URL`.

    Return None if shmgen was installed from a local folder.
    """
    try:
        noted = distribution("shmgen").read_text("direct_url.json")
    except PackageNotFoundError:
        return None
    if noted is None:
        return f"shmgen[idl]=={__version__}"
    origin = json.loads(noted)
    if "vcs_info" in origin:
        vcs = origin["vcs_info"]
        return f"shmgen[idl] @ {vcs['vcs']}+{origin['url']}@{vcs['commit_id']}"
    return None if origin["url"].startswith("file:") else f"shmgen[idl] @ {origin['url']}"
