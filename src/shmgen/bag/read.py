"""Reads the messages of an MCAP file or a ROS 2 bag, in the order of the file. The file may be truncated."""

from __future__ import annotations

import os
import struct
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode

from shmgen.bag.mcap import MAGIC, Channel
from shmgen.core.escape import legible
from shmgen.core.files import open_file
from shmgen.core.plural import counted

_HEAD = struct.Struct("<BQ")
_LARGEST_CHUNK = 1 << 28
"""Largest size in bytes of a chunk after decompression. A chunk of rosbag2 has 4 MiB, or one larger message."""


class Unreadable(ValueError):
    """A file is not a bag, or has no ROS 2 messages. The text of the exception is a single line."""

    def __init__(self, text: str) -> None:
        super().__init__(legible(text))


@dataclass(frozen=True, slots=True)
class Message:
    """A message in a bag. `logged` is the time of recording, `published` the writer's stamp, both in ns since 1970."""

    channel: Channel
    logged: int
    published: int
    data: bytes


class _Short(Exception):
    """The file ends within a record: the file is truncated."""


def messages(path: Path) -> Iterator[Channel | Message]:
    """Yield the messages of a file, or of all files of a bag. Yield each channel before its messages.

    If a file is truncated, yield all complete messages. Raises Unreadable if a file is damaged or no bag, and OSError.
    """
    for file in files(path):
        yield from _of_file(file) if file.suffix == ".mcap" else _of_others(path)


def files(path: Path) -> list[Path]:
    """Return the files of a bag in their order. Raises Unreadable if there are none, and OSError."""
    if not path.is_dir():
        if path.suffix != ".mcap":
            raise Unreadable(f"{path}: not an MCAP file and not the folder of a bag")
        return [path]
    bag_files = sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name))
    if not bag_files and not (bag_files := sorted(path.glob("*.db3"))[:1]):
        raise Unreadable(f"{path}: this folder contains no bag")
    return bag_files


def _of_file(path: Path) -> Iterator[Channel | Message]:
    schemas: dict[int, records.Schema] = {}
    channels: dict[int, Channel] = {}
    with open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        if file.read(len(MAGIC)) != MAGIC:
            raise Unreadable(f"{path}: not an MCAP file")
        try:
            for code, content in _contents(file, size, path):
                match code:
                    case Opcode.MESSAGE:
                        message = records.Message.read(_Content(content), len(content))
                        if message.channel_id in channels:
                            channel = channels[message.channel_id]
                            yield Message(channel, message.log_time, message.publish_time, message.data)
                    case Opcode.SCHEMA:
                        schema = records.Schema.read(_Content(content))
                        schemas[schema.id] = schema
                    case Opcode.CHANNEL:
                        new = records.Channel.read(_Content(content))
                        if new.id not in channels:
                            channels[new.id] = _channel(new, schemas.get(new.schema_id), path)
                            yield channels[new.id]
        except _Short:
            return
        except (EndOfFile, UnicodeDecodeError):
            raise Unreadable(f"{path}: damaged: a record ends before its last field") from None


class _Content(ReadDataStream):
    """The content of one record. Raises EndOfFile if a field of the record exceeds the content."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        if length > self._size - self.count:
            raise EndOfFile
        return super().read(length)


def _channel(channel: records.Channel, schema: records.Schema | None, path: Path) -> Channel:
    if channel.message_encoding != "cdr":
        encoding = channel.message_encoding
        raise Unreadable(f"{path}: the messages of {channel.topic} are encoded as {encoding}; shmgen reads only cdr")
    name, text = (schema.name, schema.data.decode(errors="replace")) if schema else ("", "")
    return Channel(channel.topic, name, text, channel.metadata)


def _contents(file: BinaryIO, size: int, path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the records of a file of `size` bytes as _records() does, with the records of a chunk in its place."""
    for code, content in _records(file, size):
        if code == Opcode.CHUNK:
            inner = _unpack_chunk(records.Chunk.read(_Content(content)), path)
            yield from _records(BytesIO(inner), len(inner))
        else:
            yield code, content


def _records(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Yield the opcode and the content of each record, up to the end of an MCAP file's data section.

    A record that claims to be longer than `size` bytes is not read. Raises _Short if the last record is truncated.
    """
    while len(head := file.read(_HEAD.size)) == _HEAD.size:
        code, length = _HEAD.unpack(head)
        if code in (Opcode.DATA_END, Opcode.FOOTER):
            return
        content = file.read(length) if length <= size else b""
        if len(content) < length:
            raise _Short
        yield code, content


def _unpack_chunk(chunk: records.Chunk, path: Path) -> bytes:
    size, check = chunk.uncompressed_size, chunk.uncompressed_crc
    if chunk.compression and size > _LARGEST_CHUNK:
        raise Unreadable(f"{path}: an unpacked chunk has {counted(size, 'byte')}; the limit is {_LARGEST_CHUNK:,}")
    inner = _decompress(chunk.compression, chunk.data, size, path)
    if len(inner) != size or (check and zlib.crc32(inner) != check):
        raise Unreadable(f"{path}: damaged: a chunk of {counted(size, 'byte')} has another length or checksum")
    return inner


def _decompress(compression: str, packed: bytes, size: int, path: Path) -> bytes:
    """Decompress a chunk whose header claims `size` bytes. Raises Unreadable if the chunk is damaged.

    Stop after `size` + 1 bytes, so that a wrong size is noticed and a small file cannot fill the memory.
    """
    match compression:
        case "":
            return packed
        case "lz4":
            from lz4.frame import LZ4FrameDecompressor as Decompressor
        case "zstd":
            if sys.version_info >= (3, 14):
                from compression.zstd import ZstdDecompressor as Decompressor
            else:
                from backports.zstd import ZstdDecompressor as Decompressor
        case _:
            raise Unreadable(f"{path}: its chunks are packed as {compression!r}; shmgen reads only lz4 and zstd")
    try:
        inner: bytes = Decompressor().decompress(packed, max_length=size + 1)
    except Exception as error:  # each decompressor has its own exceptions
        raise Unreadable(f"{path}: damaged: a chunk cannot be unpacked: {error}") from None
    return inner


def _of_others(folder: Path) -> Iterator[Channel | Message]:
    """Yield the channels and messages of an SQLite bag, which rosbags reads.

    Such a bag has only one time for each message.
    """
    from rosbags.rosbag2 import Reader

    try:
        with Reader(folder) as reader:
            channels = {one.id: Channel(one.topic, one.msgtype, one.msgdef.data) for one in reader.connections}
            yield from channels.values()
            for connection, logged, data in reader.messages():
                yield Message(channels[connection.id], logged, logged, bytes(data))
    except Exception as error:  # from SQLite, YAML, or rosbags on an unexpected table
        raise Unreadable(f"{folder}: {error}") from None
