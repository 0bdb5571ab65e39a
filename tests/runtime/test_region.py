"""The region: its name, its bytes, who makes it, who is refused."""

from __future__ import annotations

import gc
import mmap
import os
import struct
import subprocess
import sys
import time

import posix_ipc
import pytest

from shmgen import runtime
from shmgen.core.abi import REPAIR_LOCK, WRITER_LOCK
from shmgen.runtime import engine
from shmgen.runtime.reference import memory_order, opening
from shmgen.runtime.reference.opening import _complete_header
from shmgen.runtime.region import header as h
from shmgen.runtime.region import record_locks

from ..support.region_of import region_of
from .messages import Pose, PosePublisher, PoseSubscriber, Scan, ScanSubscriber, pose

in_python = pytest.mark.usefixtures("in_python")


@pytest.mark.parametrize(
    ("topic", "name"),
    [
        *(("/robot/pose", "robot.pose"), ("pose", "pose"), ("/a/b_2/C", "a.b_2.C"), ("/sem", "sem"), ("/_x", "_x")),
        ("/" + "a" * 245, "a" * 245),
    ],
)
def test_region_name(topic, name):
    assert runtime.region_name(topic) == name


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        ("", "is empty"),
        ("/", "is empty"),
        ("/a//b", "is empty"),
        ("/a/", "is empty"),
        ("/a.b", "'a.b' has other characters"),
        ("/1a", "'1a' starts with a digit"),
        ("/a b", "'a b' has other characters"),
        ("/grün", "'grün' has other characters"),
        ("~/pose", "stands for a node's name"),
        ("/sem/robot", "are semaphores"),
        ("/GWDrvSharedMemShm", "CODESYS keeps"),
        ("/RetainMemory", "CODESYS keeps"),
        ("/CME-request", "CODESYS keeps"),
        ("/" + "a" * 246, "246 characters"),
    ],
)
def test_bad_topics_say_why(topic, reason):
    with pytest.raises(ValueError, match=reason):
        runtime.region_name(topic)


def test_the_longest_name_leaves_room_for_its_event():
    longest = 255 - len("sem.-event")
    assert runtime.region_name("/" + "a" * longest) == "a" * longest
    with pytest.raises(ValueError, match="246 characters; a file name leaves room for 245"):
        runtime.region_name("/" + "a" * (longest + 1))


def test_header_bytes(topic, file):
    with PosePublisher(topic, depth=3) as publisher:
        for x in (1.0, 2.0):
            publisher.publish(pose(x))
        before = time.time_ns()
        publisher.publish(pose(3.0))
        publisher.heartbeat()
        data = file.read_bytes()
    assert len(data) == 4096
    assert struct.unpack_from("<IHHQIIII", data) == (
        *(0x474D4853, 2, 192, 0x0123456789ABCDEF),
        *(56, 128, os.getpid(), 4),
    )
    assert data[:4] == b"SHMG"
    assert data[32:128] == b"geometry_msgs/msg/Pose".ljust(96, b"\0")
    assert struct.unpack_from("<IIII", data, 128) == (3, 0, 0, 0)
    assert struct.unpack_from("<II", data, 144) == (0, memory_order.keeps_order())
    # heartbeat of three samples and one without; nobody inside; three entered the lock
    assert struct.unpack_from("<IIIII", data, 152) == (4, 0, 0, 0, 3)
    assert data[172:192] == bytes(20)  # nobody has missed anything; the rest is reserved
    for number in (1, 2, 3):
        stamp, found, zero, *payload = struct.unpack_from("<QII7d", data, 192 + number * 128)
        assert (found, zero, payload) == (number, 0, [float(number)] * 7)
        assert before - 10**9 < stamp < before + 10**9
    assert data[192 : 192 + 128] == bytes(128)


@pytest.mark.parametrize(("depth", "slots"), [(1, 2), (2, 4), (3, 4), (4, 8), (16, 32)])
def test_slots_are_the_power_of_two_above_depth(topic, depth, slots):
    with PoseSubscriber(topic, depth=depth):
        found = runtime.read_header(runtime.region_name(topic))
    assert (found.slots, found.size) == (slots, -(-(192 + 2 * slots * 128) // 4096) * 4096)


@pytest.mark.parametrize("depth", [0, -1, 65536])
def test_impossible_depth(topic, file, depth):
    with pytest.raises(ValueError, match="from 1 to 65535"):
        PosePublisher(topic, depth=depth)
    assert not file.exists()


@pytest.mark.parametrize("timeout", [-1, float("nan"), 1.01])
def test_impossible_lock_timeout(topic, timeout):
    with pytest.raises(ValueError, match="lock_timeout"):
        PoseSubscriber(topic, lock_timeout=timeout)
    PoseSubscriber(topic, lock_timeout=1).close()


def test_long_type_names_keep_their_nul():
    longest = "p/msg/" + "N" * 89
    assert h.pack(h.header_for(longest, 1, 8, 1))[32:128] == longest.encode() + b"\0"
    assert h.unpack(h.pack(h.header_for(longest, 1, 8, 1)), 4096).type_name == longest
    with pytest.raises(ValueError, match="longer than the 95 bytes"):
        h.header_for(longest + "N", 1, 8, 1)


def test_read_header(topic):
    with pytest.raises(runtime.RegionMissing, match="does not exist"):
        runtime.read_header(runtime.region_name(topic))
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1.0))
        found = runtime.read_header(runtime.region_name(topic))
    assert (found.type_name, found.digest, found.newest) == (Pose._type_name_, Pose._digest_, 1)
    assert (found.turn, found.heartbeat, found.lock_count, found.writer) == (0, 1, 1, os.getpid())


def test_nobody_removes_on_exit(topic, file, semaphore_file, other):
    reader = other("read", topic)
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(7.0))
    reader.end()
    assert file.exists()
    assert semaphore_file.exists()
    with PoseSubscriber(topic) as late:
        assert late.read().position.x == 7.0


def change(file, offset, data):
    with file.open("r+b") as opened:
        opened.seek(offset)
        opened.write(data)


@pytest.mark.parametrize(
    ("offset", "data", "word"),
    [
        (8, b"\1", "digest 16#0123456789ABCD01"),
        (16, b"\x40", "64 bytes"),
        (20, b"\xc0", "slots of 192 bytes"),
        (28, b"\4", "the depth differs"),
        (32, b"G", "Geometry_msgs/msg/Pose"),
    ],
)
@pytest.mark.parametrize("side", [PosePublisher, PoseSubscriber])
def test_mismatch_is_refused_and_leaves_every_byte(topic, file, semaphore_file, side, offset, data, word):
    """While somebody publishes; later the region is replaced."""
    PosePublisher(topic).close()
    change(file, offset, data)
    semaphore_file.unlink()
    before = file.read_bytes()
    with file.open("r+b") as held:
        assert record_locks.lock_byte(held.fileno(), WRITER_LOCK)
        with pytest.raises(runtime.LayoutMismatch) as caught:
            side(topic)
    text = str(caught.value)
    assert word in text
    assert ("the depth differs" in text) == (word == "the depth differs")
    assert "here:  geometry_msgs/msg/Pose, 56 bytes, digest 16#0123456789ABCDEF" in text
    assert str(file) in text
    assert "writes it: update that side, or stop it" in text
    assert file.read_bytes() == before
    assert not semaphore_file.exists()
    side(topic).close()
    assert file.read_bytes()[8:128] != before[8:128]


@pytest.mark.parametrize(("offset", "data", "word"), [(4, b"\1\0", "ABI 1"), (6, b"\0\1", "")])
@pytest.mark.parametrize("side", [PosePublisher, PoseSubscriber])
def test_what_another_generation_has_made_is_never_replaced(topic, file, side, offset, data, word):
    PosePublisher(topic).close()
    change(file, offset, data)
    before = file.read_bytes()
    with pytest.raises(runtime.LayoutMismatch) as caught:
        side(topic)
    assert word in str(caught.value)
    assert f"shmgen clean {topic}" in str(caught.value)
    assert file.read_bytes() == before


@pytest.mark.parametrize("page", [16384, 65536])
def test_a_region_that_a_runtime_has_rounded_up_to_larger_pages(topic, file, page):
    """As on a Raspberry Pi 5; but not where something lies in the rest."""
    PosePublisher(topic).close()
    os.truncate(file, page)
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        assert subscriber.read().position.x == 1.0
    file.write_bytes(bytes(page))  # still being made
    PosePublisher(topic).close()
    assert file.stat().st_size == page
    change(file, page - 1, b"1")
    with file.open("r+b") as held:
        assert record_locks.lock_byte(held.fileno(), WRITER_LOCK)
        with pytest.raises(runtime.LayoutMismatch, match=f"{page:,} bytes in all"):
            PosePublisher(topic)


def test_mismatch_of_size_and_type(topic, file):
    PosePublisher(topic).close()
    before = file.read_bytes()
    with file.open("r+b") as held:
        assert record_locks.lock_byte(held.fileno(), WRITER_LOCK)
        with pytest.raises(runtime.LayoutMismatch, match="there: geometry_msgs/msg/Pose, 56 bytes, digest"):
            ScanSubscriber(topic)
        held.truncate(8192)
        with pytest.raises(runtime.LayoutMismatch, match="8,192 bytes in all"):
            PosePublisher(topic)
        assert file.read_bytes() == before + bytes(4096)
        held.truncate(100)
        with pytest.raises(runtime.LayoutMismatch, match="100 bytes in all"):
            PosePublisher(topic)


def test_a_region_without_magic_is_completed(topic, file):
    """A peer was killed between making the region and writing the header, or has only made it."""
    PosePublisher(topic).close()
    change(file, 0, bytes(192))
    change(file, 128, struct.pack("<II", 9, 9))
    with PoseSubscriber(topic):
        data = file.read_bytes()
    made = h.pack(h.header_for(Pose._type_name_, Pose._digest_, 56, 1))
    assert data[:128] == made[:128]
    assert struct.unpack_from("<II", data, 128) == (9, 9)


def test_a_header_completed_meanwhile_is_not_written_again(topic, file):
    """Two makers of different types at once: the second finds the magic of the first, and refuses."""
    PosePublisher(topic).close()
    before = file.read_bytes()
    with file.open("r+b") as opened:
        other = h.header_for("other_msgs/msg/Pose", 77, 56, 1)
        for _ in _complete_header(opened.fileno(), mmap.mmap(opened.fileno(), 4096), other):
            pass
    assert file.read_bytes() == before


@in_python
def test_a_barrier_stands_between_a_header_and_its_magic(topic, file, monkeypatch):
    seen = []
    monkeypatch.setattr(opening, "fence", lambda: seen.append(struct.unpack_from("<I4xQ", file.read_bytes())))
    PosePublisher(topic).close()
    assert seen == [(0, 0x0123456789ABCDEF)]
    assert struct.unpack_from("<I", file.read_bytes()) == (h.MAGIC,)


@in_python
def test_a_header_is_looked_at_again_once_it_is_there(topic, file, monkeypatch):
    """Two makers of different types at once: the first finds that the second has written over it, and refuses."""
    complete = opening._complete_header

    def both(*arguments):
        yield from complete(*arguments)
        change(file, 8, b"\x99")

    monkeypatch.setattr(opening, "_complete_header", both)
    with pytest.raises(runtime.LayoutMismatch):
        PosePublisher(topic)


@in_python
def test_an_object_whose_maker_lives_is_waited_for(topic, file, monkeypatch):
    naps = on_sleep(monkeypatch, lambda: os.truncate(file, 4096))
    file.touch(mode=0o600)
    monkeypatch.setattr(opening, "_allocate", None)
    PosePublisher(topic).close()
    assert set(naps) == {0.001}


@in_python
def test_who_writes_a_header_is_waited_for(topic, file, monkeypatch):
    PosePublisher(topic).close()
    header = file.read_bytes()[:192]
    change(file, 0, bytes(192))
    with file.open("r+b") as other:

        def written():
            change(file, 0, header)
            record_locks.unlock_byte(other.fileno(), REPAIR_LOCK)

        assert record_locks.lock_byte(other.fileno(), REPAIR_LOCK)
        naps = on_sleep(monkeypatch, written)
        monkeypatch.setattr(opening, "fence", None)
        PosePublisher(topic).close()
    assert naps[0] == 0.001


def on_sleep(monkeypatch, work):
    """Whoever sleeps finds `work` done when he wakes, however long it takes; how long each wanted to sleep."""
    sleep, naps = time.sleep, []

    def slept(seconds):
        naps.append(seconds)
        work()
        sleep(seconds)

    monkeypatch.setattr(time, "sleep", slept)
    monkeypatch.setattr(opening, "PEER_TIMEOUT", 60)
    return naps


@in_python
def test_without_barriers_a_region_has_a_lock(topic, file, monkeypatch):
    class Lockless(Pose):
        _regions_ = runtime.RegionOptions(sync="sequence")

    class LocklessSubscriber(runtime.Subscriber):
        message_type = Lockless

    monkeypatch.setattr(opening, "has_barrier", lambda: False)
    with pytest.raises(runtime.RegionUnusable, match=r'sync = "sequence" needs full memory barriers'):
        LocklessSubscriber(topic)
    assert not file.exists()
    PoseSubscriber(topic).close()


def test_an_object_without_bytes_is_waited_for_and_then_taken_over(topic, file):
    file.touch(mode=0o600)
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1.0))
        assert file.stat().st_size == 4096


def test_second_writer_is_refused_also_in_another_process(topic, other):
    with PosePublisher(topic), pytest.raises(runtime.RegionInUse, match=f"process {os.getpid()} publishes already"):
        PosePublisher(topic)
    writer = other("publish", topic)
    with pytest.raises(runtime.RegionInUse, match=f"process {writer.process.pid} publishes already"):
        PosePublisher(topic)
    writer.kill()
    PosePublisher(topic).close()


def test_a_refused_writer_does_not_free_the_claim(topic):
    with PosePublisher(topic):
        for _ in range(2):
            with pytest.raises(runtime.RegionInUse):
                PosePublisher(topic)
        PoseSubscriber(topic).close()
        with pytest.raises(runtime.RegionInUse):
            PosePublisher(topic)


def test_a_plc_whose_heartbeat_moves_is_a_writer(topic):
    beat = """if True:
        import itertools, sys, time
        from messages import PoseSubscriber, region_of
        with PoseSubscriber(sys.argv[1]) as plc:
            words = region_of(plc).words
            words[6] = 0xFFFFFFFF
            for count in itertools.count():
                words[38] = count & 0xFFFF
                if count == 3: print("ready", flush=True)
                time.sleep(0.01)
    """
    where = os.path.dirname(__file__)
    with subprocess.Popen([sys.executable, "-c", beat, topic], cwd=where, stdout=subprocess.PIPE) as plc:
        try:
            assert plc.stdout.readline() == b"ready\n"
            with pytest.raises(runtime.RegionInUse, match="a PLC publishes already"):
                PosePublisher(topic)
        finally:
            plc.kill()
    with PosePublisher(topic):
        assert runtime.read_header(runtime.region_name(topic)).writer == os.getpid()


@pytest.mark.parametrize("mode", [0o660, 0o600, 0o666])
def test_mode_whatever_the_umask(topic, file, semaphore_file, mode):
    umask = os.umask(0o077)
    try:
        PosePublisher(topic, **({} if mode == 0o660 else {"mode": mode})).close()
    finally:
        os.umask(umask)
    assert file.stat().st_mode & 0o777 == mode
    assert semaphore_file.stat().st_mode & 0o777 == mode


def test_what_a_killed_maker_left_at_the_umask_is_put_right_if_it_is_asked_for(topic, file, semaphore_file):
    """Killed between the making of the file and its chmod."""
    PosePublisher(topic).close()
    files = (file, semaphore_file)
    for left in files:
        left.chmod(0o640)
    PosePublisher(topic).close()
    assert [left.stat().st_mode & 0o777 for left in files] == [0o640] * 2
    PosePublisher(topic, mode=0o660).close()
    assert [left.stat().st_mode & 0o777 for left in files] == [0o660] * 2


@pytest.mark.skipif(os.geteuid() != 0, reason="makes a file of another user")
def test_a_file_of_another_user_stays_as_it_is(topic, file):
    PosePublisher(topic).close()
    os.chown(file, 65534, -1)
    PosePublisher(topic, mode=0o666).close()
    assert file.stat().st_mode & 0o777 == 0o660


def test_a_class_says_mode_and_group_and_an_argument_wins(topic, file, semaphore_file):
    class Configured(Pose):
        _regions_ = runtime.RegionOptions(mode=0o666, group="no_such_group")

    class ConfiguredPublisher(runtime.Publisher):
        message_type = Configured

    with pytest.raises(runtime.PermissionDenied, match="groupadd no_such_group"):
        ConfiguredPublisher(topic)
    assert not file.exists()
    ConfiguredPublisher(topic, group=os.getegid()).close()
    assert [left.stat().st_mode & 0o777 for left in (file, semaphore_file)] == [0o666] * 2
    ConfiguredPublisher(topic, group=os.getegid(), mode=0o600).close()
    assert [left.stat().st_mode & 0o777 for left in (file, semaphore_file)] == [0o600] * 2


def test_group(topic, file, semaphore_file):
    """One that files do not have anyway; root gives them to any, others to those they are in."""
    others = [54321] if os.geteuid() == 0 else [gid for gid in os.getgroups() if gid != os.getegid()]
    if not others:
        pytest.skip("this user is in one group only")
    event = semaphore_file.with_name(semaphore_file.name + "-event")
    files = (file, semaphore_file, event) if engine.IN_C else (file, semaphore_file)
    for gid, mode in ((others[0], 0o660), (os.getegid(), 0o640)):  # made here, then found
        with PosePublisher(topic, group=gid), PoseSubscriber(topic, group=gid) as subscriber:
            subscriber.wait(0)
        assert [left.stat().st_gid for left in files] == [gid] * len(files)
        assert [left.stat().st_mode & 0o777 for left in files] == [mode] * len(files)
        for left in files:
            left.chmod(0o640)  # which stays, as nobody asked for another
    with pytest.raises(runtime.PermissionDenied, match="groupadd no_such_group"):
        PosePublisher(topic, group="no_such_group")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become somebody else")
def test_no_permission_says_whose_it_is(topic, file, semaphore_file):
    PosePublisher(topic, mode=0o600).close()
    code = """if True:
        import os, sys
        from messages import PosePublisher
        from shmgen import runtime
        os.setgroups([]); os.setgid(65534); os.setuid(65534)
        if not os.access(runtime.__file__, os.R_OK):
            print("nothing can be read")
            sys.exit()
        for call in (lambda: PosePublisher(sys.argv[1]), lambda: runtime.read_header(runtime.region_name(sys.argv[1]))):
            try:
                call()
            except runtime.PermissionDenied as error:
                print(error)
    """
    command = [sys.executable, "-c", code, topic]
    run = lambda: subprocess.run(command, cwd=os.path.dirname(__file__), capture_output=True, text=True)  # noqa: E731
    said = run()
    if said.stdout == "nothing can be read\n":
        pytest.skip("another user may not enter the folder of this checkout")
    assert said.stdout.count(f"{file} belongs to root:root with mode 600") == 2, said
    os.chown(file, 65534, 65534)
    assert f"{semaphore_file} belongs to root:root with mode 600" in run().stdout


def test_semaphore_starts_free_and_is_left_free(topic):
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        semaphore = posix_ipc.Semaphore("/" + runtime.region_name(topic))
        assert semaphore.value == 1
        publisher.publish(pose(1.0))
        subscriber.read()
        assert semaphore.value == 1
        semaphore.close()


def test_many_openers_at_once_agree(topic, other):
    readers = [other("read", topic) for _ in range(3)]
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(5.0))
        assert [reader.ask("go") for reader in readers] == ["5.0"] * 3


def test_closing_twice_and_using_closed(topic):
    publisher, subscriber = PosePublisher(topic), PoseSubscriber(topic)
    for side in (publisher, subscriber, publisher, subscriber):
        side.close()
    calls = [
        *(lambda message=message: publisher.publish(message) for message in (pose(1.0), Pose())),
        publisher.heartbeat,
        *(subscriber.read, subscriber.samples, lambda: subscriber.read_into(Pose()), lambda: subscriber.wait(0.1)),
        *(lambda: subscriber.wait(0), lambda: subscriber.ready(0.1), lambda: subscriber.is_stale(1)),
    ]
    for call in calls:
        with pytest.raises(runtime.Closed, match=r"(publisher|subscriber) is closed"):
            call()
    assert (publisher.topic, publisher.sequence, subscriber.missed, subscriber.age) == (topic, 0, 0, None)


def test_record_locks_are_of_one_byte_each(topic):
    def locked(region, byte):
        return record_locks.byte_is_locked(region.file, byte)

    with PoseSubscriber(topic) as one, PoseSubscriber(topic) as other:
        first, second = region_of(one), region_of(other)
        assert record_locks.lock_byte(first.file, REPAIR_LOCK)
        assert not record_locks.lock_byte(second.file, REPAIR_LOCK)
        assert (locked(second, WRITER_LOCK), locked(second, REPAIR_LOCK)) == (False, True)
        assert record_locks.lock_byte(second.file, WRITER_LOCK)
        record_locks.unlock_byte(first.file, REPAIR_LOCK)
        assert (locked(first, WRITER_LOCK), locked(second, REPAIR_LOCK)) == (True, False)
        assert record_locks.lock_byte(second.file, REPAIR_LOCK)
        record_locks.unlock_byte(second.file, WRITER_LOCK)
        assert (locked(first, WRITER_LOCK), locked(first, REPAIR_LOCK)) == (False, True)


def test_a_record_lock_that_cannot_be_is_no_lock_of_another(topic, file):
    PosePublisher(topic).close()
    with file.open("rb") as opened, pytest.raises(OSError, match="Bad file descriptor"):
        record_locks.lock_byte(opened.fileno(), WRITER_LOCK)


def test_an_abandoned_publisher_frees_the_claim(topic):
    PosePublisher(topic)
    gc.collect()
    PosePublisher(topic).close()


def test_import_is_light():
    code = "import sys, shmgen.runtime; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    top = {name.partition(".")[0] for name in loaded}
    assert not top & {"jinja2", "click", "rosbags", "numpy", "multiprocessing", "tomli", "blark"}
    ours = {"shmgen", "shmgen.core", "shmgen.core.abi", "shmgen.core.escape", "shmgen.core.plural", "shmgen._core"}
    ours |= {"shmgen.core.table"}
    others = {name for name in loaded if name.startswith("shmgen")} - ours
    assert all(name.startswith("shmgen.runtime") for name in others), others


def test_layout_of_slots():
    header = h.header_for(Scan._type_name_, Scan._digest_, 100, 1)
    assert (header.slot_size, header.slots, header.size) == (128, 2, 4096)


def test_open_region_leaves_no_descriptor_behind_when_refused(topic):
    PosePublisher(topic).close()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        with PosePublisher(topic), pytest.raises(runtime.LayoutMismatch):
            ScanSubscriber(topic)
        with PosePublisher(topic), pytest.raises(runtime.RegionInUse):
            PosePublisher(topic)
    assert len(os.listdir("/proc/self/fd")) == before
