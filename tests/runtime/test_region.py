"""A region has the specified name and bytes, and refuses incompatible peers and second writers."""

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
def test_region_name_of_a_topic(topic, name):
    assert runtime.region_name(topic) == name


@pytest.mark.parametrize(
    ("topic", "reason"),
    [
        ("", "is empty"),
        ("/", "is empty"),
        ("/a//b", "is empty"),
        ("/a/", "is empty"),
        ("/a.b", "'a.b' has invalid characters"),
        ("/1a", "'1a' starts with a digit"),
        ("/a b", "'a b' has invalid characters"),
        ("/grün", "'grün' has invalid characters"),
        ("~/pose", "replace `~` by the name"),
        ("/sem/robot", "are semaphores"),
        ("/GWDrvSharedMemShm", "CODESYS reserves"),
        ("/RetainMemory", "CODESYS reserves"),
        ("/CME-request", "CODESYS reserves"),
        ("/" + "a" * 246, "246 characters"),
    ],
)
def test_invalid_topic_reports_the_reason(topic, reason):
    with pytest.raises(ValueError, match=reason):
        runtime.region_name(topic)


def test_longest_name_allows_for_the_name_of_its_event():
    longest = 255 - len("sem.-event")
    assert runtime.region_name("/" + "a" * longest) == "a" * longest
    with pytest.raises(ValueError, match="246 characters; the limit is 245"):
        runtime.region_name("/" + "a" * (longest + 1))


def test_header_and_slots_have_the_specified_bytes(topic, file):
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
    # four heartbeats (three with samples), no holder, and three acquisitions of the lock
    assert struct.unpack_from("<IIIII", data, 152) == (4, 0, 0, 0, 3)
    assert data[172:192] == bytes(20)  # no missed samples; the rest is reserved
    for number in (1, 2, 3):
        stamp, stored_number, zero, *payload = struct.unpack_from("<QII7d", data, 192 + number * 128)
        assert (stored_number, zero, payload) == (number, 0, [float(number)] * 7)
        assert before - 10**9 < stamp < before + 10**9
    assert data[192 : 192 + 128] == bytes(128)


@pytest.mark.parametrize(("depth", "slots"), [(1, 2), (2, 4), (3, 4), (4, 8), (16, 32)])
def test_slots_are_the_power_of_two_above_depth(topic, depth, slots):
    with PoseSubscriber(topic, depth=depth):
        header = runtime.read_header(runtime.region_name(topic))
    assert (header.slots, header.size) == (slots, -(-(192 + 2 * slots * 128) // 4096) * 4096)


@pytest.mark.parametrize("depth", [0, -1, 65536])
def test_invalid_depth_is_refused(topic, file, depth):
    with pytest.raises(ValueError, match="from 1 to 65535"):
        PosePublisher(topic, depth=depth)
    assert not file.exists()


@pytest.mark.parametrize("timeout", [-1, float("nan"), 1.01])
def test_invalid_lock_timeout_is_refused(topic, timeout):
    with pytest.raises(ValueError, match="lock_timeout"):
        PoseSubscriber(topic, lock_timeout=timeout)
    PoseSubscriber(topic, lock_timeout=1).close()


def test_long_type_names_keep_their_nul():
    longest = "p/msg/" + "N" * 89
    assert h.pack(h.header_for(longest, 1, 8, 1))[32:128] == longest.encode() + b"\0"
    assert h.unpack(h.pack(h.header_for(longest, 1, 8, 1)), 4096).type_name == longest
    with pytest.raises(ValueError, match="longer than the 95 bytes"):
        h.header_for(longest + "N", 1, 8, 1)


def test_read_header_returns_the_fields(topic):
    with pytest.raises(runtime.RegionMissing, match="does not exist"):
        runtime.read_header(runtime.region_name(topic))
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(1.0))
        header = runtime.read_header(runtime.region_name(topic))
    assert (header.type_name, header.digest, header.newest) == (Pose._type_name_, Pose._digest_, 1)
    assert (header.turn, header.heartbeat, header.lock_count, header.writer) == (0, 1, 1, os.getpid())


def test_close_does_not_remove_the_region(topic, file, semaphore_file, other):
    reader = other("read", topic)
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(7.0))
    reader.end()
    assert file.exists()
    assert semaphore_file.exists()
    with PoseSubscriber(topic) as late:
        assert late.read().position.x == 7.0


def overwrite(file, offset, data):
    with file.open("r+b") as stream:
        stream.seek(offset)
        stream.write(data)


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
def test_mismatch_is_refused_and_changes_no_byte(topic, file, semaphore_file, side, offset, data, word):
    """Refuse the region while a writer holds the claim. Replace it afterwards."""
    PosePublisher(topic).close()
    overwrite(file, offset, data)
    semaphore_file.unlink()
    before = file.read_bytes()
    with file.open("r+b") as stream:
        assert record_locks.lock_byte(stream.fileno(), WRITER_LOCK)
        with pytest.raises(runtime.LayoutMismatch) as caught:
            side(topic)
    text = str(caught.value)
    assert word in text
    assert ("the depth differs" in text) == (word == "the depth differs")
    assert "here:   geometry_msgs/msg/Pose, 56 bytes, digest 16#0123456789ABCDEF" in text
    assert str(file) in text
    assert "writes the region: update or stop it" in text
    assert file.read_bytes() == before
    assert not semaphore_file.exists()
    side(topic).close()
    assert file.read_bytes()[8:128] != before[8:128]


@pytest.mark.parametrize(("offset", "data", "word"), [(4, b"\1\0", "ABI 1"), (6, b"\0\1", "")])
@pytest.mark.parametrize("side", [PosePublisher, PoseSubscriber])
def test_region_of_another_abi_is_never_replaced(topic, file, side, offset, data, word):
    PosePublisher(topic).close()
    overwrite(file, offset, data)
    before = file.read_bytes()
    with pytest.raises(runtime.LayoutMismatch) as caught:
        side(topic)
    assert word in str(caught.value)
    assert f"shmgen clean {topic}" in str(caught.value)
    assert file.read_bytes() == before


@pytest.mark.parametrize("page", [16384, 65536])
def test_region_rounded_up_to_larger_pages_is_accepted(topic, file, page):
    """Accept larger pages, as on a Raspberry Pi 5, if the additional bytes are zero."""
    PosePublisher(topic).close()
    os.truncate(file, page)
    with PosePublisher(topic) as publisher, PoseSubscriber(topic) as subscriber:
        publisher.publish(pose(1))
        assert subscriber.read().position.x == 1.0
    file.write_bytes(bytes(page))  # not yet complete
    PosePublisher(topic).close()
    assert file.stat().st_size == page
    overwrite(file, page - 1, b"1")
    with file.open("r+b") as stream:
        assert record_locks.lock_byte(stream.fileno(), WRITER_LOCK)
        with pytest.raises(runtime.LayoutMismatch, match=f"{page:,} bytes in all"):
            PosePublisher(topic)


def test_mismatch_of_size_or_type_is_refused(topic, file):
    PosePublisher(topic).close()
    before = file.read_bytes()
    with file.open("r+b") as stream:
        assert record_locks.lock_byte(stream.fileno(), WRITER_LOCK)
        with pytest.raises(runtime.LayoutMismatch, match="region: geometry_msgs/msg/Pose, 56 bytes, digest"):
            ScanSubscriber(topic)
        stream.truncate(8192)
        with pytest.raises(runtime.LayoutMismatch, match="8,192 bytes in all"):
            PosePublisher(topic)
        assert file.read_bytes() == before + bytes(4096)
        stream.truncate(100)
        with pytest.raises(runtime.LayoutMismatch, match="100 bytes in all"):
            PosePublisher(topic)


def test_region_without_magic_is_completed(topic, file):
    """Complete the header if a peer has only created the region, or was killed before it wrote the header."""
    PosePublisher(topic).close()
    overwrite(file, 0, bytes(192))
    overwrite(file, 128, struct.pack("<II", 9, 9))
    with PoseSubscriber(topic):
        data = file.read_bytes()
    expected = h.pack(h.header_for(Pose._type_name_, Pose._digest_, 56, 1))
    assert data[:128] == expected[:128]
    assert struct.unpack_from("<II", data, 128) == (9, 9)


def test_header_completed_by_another_is_not_overwritten(topic, file):
    """Keep the header if another creator, even of another type, has already stored the magic number."""
    PosePublisher(topic).close()
    before = file.read_bytes()
    with file.open("r+b") as stream:
        other = h.header_for("other_msgs/msg/Pose", 77, 56, 1)
        for _ in _complete_header(stream.fileno(), mmap.mmap(stream.fileno(), 4096), other):
            pass
    assert file.read_bytes() == before


@in_python
def test_barrier_precedes_the_magic_of_a_header(topic, file, monkeypatch):
    seen = []
    monkeypatch.setattr(opening, "fence", lambda: seen.append(struct.unpack_from("<I4xQ", file.read_bytes())))
    PosePublisher(topic).close()
    assert seen == [(0, 0x0123456789ABCDEF)]
    assert struct.unpack_from("<I", file.read_bytes()) == (h.MAGIC,)


@in_python
def test_header_is_checked_after_it_was_written(topic, file, monkeypatch):
    """Refuse the region if a second creator, of another type, has overwritten the header."""
    complete = opening._complete_header

    def complete_and_overwrite(*arguments):
        yield from complete(*arguments)
        overwrite(file, 8, b"\x99")

    monkeypatch.setattr(opening, "_complete_header", complete_and_overwrite)
    with pytest.raises(runtime.LayoutMismatch):
        PosePublisher(topic)


@in_python
def test_opening_waits_for_a_live_creator(topic, file, monkeypatch):
    naps = work_on_sleep(monkeypatch, lambda: os.truncate(file, 4096))
    file.touch(mode=0o600)
    monkeypatch.setattr(opening, "_allocate", None)
    PosePublisher(topic).close()
    assert set(naps) == {0.001}


@in_python
def test_opening_waits_for_the_writer_of_the_header(topic, file, monkeypatch):
    PosePublisher(topic).close()
    header = file.read_bytes()[:192]
    overwrite(file, 0, bytes(192))
    with file.open("r+b") as other:

        def write_header():
            overwrite(file, 0, header)
            record_locks.unlock_byte(other.fileno(), REPAIR_LOCK)

        assert record_locks.lock_byte(other.fileno(), REPAIR_LOCK)
        naps = work_on_sleep(monkeypatch, write_header)
        monkeypatch.setattr(opening, "fence", None)
        PosePublisher(topic).close()
    assert naps[0] == 0.001


def work_on_sleep(monkeypatch, work):
    """Call `work` before each sleep, and extend the timeout of peers. Return the list of the requested durations."""
    sleep, naps = time.sleep, []

    def work_and_sleep(seconds):
        naps.append(seconds)
        work()
        sleep(seconds)

    monkeypatch.setattr(time, "sleep", work_and_sleep)
    monkeypatch.setattr(opening, "PEER_TIMEOUT", 60)
    return naps


@in_python
def test_region_without_a_lock_needs_barriers(topic, file, monkeypatch):
    class Lockless(Pose):
        _regions_ = runtime.RegionOptions(sync="sequence")

    class LocklessSubscriber(runtime.Subscriber):
        message_type = Lockless

    monkeypatch.setattr(opening, "has_barrier", lambda: False)
    with pytest.raises(runtime.RegionUnusable, match=r'sync = "sequence" needs full memory barriers'):
        LocklessSubscriber(topic)
    assert not file.exists()
    PoseSubscriber(topic).close()


def test_empty_file_is_taken_over_after_a_wait(topic, file):
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


def test_refused_writer_does_not_free_the_claim(topic):
    with PosePublisher(topic):
        for _ in range(2):
            with pytest.raises(runtime.RegionInUse):
                PosePublisher(topic)
        PoseSubscriber(topic).close()
        with pytest.raises(runtime.RegionInUse):
            PosePublisher(topic)


def test_plc_with_a_moving_heartbeat_keeps_its_claim(topic):
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
    folder = os.path.dirname(__file__)
    with subprocess.Popen([sys.executable, "-c", beat, topic], cwd=folder, stdout=subprocess.PIPE) as plc:
        try:
            assert plc.stdout.readline() == b"ready\n"
            with pytest.raises(runtime.RegionInUse, match="a PLC publishes already"):
                PosePublisher(topic)
        finally:
            plc.kill()
    with PosePublisher(topic):
        assert runtime.read_header(runtime.region_name(topic)).writer == os.getpid()


@pytest.mark.parametrize("mode", [0o660, 0o600, 0o666])
def test_mode_does_not_depend_on_the_umask(topic, file, semaphore_file, mode):
    umask = os.umask(0o077)
    try:
        PosePublisher(topic, **({} if mode == 0o660 else {"mode": mode})).close()
    finally:
        os.umask(umask)
    assert file.stat().st_mode & 0o777 == mode
    assert semaphore_file.stat().st_mode & 0o777 == mode


def test_explicit_mode_repairs_the_mode_of_a_killed_creator(topic, file, semaphore_file):
    """Repair the mode only if the caller requests a mode. A creator may be killed between open() and chmod()."""
    PosePublisher(topic).close()
    files = (file, semaphore_file)
    for path in files:
        path.chmod(0o640)
    PosePublisher(topic).close()
    assert [path.stat().st_mode & 0o777 for path in files] == [0o640] * 2
    PosePublisher(topic, mode=0o660).close()
    assert [path.stat().st_mode & 0o777 for path in files] == [0o660] * 2


@pytest.mark.skipif(os.geteuid() != 0, reason="creates a file of another user")
def test_file_of_another_user_keeps_its_mode(topic, file):
    PosePublisher(topic).close()
    os.chown(file, 65534, -1)
    PosePublisher(topic, mode=0o666).close()
    assert file.stat().st_mode & 0o777 == 0o660


def test_arguments_override_mode_and_group_of_the_class(topic, file, semaphore_file):
    class Configured(Pose):
        _regions_ = runtime.RegionOptions(mode=0o666, group="no_such_group")

    class ConfiguredPublisher(runtime.Publisher):
        message_type = Configured

    with pytest.raises(runtime.PermissionDenied, match="groupadd no_such_group"):
        ConfiguredPublisher(topic)
    assert not file.exists()
    ConfiguredPublisher(topic, group=os.getegid()).close()
    assert [path.stat().st_mode & 0o777 for path in (file, semaphore_file)] == [0o666] * 2
    ConfiguredPublisher(topic, group=os.getegid(), mode=0o600).close()
    assert [path.stat().st_mode & 0o777 for path in (file, semaphore_file)] == [0o600] * 2


def test_files_get_the_requested_group(topic, file, semaphore_file):
    """Use a group that is not the default: any group as root, otherwise another group of the user."""
    others = [54321] if os.geteuid() == 0 else [gid for gid in os.getgroups() if gid != os.getegid()]
    if not others:
        pytest.skip("this user is in one group only")
    event = semaphore_file.with_name(semaphore_file.name + "-event")
    files = (file, semaphore_file, event) if engine.IN_C else (file, semaphore_file)
    for gid, mode in ((others[0], 0o660), (os.getegid(), 0o640)):  # first created, then existing
        with PosePublisher(topic, group=gid), PoseSubscriber(topic, group=gid) as subscriber:
            subscriber.wait(0)
        assert [path.stat().st_gid for path in files] == [gid] * len(files)
        assert [path.stat().st_mode & 0o777 for path in files] == [mode] * len(files)
        for path in files:
            path.chmod(0o640)  # remains, because the caller requests no mode
    with pytest.raises(runtime.PermissionDenied, match="groupadd no_such_group"):
        PosePublisher(topic, group="no_such_group")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become another user")
def test_permission_error_names_owner_and_mode(topic, file, semaphore_file):
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
    result = run()
    if result.stdout == "nothing can be read\n":
        pytest.skip("another user may not enter the folder of this checkout")
    assert result.stdout.count(f"{file} belongs to root:root with mode 600") == 2, result
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


def test_many_processes_may_open_a_topic_at_once(topic, other):
    readers = [other("read", topic) for _ in range(3)]
    with PosePublisher(topic) as publisher:
        publisher.publish(pose(5.0))
        assert [reader.ask("go") for reader in readers] == ["5.0"] * 3


def test_closed_endpoints_refuse_calls_and_close_again(topic):
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


def test_record_locks_cover_one_byte_each(topic):
    def is_locked(region, byte):
        return record_locks.byte_is_locked(region.file, byte)

    with PoseSubscriber(topic) as reader, PoseSubscriber(topic) as other_reader:
        first, second = region_of(reader), region_of(other_reader)
        assert record_locks.lock_byte(first.file, REPAIR_LOCK)
        assert not record_locks.lock_byte(second.file, REPAIR_LOCK)
        assert (is_locked(second, WRITER_LOCK), is_locked(second, REPAIR_LOCK)) == (False, True)
        assert record_locks.lock_byte(second.file, WRITER_LOCK)
        record_locks.unlock_byte(first.file, REPAIR_LOCK)
        assert (is_locked(first, WRITER_LOCK), is_locked(second, REPAIR_LOCK)) == (True, False)
        assert record_locks.lock_byte(second.file, REPAIR_LOCK)
        record_locks.unlock_byte(second.file, WRITER_LOCK)
        assert (is_locked(first, WRITER_LOCK), is_locked(first, REPAIR_LOCK)) == (False, True)


def test_impossible_record_lock_raises_an_error(topic, file):
    PosePublisher(topic).close()
    with file.open("rb") as stream, pytest.raises(OSError, match="Bad file descriptor"):
        record_locks.lock_byte(stream.fileno(), WRITER_LOCK)


def test_unreferenced_publisher_frees_the_claim(topic):
    PosePublisher(topic)
    gc.collect()
    PosePublisher(topic).close()


def test_import_loads_few_modules():
    code = "import sys, shmgen.runtime; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    top = {name.partition(".")[0] for name in loaded}
    assert not top & {"jinja2", "click", "rosbags", "numpy", "multiprocessing", "tomli", "blark"}
    expected = {"shmgen", "shmgen.core", "shmgen.core.abi", "shmgen.core.escape", "shmgen.core.plural", "shmgen._core"}
    expected |= {"shmgen.core.table"}
    others = {name for name in loaded if name.startswith("shmgen")} - expected
    assert all(name.startswith("shmgen.runtime") for name in others), others


def test_layout_of_slots():
    header = h.header_for(Scan._type_name_, Scan._digest_, 100, 1)
    assert (header.slot_size, header.slots, header.size) == (128, 2, 4096)


def test_refused_opening_leaves_no_descriptor_open(topic):
    PosePublisher(topic).close()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        with PosePublisher(topic), pytest.raises(runtime.LayoutMismatch):
            ScanSubscriber(topic)
        with PosePublisher(topic), pytest.raises(runtime.RegionInUse):
            PosePublisher(topic)
    assert len(os.listdir("/proc/self/fd")) == before
