"""Test the messages that shmgen adds to a .srv or .action, in both dialects."""

from __future__ import annotations

from pathlib import Path

import pytest

from shmgen import config
from shmgen.core.diagnostics import Rejected
from shmgen.core.model import Layouts, TypeName
from shmgen.generator import pipeline
from shmgen.targets import interfaces


def lay_out(root: Path, *requests: str, source: str = "jazzy") -> Layouts:
    texts = {
        "srv/Start.srv": "bool on\n---\nint16 result\n",
        "action/Move.action": "float64 to\n---\n---\nint8 percent\n",
    }
    for path, text in texts.items():
        (root / "cell_msgs" / path).parent.mkdir(parents=True, exist_ok=True)
        (root / "cell_msgs" / path).write_text(text)
    return pipeline.lay_out(config.Config(root, path=(root,), source=source), requests)


@pytest.mark.parametrize("source", ["jazzy", "noetic"])
def test_offsets_of_the_wrappers(tmp_path: Path, source: str) -> None:
    layouts = lay_out(tmp_path, "cell_msgs", source=source)
    members = {
        name.name: [f"{slot.offset} {slot.name}" for slot in layouts[name].slots if slot.name[0] != "_"]
        for name in layouts
    }
    assert members["Start_Reply"] == ["0 call", "4 status", "6 response"]
    assert members["Move_Command"] == ["0 cancel", "8 goal"]
    assert members["Move_Progress"] == ["0 goal", "4 status", "5 feedback"]
    assert members["Move_Outcome"] == ["0 goal", "4 status", "5 result"]
    assert all(layout.requested for layout in layouts.values())


def test_service_requires_all_its_parts(tmp_path: Path) -> None:
    start, move = TypeName("cell_msgs", "srv", "Start"), TypeName("cell_msgs", "action", "Move")
    assert list(interfaces.complete(lay_out(tmp_path, "cell_msgs/Start"))) == [start]
    assert list(interfaces.complete(lay_out(tmp_path, "cell_msgs/action/Move"))) == [move]
    parts = lay_out(tmp_path, "cell_msgs/Start_Reply", "cell_msgs/Move_Outcome", "cell_msgs/Move_Progress")
    assert {name.name for name in parts} >= {"Start_Reply", "Start_Response", "Move_Outcome", "Move_Result"}
    assert not list(interfaces.complete(parts))


def test_changed_response_changes_the_digest_of_the_reply(tmp_path: Path) -> None:
    reply = TypeName("cell_msgs", "srv", "Start_Reply")
    before = lay_out(tmp_path, "cell_msgs/Start")[reply]
    (tmp_path / "cell_msgs/srv/Stop.srv").write_text("bool on\n---\nuint16 result\n")
    after = lay_out(tmp_path, "cell_msgs/Stop")[reply._replace(name="Stop_Reply")]
    assert before.size == after.size
    assert before.digest != after.digest


def test_invalid_service_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "cell_msgs" / "srv").mkdir(parents=True)
    (tmp_path / "cell_msgs" / "srv" / "Bad.srv").write_text("bool on\n")
    with pytest.raises(Rejected) as caught:
        lay_out(tmp_path, "cell_msgs/Bad")
    assert [diagnostic.code for diagnostic in caught.value.diagnostics] == ["SHM003"]
