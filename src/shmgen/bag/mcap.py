"""Writes an MCAP file that is complete after every chunk, even if the writing process dies.

Source: the MCAP specification, version 0, and the files of rosbag2. shmgen uses only the reader of the package rosbags.
The writer of rosbags stores one time for each message. shmgen stores two: the writer's stamp and the time of recording.
The writer of rosbags also completes a file only when it closes the file, and searches all connections for each message.

Each chunk is written together with the records that end an MCAP file. The next chunk overwrites these end records.
close() replaces the end records with the summary, which contains the index. If the disk is full, the file is truncated
after its last complete chunk and end records.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from shmgen import __version__

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _METADATA, _METADATA_INDEX, _SUMMARY_OFFSET, DATA_END = 0x0B, 0x0C, 0x0D, 0x0E, 0x0F
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_ENTRY = struct.Struct("<QQ")
_CHANNEL_AND_NUMBER = struct.Struct("<HQ")
_NONE = 2**64 - 1


def _record(code: int, content: bytes) -> bytes:
    return struct.pack("<BQ", code, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _map(pairs: Mapping[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in pairs.items())
    return struct.pack("<I", len(data)) + data


_END = _record(DATA_END, bytes(4)) + _record(FOOTER, bytes(20)) + MAGIC
"""The end of a file without a summary. Readers then scan such a file from its beginning."""


@dataclass(slots=True)
class Chunk:
    """Messages that File.put() writes together.

    `parts` are the encoded records, `size` is their size in bytes, and `messages` is the number of messages. `first`
    and `last` are the times of recording of the first and last message. `index` maps the number of each channel to the
    index entries of its messages.
    """

    parts: list[bytes] = field(default_factory=list)
    size: int = 0
    messages: int = 0
    first: int = _NONE
    last: int = 0
    index: dict[int, bytearray] = field(default_factory=dict)

    def add(self, channel: int, sequence: int, logged: int, published: int, data: bytes) -> None:
        """Append a message. `logged` is the time of recording, `published` the writer's stamp, both in ns since 1970.

        `logged` must not be less than in the previous call.
        """
        entry = self.index.get(channel)
        if entry is None:
            entry = self.index[channel] = bytearray()
        entry += _ENTRY.pack(logged, self.size)
        if self.first == _NONE:
            self.first = logged
        self.last = logged
        self.messages += 1
        length = len(data)
        self.parts.append(_MESSAGE_HEAD.pack(MESSAGE, 22 + length, channel, sequence, logged, published))
        self.parts.append(data)
        self.size += 31 + length


def schema(number: int, name: str, text: str) -> bytes:
    return _record(SCHEMA, struct.pack("<H", number) + _text(name) + _text("ros2msg") + _text(text))


def channel(number: int, schema: int, topic: str, metadata: Mapping[str, str]) -> bytes:
    return _record(CHANNEL, struct.pack("<HH", number, schema) + _text(topic) + _text("cdr") + _map(metadata))


class File:
    """An MCAP file open for writing. Not thread-safe."""

    def __init__(self, path: Path) -> None:
        """Create the file. Raises OSError if the file exists or cannot be created."""
        self.path = path
        self.messages = 0
        self.first, self.last = _NONE, 0
        self.counts: dict[int, int] = {}
        self._chunks: list[bytes] = []
        self._definitions: dict[bytes, None] = {}
        self._whole = 0
        """Offset in bytes at which the last complete chunk ends. The records that end the file follow."""
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        try:
            self._append(MAGIC + _record(HEADER, _text("ros2") + _text(f"shmgen {__version__}")))
        except BaseException:
            self.abandon()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Size of the file in bytes."""
        return self._whole + len(_END)

    def put(self, chunk: Chunk, definitions: Iterable[bytes] = ()) -> None:
        """Write a chunk, after the schemas and channels in `definitions`. Each definition is written once.

        Raises OSError if writing fails; the file then stays as before.
        """
        new = [record for record in dict.fromkeys(definitions) if record not in self._definitions]
        before = b"".join(new)
        records = b"".join(chunk.parts)
        times = struct.pack("<QQ", chunk.first if chunk.messages else 0, chunk.last)
        head = times + struct.pack("<QI", len(records), zlib.crc32(records)) + _text("")
        start, length = self._whole + len(before), 9 + len(head) + 8 + len(records)
        parts = [before, struct.pack("<BQ", CHUNK, length - 9) + head + struct.pack("<Q", len(records)) + records]
        at = start + length
        offsets = b""
        for number, entries in chunk.index.items():
            offsets += _CHANNEL_AND_NUMBER.pack(number, at)
            parts.append(_record(_MESSAGE_INDEX, struct.pack("<HI", number, len(entries)) + entries))
            at += len(parts[-1])
        self._append(b"".join(parts))
        self._definitions.update(dict.fromkeys(new))
        index = times + struct.pack("<QQI", start, length, len(offsets)) + offsets
        index += struct.pack("<Q", at - start - length) + _text("") + struct.pack("<QQ", len(records), len(records))
        self._chunks.append(_record(_CHUNK_INDEX, index))
        self.messages += chunk.messages
        if chunk.messages:
            self.first, self.last = min(self.first, chunk.first), max(self.last, chunk.last)
        for number, entries in chunk.index.items():
            self.counts[number] = self.counts.get(number, 0) + len(entries) // _ENTRY.size

    def close(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write the summary and a record for each name in `metadata`, and close the file.

        Raises OSError if writing fails; the chunks in the file stay readable.
        """
        try:
            self._pwrite(self._summary(metadata))
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file without a summary."""
        os.close(self._file)

    def _append(self, data: bytes) -> None:
        self._pwrite(data + _END)
        self._whole += len(data)

    def _pwrite(self, data: bytes) -> None:
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

    def _summary(self, metadata: Mapping[str, Mapping[str, str]]) -> bytes:
        """Return the bytes that complete a file: the records of `metadata`, then the summary with the index."""
        at = self._whole
        data = bytearray()
        places = b""
        for name, pairs in metadata.items():
            record = _record(_METADATA, _text(name) + _map(pairs))
            places += _record(_METADATA_INDEX, struct.pack("<QQ", at + len(data), len(record)) + _text(name))
            data += record
        data += _record(DATA_END, bytes(4))
        begun = at + len(data)
        kinds = [record[0] for record in self._definitions]
        groups = {
            SCHEMA: b"".join(one for one in self._definitions if one[0] == SCHEMA),
            CHANNEL: b"".join(one for one in self._definitions if one[0] == CHANNEL),
            _CHUNK_INDEX: b"".join(self._chunks),
            _METADATA_INDEX: places,
            _STATISTICS: self._statistics(kinds.count(SCHEMA), kinds.count(CHANNEL), len(metadata)),
        }
        offsets = b""
        for code, records in groups.items():
            if records:
                offsets += _record(_SUMMARY_OFFSET, struct.pack("<BQQ", code, at + len(data), len(records)))
                data += records
        offsets_at = at + len(data)
        data += offsets
        head = struct.pack("<BQQQ", FOOTER, 20, begun, offsets_at)
        check = zlib.crc32(bytes(data[begun - at :]) + head)
        return bytes(data) + head + struct.pack("<I", check) + MAGIC

    def _statistics(self, schemas: int, channels: int, metadata: int) -> bytes:
        first = self.first if self.messages else 0
        counts = b"".join(_CHANNEL_AND_NUMBER.pack(number, count) for number, count in sorted(self.counts.items()))
        numbers = struct.pack(
            "<QHIIIIQQ", self.messages, schemas, channels, 0, metadata, len(self._chunks), first, self.last
        )
        return _record(_STATISTICS, numbers + struct.pack("<I", len(counts)) + counts)
