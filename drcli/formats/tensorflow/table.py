"""Sorted tables of TensorFlow: the format of `.index` files.

It is LevelDB's: blocks with checksums. Source: doc/table_format.md of LevelDB,
tensorflow/core/lib/io/table_format.txt.
"""

import itertools
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import google_crc32c

from drcli.base.errors import SettingsError

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
