"""Writes an MCAP file that is readable after every chunk, even if the writing process dies.

The package mcap encodes the records. The writer of the package rosbags does not fit: it stores one time for each
message, and shmgen stores two (the writer's stamp and the time of recording).

Each chunk is written together with the records that end an MCAP file. The next chunk overwrites these end records.
close() replaces the end records with the summary, which contains the index. If the disk is full, the file is truncated
after its last complete chunk and end records.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import DataEnd, Footer
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from shmgen import __version__

MAGIC = MCAP0_MAGIC


def _end() -> bytes:
    records = RecordBuilder()
    DataEnd(0).write(records)
    Footer(0, 0, 0).write(records)
    return bytes(records.end()) + MAGIC


_END = _end()
"""The end of a file without a summary. Readers then scan such a file from its beginning."""


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A topic in a bag, with its ROS type. `text` is the definition of the type.

    `metadata` has the keys that shmgen and rosbag2 define. It is mostly empty if another program recorded the bag.
    """

    topic: str
    type: str
    text: str
    metadata: dict[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class Chunk:
    """Messages that File.put() writes together. `size` is the size of their data in bytes.

    Each message consists of its channel, its sequence number, the time of recording, the writer's stamp,
    and its data. Both times are in ns since 1970. The messages are in the order of recording.
    """

    messages: list[tuple[Channel, int, int, int, bytes]] = field(default_factory=list)
    size: int = 0

    def add(self, channel: Channel, sequence: int, logged: int, published: int, data: bytes) -> None:
        self.messages.append((channel, sequence, logged, published, data))
        self.size += len(data)


class _Pending(BytesIO):
    """Bytes that are not written to the file yet. `tell()` counts from the beginning of the file."""

    start = 0

    def tell(self) -> int:
        return self.start + super().tell()

    def take(self) -> bytes:
        data = self.getvalue()
        self.start += len(data)
        self.seek(0)
        self.truncate(0)
        return data


class File:
    """An MCAP file open for writing. Not thread-safe."""

    def __init__(self, path: Path) -> None:
        """Create the file. Raises OSError if the file exists or cannot be created."""
        self.path = path
        self.first = self.last = 0
        """Times of recording of the first and last message, in ns since 1970."""
        self.counts: Counter[Channel] = Counter()
        """The number of messages of each channel."""
        self._numbers: dict[Channel, int] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._pending = _Pending()
        self._writer = Writer(self._pending, chunk_size=1 << 62, compression=CompressionType.NONE)
        self._whole = 0
        """Offset in bytes at which the last complete chunk ends. The records that end the file follow."""
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        try:
            self._writer.start("ros2", f"shmgen {__version__}")
            self._append(self._pending.take())
        except BaseException:
            self.abandon()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Size of the file in bytes."""
        return self._whole + len(_END)

    def put(self, chunk: Chunk) -> None:
        """Write a chunk with at least one message.

        Raises OSError if writing fails. The file is then readable to the chunk before; call abandon().
        """
        for channel, sequence, logged, published, data in chunk.messages:
            number = self._numbers.get(channel) or self._register(channel)
            self._writer.add_message(number, logged, data, published, sequence)
        self._writer.flush()
        self._append(self._pending.take())
        self.first = self.first or chunk.messages[0][2]
        self.last = chunk.messages[-1][2]
        self.counts.update(message[0] for message in chunk.messages)

    def close(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write the summary and a record for each name in `metadata`, and close the file.

        Raises OSError if writing fails; the chunks in the file stay readable.
        """
        try:
            for name, pairs in metadata.items():
                self._writer.add_metadata(name, dict(pairs))
            self._writer.finish()
            self._overwrite_end(self._pending.take())
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file without a summary."""
        os.close(self._file)

    def _register(self, channel: Channel) -> int:
        """Add a channel, and its type if the file does not have the type. Return the channel's number in the file."""
        key = channel.type, channel.text
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(channel.type, "ros2msg", channel.text.encode())
        number = self._writer.register_channel(channel.topic, "cdr", self._schemas[key], channel.metadata)
        self._numbers[channel] = number
        return number

    def _append(self, data: bytes) -> None:
        self._overwrite_end(data + _END)
        self._whole += len(data)

    def _overwrite_end(self, data: bytes) -> None:
        """Write `data` over the records that end the file.

        If writing fails, restore these end records and raise the OSError.
        """
        view, at = memoryview(data), self._whole
        try:
            while view:
                done = os.pwrite(self._file, view, at)
                view, at = view[done:], at + done
        except OSError:
            if self._whole:
                os.pwrite(self._file, _END, self._whole)  # overwrite in place: needs no more disk space
                os.ftruncate(self._file, self.size)
            raise
