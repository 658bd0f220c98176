"""Reads what a MinIO on one drive keeps in its folder, as DeepRacer-for-Cloud does in data/minio.

An object is a folder with a file xl.meta, which describes its versions, the newest first, and holds
small contents. Larger ones are beside it, in a folder of the version, as part.1, part.2 and so on.
Contents stand in blocks, each after a checksum of 32 bytes. What was read is compared with the MD5
in the object's ETag, and those checksums are left aside. MinIO before June 2022 kept plain files.

Source: minio/minio, cmd/xl-storage-format-v2.go, formats 1.0 to 1.3.
"""

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from uuid import UUID

import msgspec

from drcli.base.errors import SettingsError
from drcli.base.files import read_regular
from drcli.bucket.bucket import Bucket
from drcli.config.run_config import StorageConfig
from drcli.model import keys
from drcli.transfer.put_model import POINTERS

META = "xl.meta"
FOLDER = "data/minio"
"""Below a folder of DeepRacer-for-Cloud."""

DIRECTORY = "__XLDIR__"
"""Ends the name of an object that ends in a slash."""

_HEADER = b"XL2 "
_BLOCK_CHECKSUM_BYTES = 32
_DELETED = 2
_NOT_READ = (
    ("x-minio-internal-compression", "compressed"),
    ("x-minio-internal-server-side-encryption", "encrypted"),
    ("x-minio-internal-transition", "moved to another storage"),
)
_BESIDE_MODELS = ("training-simtrace", "evaluation-simtrace", "metrics", "ip")
_REMEDY = "Start that MinIO and read the model through it: `dr docs from-drfc`."


class _Content(msgspec.Struct):
    version: bytes = msgspec.field(name="ID")
    folder: bytes = msgspec.field(name="DDir")
    data_drives: int = msgspec.field(name="EcM")
    parity_drives: int = msgspec.field(name="EcN")
    block_bytes: int = msgspec.field(name="EcBSize")
    parts: list[int] = msgspec.field(name="PartNums")
    size: int = msgspec.field(name="Size")
    written_ns: int = msgspec.field(name="MTime")
    of_minio: dict[str, bytes] | None = msgspec.field(name="MetaSys", default=None)
    of_user: dict[str, str] | None = msgspec.field(name="MetaUsr", default=None)


class _DeleteMarker(msgspec.Struct):
    written_ns: int = msgspec.field(name="MTime")


class _Version(msgspec.Struct):
    kind: int = msgspec.field(name="Type")
    content: _Content | None = msgspec.field(name="V2Obj", default=None)
    marker: _DeleteMarker | None = msgspec.field(name="DelObj", default=None)

    def written_ns(self) -> int:
        told = self.content or self.marker
        return 0 if told is None else told.written_ns


class _Versions(msgspec.Struct):
    versions: list[_Version] = msgspec.field(name="Versions")


@dataclass(frozen=True)
class MinioObject:
    """The newest version of an object; `content` None: it was deleted."""

    path: Path
    content: _Content | None
    inline: bytes

    @classmethod
    def open(cls, path: Path) -> "MinioObject":
        """Read the xl.meta in the folder of an object.

        Raises:
            SettingsError: It is damaged, or of another kind than is read here.
            OSError: It cannot be read.
        """
        newest, inline = _newest(path / META)
        if newest.kind == _DELETED:
            return cls(path, None, b"")
        if newest.content is None:
            raise _refused(path, "was written by a MinIO of 2020 or earlier")
        return cls(path, newest.content, inline)

    @property
    def size(self) -> int:
        return 0 if self.content is None else self.content.size

    def read(self) -> bytes:
        """Its bytes.

        Raises:
            SettingsError: They are missing, damaged, or not stored as they are.
        """
        content = self.content
        if content is None:
            raise _refused(self.path, "was deleted in MinIO", "Choose another model.")
        self._refuse_other_kinds(content)
        stored = self._inline(content)
        parts = [stored] if stored is not None else [*self._parts(content)]
        plain = [self._without_checksums(part, content.block_bytes) for part in parts]
        data = b"".join(plain)
        if len(data) != content.size:
            raise _damaged(self.path, f"it has {len(data):,} bytes instead of {content.size:,}")
        if (content.of_user or {}).get("etag") not in _etags(plain):
            raise _damaged(self.path, "its bytes do not fit its ETag")
        return data

    def _refuse_other_kinds(self, content: _Content) -> None:
        drives = content.data_drives + content.parity_drives
        if drives != 1:
            raise _refused(self.path, f"was spread over {drives} drives by MinIO")
        for name in content.of_minio or {}:
            for beginning, what in _NOT_READ:
                if name.casefold().startswith(beginning):
                    raise _refused(self.path, f"was {what} by MinIO")

    def _inline(self, content: _Content) -> bytes | None:
        if not self.inline:
            return None
        version = str(UUID(bytes=content.version)) if any(content.version) else "null"
        try:
            return msgspec.msgpack.decode(self.inline[1:], type=dict[str, bytes]).get(version)
        except msgspec.DecodeError as error:
            raise _damaged(self.path / META, str(error)) from error

    def _parts(self, content: _Content) -> Iterator[bytes]:
        folder = self.path / str(UUID(bytes=content.folder))
        for number in content.parts:
            try:
                yield read_regular(folder / f"part.{number}")
            except OSError as e:
                why = f"{folder.name}/part.{number} cannot be read ({e.strerror or e})"
                raise _damaged(self.path, why) from e

    def _without_checksums(self, stored: bytes, block_bytes: int) -> bytes:
        step = _BLOCK_CHECKSUM_BYTES + block_bytes
        if block_bytes <= 0 or 0 < len(stored) % step <= _BLOCK_CHECKSUM_BYTES:
            raise _damaged(self.path, "a block of it is cut off")
        blocks = range(0, len(stored), step)
        return b"".join(stored[at + _BLOCK_CHECKSUM_BYTES : at + step] for at in blocks)


def read(path: Path) -> bytes:
    """The bytes of the object in a folder with an xl.meta.

    Raises:
        SettingsError: They are missing, damaged, or not stored as they are.
    """
    try:
        return MinioObject.open(path).read()
    except ValueError as e:
        raise _damaged(path, str(e)) from e
    except OSError as e:
        raise _damaged(path, f"{META} cannot be read ({e.strerror or e})") from e


def size_of(path: Path) -> int | None:
    """Size of the object in a folder with an xl.meta; None if it is not there any more.

    0 for one that cannot be read: reading it says why.
    """
    try:
        found = MinioObject.open(path)
    except (SettingsError, OSError):
        return 0
    is_folder = path.name.endswith(DIRECTORY)
    return None if found.content is None or is_folder else found.size


def unread_models(storage: StorageConfig, directory: Path, bucket: Bucket) -> list[str]:
    """Models in MinIO's folder that the local bucket does not have, by their prefix."""
    root = directory / FOLDER / bucket.name
    if storage.cloud != "local":
        return []
    found = []
    for parent, below, _ in os.walk(root):
        # `Path.exists` raises where a folder of another user may not be entered.
        if any(os.path.exists(f"{parent}/{pointer}") for pointer in POINTERS):  # noqa: PTH110
            found.append(Path(parent).relative_to(root).as_posix())
        left_out = ("model", *_BESIDE_MODELS)
        below[:] = sorted(each for each in below if each not in left_out and each[0] != ".")
    return [
        prefix
        for prefix in found
        if not any(bucket.exists(keys.folder(prefix) + pointer) for pointer in POINTERS)
    ]


def told_unread(models: list[str], bucket: Bucket) -> tuple[str, str]:
    """What to say about `unread_models`, and what to do."""
    folder = f"{FOLDER}/{bucket.name}"
    more = f" and {len(models) - 1:,} more lie" if len(models) > 1 else " lies"
    kept = "them" if len(models) > 1 else "it"
    what = f"{models[0]}{more} in {folder}, where MinIO kept {kept}, not in the bucket."
    return what, f"Run `dr-import {folder}/{models[0]} -t {models[0]}`."


def _newest(path: Path) -> tuple[_Version, bytes]:
    """Also what follows the versions: contents of small objects."""
    data = read_regular(path)
    if data[:4] != _HEADER or len(data) <= 8:
        raise _damaged(path, "it does not begin with XL2")
    old = data[4:8] == b"1   "
    major, minor = (1, 0) if old else (data[4] | data[5] << 8, data[6] | data[7] << 8)
    if (major, minor) > (1, 3):
        raise _refused(path, f"has format {major}.{minor} of a later MinIO than is known here")
    try:
        if minor == 0:
            return _latest(data[8:]), b""
        outer = _Pieces(data, 8)
        described = outer.blob()
        if minor > 1:
            outer.number()  # its checksum
        if minor < 3:
            return _latest(described), outer.rest()
        inner = _Pieces(described, 0)
        inner.number(), inner.number()  # formats of its two parts
        if inner.number() < 1:
            raise _damaged(path, "it describes no version")
        inner.blob()  # the header, which repeats some of the version
        return msgspec.msgpack.decode(inner.blob(), type=_Version), outer.rest()
    except (msgspec.DecodeError, IndexError, ValueError) as error:
        raise _damaged(path, str(error).rstrip(".")) from error


def _latest(data: bytes) -> _Version:
    versions = msgspec.msgpack.decode(data, type=_Versions).versions
    return max(versions, key=_Version.written_ns)


_WIDTHS = {0xC4: 1, 0xC5: 2, 0xC6: 4, 0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8}
"""Bytes of a length or number, by the byte before it."""


def _width(first: int) -> int:
    if first not in _WIDTHS:
        raise ValueError(f"byte {first} is not expected")
    return _WIDTHS[first]


class _Pieces:
    """Values of msgpack, one after the other."""

    def __init__(self, data: bytes, at: int) -> None:
        self._data = data
        self._at = at

    def number(self) -> int:
        first = self._take(1)[0]
        return first if first < 0x80 else int.from_bytes(self._take(_width(first)))

    def blob(self) -> bytes:
        return self._take(int.from_bytes(self._take(_width(self._take(1)[0]))))

    def rest(self) -> bytes:
        return self._data[self._at :]

    def _take(self, count: int) -> bytes:
        piece = self._data[self._at : self._at + count]
        if len(piece) < count:
            raise ValueError("it is cut off")
        self._at += count
        return piece


def _etags(parts: list[bytes]) -> set[str]:
    """As S3 makes them: of a whole object, or of one that was sent in parts."""
    sums = [hashlib.md5(part, usedforsecurity=False) for part in parts]
    joined = hashlib.md5(b"".join(each.digest() for each in sums), usedforsecurity=False)
    whole = {sums[0].hexdigest()} if len(parts) == 1 else {_EMPTY} if not parts else set()
    return {*whole, f"{joined.hexdigest()}-{len(parts)}"}


_EMPTY = hashlib.md5(b"", usedforsecurity=False).hexdigest()


def _refused(path: Path, what: str, remedy: str = _REMEDY) -> SettingsError:
    return SettingsError(f"{path} {what}, so it cannot be read here.", remedy=remedy)


def _damaged(path: Path, why: str) -> SettingsError:
    return SettingsError(f"{path} is damaged: {why}.", remedy=f"Copy it again. {_REMEDY}")
