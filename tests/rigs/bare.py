"""Runs the commands of README on Debian 12, Debian 13 and Ubuntu 24.04 with a minimal installation.

    sudo make bare                                             # nine runs
    sudo make bare ARGS="--only debian-13 --tests tests/cli"   # some runs and tests
    sudo make bare ARGS=--set-up                               # only the setup of `make test`

Needs root, debootstrap, git and overlayfs. All runs take an hour or more, and several hours on a busy machine. Each run
has a root file system above a minimal one, with its own mounts, processes, /dev/shm and time limit. The package indexes
are the same as on this machine, because the settings of apt and pip are copied. DEBIAN_MIRROR and UBUNTU_MIRROR select
other servers.

The exit code is 1 if a command fails, leaves a file in /dev/shm, /tmp, the home or the checkout, or leaves a process.
Logs and minimal roots stay in --folder for the next time.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from configparser import RawConfigParser
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

HERE = Path(__file__).resolve().parents[2]
PACKAGES = "python3,make"
"""The packages of each bare root, beside ca-certificates for an index. It has no git, no compiler and no locales."""
SYSTEMS = {
    "debian-12": ("bookworm", os.environ.get("DEBIAN_MIRROR", "http://deb.debian.org/debian")),
    "debian-13": ("trixie", os.environ.get("DEBIAN_MIRROR", "http://deb.debian.org/debian")),
    "ubuntu-24.04": ("noble", os.environ.get("UBUNTU_MIRROR", "http://archive.ubuntu.com/ubuntu")),
}
CACHES = ("/.cache/pip", "/.cache/shmgen")
"""The folders below the home that may stay: the caches of pip and of shmgen (docs/configuration.md)."""


SET_UP_SECONDS, SET_UP_MB = 180, 600
"""Limits of the setup of `make test` on an idle machine. It includes the packages of README."""

APT = "apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq"
DEB = f"{APT} python3-venv && shmgen/contrib/debian/make_deb.sh && {APT} ./shmgen_*.deb && shmgen --version"
VENV = "python3 -m venv v && v/bin/pip -q install ./shmgen && v/bin/shmgen --version"
UV = "python3 -m venv u && u/bin/pip -q install uv && u/bin/uv -q tool install ./shmgen && .local/bin/shmgen --version"
PIPX = "pipx install './shmgen[idl]' && .local/bin/shmgen --version"
"""Commands of docs/deploy.md that install shmgen. Root installs the .deb, and the user of the run all others."""


@dataclass(frozen=True)
class Run:
    """The properties of one run: the system, the user, the checkout and the installed compilers."""

    system: str
    user: bool
    git: bool
    closed: bool
    bytecode: bool
    cpp: bool = True
    gcc: bool = True
    installed: str = DEB

    @property
    def name(self) -> str:
        """The name of the run, which the report prints and --only selects."""
        words = [self.system, "user" if self.user else "root", "git" if self.git else "no-git"]
        words += ["closed" if self.closed else "open", "bytecode" if self.bytecode else "no-bytecode"]
        return " ".join(words + ([] if self.cpp else ["no-g++"]) + ([] if self.gcc else ["no-gcc"]))

    @property
    def needed(self) -> str:
        """The packages that README requires and the minimal root does not contain."""
        compilers = f"{'gcc libc6-dev' if self.gcc else ''}{' g++' if self.cpp else ''}"
        return f"python3-venv python3-dev {compilers}" if self.user else compilers

    @property
    def home(self) -> str:
        """The home of the user who runs the commands. The checkout is below it."""
        return "/home/dev" if self.user else "/root"


RUNS = (
    Run("debian-12", user=True, git=False, closed=False, bytecode=False, cpp=False, installed=VENV),
    Run("debian-12", user=False, git=True, closed=True, bytecode=True),
    Run("debian-13", user=True, git=False, closed=True, bytecode=True, installed=PIPX),
    Run("debian-12", user=False, git=False, closed=False, bytecode=False, cpp=False),
    Run("debian-13", user=False, git=True, closed=False, bytecode=False),
    Run("debian-13", user=False, git=False, closed=True, bytecode=True, cpp=False),
    Run("debian-13", user=True, git=False, closed=False, bytecode=False, cpp=False, gcc=False, installed=VENV),
    Run("ubuntu-24.04", user=True, git=True, closed=False, bytecode=True, installed=UV),
    Run("ubuntu-24.04", user=False, git=False, closed=True, bytecode=False),
)
"""The fewest runs that contain each pair of two properties' values."""

INSIDE = """
set -e
root=$1 upper=$2 base=$3 folders=$4 who=$5 home=$6
mount -t overlay overlay -o lowerdir="$base",upperdir="$upper/root",workdir="$upper/work" "$root"
mount -t proc proc "$root/proc"
mount --bind -o ro /sys "$root/sys"
mount -t tmpfs -o mode=755 tmpfs "$root/dev"
mkdir "$root/dev/shm" "$root/dev/pts"
mount -t tmpfs -o mode=1777 tmpfs "$root/dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx"; ln -s /proc/self/fd "$root/dev/fd"
for node in null zero full random urandom tty; do : > "$root/dev/$node"; mount --bind /dev/$node "$root/dev/$node"; done
for folder in $folders; do mkdir -p "$root$folder"; mount --bind -o ro "$folder" "$root$folder"; done
cd "$root"
chroot --userspec="$who" . /usr/bin/env -i HOME="$home" $7 sh -c "cd ~; $8" || code=$?
sleep 1
ls -A "$root/dev/shm" | sed 's,^,LEFT in /dev/shm: ,'
for process in /proc/[0-9]*; do
    test "$process" = /proc/$$ || ! grep -q . "$process/cmdline" 2>/dev/null \
    || case $(readlink "$process/root") in "$root"*) echo "LEFT running: $(tr '\\0' ' ' < "$process/cmdline")";; esac
done
exit ${code:-0}
"""


class Machine:
    """The root file system of a run, above a minimal root."""

    def __init__(self, run: Run, folder: Path) -> None:
        self.run, self.base = run, folder / run.system
        self.upper, self.root = folder / "run", folder / "mounted"
        shutil.rmtree(self.upper, ignore_errors=True)
        for part in (self.root, self.upper / "work", self.upper / "root"):
            part.mkdir(parents=True, exist_ok=True)
        os.chmod(self.upper / "root", 0o755)
        self.log = folder / f"{run.name.replace(' ', '_')}.log"
        self.log.write_text("")
        self.checkout = self.upper / "root" / run.home[1:] / "shmgen"

    def create_checkout(self) -> None:
        """Create the checkout from the committed files, with the git history or without."""
        home = self.checkout.parent
        home.mkdir(parents=True)
        source = str(HERE)
        if self.run.git:
            command = ["git", "clone", "--quiet", "--no-hardlinks", "--single-branch", source, str(self.checkout)]
            subprocess.run(command, check=True)
        else:
            self.checkout.mkdir()
            packed = subprocess.run(["git", "-C", source, "archive", "HEAD"], stdout=subprocess.PIPE, check=True)
            subprocess.run(["tar", "-x", "-C", str(self.checkout)], input=packed.stdout, check=True)
        if self.run.user:
            subprocess.run(["chown", "-R", "1000:1000", str(home)], check=True)
        home.chmod(0o700 if self.run.closed else 0o755)

    def execute(self, command: str, limit: float, as_root: bool = False) -> tuple[int, float, list[str]]:
        """Run a line of shell for at most `limit` seconds. Return its exit code, duration in seconds, and output.

        The output also lists what the command left behind.
        """
        root = as_root or not self.run.user
        variables = [
            *pip_variables(),
            "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        ]
        if not self.run.bytecode:
            variables.append("PYTHONDONTWRITEBYTECODE=1")
        arguments = [
            str(self.root),
            str(self.upper),
            str(self.base),
            " ".join(folders()),
            "0:0" if root else "1000:1000",
        ]
        arguments += ["/root" if root else self.run.home, " ".join(variables), command]
        namespaces = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
        start, at = time.monotonic(), self.log.stat().st_size
        with self.log.open("ab") as log:
            process = subprocess.Popen(
                [*namespaces, "sh", "-c", INSIDE, "sh", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
            try:
                code = process.wait(limit)
            except subprocess.TimeoutExpired:
                code = 124
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
        output = self.log.read_bytes()[at:].decode(errors="replace")
        return code, time.monotonic() - start, output.splitlines()

    def size(self) -> int:
        """Return the size in MB of all files that the minimal root does not contain."""
        return int(subprocess.run(["du", "-sm", self.upper], stdout=subprocess.PIPE, check=True).stdout.split()[0])

    def files(self) -> dict[str, str]:
        """Return a hash of each file in the home, the checkout and /tmp, by path.

        Caches and files that .gitignore names are omitted.
        """
        ignored = [line.strip("/") for line in (HERE / ".gitignore").read_text().split()]
        hashes = {}
        for top in (self.upper / "root/tmp", self.upper / "root/var/tmp", self.checkout.parent):
            for folder, below, files in os.walk(top):
                tracked = [name for name in below if not any(fnmatch(name, pattern) for pattern in ignored)]
                below[:] = [name for name in tracked if name != ".git" and not f"{folder}/{name}".endswith(CACHES)]
                for name in (*files, *(name for name in below if not any(Path(folder, name).iterdir()))):
                    path = Path(folder, name)
                    if not any(fnmatch(name, pattern) for pattern in ignored):
                        text = path.read_bytes() if path.is_file() and not path.is_symlink() else b""
                        hashes[f"/{path.relative_to(self.upper / 'root')}"] = hashlib.sha256(text).hexdigest()
        return hashes


def pip_variables() -> list[str]:
    """Return the environment variables of this process for pip and for proxies."""
    pattern = re.compile(r"PIP_|(https?|no|all)_proxy$|SSL_CERT_FILE$|REQUESTS_CA_BUNDLE$", re.IGNORECASE)
    return [f"{name}={value}" for name, value in os.environ.items() if pattern.match(name) and " " not in value]


def pip_settings() -> RawConfigParser:
    """Return the settings of pip on this machine. The settings of the user come after the settings of the machine."""
    settings = RawConfigParser()
    home = Path.home()
    settings.read(["/etc/pip.conf", home / ".pip/pip.conf", home / ".config/pip/pip.conf"])
    return settings


def folders() -> list[str]:
    """Return the folders that the settings and variables of pip name."""
    return sorted({str(path) for path in _paths() if path.is_dir()})


def _paths() -> Iterator[Path]:
    settings = pip_settings()
    values = [value for section in settings.sections() for _, value in settings.items(section)]
    for word in " ".join(values + [line.partition("=")[2] for line in pip_variables()]).split():
        path = Path(word.removeprefix("file://"))
        if path.is_absolute() and path.exists():
            yield path.parent if word.startswith("file://") else path  # its files are beside an index


def make_base(system: str, folder: Path) -> None:
    """Create the minimal root of a system, with the packages that README requires, if it does not exist."""
    base, (suite, mirror) = folder / system, SYSTEMS[system]
    ready = base / "ready"
    if ready.exists() and ready.read_text() == PACKAGES:
        return
    shutil.rmtree(base, ignore_errors=True)
    key = Path(
        "/usr/share/keyrings", "ubuntu-archive-keyring.gpg" if "ubuntu" in system else "debian-archive-keyring.gpg"
    )
    if not key.exists():
        print(f"{key} is missing: the packages of {mirror} are not verified", file=sys.stderr)
    scripts = Path("/usr/share/debootstrap/scripts")
    script = [] if (scripts / suite).exists() else [str(scripts / ("gutsy" if "ubuntu" in system else "sid"))]
    command = ["debootstrap", "--variant=minbase", f"--include={PACKAGES},ca-certificates"]
    command += [f"--keyring={key}"] if key.exists() else ["--no-check-gpg"]
    command += ["--components=main,universe" if "ubuntu" in system else "--components=main"]
    print(f"{system}: creating a root of {suite}", flush=True)
    with (folder / f"{system}.log").open("wb") as log:
        subprocess.run([*command, suite, str(base), mirror, *script], stdout=log, stderr=log, check=True, timeout=1800)
    configure(base)


def configure(base: Path) -> None:
    """Copy this machine's settings of apt, pip and the network into a minimal root, and create a user."""
    for file in Path("/etc/apt/apt.conf.d").iterdir():
        if "Acquire" in (text := file.read_text()) and "Invoke" not in text:
            shutil.copy(file, base / "etc/apt/apt.conf.d")
    for name in ("resolv.conf", "hosts", "ssl/certs/ca-certificates.crt"):
        shutil.copy(Path("/etc", name).resolve(), base / "etc" / name)
    with (base / "etc/pip.conf").open("w") as stream:
        pip_settings().write(stream)
    for path in _paths():
        if path.is_file():
            (base / str(path.parent)[1:]).mkdir(parents=True, exist_ok=True)
            shutil.copy(path, base / str(path)[1:])
    users = subprocess.run(["chroot", str(base), "id", "-un", "1000"], stdout=subprocess.PIPE, text=True, check=False)
    if name := users.stdout.strip():
        subprocess.run(["chroot", str(base), "userdel", "-r", name], stderr=subprocess.DEVNULL, check=True)
    subprocess.run(["chroot", str(base), "useradd", "--create-home", "--uid", "1000", "dev"], check=True)
    (base / "ready").write_text(PACKAGES)


def set_up(run: Run, folder: Path) -> bool:
    """Run the setup of `make test` on a new machine. Print its duration and size, and the load of this machine before.

    Return True if the setup succeeded within the limits.
    """
    machine = Machine(run, folder)
    machine.create_checkout()
    start, size, busy = time.monotonic(), machine.size(), os.getloadavg()[0]
    code, output = 0, []
    if run.user:
        code, _, output = machine.execute(f"{APT} {run.needed}", 900, as_root=True)
    if code == 0:
        code, _, output = machine.execute("make -C shmgen .venv/ready-to-test", 900)
    seconds, more = time.monotonic() - start, machine.size() - size
    good = code == 0 and seconds < SET_UP_SECONDS and more < SET_UP_MB
    print(f"{'ok  ' if good else 'RED '} {run.name}: {seconds:.0f} s, {more:+} MB, exit {code}; load {busy:.1f} before")
    for line in output[-30:] if code else []:
        print(f"       {line}")
    sys.stdout.flush()
    return good


def try_readme(run: Run, folder: Path, tests: str) -> bool:
    """Run the commands of README on a new machine, and print a line for each. Return True if all succeeded."""
    machine = Machine(run, folder)
    machine.create_checkout()
    fine = True

    def step(command: str, limit: float, as_root: bool = False, fails: bool = False, leaves: bool = False) -> list[str]:
        nonlocal fine
        size, before = machine.size(), machine.files()
        code, seconds, output = machine.execute(command, limit, as_root)
        left = [line for line in output if line.startswith("LEFT ")]
        after = {} if as_root or leaves else machine.files()
        left += [f"LEFT {path}" for path, text in sorted(after.items()) if before.get(path) != text]
        good = (code != 0) == fails and not left
        fine = fine and good
        print(f"  {'ok  ' if good else 'RED '} {command}: {seconds:.0f} s, {machine.size() - size:+} MB, exit {code}")
        more = [f"LEFT {len(left) - 20} more"] if len(left) > 20 else []  # a failed test leaves its folder
        for line in [*left[:20], *more, *([] if (code != 0) == fails else output[-30:])]:
            print(f"       {line}")
        sys.stdout.flush()
        return output

    print(run.name, flush=True)
    if run.git:
        step(f"{APT} git", 900, as_root=True)
    if run.user:
        output = step("make -C shmgen demo", 30, fails=True)
        fine = fine and any("sudo apt-get install python3-venv" in line for line in output)
    step(f"{APT} {run.needed}", 900, as_root=True)
    step("make -C shmgen demo", 900)
    output = step(f"make -C shmgen test{f' TESTS={shlex.quote(tests)}' if tests else ''}", 7200)
    for line in output:
        if re.match(r"left out: |failed, and was|\d+ passed|FAILED|ERROR|\d+ failed", line):
            print(f"       {line}")
    output = step("cd shmgen && . .venv/bin/activate && shmgen --version", 30)
    fine = fine and any(f"publish and read in {'C' if run.gcc else 'Python'}" in line for line in output)
    if run.installed == PIPX:
        step(f"{APT} pipx", 900, as_root=True)
    step(run.installed, 900, leaves=True)
    return fine


def main() -> None:
    """Execute the selected runs, and print each command with its result."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", default="", help="words that the name of a run contains, such as `debian-12 user`")
    parser.add_argument("--tests", default="", help="the tests of `make test`, such as `tests/cli`; all by default")
    parser.add_argument("--set-up", action="store_true", help="only the setup of `make test`, with its duration")
    parser.add_argument(
        "--folder", type=Path, default=Path("/var/tmp/shmgen-bare"), help="folder of the roots and logs"
    )
    options = parser.parse_args()
    if os.geteuid() or not shutil.which("debootstrap"):
        sys.exit("needs root, and: apt-get install debootstrap")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))
    options.folder.mkdir(parents=True, exist_ok=True)
    runs = [run for run in RUNS if all(word in run.name.split() for word in options.only.split())]
    for system in dict.fromkeys(run.system for run in runs):
        make_base(system, options.folder)
    if options.set_up:
        red = [run.name for run in runs if not set_up(run, options.folder)]
    else:
        red = [run.name for run in runs if not try_readme(run, options.folder, options.tests)]
    shutil.rmtree(options.folder / "run", ignore_errors=True)
    print(f"{len(runs) - len(red)} of {len(runs)} runs are green" + "".join(f"\nred: {name}" for name in red))
    sys.exit(bool(red))


if __name__ == "__main__":
    main()
