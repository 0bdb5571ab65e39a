"""Finds temporary files in /dev/shm of processes that were killed while creating a semaphore."""

from __future__ import annotations

import os
import re
import time
from contextlib import suppress

from shmgen.live.processes import Processes, has_open
from shmgen.live.regions import FOLDER
from shmgen.runtime.region.names import region_file
from shmgen.tools.doctor.snapshot import SIZES

AGE = 3.0
"""Seconds after which a temporary file counts as abandoned. Creating a semaphore takes microseconds."""
_TEMPORARY = re.compile(r"sem\.[A-Za-z0-9]{6}")
"""Temporary name of a semaphore in glibc, which then links the file to its name (sem_open.c, mktemp)."""
_WORD = re.compile(r"sem\.([A-Za-z][a-z]*|[A-Z]+)[0-9]*")
"""Names that a user may have chosen, such as `sem.camera` or `sem.motor1`. One random name in forty matches too."""


def semaphores(processes: Processes) -> list[str]:
    """Return temporary semaphore files that are older than AGE and that no process uses.

    Skip names that a user may have chosen, such as `sem.camera`. `shmgen clean NAME` also removes skipped files.
    """
    mapped = {(mapping.device, mapping.inode) for mapping in processes.mappings}
    orphans = []
    for name in sorted(filter(is_temporary, os.listdir(FOLDER))) if os.access(FOLDER, os.R_OK) else ():
        file = f"{FOLDER}/{name}"
        with suppress(OSError):  # the semaphore was completed meanwhile
            status = os.lstat(file)
            settled = time.time() - status.st_ctime > AGE
            unused = (status.st_dev, status.st_ino) not in mapped
            alone = not os.path.lexists(region_file(name.removeprefix("sem.")))
            if status.st_size in (0, *SIZES) and settled and alone and unused and not has_open(status):
                orphans.append(file)
    return orphans


def is_temporary(name: str) -> bool:
    """Return True if glibc may have generated the name at random, and a user has probably not chosen the name."""
    return bool(_TEMPORARY.fullmatch(name) and not _WORD.fullmatch(name))
