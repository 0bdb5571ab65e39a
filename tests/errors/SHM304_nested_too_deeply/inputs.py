"""Writes 51 messages, each of which contains the next."""

from pathlib import Path

FOLDER = Path("msgs", "demo_msgs", "msg")
FOLDER.mkdir(parents=True)
for number in range(1, 51):
    (FOLDER / f"Node{number}.msg").write_text(f"Node{number + 1} child\n")
(FOLDER / "Node51.msg").write_text("float64 value\n")
