"""Real ROS 2 for the tests: rclpy of Jazzy and of Kilted, each in an environment of its own that `make` has made.

They are a volunteer's wheels on PyPI, for Linux x86-64; where there are none, what needs them is skipped.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ..conftest import REPOSITORY

DISTRIBUTIONS = ("jazzy", "kilted")


def prefix(distribution: str) -> Path:
    """An ament prefix that is an environment of Python too."""
    found = REPOSITORY / ".venv" / f"ros2-{distribution}"
    if not (found / "share" / "rclpy").is_dir():
        pytest.skip(f"no wheels of ROS 2 {distribution}: `make test` installs them where there are any")
    return found


def hashes(distribution: str) -> dict[str, str]:
    """Full name -> type hash of all that is installed: messages, and the parts of services and actions."""
    found: dict[str, str] = {}
    for file in prefix(distribution).glob("share/*/*/*.json"):
        if file.parent.name in ("msg", "srv", "action"):
            data = json.loads(file.read_text())
            found |= {entry["type_name"]: entry["hash_string"] for entry in data.get("type_hashes", ())}
    return found
