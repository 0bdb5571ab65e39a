"""Tests of the warning of `shmgen doctor` that systemd-logind removes regions."""

from __future__ import annotations

import os
from types import SimpleNamespace

import pytest

from shmgen.tools.doctor.environment import of_logout, removes_ipc


def put(root, path, value):
    file = root / path
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"# as shipped\n[Login]\n#RemoveIPC=no\n{value}\n")


@pytest.mark.parametrize(
    ("files", "removes"),
    [
        ({}, True),
        ({"etc/systemd/logind.conf": ""}, True),
        ({"etc/systemd/logind.conf": "RemoveIPC=no"}, False),
        ({"etc/systemd/logind.conf": "RemoveIPC = yes", "usr/lib/systemd/logind.conf": "RemoveIPC=no"}, True),
        ({"usr/lib/systemd/logind.conf": "RemoveIPC=no"}, False),
        ({"etc/systemd/logind.conf": "RemoveIPC=yes", "etc/systemd/logind.conf.d/shmgen.conf": "RemoveIPC=no"}, False),
        ({"usr/lib/systemd/logind.conf.d/a.conf": "RemoveIPC=no", "etc/systemd/logind.conf.d/a.conf": ""}, True),
        ({"usr/lib/systemd/logind.conf.d/b.conf": "RemoveIPC=1", "run/systemd/logind.conf.d/a.conf": "RemoveIPC=0"}, 1),
    ],
)  # fmt: skip
def test_effective_removeipc_setting_is_read(tmp_path, files, removes):
    for path, value in files.items():
        put(tmp_path, path, value)
    assert removes_ipc(tmp_path) == removes


def regions(*owners):
    return [SimpleNamespace(topic=f"/cell/n{n}", status=SimpleNamespace(st_uid=uid)) for n, uid in enumerate(owners)]


def test_warning_names_only_regions_of_login_users(tmp_path):
    some_regions = regions(4711, 4711, 0, 998)
    assert not [*of_logout(some_regions, tmp_path)], "there is no logind"
    (tmp_path / "run/systemd/seats").mkdir(parents=True)
    (finding,) = of_logout(some_regions, tmp_path)
    assert finding.message == "systemd-logind removes /cell/n0, /cell/n1 when 4711 logs out (RemoveIPC=yes)"
    assert finding.note
    assert not [*of_logout(regions(0, 998), tmp_path)], "logind keeps regions of root and of services"


def test_command_of_the_hint_prevents_the_removal(tmp_path):
    (tmp_path / "run/systemd/seats").mkdir(parents=True)
    (finding,) = of_logout(regions(4711), tmp_path)
    command = finding.hint.split("`")[1].partition(" && sudo systemctl")[0]
    command = command.replace("sudo ", "").replace("/etc/", f"{tmp_path}/etc/")
    assert os.system(f"{command} >/dev/null") == 0
    assert not [*of_logout(regions(4711), tmp_path)]
