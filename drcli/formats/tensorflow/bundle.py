"""Checkpoint files of TensorFlow: named tensors in `.index` and `.data-*` files.

The index is a sorted table: a header under the empty key, then tensors. Source:
tensorflow/core/protobuf/tensor_bundle.proto.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from drcli.base.errors import SettingsError
from drcli.base.problems import shown
from drcli.formats.tensorflow.graph import data_type, dtype_of, shape_of
from drcli.formats.tensorflow.messages import BundleEntryMessage, BundleHeaderMessage
from drcli.formats.tensorflow.table import damaged, masked_crc, read_table, write_table

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
