"""Files in /dev/shm that others made: which are used, which refused with the line that allows them, and traps."""

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
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become other users")

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
TOLD_GROUP = {"group": 2010}
TOLD_ALL = {"mode": 0o666}

# Who makes the files, with which mode and group; who opens them, and what he was told of.
USED = {
    "a PLC's own user, and one of its group": ("codesyscontrol", "0770", "", "robot", {}),
    "a PLC's own user, and root": ("codesyscontrol", "0750", "", "root", {}),
    "a PLC's user with a group for both": ("codesyscontrol", "0660", "cell", "robot", {}),
    "one's own": ("robot", "0600", "", "robot", {}),
    "one's own, with a group": ("robot", "0660", "cell", "robot", {}),
    "root's, as a unit makes them": ("root", "0660", "cell", "robot", {}),
    "a person's, in whose own group one is": ("vision", "0660", "", "robot", {}),
    "a person's of the group that was named": ("vision", "0660", "cell", "robot", TOLD_GROUP),
    "a person's of the group that was named, by root": ("vision", "0660", "cell", "root", TOLD_GROUP),
    "all users, as was said": ("mallory", "0666", "", "robot", TOLD_ALL),
    "all users, as was said to root": ("mallory", "0666", "", "root", TOLD_ALL),
}
ALL_MAY = (
    "every user of this machine can write it, and is not used\n"
    '  hint: `chmod o-w {}`; if all of them may, mode = "0666"'
)
REFUSED = {
    "what all may write": ("root", "0666", "", "robot", {}, ALL_MAY),
    "what all may write, by root": ("mallory", "0666", "", "root", {}, ALL_MAY),
    "what all may write, though the group is right": ("vision", "0662", "cell", "robot", TOLD_GROUP, ALL_MAY),
    "a stranger's, by root": ("mallory", "0660", "", "root", {}, "it belongs to mallory, a stranger to root"),
    "a stranger's of a group for everybody": ("mallory", "0660", "users", "robot", {}, 'group = "users" under'),
    "a person's of a group that was not named": ("vision", "0660", "cell", "robot", {}, 'group = "cell" under'),
    "a stranger's, though a group was named": ("mallory", "0660", "", "root", TOLD_GROUP, "a stranger to root"),
}  # fmt: skip


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What every reader got, in a mount namespace where those users exist."""
    folder = tmp_path_factory.mktemp("users")
    (folder / "passwd").write_text(PASSWD)
    (folder / "group").write_text(GROUP)
    binds = f"mount --bind {folder}/passwd /etc/passwd && mount --bind {folder}/group /etc/group"
    own = ["unshare", "-m", "sh", "-c", f'{binds} && exec "$@"', "sh"]
    cases = USED | {name: case[:5] for name, case in REFUSED.items()}
    asked = [dict(zip(("maker", "mode", "group", "reader", "told"), case, strict=True)) for case in cases.values()]
    topic = f"/shmgen_test/strangers{os.getpid()}"
    command = [*own, sys.executable, "-c", SCRIPT, topic]
    done = subprocess.run(command, cwd=HERE, input=json.dumps(asked), capture_output=True, text=True, check=False)
    if done.stderr.startswith(("unshare", "mount", "sh:")):
        pytest.skip("no mount namespaces: root may make them")
    assert done.returncode == 0, done.stderr
    answers = zip(cases, map(json.loads, done.stdout.splitlines()), strict=True)
    return f"/dev/shm/{runtime.region_name(topic)}", dict(answers)


@root_only
@pytest.mark.parametrize("case", USED)
def test_used(found, case):
    assert found[1][case] == ["3.0", "SHMG"]


@root_only
@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_the_line_that_allows_it(found, case):
    file, answers = found
    said, magic = answers[case]
    assert said.startswith(f"PermissionDenied: {file}: ")
    assert REFUSED[case][-1].format(file) in said
    assert magic == "SHMG"


def test_a_semaphore_that_all_may_write_is_refused_too(topic, semaphore_file):
    PosePublisher(topic).close()
    semaphore_file.chmod(0o666)
    with pytest.raises(runtime.PermissionDenied, match=f"{semaphore_file}: every user of this machine can write it"):
        PoseSubscriber(topic)
    PoseSubscriber(topic, mode=0o660).close()  # which puts it right, since it is this user's
    assert semaphore_file.stat().st_mode & 0o777 == 0o660


def test_a_group_that_its_maker_is_about_to_give(topic, file):
    """Between the making of a file and its chmod a peer waits, as it does before its first byte."""
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
def test_a_group_that_its_maker_may_not_give(topic, file, monkeypatch):
    def refuse(*of):
        raise PermissionError

    monkeypatch.setattr(access.os, "fchown", refuse)
    with pytest.raises(runtime.PermissionDenied, match=f"{file}: cannot be given to group 54321; join the group"):
        PosePublisher(topic, group=54321)
    assert not file.exists()


def test_a_user_and_a_group_without_a_name_are_called_by_their_numbers():
    assert (access.name_of_user(0), access.name_of_group(0)) == ("root", "root")
    assert (access.name_of_user(54321), access.name_of_group(54321)) == ("54321", "54321")


@pytest.mark.parametrize(
    ("primary", "name", "known"), [(7000, "vision", True), (7000, "users", False), (7001, "vision", False)]
)
def test_a_persons_own_group_is_his_first_and_has_his_name(monkeypatch, primary, name, known):
    """One that many have as their first is nobody's own, nor is one that is only called like its owner."""
    person = SimpleNamespace(pw_gid=primary, pw_name="vision")
    group = SimpleNamespace(gr_gid=7000, gr_name=name)
    monkeypatch.setattr(access, "pwd", SimpleNamespace(getpwuid=lambda uid: person))
    monkeypatch.setattr(access, "grp", SimpleNamespace(getgrgid=lambda gid: group))
    monkeypatch.setattr(access.os, "getgroups", lambda: [7000])
    assert access._known(SimpleNamespace(st_uid=54321, st_gid=7000)) is known


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
def test_what_is_no_file_is_an_error_and_stays_as_it_is(topic, place, tmp_path, trap):
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


def test_reading_a_header_waits_for_no_fifo(topic, file):
    os.mkfifo(file)
    with pytest.raises(runtime.RegionUnusable, match="is not a regular file"):
        runtime.read_header(runtime.region_name(topic))


@pytest.mark.usefixtures("in_python")
@pytest.mark.parametrize("when", ["found", "made"])
def test_a_link_put_in_place_of_a_semaphore_meanwhile(topic, semaphore_file, tmp_path, monkeypatch, when):
    """Mode and group are given to what was opened; a link that came since is not followed, nor is it used."""
    victim = tmp_path / "secret"
    victim.write_bytes(b"mine")
    victim.chmod(0o600)
    swaps = []

    def swap():
        if not swaps:
            semaphore_file.unlink()
            semaphore_file.symlink_to(victim)
        swaps.append(1)

    def opening(*arguments):
        opened = found(*arguments)
        swap()
        return opened

    class Making:
        def __init__(self, *arguments, **keywords):
            self.made = real(*arguments, **keywords)

        def close(self):
            self.made.close()
            swap()

    real, found = regions.posix_ipc.Semaphore, regions.Semaphore
    if when == "found":
        PosePublisher(topic).close()
        monkeypatch.setattr(regions, "Semaphore", opening)
    else:
        monkeypatch.setattr(regions.posix_ipc, "Semaphore", Making)
    with pytest.raises(runtime.RegionUnusable, match=f"{semaphore_file} cannot be opened: "):
        PosePublisher(topic, mode=0o666).publish(pose(1.0))
    assert swaps
    assert victim.stat().st_mode & 0o777 == 0o600
