"""A build with CMake generates the files, and the generated Python can be a package."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest

from .conftest import REPOSITORY
from .drift.test_check import ARM, ROBOT, SETTINGS, write
from .support import import_or_skip
from .support.command import run

CMAKE = """cmake_minimum_required(VERSION 3.16)
project(robot_shm C CXX)
find_package(shmgen REQUIRED)
shmgen_generate(robot_messages INCLUDE interfaces/share INSTALL TARGETS c cpp cpp_ros2 python)
add_executable(size size.c)
target_link_libraries(size PRIVATE robot_messages)
add_executable(sends sends.cpp)
target_link_libraries(sends PRIVATE robot_messages)
target_compile_features(sends PRIVATE cxx_std_17)
target_compile_options(sends PRIVATE -Wall -Wextra -Wold-style-cast -Werror)
target_include_directories(sends PRIVATE ros)
"""
SENDS = """#include "shm_msgs/demo_msgs/msg/robot.hpp"
#include "shm_msgs_ros2/far_msgs/msg/far.hpp"
int main() {
    if (shmgen::to_ros(shm_msgs::far_msgs::msg::Far{}).a != 0)
        return 2;
    shm_msgs::demo_msgs::msg::RobotPublisher publisher("/shmgen_test/cmake");
    return publisher.publish({}) ? 0 : 1;
}
"""
FAR = "#include <cstdint>\nnamespace far_msgs::msg { struct Far { std::int8_t a, b; }; }\n"
SIZE = """#include <stdio.h>
#include "shm_msgs/demo_msgs/msg/robot.h"
int main(void) { printf("%zu\\n", sizeof(shm_demo_msgs_Robot)); return 0; }
"""


@pytest.mark.sample("Makefiles")
@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake")
@pytest.mark.parametrize("generator", ["Unix Makefiles", "Ninja"])
def test_cmake_regenerates_after_a_change(tmp_path: Path, generator: str) -> None:
    """Change an installed interface package below share/, one beside CMakeLists.txt, and one elsewhere."""
    if generator == "Ninja" and shutil.which("ninja") is None:
        pytest.skip("no ninja: apt-get install ninja-build")
    source, build, far = tmp_path / "source", tmp_path / "build", tmp_path / "far away"
    write(
        source,
        {
            "CMakeLists.txt": CMAKE,
            "size.c": SIZE,
            "sends.cpp": SENDS,
            "shmgen.toml": f'path = ["{far}"]\n'
            + SETTINGS.replace('"demo_msgs/Robot"', '"demo_msgs", "far_msgs"').replace('path = ["msgs"]\n', ""),
            "ros/far_msgs/msg/far.hpp": FAR,
            "msgs/other_msgs/msg/Other.msg": "int8 a\n",
            "interfaces/share/demo_msgs/package.xml": "<package><name>demo_msgs</name></package>",
            "interfaces/share/demo_msgs/msg/Robot.msg": ROBOT,
            "interfaces/share/demo_msgs/msg/Arm.msg": ARM,
        },
    )
    manifest = "<package><name>far_msgs</name><buildtool_depend>{}</buildtool_depend></package>"
    write(far, {"far_msgs/package.xml": manifest.format("catkin"), "far_msgs/msg/Far.msg": "int8 a\n"})
    bin = tmp_path / "bin"
    bin.mkdir()
    (bin / "shmgen").write_text(f'#!/bin/sh\nexec {sys.executable} -m shmgen "$@"\n')
    (bin / "shmgen").chmod(0o755)
    environment = {**os.environ, "PATH": f"{bin}:{os.environ['PATH']}"}

    def cmake(*arguments: object) -> str:
        command = ["cmake", *map(str, arguments)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def size() -> int:
        return int(subprocess.run([build / "size"], capture_output=True, check=True).stdout)

    install = tmp_path / "installed"
    options = [f"-Dshmgen_DIR={REPOSITORY / 'src' / 'shmgen' / 'cmake'}", f"-DCMAKE_INSTALL_PREFIX={install}"]
    cmake("-S", source, "-B", build, "-G", generator, *options)
    assert "shmgen generate robot_messages" in cmake("--build", build)
    before = size()
    assert "shmgen generate" not in cmake("--build", build)
    time.sleep(1.1)  # make may compare times in whole seconds
    write(source, {"interfaces/share/demo_msgs/msg/Arm.msg": ARM + "float64 last\n"})
    assert "shmgen generate robot_messages" in cmake("--build", build)
    assert size() > before
    for changed in (
        {"far_msgs/msg/Far.msg": "int8 a\nint8 b\n"},
        {"far_msgs/package.xml": manifest.format("ament_cmake")},
    ):
        assert "shmgen generate" not in cmake("--build", build)
        time.sleep(1.1)
        write(far, changed)
        assert "shmgen generate robot_messages" in cmake("--build", build), changed
    time.sleep(1.1)
    write(source, {"interfaces/share/late_msgs/msg/Late.idl": "module late_msgs {};\n"})
    assert "shmgen generate robot_messages" in cmake("--build", build)
    assert "shmgen generate" not in cmake("--build", build)
    cmake("--install", build)
    for header in (
        "shm_msgs/demo_msgs/msg/robot.h",
        "shm_msgs/demo_msgs/msg/robot.hpp",
        "shm_msgs_ros2/shmgen_ros.hpp",
    ):
        assert (install / "include" / header).is_file()
    assert subprocess.run([build / "sends"], check=False).returncode == 0
    for file in Path("/dev/shm").glob("*shmgen_test.cmake*"):
        file.unlink()
    assert (install / "share/robot_shm/shmgen/python/shm_msgs/demo_msgs/msg/_robot.py").is_file()
    assert not (source / "generated").exists()


def test_generated_python_is_built_as_a_wheel(tmp_path: Path) -> None:
    import_or_skip("hatchling")
    write(tmp_path, {"shmgen.toml": 'messages = ["std_msgs/Bool"]\ndistribution = "robot-shm 1.2.0"\n'})
    assert run(["generate", "-q"], tmp_path).code == 0
    assert run(["check"], tmp_path).code == 0
    project = tmp_path / "generated/python"
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path / "wheels")]
    subprocess.run(command, cwd=project, check=True, capture_output=True)
    (wheel,) = (tmp_path / "wheels").iterdir()
    assert wheel.name == "robot_shm-1.2.0-py3-none-any.whl"
    files = zipfile.ZipFile(wheel).namelist()
    assert {"shm_msgs/py.typed", "shm_msgs/std_msgs/msg/_bool.py"} <= set(files)
    environment = {**os.environ, "PYTHONPATH": f"{wheel}:{REPOSITORY / 'src'}"}
    code = "from shm_msgs.std_msgs.msg import Bool, BoolPublisher; print(Bool(data=True))"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("Bool(data=True)\n", "")


LIBRARY = """cmake_minimum_required(VERSION 3.20)
project(robot_shm C)
find_package(shmgen REQUIRED)
shmgen_generate(robot_messages INSTALL TARGETS c python)
shmgen_library(robot_messages INSTALL)
"""
DECLARED = """
typedef struct { const char *name, *group; uint64_t digest; uint32_t size, mode, sequence, reserved; } shmgen_type;
extern size_t shmgen_sizeof_publisher;
int shmgen_publisher_open(void *self, const char *topic, const shmgen_type *type, const void *options);
int shmgen_publisher_write(void *self, const void *message, size_t size, int64_t limit);
void shmgen_publisher_close(void *self);
const char *shmgen_status_text(int status);
"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake")
def test_shared_library_works_without_the_headers(tmp_path: Path, topic: str) -> None:
    """Call the library from Python through cffi, with the declarations above instead of the headers."""
    cffi = import_or_skip("cffi", reason="no cffi: pip install cffi")
    settings = 'messages = ["demo_msgs/Robot"]\npath = ["msgs"]\n'
    write(tmp_path, {"CMakeLists.txt": LIBRARY, "shmgen.toml": settings, "msgs/demo_msgs/msg/Robot.msg": "int32 a\n"})
    build, prefix = tmp_path / "build", tmp_path / "installed"
    (tmp_path / "shmgen").write_text(f'#!/bin/sh\nexec {sys.executable} -m shmgen "$@"\n')
    (tmp_path / "shmgen").chmod(0o755)
    options = [f"-Dshmgen_DIR={REPOSITORY / 'src' / 'shmgen' / 'cmake'}", f"-DCMAKE_INSTALL_PREFIX={prefix}"]
    options += [f"-DSHMGEN_EXECUTABLE={tmp_path / 'shmgen'}", "-DCMAKE_INSTALL_LIBDIR=lib"]
    for command in (["-S", tmp_path, "-B", build, *options], ["--build", build], ["--install", build]):
        done = subprocess.run(["cmake", *map(str, command)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    assert (prefix / "lib" / "libshmgen.a").is_file()
    if shutil.which("pkg-config"):
        environment = {**os.environ, "PKG_CONFIG_PATH": str(prefix / "lib" / "pkgconfig")}
        ask = ["pkg-config", "--cflags", "--libs", "shmgen"]
        done = subprocess.run(ask, env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.split() == [f"-I{prefix}/include", f"-L{prefix}/lib", "-lshmgen"]
    symbols = subprocess.run(
        ["nm", "-D", "--defined-only", prefix / "lib/libshmgen.so"], capture_output=True, text=True, check=True
    )
    assert {line.split()[-1].partition("@")[0][:7].lower() for line in symbols.stdout.splitlines()} == {"shmgen_"}

    ffi = cffi.FFI()
    ffi.cdef(DECLARED)
    library = ffi.dlopen(str(prefix / "lib" / "libshmgen.so"))
    sys.path.insert(0, str(build / "robot_messages" / "python"))
    try:
        from shm_msgs.demo_msgs.msg import Robot, RobotSubscriber
    finally:
        del sys.path[0]
    name = ffi.new("char[]", b"demo_msgs/msg/Robot")
    type_ = ffi.new("shmgen_type *", {"name": name, "digest": Robot._digest_, "size": Robot._size_})
    publisher = ffi.new("char[]", library.shmgen_sizeof_publisher)
    assert library.shmgen_publisher_open(publisher, topic.encode(), type_, ffi.NULL) == 0
    with RobotSubscriber(topic) as subscriber:
        message = ffi.from_buffer(bytes(Robot(a=7)))
        status = library.shmgen_publisher_write(publisher, message, len(message), 0)
        assert ffi.string(library.shmgen_status_text(status)) == b"done"
        assert subscriber.wait(30).a == 7
    library.shmgen_publisher_close(publisher)
