"""Writes objects as a MinIO on one drive keeps them in its folder (format 1.3)."""

import hashlib
from pathlib import Path
from uuid import UUID

from msgspec import msgpack

BLOCK_BYTES = 1 << 20
_DATA_DIR = UUID(int=7)
_CHECKSUM = b"\xaa" * 32
"""HighwayHash in truth; it is not read."""


def blocks(data: bytes) -> bytes:
    pieces = (data[at : at + BLOCK_BYTES] for at in range(0, len(data), BLOCK_BYTES))
    return b"".join(_CHECKSUM + piece for piece in pieces)


def content(parts: list[bytes], **changes: object) -> dict[str, object]:
    sums = [hashlib.md5(part).digest() for part in parts]
    etag = sums[0].hex()
    if len(parts) > 1:
        etag = f"{hashlib.md5(b''.join(sums)).hexdigest()}-{len(parts)}"
    return {
        "ID": bytes(16),
        "DDir": _DATA_DIR.bytes,
        "EcAlgo": 1,
        "EcM": 1,
        "EcN": 0,
        "EcBSize": BLOCK_BYTES,
        "EcIndex": 1,
        "EcDist": b"\x01",
        "CSumAlgo": 1,
        "PartNums": [number + 1 for number in range(len(parts))],
        "PartETags": None,
        "PartSizes": [len(part) for part in parts],
        "PartASizes": [len(part) for part in parts],
        "Size": sum(map(len, parts)),
        "MTime": 1_700_000_000_000_000_000,
        "MetaSys": None,
        "MetaUsr": {"etag": etag, "content-type": "application/octet-stream"},
        **changes,
    }


def described(version: dict[str, object], inline: bytes | None = None) -> bytes:
    """An xl.meta with one version."""
    header = [bytes(16), 1, bytes(4), version["Type"], 0, 0, 1]
    numbers = b"\x03\x03\x01"
    inner = numbers + _blob(msgpack.encode(header)) + _blob(msgpack.encode(version))
    data = b"" if inline is None else b"\x01" + msgpack.encode({"null": inline})
    crc = b"\xce" + bytes(4)
    return b"XL2 \x01\x00\x03\x00" + b"\xc6" + len(inner).to_bytes(4) + inner + crc + data


def put(path: Path, *parts: bytes, inline: bool = False, **changes: object) -> None:
    """Write an object; `changes` are fields of its version."""
    path.mkdir(parents=True, exist_ok=True)
    version = {"Type": 1, "V2Obj": content(list(parts), **changes), "v": 1}
    (path / "xl.meta").write_bytes(described(version, blocks(parts[0]) if inline else None))
    if not inline:
        folder = path / str(_DATA_DIR)
        folder.mkdir(exist_ok=True)
        for number, part in enumerate(parts, 1):
            (folder / f"part.{number}").write_bytes(blocks(part))


def delete(path: Path) -> None:
    """Leave a delete marker."""
    path.mkdir(parents=True, exist_ok=True)
    version = {"Type": 2, "DelObj": {"ID": bytes(16), "MTime": 2_000_000_000_000_000_000}, "v": 1}
    (path / "xl.meta").write_bytes(described(version))


def _blob(data: bytes) -> bytes:
    return b"\xc5" + len(data).to_bytes(2) + data
