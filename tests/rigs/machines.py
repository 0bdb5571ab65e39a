"""Runs tests on other machines, each in a Debian root of its architecture, and prints a line for each machine.

    sudo python -m tests.rigs.machines [--folder FOLDER] [--seconds 20] i386 arm64 … [-- pytest's own arguments]

Each root has Debian's Python, compiler and test packages for its architecture, which are unpacked but not installed.
Programs for another processor run under qemu-user, which the kernel must know (packages qemu-user-static and
binfmt_misc). The tests of the runtime, calls and tools of this checkout run in the root, then a short chaos. The
machine `named` needs no root: it is this machine under another name, on which code must not rely on the order of loads
and stores.
"""

from __future__ import annotations

import argparse
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from shmgen.generator.render import render
from shmgen.targets.c import region

from ..support import REPOSITORY
from ..support.machine import NAME, PATIENCE

PACKAGES = (
    *("base-files", "base-passwd", "bash", "coreutils", "dash", "mount", "procps", "util-linux"),
    *("g++", "gcc", "libc6-dev", "python3", "python3-dev", "python3-pip", "python3-setuptools", "python3-wheel"),
    *("python3-click", "python3-hypothesis", "python3-jinja2", "python3-lxml", "python3-lz4"),
    *("python3-numpy", "python3-ruamel.yaml", "python3-typing-extensions", "python3-zstandard"),
)
PYTEST = ("execnet", "iniconfig", "packaging", "pluggy", "pygments", "pytest", "pytest-timeout", "pytest-xdist")
PURE = ("blark", "lark", "mcap", "rosbags", *PYTEST)
"""Packages of PyPI without compiled parts. The lark and pytest of Debian 12 are too old."""
BUILT = "posix_ipc"
"""The package of PyPI that the machine itself compiles."""
TESTS = ("tests/runtime", "tests/calls", "tests/tools")
UNTESTED = "--ignore=tests/runtime/test_other_machine.py"
"""Excludes a module that runs the same tests under other machine names."""
SLOWER = 20
"""The largest slowdown by qemu-user."""
LIMIT = 300
"""The timeout of a test in seconds, as in pyproject.toml."""
HOOK = "/usr/share/mmdebstrap/hooks/merged-usr"
INSIDE = Path("/srv/shmgen")
"""The folder of the checkout in each root."""


@dataclass(frozen=True)
class Machine:
    """A Debian of another architecture. `emulator` runs its programs. The words in `before` precede each command."""

    suite: str
    architecture: str
    emulator: str = ""
    before: tuple[str, ...] = ()

    @property
    def chaos_options(self) -> tuple[str, ...]:
        """The options that leave out the parts of rigs/chaos.py with compilers, which are slow under an emulator."""
        return ("--no-plc", "--no-cpp") if self.emulator else ()


MACHINES = {
    "i386": Machine("bookworm", "i386"),
    "i686": Machine("bookworm", "i386", before=("setarch", "i686")),
    "arm64": Machine("bookworm", "arm64", "aarch64"),
    "armhf": Machine("bookworm", "armhf", "arm"),
    "armhf-t64": Machine("trixie", "armhf", "arm"),
    "riscv64": Machine("trixie", "riscv64", "riscv64"),
    "python3.14": Machine("forky", "amd64"),
}
"""`i686` is i386 with the machine name that a kernel of 32 bits reports. `t64` has a time of 64 bits."""
NAMED = "named"


def main() -> None:
    """Test the given machines and print a line for each. The exit code is 1 if a test fails on one of them."""
    parser = argparse.ArgumentParser(description="The runtime, calls and tools on other machines.")
    parser.add_argument("machines", nargs="+", choices=[NAMED, *MACHINES], metavar="machine")
    parser.add_argument("--folder", type=Path, default=Path("/var/tmp/shmgen-machines"), help="folder of the roots")
    parser.add_argument("--seconds", type=float, default=20, help="duration of the chaos; 0: no chaos")
    own = sys.argv[1:]
    tests = own[own.index("--") + 1 :] if "--" in own else []
    options = parser.parse_args(own[: own.index("--")] if "--" in own else own)
    lines = []
    for name in options.machines:
        begun = time.monotonic()
        commands = for_this_machine(tests) if name == NAMED else for_root(name, options.folder, tests)
        tested, summary = run(commands.pytest)
        chaos, verdict = run(commands.chaos(options.seconds)) if options.seconds else (0, "")
        lines.append((tested or chaos, f"{name}: {summary}; {verdict or 'no chaos'}; {time.monotonic() - begun:.0f} s"))
    print(*(line for _, line in lines), sep="\n")
    sys.exit(any(failed for failed, _ in lines))


@dataclass(frozen=True)
class Commands:
    """The commands that run on a machine. `python` is the command of its Python, with the words that precede it."""

    python: tuple[str, ...]
    tests: list[str]
    chaos_options: tuple[str, ...] = ()
    """Options that exclude parts of the chaos."""
    slower: int = 1

    @property
    def pytest(self) -> tuple[str, ...]:
        limit = f"--timeout={self.slower * LIMIT}"
        return *self.python, "-m", "pytest", "-p", "no:cacheprovider", limit, UNTESTED, *(self.tests or TESTS)

    def chaos(self, seconds: float) -> tuple[str, ...]:
        return *self.python, "-m", "tests.rigs.chaos", "--seed", "1", "--seconds", str(seconds), *self.chaos_options


def run(command: tuple[str, ...]) -> tuple[int, str]:
    """Run a command and print its output at once. Return its exit code and its last line."""
    with subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        last = ""
        for line in process.stdout:
            print(line, end="", flush=True)
            last = line.strip() or last
    return process.returncode, last


def for_this_machine(tests: list[str]) -> Commands:
    """Return the commands for this machine under another name. Only x86 guarantees the order of loads and stores."""
    other = "aarch64" if platform.machine() != "aarch64" else "riscv64"
    return Commands(("env", f"{NAME}={other}", sys.executable), tests)


def for_root(name: str, folder: Path, tests: list[str]) -> Commands:
    """Return the commands for a machine in namespaces: its /dev/shm, processes and network end with the command."""
    machine = MACHINES[name]
    root = prepare_root(machine, folder)
    copy_checkout(root)
    mounts = (
        f"mount --bind {root} {root}; mount --rbind /dev {root}/dev; mount -t tmpfs -o mode=1777 tmpfs {root}/dev/shm; "
        f"mount -t tmpfs -o mode=1777 tmpfs {root}/tmp; mount -t proc proc {root}/proc; ip link set lo up 2>/dev/null; "
    )
    # pivot_root instead of chroot, which shows paths of other namespaces from the old root. The shell stays, because
    # the first process must wait for orphans.
    turn = f'cd {root}; mkdir -p old; pivot_root . old; cd /; umount -l old; "$@"; code=$?; exit $code'
    enter = ("unshare", "-mnpf", "--kill-child", "sh", "-c", mounts + turn, "sh")
    slower = SLOWER if machine.emulator else 1
    variables = ("PATH=/usr/sbin:/usr/bin", "HOME=/root", "LANG=C.UTF-8", f"{PATIENCE}={slower}")
    command = (*enter, *machine.before, "env", "-i", "-C", str(INSIDE), *variables, "python3")
    return Commands(command, tests, machine.chaos_options, slower)


def prepare_root(machine: Machine, folder: Path) -> Path:
    """Return the root of a machine. Create it first if it does not exist."""
    root = folder / f"{machine.suite}-{machine.architecture}"
    if machine.emulator:
        register_emulator(machine.emulator)
    if not (root / "etc/passwd").exists():
        folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(root, ignore_errors=True)
        # A mirror may be a snapshot, whose Release file has expired.
        options = [
            "--variant=extract",
            '--aptopt=Acquire::Check-Valid-Until "false"',
            f"--architectures={machine.architecture}",
            f"--include={','.join(PACKAGES)}",
        ]
        subprocess.run(["mmdebstrap", *options, f"--hook-dir={HOOK}", machine.suite, root, *mirror()], check=True)
        complete_installation(root)
    if not (root / "opt/built").is_dir():
        add_python_packages(root)
    return root


def mirror() -> list[str]:
    """Return the Debian mirror of this machine. Return an empty list on another system, so that mmdebstrap chooses."""
    command = ["apt-get", "indextargets", "--format", "$(SITE)", "Created-By: Packages", "Label: Debian"]
    sites = subprocess.run(command, capture_output=True, text=True, check=False).stdout.split()
    return sites[:1]


def complete_installation(root: Path) -> None:
    """Create the files and links that an installation would create, because the packages are only unpacked."""
    for name in ("passwd", "group"):
        shutil.copy(root / f"usr/share/base-passwd/{name}.master", root / "etc" / name)
    certificates = sorted((root / "usr/share/ca-certificates/mozilla").glob("*.crt"))
    (root / "etc/ssl/certs/ca-certificates.crt").write_bytes(b"".join(file.read_bytes() for file in certificates))
    for library in ("blas", "lapack"):
        for file in root.glob(f"usr/lib/*/{library}/lib{library}.so.3"):
            link = file.parents[1] / file.name
            if not link.is_symlink():
                link.symlink_to(f"{library}/{file.name}")
    for short, tool in (("cc", "gcc"), ("c++", "g++")):
        if not (root / "usr/bin" / short).is_symlink():
            (root / "usr/bin" / short).symlink_to(tool)


def add_python_packages(root: Path) -> None:
    """Add the Python packages that Debian lacks: pure ones to /opt/pure, and compiled ones to /opt/built."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, "install", "--no-deps", "--target", root / "opt/pure", *PURE], check=True)
    with tempfile.TemporaryDirectory(dir=root) as sources:
        subprocess.run([*pip, "download", "--no-deps", "--no-binary", BUILT, "-d", sources, BUILT], check=True)
        (source,) = Path(sources).iterdir()
        archive = Path("/", Path(sources).name, source.name)
        install = ["python3", "-m", "pip", "install", "--no-index", "--no-deps", "--no-build-isolation"]
        command = [
            "chroot",
            root,
            "env",
            "-i",
            "PATH=/usr/bin",
            "HOME=/root",
            *install,
            "--target",
            "/opt/built",
            archive,
        ]
        subprocess.run(command, check=True)


def copy_checkout(root: Path) -> None:
    """Copy this checkout into the root, and compile the extension there."""
    target = root / INSIDE.relative_to("/")
    shutil.rmtree(target, ignore_errors=True)
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    names = subprocess.run(listed, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout.split("\0")
    for name in filter(None, names):
        source = REPOSITORY / name
        if source.is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target / name)
    paths = (f"{INSIDE}/src", "/opt/built", "/opt/pure")
    (root / "usr/lib/python3/dist-packages/shmgen.pth").write_text(f"import sys; sys.path[:0] = {paths}\n")
    header = render([region.plan("engine")])["c/engine/shmgen.h"]
    (target / "shmgen.h").write_text(header)
    core = f"{INSIDE}/src/shmgen/runtime/co*.c -o {INSIDE}/src/shmgen/_core.abi3.so"
    flags = "-O2 -std=gnu11 -fPIC -shared -pthread -DPy_LIMITED_API=0x030A0000"
    include = "$(python3 -c 'import sysconfig; print(sysconfig.get_path(\"include\"))')"
    build = f"gcc {flags} -I{include} -I{INSIDE}/templates/c -I{INSIDE} {core}"
    subprocess.run(["chroot", root, "env", "-i", "PATH=/usr/bin", "sh", "-c", build], check=True)


def register_emulator(emulator: str) -> None:
    """Register an emulator with the kernel if it is not registered.

    The flag F keeps the emulator open, so that the root does not need to contain it.
    """
    folder = Path("/proc/sys/fs/binfmt_misc")
    if not (folder / "register").exists():
        subprocess.run(["mount", "-t", "binfmt_misc", "binfmt_misc", folder], check=True)
    if not (folder / f"qemu-{emulator}").exists():
        rule = Path(f"/usr/lib/binfmt.d/qemu-{emulator}.conf").read_text().strip()
        (folder / "register").write_text(rule)


if __name__ == "__main__":
    main()
