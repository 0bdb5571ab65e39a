"""Files of other users in /dev/shm are used or refused. A refusal names the setting that permits the file."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from shmgen import runtime
from shmgen.runtime.reference import opening as regions
from shmgen.runtime.region import access

from .messages import PosePublisher, PoseSubscriber, pose

HERE = Path(__file__).parent
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become other users")

PASSWD = """\
root:x:0:0::/:/bin/sh
codesyscontrol:x:999:998::/:/bin/sh
robot:x:2001:2001::/:/bin/sh
mallory:x:1000:1000::/:/bin/sh
vision:x:2003:2003::/:/bin/sh
"""
GROUP = """\
root:x:0:
users:x:100:robot,mallory
codesyscontrol:x:998:robot
robot:x:2001:
mallory:x:1000:
vision:x:2003:robot
cell:x:2010:robot,vision,codesyscontrol
"""
SCRIPT = """
import grp, json, os, pwd, sys
from messages import PosePublisher, PoseSubscriber, pose
from shmgen import runtime

def as_user(name, work):
    out, into = os.pipe()
    if os.fork() == 0:
        try:
            user = pwd.getpwnam(name)
            os.initgroups(name, user.pw_gid); os.setgid(user.pw_gid); os.setuid(user.pw_uid)
            said = work()
        except BaseException as error:
            said = f"{type(error).__name__}: {error}"
        os.write(into, str(said).encode())
        os._exit(0)
    os.close(into)
    with open(out) as pipe:
        said = pipe.read()
    os.wait()
    return said

def make():
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(3.0))
    for file in files:
        os.chmod(file, int(case["mode"], 8))
        if case["group"]:
            os.chown(file, -1, grp.getgrnam(case["group"]).gr_gid)

def take():
    with PoseSubscriber(topic, **case["told"]) as subscriber:
        return subscriber.read().position.x

topic = sys.argv[1]
name = runtime.region_name(topic)
files = [f"/dev/shm/{name}", f"/dev/shm/sem.{name}"]
for case in json.load(sys.stdin):
    said = as_user(case["maker"], make)
    assert said == "None", (case, said)
    print(json.dumps([as_user(case["reader"], take), open(files[0], "rb").read()[:4].decode()]))
    for file in files:
        os.unlink(file)
"""
GROUP_OPTION = {"group": 2010}
MODE_OPTION = {"mode": 0o666}

# Each case lists the creator, mode and group of the files, and the reader with its options.
USED = {
    "a PLC's user, and a member of its group": ("codesyscontrol", "0770", "", "robot", {}),
    "a PLC's user, and root": ("codesyscontrol", "0750", "", "root", {}),
    "a PLC's user with a common group": ("codesyscontrol", "0660", "cell", "robot", {}),
    "the reader's own": ("robot", "0600", "", "robot", {}),
    "the reader's own, with a group": ("robot", "0660", "cell", "robot", {}),
    "root's, like those of a systemd unit": ("root", "0660", "cell", "robot", {}),
    "a person's, whose own group the reader is in": ("vision", "0660", "", "robot", {}),
    "a person's of the configured group": ("vision", "0660", "cell", "robot", GROUP_OPTION),
    "a person's of the configured group, and root": ("vision", "0660", "cell", "root", GROUP_OPTION),
    "all users, as configured": ("mallory", "0666", "", "robot", MODE_OPTION),
    "all users, as configured for root": ("mallory", "0666", "", "root", MODE_OPTION),
}
ALL_MAY = (
    "the file is not used, because every user of this machine can write it\n"
    '  hint: `chmod o-w {}`; to allow all users, set mode = "0666"'
)
REFUSED = {
    "writable by all": ("root", "0666", "", "robot", {}, ALL_MAY),
    "writable by all, and root": ("mallory", "0666", "", "root", {}, ALL_MAY),
    "writable by all, with the configured group": ("vision", "0662", "cell", "robot", GROUP_OPTION, ALL_MAY),
    "another user's, and root": ("mallory", "0660", "", "root", {}, "belongs to user mallory"),
    "another user's of a group of all users": ("mallory", "0660", "users", "robot", {}, 'group = "users" under'),
    "a person's of a group that is not configured": ("vision", "0660", "cell", "robot", {}, 'group = "cell" under'),
    "another user's, with a configured group": ("mallory", "0660", "", "root", GROUP_OPTION, "belongs to user mallory"),
}  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """The result of every reader, in a mount namespace with these users."""
    folder = tmp_path_factory.mktemp("users")
    (folder / "passwd").write_text(PASSWD)
    (folder / "group").write_text(GROUP)
    binds = f"mount --bind {folder}/passwd /etc/passwd && mount --bind {folder}/group /etc/group"
    namespace = ["unshare", "-m", "sh", "-c", f'{binds} && exec "$@"', "sh"]
    cases = USED | {name: case[:5] for name, case in REFUSED.items()}
    inputs = [dict(zip(("maker", "mode", "group", "reader", "told"), case, strict=True)) for case in cases.values()]
    topic = f"/shmgen_test/strangers{os.getpid()}"
    command = [*namespace, sys.executable, "-c", SCRIPT, topic]
    done = subprocess.run(command, cwd=HERE, input=json.dumps(inputs), capture_output=True, text=True, check=False)
    if done.stderr.startswith(("unshare", "mount", "sh:")):
        pytest.skip("no mount namespaces: root may make them")
    assert done.returncode == 0, done.stderr
    answers = zip(cases, map(json.loads, done.stdout.splitlines()), strict=True)
    return f"/dev/shm/{runtime.region_name(topic)}", dict(answers)


@root_only
@pytest.mark.parametrize("case", USED)
def test_permitted_file_is_used(results, case):
    assert results[1][case] == ["3.0", "SHMG"]


@root_only
@pytest.mark.parametrize("case", REFUSED)
def test_refusal_names_the_setting_that_permits_the_file(results, case):
    file, answers = results
    error, magic = answers[case]
    assert error.startswith(f"PermissionDenied: {file}: ")
    assert REFUSED[case][-1].format(file) in error
    assert magic == "SHMG"


def test_semaphore_writable_by_all_users_is_refused(topic, semaphore_file):
    PosePublisher(topic).close()
    semaphore_file.chmod(0o666)
    with pytest.raises(runtime.PermissionDenied, match=f"{semaphore_file}: the file is not used, because every"):
        PoseSubscriber(topic)
    PoseSubscriber(topic, mode=0o660).close()  # repairs the mode, because the file belongs to this user
    assert semaphore_file.stat().st_mode & 0o777 == 0o660


def test_opening_waits_until_the_creator_has_set_the_mode(topic, file):
    """Wait 0.1 s for the chmod() after the creation of a file, as for its first byte. Then refuse the file."""
    PosePublisher(topic).close()
    file.chmod(0o666)
    timer = threading.Timer(0.02, file.chmod, [0o660])
    timer.start()
    PoseSubscriber(topic).close()
    timer.join()
    file.chmod(0o666)
    before = time.monotonic()
    with pytest.raises(runtime.PermissionDenied, match="every user"):
        PoseSubscriber(topic)
    assert time.monotonic() - before >= 0.1


@pytest.mark.usefixtures("in_python")
def test_group_that_the_creator_may_not_set_is_an_error(topic, file, monkeypatch):
    def refuse(*arguments):
        raise PermissionError

    monkeypatch.setattr(access.os, "fchown", refuse)
    with pytest.raises(runtime.PermissionDenied, match=f"{file}: only members may set group 54321; join the group"):
        PosePublisher(topic, group=54321)
    assert not file.exists()


def test_user_or_group_without_a_name_is_shown_as_a_number():
    assert (access.name_of_user(0), access.name_of_group(0)) == ("root", "root")
    assert (access.name_of_user(54321), access.name_of_group(54321)) == ("54321", "54321")


@pytest.mark.parametrize(
    ("primary", "name", "is_known"), [(7000, "vision", True), (7000, "users", False), (7001, "vision", False)]
)
def test_private_group_is_primary_and_has_the_users_name(monkeypatch, primary, name, is_known):
    """Reject a primary group with another name, and a group with the user's name that is not primary."""
    person = SimpleNamespace(pw_gid=primary, pw_name="vision")
    group = SimpleNamespace(gr_gid=7000, gr_name=name)
    monkeypatch.setattr(access, "pwd", SimpleNamespace(getpwuid=lambda uid: person))
    monkeypatch.setattr(access, "grp", SimpleNamespace(getgrgid=lambda gid: group))
    monkeypatch.setattr(access.os, "getgroups", lambda: [7000])
    assert access._known(SimpleNamespace(st_uid=54321, st_gid=7000)) is is_known


@pytest.fixture(params=["region", "semaphore"])
def place(request, file, semaphore_file):
    return file if request.param == "region" else semaphore_file


def trap_fifo(path, folder):
    os.mkfifo(path)


def trap_link(path, folder):
    victim = folder / "secret"
    victim.write_bytes(b"mine" * 2000)
    victim.chmod(0o600)
    path.symlink_to(victim)


def trap_folder(path, folder):
    path.mkdir()


@pytest.mark.parametrize("trap", [trap_fifo, trap_link, trap_folder])
def test_irregular_file_is_refused_and_unchanged(topic, place, tmp_path, trap):
    PosePublisher(topic).close()
    place.unlink()
    trap(place, tmp_path)
    for side in (PosePublisher, PoseSubscriber):
        with pytest.raises(runtime.RegionUnusable, match=f"{place} (is not a regular file|cannot be opened: )"):
            side(topic, mode=0o640)
    if trap is trap_link:
        victim = tmp_path / "secret"
        assert (victim.stat().st_mode & 0o777, victim.read_bytes()) == (0o600, b"mine" * 2000)
    place.rmdir() if trap is trap_folder else place.unlink()


def test_read_header_does_not_block_on_a_fifo(topic, file):
    os.mkfifo(file)
    with pytest.raises(runtime.RegionUnusable, match="is not a regular file"):
        runtime.read_header(runtime.region_name(topic))


@pytest.mark.usefixtures("in_python")
@pytest.mark.parametrize("when", ["found", "made"])
def test_symlink_that_replaces_a_semaphore_is_not_followed(topic, semaphore_file, tmp_path, monkeypatch, when):
    """Set mode and group only on the opened file. Do not use a symlink that has replaced the file since then."""
    victim = tmp_path / "secret"
    victim.write_bytes(b"mine")
    victim.chmod(0o600)
    swaps = []

    def swap():
        if not swaps:
            semaphore_file.unlink()
            semaphore_file.symlink_to(victim)
        swaps.append(1)

    def open_and_swap(*arguments):
        semaphore = open_semaphore(*arguments)
        swap()
        return semaphore

    class SwappingSemaphore:
        def __init__(self, *arguments, **keywords):
            self.semaphore = create(*arguments, **keywords)

        def close(self):
            self.semaphore.close()
            swap()

    create, open_semaphore = regions.posix_ipc.Semaphore, regions.Semaphore
    if when == "found":
        PosePublisher(topic).close()
        monkeypatch.setattr(regions, "Semaphore", open_and_swap)
    else:
        monkeypatch.setattr(regions.posix_ipc, "Semaphore", SwappingSemaphore)
    with pytest.raises(runtime.RegionUnusable, match=f"{semaphore_file} cannot be opened: "):
        PosePublisher(topic, mode=0o666).publish(pose(1.0))
    assert swaps
    assert victim.stat().st_mode & 0o777 == 0o600
