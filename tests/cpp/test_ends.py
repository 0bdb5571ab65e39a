"""What C and C++ promise users: calls in a wrong order, forks, waits, values that do not fit, samples in place."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from shmgen.core.model import TypeOptions
from shmgen.runtime import region_name

from ..support import cpp_peer, kept
from ..support.cpp_peer import COMPILERS, HERE

ALL = """string<=9 text
wstring<=9 wide
uint8[<=8] bytes
int16[<=4] shorts
float32[<=4] floats
uint8[2] fixed
bool flag
builtin_interfaces/Time stamp
builtin_interfaces/Duration span
Part[<=2] parts
"""
MESSAGES = {"ends_msgs/msg/All.msg": ALL, "ends_msgs/msg/Part.msg": "string<=9 name\nuint8[<=4] marks\n"}
CASES = re.findall(r"CASE\((\w+)\),", (HERE / "alone.c").read_text())


@pytest.fixture(scope="session")
def alone(generated: Path) -> Path:
    return cpp_peer.compiled(generated, "alone", HERE / "alone.c")


@pytest.mark.parametrize("case", CASES)
def test_in_c(case: str, alone: Path, topic: str) -> None:
    done = subprocess.run([alone, case, topic], capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.returncode) == ("", 0)


# --- C++ --------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def of_all(generated: Path) -> Path:
    """C++ of a message that has a field of each kind."""
    folder = generated / "ends"
    with kept.locked(folder / "lock"):
        if not (folder / "cpp").exists():
            cpp_peer.generate(folder, MESSAGES, package="shm_ends", types=TypeOptions(time="struct"))
    return folder


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.family("[g++]")
def test_in_cpp(compiler: str, of_all: Path, topic: str) -> None:
    """With sanitizers: a copy whose ends overlap is one thing that they see and a test without them may not."""
    options = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O0"]
    program = cpp_peer.compiled(of_all, f"api-{compiler}", HERE / "api.cpp", options=options, compiler=compiler)
    done = subprocess.run([program, topic], capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.stderr, done.returncode) == ("", "", 0)


REFUSED = {
    "bool ok = publisher.publish(message); (void)ok;": "cannot convert|no viable conversion",
    "int code = publisher.publish(message); (void)code;": "cannot convert|no viable conversion",
    "publisher.publish(message);": "nodiscard",
    "publisher.heartbeat();": "nodiscard",
    "subscriber.read_into(message);": "nodiscard",
    "subscriber.read();": "nodiscard",
    "subscriber.wait(1ms);": "nodiscard",
    "publisher.loan();": "nodiscard",
    "subscriber.borrow().give_back();": "nodiscard",
    "message.text.empty();": "nodiscard",
    "message.bytes = {300};": "narrowing|cannot be narrowed",
    "message.bytes = std::vector<double>{1.5};": "round them first",
    "subscriber.borrow()->text = message.text;": "discards qualifiers|no viable overloaded|passing .const",
    "auto one = publisher.loan(); auto two = one;": "deleted",
}


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("line", REFUSED)
@pytest.mark.family("publisher.loan();-g++")
def test_what_a_compiler_refuses(line: str, compiler: str, of_all: Path) -> None:
    errors = errors_of(line, compiler, of_all)
    assert re.search(REFUSED[line], errors), errors


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS)
def test_a_class_is_the_same_without_exceptions(compiler: str, of_all: Path) -> None:
    """Files of one program may differ in `-fno-exceptions`, so all of them must declare the same members."""
    for end in ("AllPublisher", "AllSubscriber"):
        declared = f"static_assert(std::is_constructible_v<{end}, std::string_view>);"
        assert errors_of(declared, compiler, of_all, "-fno-exceptions") == ""
        assert "call open()" in errors_of(f'{end} end("/a");', compiler, of_all, "-fno-exceptions")


def errors_of(line: str, compiler: str, of_all: Path, *options: str) -> str:
    """Return the compiler's errors about one line in a function with a publisher, a subscriber and a message."""
    source = f"""
        #include "shm_ends/ends_msgs/msg/all.hpp"
        using namespace std::chrono_literals;
        using namespace shm_ends::ends_msgs::msg;
        void use(AllPublisher &publisher, AllSubscriber &subscriber, All &message)
        {{
            (void)publisher, (void)subscriber, (void)message;
            {line}
        }}"""
    strict = ["-xc++", "-std=c++17", "-Wall", "-Wextra", "-Werror", *options]
    command = [compiler, *strict, f"-I{of_all}/cpp", "-fsyntax-only", "-"]
    return subprocess.run(command, input=source, capture_output=True, text=True, timeout=60, check=False).stderr


# --- groups -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("unshare"), reason="only root makes a group of its own")
def test_a_group_may_have_many_members(language: str, program: Path, topic: str, tmp_path: Path) -> None:
    """600 of them take more room than getgrnam_r is usually given."""
    members = ",".join(f"member_of_the_cell_{number}" for number in range(600))
    (tmp_path / "group").write_text(f"root:x:0:\ncell:x:4711:{members}\n")
    bind = f'mount --bind {tmp_path}/group /etc/group && exec "$@"'
    own = ["unshare", "-m", "sh", "-c", bind, "sh"]
    if subprocess.run([*own, "true"], capture_output=True, timeout=20, check=False).returncode:
        pytest.skip("no mount namespaces")
    peer = cpp_peer.Peer(program, language, own)
    try:
        assert peer.opens("w", "pub", topic, "group=cell") == 0
        assert (Path("/dev/shm") / region_name(topic)).stat().st_gid == 4711
        assert peer.opens("x", "pub", topic, "group=no_such_group") == 7
    finally:
        peer.close()
