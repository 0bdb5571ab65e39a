"""The files in contrib/ fit together, as far as tests without docker show. `make bare` tests the Debian package."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from ruamel.yaml import YAML

from .conftest import REPOSITORY
from .test_distributions import tomllib

DOCKER = REPOSITORY / "contrib" / "docker"


def test_docker_image_gets_all_files_of_the_wheel() -> None:
    included = [line[1:] for line in (DOCKER / "Dockerfile.dockerignore").read_text().split() if line[0] == "!"]
    assert all((REPOSITORY / path).exists() for path in included)
    wheel = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    for path in (*wheel["packages"], *wheel["force-include"], *wheel["shared-data"], wheel["hooks"]["custom"]["path"]):
        assert any(path == name or path.startswith(f"{name}/") for name in included), path


def test_containers_of_compose_share_one_dev_shm(topic: str) -> None:
    """Run the commands of both containers as two processes, which exchange a pose."""
    compose = YAML(typ="safe").load(DOCKER / "compose.yaml")
    services = compose["services"]
    owners = [name for name, service in services.items() if service["ipc"] == "shareable"]
    assert len(owners) == 1
    assert all(services[name]["ipc"] == f"service:{owners[0]}" for name in services if name not in owners)
    for service in services.values():
        build = service["build"]
        assert (DOCKER / build["context"] / build["dockerfile"]).samefile(DOCKER / "Dockerfile")
    assert 'ENTRYPOINT ["shmgen"]' in (DOCKER / "Dockerfile").read_text()
    commands = [[topic if word == "/cell/pose" else word for word in services[name]["command"]] for name in services]
    shmgen = [sys.executable, "-m", "shmgen"]
    with subprocess.Popen([*shmgen, *commands[0]], stdout=subprocess.DEVNULL) as publisher:
        try:
            read = subprocess.run([*shmgen, *commands[1], "--once"], capture_output=True, text=True, timeout=60)
        finally:
            publisher.kill()
    assert "x: 1.5" in read.stdout, read.stderr


OURS = r"\.(?=[\[\s`])|\./shmgen|\$GITHUB_ACTION_PATH|/source|shmgen(?:\[idl\])? @|git\+"
INSTALLS = rf"""(?:pipx|pip"?|uv tool) install (?:--\S+ )*['"]?(?:{OURS})\S*"""


def test_install_commands_include_the_idl_parser() -> None:
    """Accept extras for a further purpose, such as `.[view]`, which users install in addition."""
    places = ["README.md", "action.yml", "contrib/docker/Dockerfile", "tests/rigs/bare.py"]
    texts = [(REPOSITORY / place).read_text() for place in places]
    texts += [path.read_text() for path in (REPOSITORY / "docs").rglob("*.md")]
    commands = [re.findall(INSTALLS, text) for text in texts]
    assert all(commands[: len(places)])
    others = [
        line
        for lines in commands
        for line in lines
        if not re.search(r"\[(idl|idl,demo|dds,idl|view|dds|ros2|zenoh)\]", line)
    ]
    assert others == []


def test_scripts_are_valid_sh(tmp_path: Path) -> None:
    subprocess.run(["sh", "-n", REPOSITORY / "contrib" / "debian" / "make_deb.sh"], check=True, cwd=tmp_path)


def test_page_names_the_rosdep_key() -> None:
    keys = YAML(typ="safe").load(REPOSITORY / "contrib" / "rosdep" / "cell.yaml")
    assert all(rule["pip"]["packages"] == ["posix_ipc"] for key in keys for rule in keys[key].values())
    page = (REPOSITORY / "contrib" / "README.md").read_text()
    assert all(f"<exec_depend>{key}</exec_depend>" in page for key in keys)
