"""Finds what a process left in /dev/shm that was killed while it made a semaphore."""

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
"""Seconds; making a semaphore takes microseconds."""
_TEMPORARY = re.compile(r"sem\.[A-Za-z0-9]{6}")
"""glibc makes a semaphore under such a name, links it to the right one and removes it (sem_open.c, mktemp)."""
_WORD = re.compile(r"sem\.([A-Za-z][a-z]*|[A-Z]+)[0-9]*")
"""What may be somebody's own semaphore, `sem.camera` or `sem.motor1`; one in forty made by chance looks so too."""


def semaphores(processes: Processes) -> list[str]:
    """Files that nobody uses, a few seconds old at least.

    A name that could be a word is left out: `shmgen clean NAME` removes it all the same.
    """
    mapped = {(mapping.device, mapping.inode) for mapping in processes.mappings}
    found = []
    for name in sorted(filter(is_temporary, os.listdir(FOLDER))):
        file = f"{FOLDER}/{name}"
        with suppress(OSError):  # it was finished meanwhile
            status = os.lstat(file)
            settled = time.time() - status.st_ctime > AGE
            unused = (status.st_dev, status.st_ino) not in mapped
            alone = not os.path.lexists(region_file(name.removeprefix("sem.")))
            if status.st_size in (0, *SIZES) and settled and alone and unused and not has_open(status):
                found.append(file)
    return found


def is_temporary(name: str) -> bool:
    """Whether chance made the name of a semaphore's file."""
    return bool(_TEMPORARY.fullmatch(name) and not _WORD.fullmatch(name))
