"""Turns a mode and a group into files that both sides may open, and a refusal into who may and what to do."""

from __future__ import annotations

import grp
import os
import pwd
from contextlib import suppress
from typing import NamedTuple

from shmgen.runtime.errors import PermissionDenied

_MODE = 0o660


class RegionOptions(NamedTuple):
    """How the files of a region look that are made here, and whether it has a lock.

    `mode` None: 0o660, and a file that is there stays as it is; any other mode and group are also given to a file
    that is there, if it is this user's. `sync` is `lock`, or `sequence` for none: the slots alone carry integrity.
    """

    mode: int | None = None
    group: str | int | None = None
    sync: str = "lock"

    def but(self, mode: int | None, group: str | int | None) -> RegionOptions:
        """The same, with what a caller asks for."""
        return self._replace(mode=self.mode if mode is None else mode, group=self.group if group is None else group)


class Access(NamedTuple):
    """Mode and group wanted of a file, None for those of a fresh one."""

    mode: int | None
    gid: int | None

    @property
    def made_mode(self) -> int:
        """Of a file made here."""
        return _MODE if self.mode is None else self.mode

    def give(self, file: int | str, path: str) -> None:
        """To a file made just now: the umask has had its say."""
        try:
            if self.gid is not None:
                os.chown(file, -1, self.gid)
            os.chmod(file, self.made_mode)
        except PermissionError:
            raise PermissionDenied(
                f"{path}: cannot be given to group {self.gid}; join the group (`usermod -aG`) or leave `group` out"
            ) from None

    def mend(self, file: int | str, path: str) -> None:
        """To a file of this user's: who made it may have been killed before it gave it the mode, or wanted another."""
        status = os.stat(file)
        wrong = self.mode not in (None, status.st_mode & 0o7777) or self.gid not in (None, status.st_gid)
        if wrong and status.st_uid == os.geteuid():
            kept = status.st_mode & 0o7777
            self._replace(mode=kept if self.mode is None else self.mode).give(file, path)


def access_for(options: RegionOptions) -> Access:
    """With the group looked up. Raises PermissionDenied."""
    return Access(options.mode, _group_id(options.group))


def denied(path: str) -> PermissionDenied:
    """What to say of a file that may not be opened or made."""
    try:
        status = os.stat(path)
    except OSError:
        return PermissionDenied(f"{path} cannot be made: see the permissions of /dev/shm")
    with suppress(KeyError):
        owner = pwd.getpwuid(status.st_uid).pw_name
        group = grp.getgrgid(status.st_gid).gr_name
        return PermissionDenied(
            f"{path} belongs to {owner}:{group} with mode {status.st_mode & 0o7777:o}, and this is user "
            f"{os.geteuid()}: join the group (`usermod -aG {group} USER`), or let the owner open it with another "
            "group and mode"
        )
    return PermissionDenied(
        f"{path} belongs to {status.st_uid}:{status.st_gid} with mode {status.st_mode & 0o7777:o}, and this is "
        f"user {os.geteuid()}: let the owner open it with a group and mode that include this user"
    )


def _group_id(group: str | int | None) -> int | None:
    if not isinstance(group, str):
        return group
    try:
        return grp.getgrnam(group).gr_gid
    except KeyError:
        raise PermissionDenied(f"there is no group {group!r} here: `groupadd {group}` makes it") from None
