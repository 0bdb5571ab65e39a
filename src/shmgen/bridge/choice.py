"""Chooses the backend, by what is installed and what the environment says."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from types import ModuleType

from shmgen.bridge.backend import BackendMissing
from shmgen.config.backends import BACKENDS

_PACKAGES = {"yaml": "pyyaml"}
"""What PyPI calls a module, where that is another name."""


def chosen(key: str) -> tuple[str, str]:
    """The backend's key, and why it is this one. Raises BackendMissing."""
    if key != "auto":
        return key, "as told"
    version = os.environ.get("ROS_VERSION", "")
    for backend in BACKENDS:
        if version and backend.ros_version == version:
            return backend.key, f"ROS_VERSION is {version}"
    for backend in BACKENDS:
        if importlib.util.find_spec(backend.imports):
            return backend.key, f"{backend.imports} is installed"
    lines = "\n".join(f"  {backend.key}: {backend.imports} is missing: {backend.install}" for backend in BACKENDS)
    raise BackendMissing(f"there is no ROS here, and no DDS; one of these is needed\n{lines}")


def module(key: str) -> ModuleType:
    """Of `shmgen.bridge`. Raises BackendMissing."""
    backend = next(one for one in BACKENDS if one.key == key)
    if not importlib.util.find_spec(backend.imports):
        raise BackendMissing(f"backend {key}: {backend.imports} is missing: {backend.install}")
    try:
        return importlib.import_module(f"shmgen.bridge.{key}.backend")
    except ImportError as error:
        needed = (error.name or "").partition(".")[0]
        if needed == "shmgen":
            raise
        if needed == backend.imports or not isinstance(error, ModuleNotFoundError):  # built for another Python
            why = str(error).partition("\n")[0]
            raise BackendMissing(
                f"backend {key}: {backend.imports} cannot be loaded, {why}: {backend.install}"
            ) from None
        package = _PACKAGES.get(needed, needed)
        tool = (
            f"{sys.executable} -m pip install"
            if importlib.util.find_spec("pip")
            else f"uv pip install -p {sys.executable}"
        )
        raise BackendMissing(
            f"backend {key}: {backend.imports} needs {needed}, which is missing here: `{tool} {package}`"
        ) from None
