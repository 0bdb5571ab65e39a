"""Tests of the C and C++ API: calls in a wrong order, forks, waits, values that do not fit, samples in place."""

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
CASES = re.findall(r"CASE\((\w+)\),", (HERE / "api.c").read_text())


@pytest.fixture(scope="session")
def api_program(generated: Path) -> Path:
    return cpp_peer.compiled(generated, "api", HERE / "api.c")


@pytest.mark.parametrize("case", CASES)
def test_c_api_passes_case(case: str, api_program: Path, topic: str) -> None:
    process = subprocess.run([api_program, case, topic], capture_output=True, text=True, timeout=60, check=False)
    assert (process.stdout, process.returncode) == ("", 0)


# --- C++ --------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def all_kinds(generated: Path) -> Path:
    """Generated C++ of a message that has a field of each kind."""
    folder = generated / "ends"
    with kept.locked(folder / "lock"):
        if not (folder / "cpp").exists():
            cpp_peer.generate(folder, MESSAGES, package="shm_ends", types=TypeOptions(time="struct"))
    return folder


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.slow
def test_cpp_api_passes_under_sanitizers(compiler: str, all_kinds: Path, topic: str) -> None:
    """Run with sanitizers, because they detect overlapping copies that a plain run may not show."""
    options = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O0"]
    program = cpp_peer.compiled(all_kinds, f"api-{compiler}", HERE / "api.cpp", options=options, compiler=compiler)
    process = subprocess.run([program, topic], capture_output=True, text=True, timeout=60, check=False)
    assert (process.stdout, process.stderr, process.returncode) == ("", "", 0)


COMPILER_ERRORS = {
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
@pytest.mark.parametrize("line", COMPILER_ERRORS)
@pytest.mark.family("publisher.loan();-g++")
def test_wrong_use_does_not_compile(line: str, compiler: str, all_kinds: Path) -> None:
    errors = errors_of(line, compiler, all_kinds)
    assert re.search(COMPILER_ERRORS[line], errors), errors


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS)
def test_class_has_the_same_members_without_exceptions(compiler: str, all_kinds: Path) -> None:
    """Require the same members, because files of one program may differ in `-fno-exceptions`."""
    for end in ("AllPublisher", "AllSubscriber"):
        assertion = f"static_assert(std::is_constructible_v<{end}, std::string_view>);"
        assert errors_of(assertion, compiler, all_kinds, "-fno-exceptions") == ""
        assert "call open()" in errors_of(f'{end} end("/a");', compiler, all_kinds, "-fno-exceptions")


def errors_of(line: str, compiler: str, all_kinds: Path, *options: str) -> str:
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
    command = [compiler, *strict, f"-I{all_kinds}/cpp", "-fsyntax-only", "-"]
    return subprocess.run(command, input=source, capture_output=True, text=True, timeout=60, check=False).stderr


# --- groups -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("unshare"), reason="only root can mount over /etc/group")
def test_group_with_600_members_is_accepted(language: str, program: Path, topic: str, tmp_path: Path) -> None:
    """Read a group whose member list exceeds the usual buffer of getgrnam_r."""
    members = ",".join(f"member_of_the_cell_{number}" for number in range(600))
    (tmp_path / "group").write_text(f"root:x:0:\ncell:x:4711:{members}\n")
    bind = f'mount --bind {tmp_path}/group /etc/group && exec "$@"'
    with_own_group = ["unshare", "-m", "sh", "-c", bind, "sh"]
    if subprocess.run([*with_own_group, "true"], capture_output=True, timeout=20, check=False).returncode:
        pytest.skip("no mount namespaces")
    peer = cpp_peer.Peer(program, language, with_own_group)
    try:
        assert peer.opens("w", "pub", topic, "group=cell") == 0
        assert (Path("/dev/shm") / region_name(topic)).stat().st_gid == 4711
        assert peer.opens("x", "pub", topic, "group=no_such_group") == 7
    finally:
        peer.close()
