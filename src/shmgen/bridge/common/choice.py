"""Chooses the backend from the installed packages and the environment."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from types import ModuleType

from shmgen.bridge.backend import BackendMissing
from shmgen.config.backends import BACKENDS

_PACKAGES = {"yaml": "pyyaml"}
"""The PyPI package of a module, if the two names differ."""


def chosen(key: str) -> tuple[str, str]:
    """Return the backend for `key`, which may be "auto", and the reason. Raises BackendMissing if none is installed."""
    if key != "auto":
        return key, "as configured"
    version = os.environ.get("ROS_VERSION", "")
    for backend in BACKENDS:
        if version and backend.ros_version == version:
            return backend.key, f"ROS_VERSION is {version}"
    for backend in BACKENDS:
        if importlib.util.find_spec(backend.imports):
            return backend.key, f"{backend.imports} is installed"
    lines = "\n".join(f"  {backend.key}: {backend.imports} is missing: {backend.install}" for backend in BACKENDS)
    hint = "install one of these packages, or source the setup of a ROS"
    raise BackendMissing(f"no backend is installed\n{lines}\n  hint: {hint}")


def module(key: str) -> ModuleType:
    """Import the module of the backend `key`. Raises BackendMissing if a package that the module needs is missing."""
    backend = next(one for one in BACKENDS if one.key == key)
    if not importlib.util.find_spec(backend.imports):
        raise BackendMissing(f"backend {key}: {backend.imports} is missing\n  hint: {backend.install}")
    try:
        return importlib.import_module(f"shmgen.bridge.{key}.backend")
    except ImportError as error:
        needed = (error.name or "").partition(".")[0]
        if needed == "shmgen":
            raise
        if needed == backend.imports or not isinstance(error, ModuleNotFoundError):  # built for another Python
            why = str(error).partition("\n")[0]
            raise BackendMissing(
                f"backend {key}: {backend.imports} cannot be loaded, {why}\n  hint: {backend.install}"
            ) from None
        package = _PACKAGES.get(needed, needed)
        tool = (
            f"{sys.executable} -m pip install"
            if importlib.util.find_spec("pip")
            else f"uv pip install -p {sys.executable}"
        )
        raise BackendMissing(
            f"backend {key}: {backend.imports} needs {needed}, which is missing here\n  hint: `{tool} {package}`"
        ) from None
