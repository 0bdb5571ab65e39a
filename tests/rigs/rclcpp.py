"""Build rclcpp and hardware_interface of Jazzy from their sources against the wheels of ROS 2, into .venv/rclcpp.

    python -m tests.rigs.rclcpp FOLDER

Finds the packages below FOLDER by their package.xml. Builds the missing packages in the order of their dependencies, in
about 10 minutes on two processors. If a package fails, the rig still builds the packages that do not depend on it. The
logs are in .venv/rclcpp/log. The exit code is 1 if a target is missing.

hardware_interface also needs the source of TinyXML-2 (tinyxml2.cpp) below FOLDER, see `build_tinyxml2`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

from ..support import REPOSITORY
from ..support.rclcpp import BUILT, WHEELS, search_paths
from ..support.wheels import cmake_prefix

TARGETS = ("rclcpp_action", "rclcpp_lifecycle", "rclcpp_components", "hardware_interface")
STAND_INS = {
    "backward_ros": "",  # prints stacks of crashed programs; joint_limits finds the package and uses nothing of it
    "console_bridge_vendor": "find_package(console_bridge REQUIRED)",
    "tinyxml2_vendor": "find_package(TinyXML2 REQUIRED)",
    "TinyXML2": f"""if(NOT TARGET tinyxml2::tinyxml2)
  add_library(tinyxml2::tinyxml2 STATIC IMPORTED)
  set_target_properties(tinyxml2::tinyxml2 PROPERTIES IMPORTED_LOCATION {BUILT}/lib/libtinyxml2_renamed.a
    INTERFACE_INCLUDE_DIRECTORIES {BUILT}/include/tinyxml2 INTERFACE_COMPILE_DEFINITIONS tinyxml2=tinyxml2_renamed)
endif()
set(TinyXML2_LIBRARIES tinyxml2::tinyxml2)
set(TinyXML2_TARGETS tinyxml2::tinyxml2)
""",
}
"""The CMake files of packages that have no build of their own here."""
SETTINGS = (
    f"-DCMAKE_INSTALL_PREFIX={BUILT}",
    "-DCMAKE_BUILD_TYPE=Release",
    "-DCMAKE_CXX_FLAGS_RELEASE=-O1 -DNDEBUG -w",
    "-DCMAKE_CXX_STANDARD=17",
    "-DBUILD_TESTING=OFF",
    f"-DPython3_EXECUTABLE={WHEELS}/bin/python",
    "-DPython3_FIND_VIRTUALENV=ONLY",
)


def main() -> None:
    """Build each target and print the progress."""
    folder = Path(sys.argv[1])
    sources = find_sources(folder)
    prepare()
    failed = set() if build_tinyxml2(folder) else {"tinyxml2_vendor"}
    for target in TARGETS:
        for name in with_dependencies(target, sources):
            if name in failed or is_installed(name):
                continue
            if failed.intersection(dependencies(sources[name])) or not build(name, sources[name]):
                failed.add(name)
    missing = [target for target in TARGETS if not is_installed(target)]
    print(f"{BUILT}: " + (f"without {', '.join(missing)}" if missing else "complete"), flush=True)
    sys.exit(1 if missing else 0)


def find_sources(folder: Path) -> dict[str, Path]:
    """Return the folder of each package by the package's name."""
    files = sorted(folder.rglob("package.xml"))
    return {ElementTree.parse(file).findtext("name", "").strip(): file.parent for file in files}


def prepare() -> None:
    """Create the prefix of the wheels and the stand-ins, if they are missing."""
    if not WHEELS.exists():
        cmake_prefix(REPOSITORY / ".venv" / "ros2-jazzy", WHEELS)
    for name, text in STAND_INS.items():
        file = BUILT / "share" / name / "cmake" / f"{name}Config.cmake"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    (BUILT / "log").mkdir(exist_ok=True)


def build_tinyxml2(folder: Path) -> bool:
    """Build TinyXML-2 as a static library with a renamed namespace. Return False if its source is missing.

    Fast DDS in the wheels loads version 6. If a process also loaded Debian's version 9, one version would call
    functions of the other version.
    """
    source = next(folder.rglob("tinyxml2.cpp"), None)
    if source is None:
        print(f"no tinyxml2.cpp below {folder}: hardware_interface requires this file", flush=True)
        return False
    library, headers = BUILT / "lib" / "libtinyxml2_renamed.a", BUILT / "include" / "tinyxml2"
    for parent in (library.parent, headers):
        parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(source.with_name("tinyxml2.h"), headers)
    code = library.with_suffix(".o")
    subprocess.run(["g++", "-O1", "-fPIC", "-Dtinyxml2=tinyxml2_renamed", "-c", source, "-o", code], check=True)
    subprocess.run(["ar", "rcs", library, code], check=True)
    return True


def is_installed(name: str) -> bool:
    return any((prefix / "share" / name / "package.xml").is_file() for prefix in (BUILT, WHEELS))


def dependencies(source: Path) -> set[str]:
    """Return the packages that the build or the use of a package requires."""
    manifest = ElementTree.parse(source / "package.xml").getroot()
    kinds = ("depend", "build_depend", "build_export_depend", "buildtool_depend", "exec_depend")
    return {(entry.text or "").strip() for kind in kinds for entry in manifest.iter(kind)}


def with_dependencies(name: str, sources: dict[str, Path]) -> list[str]:
    """Return a package and the packages that it requires, in the order of the build. Omit packages without sources."""
    if name not in sources or name in STAND_INS or is_installed(name):
        return []
    required = [inner for outer in sorted(dependencies(sources[name])) for inner in with_dependencies(outer, sources)]
    return list(dict.fromkeys([*required, name]))


def build(name: str, source: Path) -> bool:
    """Build and install a package. Return False if this fails."""
    print(f"building {name}", flush=True)
    begun = time.monotonic()
    bare = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    folder, log = BUILT / "build" / name, BUILT / "log" / f"{name}.log"
    configure = ["cmake", "-S", source, "-B", folder, *SETTINGS]
    install = ["cmake", "--build", folder, "--target", "install", "--parallel", str(os.cpu_count())]
    with log.open("w") as output:
        for command in (configure, install):
            environment = bare | search_paths([BUILT, WHEELS]) | {"ROS_DISTRO": "jazzy"}
            done = subprocess.run(command, env=environment, stdout=output, stderr=subprocess.STDOUT, check=False)
            if done.returncode:
                print(f"{name} failed: {log}", flush=True)
                return False
    print(f"{name} built in {time.monotonic() - begun:.0f} s", flush=True)
    return True


if __name__ == "__main__":
    main()
