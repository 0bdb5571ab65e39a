"""Warns of regions that systemd-logind removes when their owner logs out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from shmgen.runtime.region.access import name_of_user
from shmgen.tools.doctor.problem import Problem
from shmgen.tools.doctor.snapshot import Evidence

_PLACES = ("etc", "run", "usr/local/lib", "usr/lib")
"""Folders that may contain systemd/logind.conf and its drop-ins. The first logind.conf counts; drop-ins override it."""
_FIRST_USER = 1000
"""Lowest user id of a person. logind keeps the regions of system users, whose ids are lower."""
_TYPE = (
    "`sudo mkdir -p /etc/systemd/logind.conf.d && printf '[Login]\\nRemoveIPC=no\\n' | "
    "sudo tee /etc/systemd/logind.conf.d/shmgen.conf && sudo systemctl restart systemd-logind`; "
    "or create the regions as a service: docs/deploy.md"
)


def of_logout(regions: Sequence[Evidence], root: Path = Path("/")) -> Iterator[Problem]:
    """Yield a note for each owner of regions if systemd-logind removes the owner's regions at logout."""
    owners = sorted({region.status.st_uid for region in regions if region.status.st_uid >= _FIRST_USER})
    if not owners or not (root / "run/systemd/seats").is_dir() or not removes_ipc(root):
        return
    for owner in owners:
        topics = [region.topic for region in regions if region.status.st_uid == owner]
        listed = ", ".join(topics[:3]) + (", ..." if len(topics) > 3 else "")
        message = f"systemd-logind removes {listed} when {name_of_user(owner)} logs out (RemoveIPC=yes)"
        yield Problem("", message, _TYPE, note=True)


def removes_ipc(root: Path = Path("/")) -> bool:
    """Return True if RemoveIPC= is yes, the default, in logind.conf and its drop-ins below `root`."""
    mains = (root / place / "systemd/logind.conf" for place in _PLACES)
    drop_ins: dict[str, Path] = {}
    for place in reversed(_PLACES):
        drop_ins |= {path.name: path for path in (root / place / "systemd/logind.conf.d").glob("*.conf")}
    files = [*[path for path in mains if path.is_file()][:1], *(drop_ins[name] for name in sorted(drop_ins))]
    settings = [value for path in files for value in _settings(path)]
    return not settings or settings[-1] not in ("no", "0", "false", "off", "n", "f")


def _settings(path: Path) -> Iterator[str]:
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        key, _, value = line.partition("=")
        if key.strip() == "RemoveIPC":
            yield value.strip().lower()
