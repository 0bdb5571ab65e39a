"""Writes a ROS 2 bag: a folder with metadata.yaml and a series of MCAP files."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shmgen.bag import mcap
from shmgen.bag.mcap import Channel, Chunk

_VERSION = 9
"""Version of the metadata.yaml format, from ROS 2 Jazzy."""


class Bag:
    """A bag open for writing. Not thread-safe."""

    def __init__(self, folder: Path, most: int | None = None, longest: float | None = None) -> None:
        """Create the folder of a bag. put() begins a new file after `most` bytes or `longest` seconds; None: no limit.

        Raises OSError if the folder exists or cannot be created.
        """
        folder.mkdir(parents=True)
        self.folder = folder
        self.samples = 0
        self.size = 0
        self._most, self._longest = most, longest
        self._channels: list[Channel] = []
        self._files: list[mcap.File] = []
        self._open: mcap.File | None = None
        self._begun = 0.0
        self.write_metadata()

    @property
    def files(self) -> list[Path]:
        return [file.path for file in self._files]

    def add(self, channel: Channel) -> None:
        """Add a channel to the topics in metadata.yaml. Call this before put() of its first message."""
        self._channels.append(channel)

    def put(self, chunk: Chunk) -> None:
        """Write a chunk; begin a new file if the current file is full.

        Raises OSError if writing fails. The bag is then readable to the chunk before; call abandon().
        """
        if self._open and self._is_full(self._open):
            self.end_file()
        if self._open is None:
            self._open = mcap.File(self.folder / f"{self.folder.name}_{len(self._files)}.mcap")
            self._files.append(self._open)
            self._begun = time.monotonic()
            self.write_metadata()
        before = self._open.size
        self._open.put(chunk)
        self.size += self._open.size - before
        self.samples += len(chunk.messages)

    def end_file(self, notes: Mapping[str, str] | None = None) -> None:
        """Complete the current file with its index. Store `notes`, if given, in the file's metadata record `shmgen`.

        Raises OSError if writing fails.
        """
        if self._open is not None:
            file, self._open = self._open, None
            about = {"rosbag2": {"serialized_metadata": self._about([file])}}
            file.close(about | ({"shmgen": dict(notes)} if notes else {}))

    def abandon(self) -> None:
        """Close the current file without an index. The file is readable to its last chunk."""
        if self._open is not None:
            self._open.abandon()
            self._open = None

    def write_metadata(self, notes: Mapping[str, str] | None = None) -> None:
        """Write the bag's metadata.yaml, which lists its files and topics, and add `notes`, if given.

        The replacement is atomic: a reader finds either the old or the new file. Raises OSError if writing fails.
        """
        file = self.folder / "metadata.yaml"
        new = file.with_suffix(".yaml.new")
        try:
            new.write_text(f'{{"rosbag2_bagfile_information": {self._about(self._files, notes)}}}\n', encoding="utf-8")
            os.replace(new, file)
        finally:
            new.unlink(missing_ok=True)

    def _is_full(self, file: mcap.File) -> bool:
        too_long = self._longest is not None and time.monotonic() - self._begun >= self._longest
        return too_long or (self._most is not None and file.size >= self._most)

    def _about(self, files: list[mcap.File], notes: Mapping[str, str] | None = None) -> str:
        """Return the description of `files` for metadata.yaml, with the keys that rosbag2 requires.

        The text is JSON, because JSON is valid YAML.
        """
        counts = sum((file.counts for file in files), Counter[Channel]())
        first = min((file.first for file in files if file.counts), default=0)
        last = max((file.last for file in files), default=0)
        about: dict[str, Any] = {
            "version": _VERSION,
            "storage_identifier": "mcap",
            "relative_file_paths": [file.path.name for file in files],
            "duration": {"nanoseconds": last - first},
            "starting_time": {"nanoseconds_since_epoch": first},
            "message_count": counts.total(),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": channel.topic,
                        "type": channel.type,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [],
                        "type_description_hash": channel.metadata["topic_type_hash"],
                    },
                    "message_count": counts[channel],
                }
                for channel in self._channels
            ],
            "compression_format": "",
            "compression_mode": "",
            "files": [
                {
                    "path": file.path.name,
                    "starting_time": {"nanoseconds_since_epoch": file.first},
                    "duration": {"nanoseconds": file.last - file.first},
                    "message_count": file.counts.total(),
                }
                for file in files
            ],
            "custom_data": dict(notes) if notes else None,
            "ros_distro": "shmgen",
        }
        return json.dumps(about, indent=1)
