"""Check and set the permissions of the files of a region, and explain why access is refused."""

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
from shmgen.runtime.region.resource import close_after_fork

PEER_TIMEOUT = abi.PEER_MS / 1000
"""Seconds to wait for a peer that is between two system calls. After that time the peer is considered dead."""
_MODE = 0o660
_FIRST_PERSON = 1000
"""The first user id of a person. Smaller ids belong to system services (Debian policy 9.2.2, SYS_UID_MAX)."""


class RegionOptions(NamedTuple):
    """The permissions of the files of a region, and whether the region has a lock.

    If `mode` is None, new files get mode 0o660 and existing files keep their mode. Any other `mode`, and `group`, are
    also set on existing files that this user owns. `sync` is `lock`, or `sequence` for a region without a lock.
    Without a lock, readers detect an overwritten sample by the number in its slot.

    ```python
    options = RegionOptions(mode=0o666, group="plc")  # generated code has such a line from [regions] in shmgen.toml
    ```
    """

    mode: int | None = None
    group: str | int | None = None
    sync: str = "lock"

    def but(self, mode: int | None, group: str | int | None) -> RegionOptions:
        """Return these options with another mode and group. An argument of None keeps the present value."""
        return self._replace(mode=self.mode if mode is None else mode, group=self.group if group is None else group)


class Access(NamedTuple):
    """The mode and group id that a file must have. None is the default for a new file, and keeps an existing value."""

    mode: int | None
    gid: int | None

    @property
    def creation_mode(self) -> int:
        """The mode for new files."""
        return _MODE if self.mode is None else self.mode

    def apply(self, file: int, path: str) -> None:
        """Set the mode and group of a new file, because the umask may have changed the mode.

        Leave a file of another user unchanged. Raises PermissionDenied if this user is not in the group.
        """
        if os.fstat(file).st_uid != os.geteuid():
            return  # the new file was removed, and another user has created one since
        try:
            if self.gid is not None:
                os.fchown(file, -1, self.gid)
            os.fchmod(file, self.creation_mode)
        except PermissionError:
            raise PermissionDenied(
                f"{path}: only members may set group {self.gid}; join the group (`usermod -aG`) or remove `group`"
            ) from None

    def correct(self, file: int, path: str) -> None:
        """Correct the mode and group of an existing file, if this user owns the file.

        The creator of the file may have been killed before it set the mode, or may have used another mode.
        """
        status = os.fstat(file)
        wrong = self.mode not in (None, status.st_mode & 0o7777) or self.gid not in (None, status.st_gid)
        if wrong:
            present = status.st_mode & 0o7777
            self._replace(mode=present if self.mode is None else self.mode).apply(file, path)

    def objection(self, status: os.stat_result, path: str) -> tuple[str, str] | None:
        """Return two texts: which unauthorized user could write to a file, and how to authorize this user.

        Return None if every user who can write is authorized.

        Authorized users are this user, root, the system services, and a user whose own group this user belongs to. A
        file of the configured group is accepted from any owner, because only members can give a file to a group. If the
        configured mode lets all users write, every file is accepted. The owner of a file decides its group and whether
        the group may write.
        """
        if (self.mode or 0) & stat.S_IWOTH:
            return None
        if status.st_mode & stat.S_IWOTH:
            leave = 'to allow all users, set mode = "0666" under [regions] in shmgen.toml, or mode=0o666 in Python'
            return "every user of this machine can write it", f"`chmod o-w {path}`; {leave}"
        if status.st_gid == self.gid or _known(status):
            return None
        group = name_of_group(status.st_gid)
        leave = (
            f'to allow its group, set group = "{group}" under [regions] in shmgen.toml, or group="{group}" in Python'
        )
        owner, user = name_of_user(status.st_uid), name_of_user(os.geteuid())
        return f"it belongs to user {owner}, but this program runs as {user}", leave


def access_for(options: RegionOptions) -> Access:
    """Return the file mode and group id that `options` request. Look up the id of a group given by name.

    Raises PermissionDenied if the group does not exist.
    """
    return Access(options.mode, _group_id(options.group))


def opened(path: str, how: int) -> io.FileIO:
    """Open an existing regular file, as shm_open does: without following links or waiting for a FIFO.

    `how` is the access mode, such as os.O_RDONLY.
    Raises FileNotFoundError, PermissionError, and RegionUnusable if the path is not a regular file.
    """
    try:
        flags = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        file: io.FileIO = close_after_fork(io.FileIO(os.open(path, how | flags)))
    except (FileNotFoundError, PermissionError):
        raise
    except OSError as error:
        raise RegionUnusable(f"{path} cannot be opened: {error.strerror}") from None
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise RegionUnusable(f"{path} is not a regular file, so it cannot be a region: remove it")
    return file


def denied(path: str) -> PermissionDenied:
    """Return the error for a file that this user may not open or create."""
    try:
        status = os.lstat(path)
    except OSError:
        return PermissionDenied(f"{path} cannot be created: check the permissions of /dev/shm")
    owner, group = name_of_user(status.st_uid), name_of_group(status.st_gid)
    return PermissionDenied(
        f"{path} belongs to {owner}:{group} with mode {status.st_mode & 0o7777:o}, but this program runs as "
        f"user {os.geteuid()}: {way_in(status)}"
    )


def way_in(status: os.stat_result) -> str:
    """Return advice for a user who may not open the file with this `status`.

    The advice never recommends joining a group that grants far more than access to this file, such as docker.
    """
    group = name_of_group(status.st_gid)
    if status.st_gid == 0 or group in _POWERFUL_GROUPS:
        return (
            f"run both sides as one user, or set `group` under [regions] in shmgen.toml to a group of both users and "
            f"let the other side create the file again; do not join {group}, which grants far more than this file"
        )
    if status.st_mode & 0o060 != 0o060:
        return "its group may not open it either: let its owner create it with mode 0660, or `chmod g+rw` it"
    return (
        f"join its group (`sudo usermod -aG {group} $USER`, then log in again), or let its owner give it another group"
    )


_POWERFUL_GROUPS = {"root", "sudo", "wheel", "admin", "adm", "docker", "lxd", "disk", "shadow", "kmem"}


def name_of_user(uid: int) -> str:
    """Return the name of a user, or the user id as text if there is no name."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def name_of_group(gid: int) -> str:
    """Return the name of a group, or the group id as text if there is no name."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _known(status: os.stat_result) -> bool:
    """Return True if the owner of the file is this user, a system service, or a user whose own group includes us."""
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
        if group.isdecimal():  # a group id without a name, as in containers
            return int(group)
        raise PermissionDenied(f"group {group!r} does not exist: `groupadd {group}` creates it") from None
