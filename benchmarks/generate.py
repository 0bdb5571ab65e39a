"""Times whole commands: one message against the start of bare Python, and the whole store against rosidl's C generator.

All output goes into new folders in memory, to exclude the time of the disk. Both sides of a ratio run in turn. Against
bare Python, the ratio is the median of the ratios of adjacent runs, because other load on the machine changes this
median least. Against rosidl, the ratio is the ratio of the medians. Without Debian's rosidl-generator-c-cpp, the part
with rosidl is skipped.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from shmgen.definitions import store

RUNS = 21
SHMGEN = [str(Path(sys.executable).parent / "shmgen")]
ROSIDL = Path("/usr/libexec/rosidl/rosidl_generator_c")
DEBIAN_PYTHON = "/usr/bin/python3"


def main() -> None:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        one_message(Path(folder), environment)
        whole_store(Path(folder), environment)


def one_message(folder: Path, environment: dict[str, str]) -> None:
    bare = [sys.executable, "-c", "pass"]
    generate = [*SHMGEN, "generate", "geometry_msgs/Pose", "--quiet", "--output"]
    run([*generate, str(folder / "pose")], environment)
    floors, ours = [], []
    for number in range(RUNS):
        floors.append(run(bare, environment))
        ours.append(run([*generate, str(folder / f"pose{number}")], environment))
    floor, mine = statistics.median(floors), statistics.median(ours)
    ratio = statistics.median(our / bare for our, bare in zip(ours, floors, strict=True))
    print(f"bare python start            {floor * 1e3:8.1f} ms   1")
    print(f"shmgen generate, one message {mine * 1e3:8.1f} ms   {ratio:.1f}x (wanted: at most 8x)")


def whole_store(folder: Path, environment: dict[str, str]) -> None:
    """Print the times of generating all packages of the built-in store that contain only messages.

    Packages with services are omitted, because rosidl's generator handles services differently.
    """
    packages = {
        package: candidates
        for package, candidates in store.catalogue("jazzy").items()
        if all(name.kind == "msg" for (one,) in [candidates] for name in one.definitions)
    }
    messages = {
        str(name): str(one.content)
        for (candidates,) in packages.values()
        for name, one in candidates.definitions.items()
    }
    bounds = "".join(f"{package} = 4\n" for package in packages)
    names = json.dumps(sorted(packages))
    (folder / "shmgen.toml").write_text(f'messages = {names}\ntargets = ["c"]\n[bounds]\n{bounds}')
    alone = [*SHMGEN, "generate", "--quiet", "-c", str(folder / "shmgen.toml"), "--output"]
    mine = statistics.median(run([*alone, str(folder / f"c{index}")], environment) for index in range(3))
    (folder / "shmgen.toml").write_text(f"messages = {names}\n[bounds]\n{bounds}")
    everything = statistics.median(run([*alone, str(folder / f"all{index}")], environment) for index in range(3))
    count = len(messages)
    print(f"shmgen, C alone              {mine / count * 1e3:8.2f} ms a message, {count} messages")
    print(f"shmgen, default targets      {everything / count * 1e3:8.2f} ms a message (wanted: at most 2 ms)")
    if not ROSIDL.exists():
        print("rosidl's C generator is not installed (apt-get install rosidl-generator-c-cpp python3-rosidl)")
        return
    theirs = rosidl(folder, messages, environment)
    print(
        f"rosidl C generator           {theirs / count * 1e3:8.2f} ms a message   "
        f"{theirs / everything:.0f}x our default targets, {theirs / mine:.0f}x our C (wanted: at least 20x)"
    )


def rosidl(folder: Path, messages: dict[str, str], environment: dict[str, str]) -> float:
    """Run rosidl's C generator on `messages` and return the total seconds, without the conversion to .idl.

    One process runs for each package, as in rosidl's CMake.
    """
    total = 0.0
    for package in sorted({name.partition("/")[0] for name in messages}):
        source = folder / "rosidl" / package
        (source / "msg").mkdir(parents=True)
        (source / "package.xml").write_text(
            f"<package format='3'><name>{package}</name><version>0.0.0</version><description/>"
            "<maintainer email='a@b.c'>a</maintainer><license>Apache-2.0</license></package>"
        )
        own = [name.rpartition("/")[2] for name in messages if name.startswith(f"{package}/")]
        for name in own:
            (source / "msg" / f"{name}.msg").write_text(messages[f"{package}/msg/{name}"])
        convert = (
            "import sys, pathlib; from rosidl_adapter.msg import convert_msg_to_idl\n"
            "for name in sys.argv[3:]: convert_msg_to_idl(pathlib.Path(sys.argv[1]), sys.argv[2],"
            " pathlib.Path('msg', name + '.msg'), pathlib.Path(sys.argv[1], 'msg'))"
        )
        run([DEBIAN_PYTHON, "-c", convert, str(source), package, *own], environment)
        arguments = source / "arguments.json"
        arguments.write_text(
            json.dumps(
                {
                    "package_name": package,
                    "output_dir": str(source / "out"),
                    "template_dir": "/usr/share/rosidl_generator_c/resource",
                    "idl_tuples": [f"{source}:msg/{name}.idl" for name in own],
                    "ros_interface_dependencies": [],
                    "target_dependencies": [],
                }
            )
        )
        total += run([DEBIAN_PYTHON, str(ROSIDL), "--generator-arguments-file", str(arguments)], environment)
    return total


def run(command: Sequence[str], environment: dict[str, str]) -> float:
    """Run a process that must succeed, and return its duration in seconds."""
    start = time.perf_counter()
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        sys.exit(f"{' '.join(command)}\n{result.stdout}{result.stderr}")
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
