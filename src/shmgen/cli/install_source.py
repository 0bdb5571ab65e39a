"""Says how a CI machine installs the same shmgen: from where this one was installed, as pip noted it down (PEP 610)."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, distribution

from shmgen import __version__


def requirement() -> str | None:
    """`shmgen[idl]==1.0` of a package index, or `shmgen[idl] @ URL`; None for a folder, which only this machine has."""
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
