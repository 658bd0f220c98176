"""Checkpoint files of TensorFlow: named tensors in `.index` and `.data-*` files.

The index is a sorted table: a header under the empty key, then tensors. Source:
tensorflow/core/protobuf/tensor_bundle.proto.
"""

import itertools
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import google_crc32c
import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from drcli.base.errors import SettingsError, shown
from drcli.convert.tensorflow.graph import (
    BundleEntryMessage,
    BundleHeaderMessage,
    data_type,
    dtype_of,
    shape_of,
)

# Sorted tables of TensorFlow: the format of `.index` files.
#
# It is LevelDB's: blocks with checksums. Source: doc/table_format.md of LevelDB,
# tensorflow/core/lib/io/table_format.txt.


_MAGIC = 0xDB4775248B80FB57
_FOOTER_BYTES = 48
_TRAILER_BYTES = 5
"""Compression and checksum."""

_UNCOMPRESSED, _SNAPPY = 0, 1
_RESTART_INTERVAL = 16
_BLOCK_BYTES = 262_144
"""TensorFlow's."""

_MAX_KEY_BYTES = 4096
_MAX_ENTRIES = 100_000
"""An entry may repeat most of the key before it, so a few MB can claim many GB."""

_UINT32 = (1 << 32) - 1


@dataclass(frozen=True)
class _Place:
    offset: int
    size: int


def masked_crc(data: bytes) -> int:
    """CRC-32C, rotated, plus a constant."""
    crc = int(google_crc32c.value(data))
    return (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & _UINT32


def read_table(data: bytes, origin: str) -> dict[bytes, bytes]:
    """SettingsError if it is damaged or compressed, or has too many entries."""
    index_place = _footer(data, origin)
    found: dict[bytes, bytes] = {}
    before: bytes | None = None
    for _, handle in _entries(_block(data, index_place, origin), origin):
        place, _ = _handle(handle, 0, origin)
        for key, value in _entries(_block(data, place, origin), origin):
            if before is not None and key <= before:
                raise damaged(origin, f"the key {_shown(key)} is not after {_shown(before)}")
            if len(found) == _MAX_ENTRIES:
                raise damaged(origin, f"it has more than {_MAX_ENTRIES} entries")
            found[key] = value
            before = key
    return found


def write_table(entries: dict[bytes, bytes], *, block_bytes: int = _BLOCK_BYTES) -> bytes:
    file = bytearray()
    index, block = _Block(1), _Block(_RESTART_INTERVAL)
    ordered = sorted(entries.items())
    for (key, value), after in itertools.zip_longest(ordered, ordered[1:]):
        block.add(key, value)
        if after is None or block.size >= block_bytes:
            limit = _successor(key) if after is None else _separator(key, after[0])
            index.add(limit, _append(file, block.content()))
            block = _Block(_RESTART_INTERVAL)
    handles = _append(file, block.content()) + _append(file, index.content())
    padding = bytes(_FOOTER_BYTES - 8 - len(handles))
    return bytes(file + handles + padding + struct.pack("<Q", _MAGIC))


def damaged(origin: str, fault: str) -> SettingsError:
    return SettingsError(
        f"{origin} is damaged: {fault}.",
        remedy="Copy the file again from where it was written, or choose another checkpoint.",
    )


def _footer(data: bytes, origin: str) -> _Place:
    footer = data[-_FOOTER_BYTES:]
    if len(footer) < _FOOTER_BYTES or struct.unpack("<Q", footer[-8:])[0] != _MAGIC:
        raise SettingsError(
            f"{origin} is not the index of a TensorFlow checkpoint, or its end is missing.",
            remedy="Name a file that ends with .ckpt.index, or copy it again if it is incomplete.",
        )
    _, position = _handle(footer, 0, origin)
    place, _ = _handle(footer, position, origin)
    return place


def _block(data: bytes, place: _Place, origin: str) -> bytes:
    end = place.offset + place.size
    if end + _TRAILER_BYTES > len(data) - _FOOTER_BYTES:
        raise damaged(origin, f"a block ends at byte {end}, and the file has {len(data)}")
    content, kind = data[place.offset : end], data[end]
    (written,) = struct.unpack("<I", data[end + 1 : end + _TRAILER_BYTES])
    if written != masked_crc(data[place.offset : end + 1]):
        raise damaged(origin, f"the checksum (CRC-32C) of the block at {place.offset} is wrong")
    if kind == _SNAPPY:
        raise SettingsError(
            f"{origin} is compressed with Snappy, which checkpoints of the reference never are.",
            remedy="Save the checkpoint again with tf.compat.v1.train.Saver, which does not "
            "compress.",
        )
    if kind != _UNCOMPRESSED:
        raise damaged(origin, f"its blocks have the unknown compression {kind}")
    return content


def _entries(block: bytes, origin: str) -> Iterator[tuple[bytes, bytes]]:
    """A key repeats the first bytes of the one before it."""
    if len(block) < 4:
        raise damaged(origin, "a block is too short")
    (restarts,) = struct.unpack("<I", block[-4:])
    end = len(block) - 4 - 4 * restarts
    if end < 0:
        raise damaged(origin, f"a block of {len(block)} bytes claims {restarts} restart points")
    entries, position, key = block[:end], 0, b""
    while position < end:
        shared, position = _varint(entries, position, origin)
        unshared, position = _varint(entries, position, origin)
        length, position = _varint(entries, position, origin)
        value_start = position + unshared
        if shared > len(key) or value_start + length > end:
            raise damaged(origin, "an entry is longer than its block")
        if shared + unshared > _MAX_KEY_BYTES:
            raise damaged(origin, f"a key has more than {_MAX_KEY_BYTES} bytes")
        key = key[:shared] + entries[position:value_start]
        position = value_start + length
        yield key, entries[value_start:position]


def _handle(data: bytes, position: int, origin: str) -> tuple[_Place, int]:
    offset, position = _varint(data, position, origin)
    size, position = _varint(data, position, origin)
    return _Place(offset, size), position


def _varint(data: bytes, position: int, origin: str) -> tuple[int, int]:
    number = 0
    for shift in range(0, 64, 7):
        if position >= len(data):
            raise damaged(origin, "it ends inside a number")
        byte = data[position]
        position += 1
        number |= (byte & 0x7F) << shift
        if byte < 0x80:
            return number, position
    raise damaged(origin, "a number has more than 64 bits")


class _Block:
    def __init__(self, restart_interval: int) -> None:
        self._interval = restart_interval
        self._entries = bytearray()
        self._restarts = [0]
        self._count = 0
        self._before = b""

    @property
    def size(self) -> int:
        return len(self._entries) + 4 * len(self._restarts) + 4

    def add(self, key: bytes, value: bytes) -> None:
        shared = _common(self._before, key)
        if self._count and self._count % self._interval == 0:
            self._restarts.append(len(self._entries))
            shared = 0
        for length in (shared, len(key) - shared, len(value)):
            self._entries += _encoded_varint(length)
        self._entries += key[shared:] + value
        self._before = key
        self._count += 1

    def content(self) -> bytes:
        ends = (*self._restarts, len(self._restarts))
        return bytes(self._entries) + struct.pack(f"<{len(ends)}I", *ends)


def _append(file: bytearray, block: bytes) -> bytes:
    place = _encoded_varint(len(file)) + _encoded_varint(len(block))
    content = block + bytes([_UNCOMPRESSED])
    file += content + struct.pack("<I", masked_crc(content))
    return place


def _separator(last: bytes, first: bytes) -> bytes:
    """A short key between two blocks."""
    shared = _common(last, first)
    if shared < len(last) and last[shared] < 0xFF and last[shared] + 1 < first[shared]:
        return last[:shared] + bytes([last[shared] + 1])
    return last


def _successor(last: bytes) -> bytes:
    for position, byte in enumerate(last):
        if byte < 0xFF:
            return last[:position] + bytes([byte + 1])
    return last


def _common(one: bytes, other: bytes) -> int:
    length = min(len(one), len(other))
    return next((i for i in range(length) if one[i] != other[i]), length)


def _encoded_varint(number: int) -> bytes:
    encoded = bytearray()
    while number >= 0x80:
        encoded.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*encoded, number])


def _shown(key: bytes) -> str:
    return repr(key.decode(errors="backslashreplace"))[:80]


Array = NDArray[Any]

INDEX = ".index"
DATA = ".data-00000-of-00001"
_VERSION = 1
_BIG_ENDIAN = 1

_MAX_SHARDS = 1000

_TYPE_NAMES = {
    4: "uint8",
    5: "int16",
    6: "int8",
    7: "text",
    8: "complex64",
    10: "bool",
    14: "bfloat16",
    17: "uint16",
    20: "resource",
    21: "variant",
    22: "uint32",
    23: "uint64",
}
"""Source: TensorFlow's `types.proto`."""


@dataclass(frozen=True)
class Entry:
    """A tensor in the index.

    Attributes:
        shape: None for an unknown rank.
        shard: Number of its data file.
        slices: 0 if it is stored as a whole.
    """

    name: str
    dtype: int
    shape: tuple[int, ...] | None
    shard: int
    offset: int
    size: int
    crc: int
    slices: int


@dataclass(frozen=True)
class Bundle:
    """A checkpoint's index."""

    origin: str
    shards: int
    big_endian: bool
    entries: Mapping[str, Entry]

    @property
    def data_names(self) -> list[str]:
        return data_names(self.origin, self.shards)

    def read(self, name: str, data: bytes | Sequence[bytes]) -> Array:
        """The values of a tensor, from all data files in order.

        Raises:
            SettingsError: A file is missing, too short or altered, or the form is not read.
        """
        entry = self.entries[name]
        files = [data] if isinstance(data, bytes) else data
        if len(files) != self.shards:
            raise SettingsError(
                f"{self.origin} has {self.shards} data files, and {len(files)} of them are here.",
                remedy=f"Copy all files from {self.data_names[0]} to {self.data_names[-1]}.",
            )
        dtype, shape = self._checked(entry)
        end = entry.offset + entry.size
        file, file_name = files[entry.shard], self.data_names[entry.shard]
        if end > len(file):
            raise damaged(
                file_name, f"{shown(name)} ends at byte {end}, and the file has {len(file)}"
            )
        stored = file[entry.offset : end]
        if masked_crc(stored) != entry.crc:
            raise damaged(file_name, f"the checksum (CRC-32C) of {shown(name)} is wrong")
        values = np.frombuffer(stored, dtype.newbyteorder(">") if self.big_endian else dtype)
        return values.astype(dtype, copy=False).reshape(shape)

    def _checked(self, entry: Entry) -> tuple[np.dtype[Any], tuple[int, ...]]:
        index, name = self.origin + INDEX, shown(entry.name)
        if entry.slices:
            raise SettingsError(
                f"{index}: {name} is stored in {entry.slices} slices of a partitioned variable, "
                "which checkpoints of the reference never are.",
                remedy="Save the checkpoint again without a partitioner.",
            )
        dtype = dtype_of(entry.dtype)
        if dtype is None:
            kind = _TYPE_NAMES.get(entry.dtype, str(entry.dtype))
            raise SettingsError(
                f"{index}: {name} has values of the type {kind}, which no weight of a policy has.",
                remedy="Name a checkpoint that the reference simulator wrote.",
            )
        shape = entry.shape
        if shape is None or min(shape, default=0) < 0:
            raise damaged(index, f"{name} has no definite shape")
        if math.prod(shape) * dtype.itemsize != entry.size:
            raise damaged(
                index, f"{name} has {entry.size} bytes, which do not fit its shape {list(shape)}"
            )
        return dtype, shape


def open_bundle(index: bytes, origin: str) -> Bundle:
    """SettingsError if it is not an index, or damaged."""
    origin = origin.removesuffix(INDEX)
    name = origin + INDEX
    table = read_table(index, name)
    header = BundleHeaderMessage()
    try:
        header.ParseFromString(table.pop(b""))
    except (KeyError, DecodeError):
        raise damaged(name, "it has no header") from None
    if header.version.min_consumer > _VERSION:
        raise SettingsError(
            f"{name} has version {header.version.min_consumer} of the format, which is newer than "
            f"version {_VERSION}.",
            remedy="Save the checkpoint with an older version of TensorFlow.",
        )
    if not 1 <= header.num_shards <= _MAX_SHARDS:
        raise damaged(name, f"it claims {header.num_shards} data files")
    entries = {}
    for key, value in table.items():
        if key.startswith(b"\0"):
            continue  # a slice of a partitioned variable, which has an entry of its own
        entry = _entry(key, value, name)
        if not 0 <= entry.shard < header.num_shards or entry.offset < 0 or entry.size < 0:
            raise damaged(name, f"{shown(entry.name)} is at an impossible place")
        entries[entry.name] = entry
    return Bundle(origin, header.num_shards, header.endianness == _BIG_ENDIAN, entries)


def read_bundle(index: bytes, data: bytes | Sequence[bytes], origin: str) -> dict[str, Array]:
    bundle = open_bundle(index, origin)
    left = sum(map(len, [data] if isinstance(data, bytes) else data))
    found = {}
    for name, entry in bundle.entries.items():
        found[name] = bundle.read(name, data)
        left -= entry.size
        if left < 0:
            raise damaged(bundle.origin + INDEX, "its tensors have more bytes than the data")
    return found


def write_bundle(tensors: Mapping[str, Array]) -> tuple[bytes, bytes]:
    """`.index` and data file, with the bytes of TensorFlow.

    Raises:
        ValueError: A type cannot be written, or a name is empty.
    """
    header = BundleHeaderMessage(num_shards=1)
    header.version.producer = _VERSION
    table = {b"": header.SerializeToString(deterministic=True)}
    data = bytearray()
    for name, tensor in sorted(tensors.items(), key=lambda item: item[0].encode()):
        if not name:
            raise ValueError("A tensor has no name.")
        stored = np.asarray(tensor, order="C").tobytes()
        entry = BundleEntryMessage(
            dtype=data_type(tensor), offset=len(data), size=len(stored), crc32c=masked_crc(stored)
        )
        entry.shape.SetInParent()
        for size in tensor.shape:
            entry.shape.dim.add(size=size)
        table[name.encode()] = entry.SerializeToString(deterministic=True)
        data += stored
    return write_table(table), bytes(data)


def data_names(checkpoint: str, shards: int = 1) -> list[str]:
    return [f"{checkpoint}.data-{number:05d}-of-{shards:05d}" for number in range(shards)]


def _entry(key: bytes, value: bytes, origin: str) -> Entry:
    message = BundleEntryMessage()
    try:
        name = key.decode()
        message.ParseFromString(value)
    except (UnicodeDecodeError, DecodeError):
        raise damaged(origin, f"its entry {key[:60]!r} cannot be read") from None
    return Entry(
        name,
        message.dtype,
        None if message.shape.unknown_rank else tuple(shape_of(message.shape)),
        message.shard_id,
        message.offset,
        message.size,
        message.crc32c,
        len(message.slices),
    )
