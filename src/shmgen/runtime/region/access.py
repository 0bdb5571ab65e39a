"""Files that both sides may open and strangers cannot write, by mode and group, and a refusal in words."""

from __future__ import annotations

import grp
import io
import os
import pwd
import stat
from contextlib import suppress
from typing import NamedTuple

from shmgen.core import abi
from shmgen.runtime.errors import PermissionDenied, RegionUnusable
from shmgen.runtime.region.resource import kept_from_children

PATIENCE = abi.PEER_MS / 1000
"""Seconds to wait for a peer that is between two system calls; after that it is taken to be dead."""
_MODE = 0o660
_FIRST_PERSON = 1000
"""User ids below are the machine's own services, which only root makes (Debian policy 9.2.2, SYS_UID_MAX)."""


class RegionOptions(NamedTuple):
    """Permissions of the files of a region that are created here, and whether it has a lock.

    `mode` None: 0o660, and an existing file stays as it is; any other mode and group are also given to an existing
    file, if it is this user's. `sync` is `lock`, or `sequence` for none: the slots alone carry integrity.
    """

    mode: int | None = None
    group: str | int | None = None
    sync: str = "lock"

    def but(self, mode: int | None, group: str | int | None) -> RegionOptions:
        """The same, with the mode and group that are given here."""
        return self._replace(mode=self.mode if mode is None else mode, group=self.group if group is None else group)


class Access(NamedTuple):
    """Mode and group wanted of a file, None for those of a fresh one."""

    mode: int | None
    gid: int | None

    @property
    def made_mode(self) -> int:
        """Of a file made here."""
        return _MODE if self.mode is None else self.mode

    def give(self, file: int, path: str) -> None:
        """To a file made just now: the umask has had its say. One of somebody else's is left as it is."""
        if os.fstat(file).st_uid != os.geteuid():
            return  # ours was removed, and he was quick
        try:
            if self.gid is not None:
                os.fchown(file, -1, self.gid)
            os.fchmod(file, self.made_mode)
        except PermissionError:
            raise PermissionDenied(
                f"{path}: cannot be given to group {self.gid}; join the group (`usermod -aG`) or leave `group` out"
            ) from None

    def mend(self, file: int, path: str) -> None:
        """To a file of this user's: who made it may have been killed before it gave it the mode, or wanted another."""
        status = os.fstat(file)
        wrong = self.mode not in (None, status.st_mode & 0o7777) or self.gid not in (None, status.st_gid)
        if wrong:
            kept = status.st_mode & 0o7777
            self._replace(mode=kept if self.mode is None else self.mode).give(file, path)

    def objection(self, status: os.stat_result, path: str) -> tuple[str, str] | None:
        """Who could write a file without leave, and what gives it; None where nobody could.

        Leave have this user, root, the services of the machine, and who owns a group of his own that this user was
        put into. Files of the group that was named pass whoever made them, since nobody gives a file to a group that
        he is not in; so does every file where all users were given leave by the mode. What group a file of theirs
        has, and that its members may write it, is the owner's word.
        """
        if (self.mode or 0) & stat.S_IWOTH:
            return None
        if status.st_mode & stat.S_IWOTH:
            leave = 'if all of them may, mode = "0666" under [regions] in shmgen.toml, or mode=0o666 in Python'
            return "every user of this machine can write it", f"`chmod o-w {path}`; {leave}"
        if status.st_gid == self.gid or _known(status):
            return None
        group = name_of_group(status.st_gid)
        leave = (
            f'if those of {group} may, group = "{group}" under [regions] in shmgen.toml, or group="{group}" in Python'
        )
        return f"it belongs to {name_of_user(status.st_uid)}, a stranger to {name_of_user(os.geteuid())}", leave


def access_for(options: RegionOptions) -> Access:
    """With the group looked up. Raises PermissionDenied."""
    return Access(options.mode, _group_id(options.group))


def opened(path: str, how: int) -> io.FileIO:
    """As shm_open opens what is there: no link is followed, and no FIFO waited for.

    Raises FileNotFoundError, PermissionError, and RegionUnusable for what is no regular file.
    """
    try:
        flags = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        file: io.FileIO = kept_from_children(io.FileIO(os.open(path, how | flags)))
    except (FileNotFoundError, PermissionError):
        raise
    except OSError as error:
        raise RegionUnusable(f"{path} cannot be opened: {error.strerror}") from None
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise RegionUnusable(f"{path} is not a regular file, so it cannot be a region: remove it")
    return file


def denied(path: str) -> PermissionDenied:
    """What to say of a file that may not be opened or made."""
    try:
        status = os.lstat(path)
    except OSError:
        return PermissionDenied(f"{path} cannot be made: see the permissions of /dev/shm")
    owner, group = name_of_user(status.st_uid), name_of_group(status.st_gid)
    return PermissionDenied(
        f"{path} belongs to {owner}:{group} with mode {status.st_mode & 0o7777:o}, and this is user "
        f"{os.geteuid()}: join the group (`usermod -aG {group} USER`), or let the owner open it with another "
        "group and mode"
    )


def name_of_user(uid: int) -> str:
    """Its number where it has none."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def name_of_group(gid: int) -> str:
    """Its number where it has none."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _known(status: os.stat_result) -> bool:
    """Whether this user has reason to trust the owner."""
    if status.st_uid < _FIRST_PERSON or status.st_uid == os.geteuid():
        return True
    with suppress(KeyError):
        owner, group = pwd.getpwuid(status.st_uid), grp.getgrgid(status.st_gid)
        own = owner.pw_gid == group.gr_gid and owner.pw_name == group.gr_name
        return own and group.gr_gid in (os.getegid(), *os.getgroups())
    return False


def _group_id(group: str | int | None) -> int | None:
    if not isinstance(group, str):
        return group
    try:
        return grp.getgrnam(group).gr_gid
    except KeyError:
        if group.isdecimal():  # one without a name, as in containers
            return int(group)
        raise PermissionDenied(f"group {group!r} does not exist: `groupadd {group}` creates it") from None
