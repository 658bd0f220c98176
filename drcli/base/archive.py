"""Reads ZIP and tar archives of anybody in memory; nothing is extracted.

Python's `tarfile` takes a damaged header for the end, and reads headers of any size. This reader
refuses what it does not expect; it knows ustar, GNU and pax.
"""

import bz2
import lzma
import pickletools
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

from drcli.base.errors import SettingsError, shown
from drcli.base.files import is_left_behind

# Reads the bytes of an archive within limits.


LARGEST_BYTES = 1 << 30
"""Unpacked; importers of models have the same limit."""

READ_BYTES = 1 << 18

LARGEST_RATIO = 100
RATIO_FROM_BYTES = 16 << 20
"""A small archive that grows a lot is an attack."""

_XZ_BYTES = 256 << 20
"""`xz -9` needs 65 MB."""

_COMPRESSED = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ\x00": "xz"}
_OTHER_FORMATS = {
    b"\x28\xb5\x2f\xfd": "Zstandard",
    b"7z\xbc\xaf": "7-Zip",
    b"Rar!": "RAR",
}


class ArchiveFault(Exception):
    """To be read after a name."""

    def __init__(self, reason: str, member: str = "") -> None:
        super().__init__(reason)
        self.member = member


class Stream:
    """Unpacked bytes; `position` counts them."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._piece = memoryview(b"")
        self.position = 0
        self._produced = 0

    def read(self, size: int) -> bytes:
        """Fewer only at the end; ArchiveFault if damaged or too large."""
        pieces = []
        while size > 0:
            if not self._piece:
                piece = self._next()
                self._produced += len(piece)
                if self._produced > LARGEST_BYTES:
                    raise ArchiveFault(f"unpacks to more than {LARGEST_BYTES >> 20:,} MB")
                if not piece:
                    break
                self._piece = memoryview(piece)
            taken = self._piece[:size]
            self._piece = self._piece[size:]
            pieces.append(taken)
            size -= len(taken)
            self.position += len(taken)
        return b"".join(pieces)

    def _next(self) -> bytes:
        return self._file.read(READ_BYTES)


class _Compressed(Stream):
    def __init__(self, file: BinaryIO, mark: bytes) -> None:
        super().__init__(file)
        self._mark = mark
        self._unpack = self._begin()
        self._waiting = b""
        self._consumed = 0

    def _begin(self) -> Any:
        match _COMPRESSED[self._mark]:
            case "gzip":
                return zlib.decompressobj(wbits=31)
            case "bzip2":
                return bz2.BZ2Decompressor()
            case _:
                return lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_XZ_BYTES)

    def _fault(self, reason: str) -> ArchiveFault:
        form = _COMPRESSED[self._mark]
        return ArchiveFault(reason if form == "gzip" else f"is a {form} file that {reason}")

    def _next(self) -> bytes:
        while True:
            if self._unpack.eof and not self._continues():
                return b""
            packed = b""
            if getattr(self._unpack, "needs_input", True):
                packed = self._waiting or self._file.read(READ_BYTES)
                if not packed:
                    raise self._fault("is truncated")
                self._waiting = b""
            try:
                piece: bytes = self._unpack.decompress(packed, READ_BYTES)
            except (zlib.error, lzma.LZMAError, OSError):
                raise self._fault("is damaged: it cannot be decompressed") from None
            self._waiting = getattr(self._unpack, "unconsumed_tail", b"")
            self._consumed += len(packed) - len(self._waiting)
            grown = self._produced + len(piece)
            if grown > max(RATIO_FROM_BYTES, LARGEST_RATIO * self._consumed):
                raise ArchiveFault(f"unpacks to more than {LARGEST_RATIO} times its size")
            if piece:
                return piece

    def _continues(self) -> bool:
        """Zeros may stand at the end."""
        rest: bytes = self._unpack.unused_data or self._file.read(READ_BYTES)
        if len(rest) < len(self._mark):
            rest += self._file.read(READ_BYTES)
        self._consumed -= len(self._unpack.unused_data)
        if rest.startswith(self._mark):
            self._unpack, self._waiting = self._begin(), rest
            return True
        while rest:
            if any(rest):
                raise self._fault("is damaged: other data follows its end")
            rest = self._file.read(READ_BYTES)
        return False


def open_stream(file: BinaryIO) -> Stream:
    """Decompresses gzip, bzip2 and xz.

    Raises:
        ArchiveFault: It is empty, or of another format.
    """
    start = file.read(8)
    file.seek(0)
    if not start:
        raise ArchiveFault("is empty")
    for mark, name in _OTHER_FORMATS.items():
        if start.startswith(mark):
            raise ArchiveFault(f"is a {name} file instead of a .tar.gz")
    for mark in _COMPRESSED:
        if start.startswith(mark):
            return _Compressed(file, mark)
    return Stream(file)


# Recognises Python pickles; loading one may run any program.


_WEIGHT_FILE = re.compile(
    r"\.(pb|index|meta|safetensors|onnx|tflite|bin|xml|pt|pth|pkl|pickle|npy|npz|ckpt|h5|zip)$"
    r"|\.data-\d+-of-\d+$",
    re.IGNORECASE,
)

_CERTAIN_AFTER = 200
"""Other data does not have so many operations in a row."""

_PICKLE_IN_ZIP = re.compile(r"(^|/)[^/]*\.(pkl|pickle)$|(^|/)data$", re.IGNORECASE)


def is_weight_file(name: str) -> bool:
    return _WEIGHT_FILE.search(name) is not None


def is_pickle(data: bytes) -> bool:
    """Also a file of PyTorch or NumPy that contains one."""
    if data.startswith(b"PK\x03\x04"):
        try:
            with zipfile.ZipFile(BytesIO(data)) as archive:
                return any(map(_PICKLE_IN_ZIP.search, archive.namelist()))
        except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError, OSError):
            return False
    if data.startswith(b"\x93NUMPY"):
        return b"'O'" in data[:256] or b"|O" in data[:256]
    return _has_operations(data)


def _has_operations(data: bytes) -> bool:
    stream = BytesIO(data)
    count = 0
    name = ""
    try:
        for operation, _, _ in islice(pickletools.genops(stream), _CERTAIN_AFTER):
            count += 1
            name = operation.name
    except (ValueError, EOFError, UnicodeDecodeError, OverflowError, MemoryError):
        return False
    if name == "STOP":
        return count > 1 and not data[stream.tell() :].strip(b"\0\r\n ")
    return count == _CERTAIN_AFTER


ENDINGS = (".tar.gz", ".tgz", ".tar", ".tar.bz2", ".tbz2", ".tar.xz", ".txz", ".zip")
LARGEST_MEMBER_BYTES = 512 << 20
"""The reference's largest checkpoint has about 230 MB."""

MOST_MEMBERS = 10_000

_LONGEST_NAME = 1024
_LARGEST_HEADER_BYTES = 1 << 20
_BLOCK = 512
_REGULAR, _CONTIGUOUS, _FOLDER = b"0", b"7", b"5"
_GNU_NAME, _GNU_LINK, _PAX, _PAX_GLOBAL = b"L", b"K", b"x", b"g"

_REFUSED = {
    b"1": "is a hard link",
    b"2": "is a symbolic link",
    b"3": "is a device",
    b"4": "is a device",
    b"6": "is a named pipe",
    b"S": "is a sparse file",
    b"M": "continues in another archive",
    b"V": "is the label of a volume",
    b"D": "is a list of files",
}
_ENCRYPTED = 0x1

_ZIP_DAMAGE = (
    *(zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, ValueError, struct.error),
    *(zlib.error, lzma.LZMAError, OSError),  # OSError: what is wrong with a bzip2 stream
)
_REMEDY = "Use another archive, or pack the model's files again with `tar czf NAME.tar.gz FILES`."


def read_archive(path: Path) -> dict[str, bytes]:
    """Read all files of an archive but those that programs leave behind.

    Raises:
        SettingsError: It is unreadable, damaged, or contains something that no model has.
    """
    return unpack_archive(BytesIO(read_packed(path)), str(path))


def read_packed(path: Path) -> bytes:
    """SettingsError if it is too large."""
    remedy = "Name an archive (.tar.gz, .tar or .zip) that you can read."
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):  # opening a named pipe would wait for a writer
            raise SettingsError(f"{path} is not an ordinary file.", remedy=remedy)
        if found.st_size > LARGEST_BYTES:
            limit = f"{LARGEST_BYTES >> 20:,} MB"
            raise SettingsError(f"{path} has more than {limit}.", remedy=_REMEDY)
        return path.read_bytes()
    except (OSError, ValueError) as e:
        reason = getattr(e, "strerror", None) or e
        raise SettingsError(f"{path} cannot be read: {reason}.", remedy=remedy) from e


def unpack_archive(
    file: BinaryIO, origin: str, *, wanted: Callable[[str], bool] = lambda n: not is_left_behind(n)
) -> dict[str, bytes]:
    """Read wanted files, see `read_archive`; messages call the archive `origin`."""
    found: dict[str, bytes] = {}
    folders: set[str] = set()
    try:
        for name, data in _members(file, wanted):
            if name in found or name in folders:
                raise ArchiveFault("occurs twice", name)
            found[name] = data
            above = name.split("/")[:-1]
            folders.update("/".join(above[:depth]) for depth in range(1, len(above) + 1))
            if not folders.isdisjoint(found):
                raise ArchiveFault("is a file and also a folder", min(folders & found.keys()))
            if is_weight_file(name) and is_pickle(data):
                raise ArchiveFault(
                    "is a Python pickle, which could run any program when it is read", name
                )
    except ArchiveFault as fault:
        place = f": {shown(fault.member)}" if fault.member else ""
        raise SettingsError(f"{origin}{place} {fault}.", remedy=_REMEDY) from None
    return found


def unpack_readable(
    file: BinaryIO, wanted: Callable[[str], bool]
) -> tuple[dict[str, bytes], ArchiveFault | None]:
    """Read wanted files of an archive as far as possible, and what ended that early.

    Nothing is executed or written, so links, doubles (the last one counts) and weights do not
    matter. The limits of `open_stream` hold.
    """
    found: dict[str, bytes] = {}
    try:
        found.update(_members(file, wanted))
    except ArchiveFault as fault:
        return found, fault
    return found, None


def _members(file: BinaryIO, wanted: Callable[[str], bool]) -> Iterator[tuple[str, bytes]]:
    start = file.read(4)
    file.seek(0)
    if start.startswith(b"PK"):
        yield from _zip_members(file, wanted)
    else:
        yield from (each for each in _tar_members(open_stream(file)) if wanted(each[0]))


def _zip_members(file: BinaryIO, wanted: Callable[[str], bool]) -> Iterator[tuple[str, bytes]]:
    """The directory may state wrong sizes."""
    budget = LARGEST_BYTES
    try:
        with zipfile.ZipFile(file) as archive:
            infos = archive.infolist()
            if len(infos) > MOST_MEMBERS:
                raise ArchiveFault(f"has more than {MOST_MEMBERS:,} members")
            for info in infos:
                name = _plain(info.filename.replace("\\", "/"))
                if stat.S_ISLNK(info.external_attr >> 16):
                    raise ArchiveFault(f"{_REFUSED[b'2']}, which no model has", name)
                if info.is_dir() or not wanted(name):
                    continue
                data = _unzipped(archive, info, min(budget, LARGEST_MEMBER_BYTES))
                budget -= len(data)
                yield name, data
    except _ZIP_DAMAGE as error:
        reason = error or "it ends too early"
        raise ArchiveFault(f"is a ZIP file that is damaged: {reason}") from None


def _unzipped(archive: zipfile.ZipFile, info: zipfile.ZipInfo, limit: int) -> bytes:
    if info.flag_bits & _ENCRYPTED:
        raise ArchiveFault("is encrypted", info.filename)
    with archive.open(info) as member:
        data = member.read(limit + 1)
    if len(data) > limit:
        raise ArchiveFault(f"unpacks to more than {limit >> 20:,} MB", info.filename)
    if len(data) > max(RATIO_FROM_BYTES, LARGEST_RATIO * info.compress_size):
        raise ArchiveFault(f"unpacks to more than {LARGEST_RATIO} times its size", info.filename)
    return data


def _tar_members(stream: Stream) -> Iterator[tuple[str, bytes]]:
    attributes: dict[str, str] = {}
    count = 0
    while (header := _header(stream)) is not None:
        count += 1
        if count > MOST_MEMBERS:
            raise ArchiveFault(f"has more than {MOST_MEMBERS:,} members")
        kind = header[156:157]
        name = attributes.get("path") or _name(header)
        if kind in (_GNU_NAME, _GNU_LINK, _PAX, _PAX_GLOBAL):
            attributes |= _attributes(stream, kind, _number(header[124:136], name), name)
            continue
        size = _size(header, attributes, name)
        attributes = {}
        if kind in _REFUSED:
            raise ArchiveFault(f"{_REFUSED[kind]}, which no model has", name)
        is_folder = kind == _FOLDER or (kind in (_REGULAR, b"\0") and name.endswith("/"))
        if not is_folder and kind not in (_REGULAR, b"\0", _CONTIGUOUS):
            raise ArchiveFault("is of an unknown kind", name)
        plain = _plain(name)
        if size > LARGEST_MEMBER_BYTES:
            limit = LARGEST_MEMBER_BYTES >> 20
            raise ArchiveFault(f"has {size:,} bytes, more than the {limit} MB of any model", name)
        content = _content(stream, size, name)
        if not is_folder:
            if not plain:
                raise ArchiveFault("is a file without a name", name)
            yield plain, content


def _header(stream: Stream) -> bytes | None:
    first = stream.position == 0
    header = stream.read(_BLOCK)
    if len(header) < _BLOCK:
        raise ArchiveFault("is not a tar archive" if first else "is truncated")
    if not any(header):
        while stream.read(READ_BYTES):  # what follows the mark is not part of the archive
            pass
        return None
    known = _octal(header[148:156])
    blank = header[:148] + b" " * 8 + header[156:]
    sums = {sum(blank), sum(byte - 256 * (byte > 127) for byte in blank)}  # old tars add signed
    if known not in sums:
        raise ArchiveFault("is not a tar archive" if first else "is damaged: a header is wrong")
    return header


def _attributes(stream: Stream, kind: bytes, size: int, name: str) -> dict[str, str]:
    if size > _LARGEST_HEADER_BYTES:
        raise ArchiveFault(f"has a header of {size:,} bytes", name)
    content = _content(stream, size, name)
    if kind == _GNU_NAME:
        return {"path": _text(content)}
    if kind == _GNU_LINK:
        return {}  # the link itself is refused
    found = _pax(content, name)
    if kind == _PAX:
        return found
    if found.keys() & {"path", "size"}:
        raise ArchiveFault("gives all members the same name or size", name)
    return {}


def _content(stream: Stream, size: int, name: str) -> bytes:
    data = stream.read(size)
    padding = -size % _BLOCK
    if len(data) < size or len(stream.read(padding)) < padding:
        raise ArchiveFault("is truncated", name)
    return data


def _name(header: bytes) -> str:
    name, before = (header[part].partition(b"\0")[0] for part in (slice(100), slice(345, 500)))
    is_posix = header[257:263] == b"ustar\0"
    return _text(before + b"/" + name if is_posix and before else name)


def _text(data: bytes) -> str:
    return data.partition(b"\0")[0].decode("utf-8", "surrogateescape")


def _size(header: bytes, attributes: Mapping[str, str], name: str) -> int:
    if "size" not in attributes:
        return _number(header[124:136], name)
    if not (attributes["size"].isascii() and attributes["size"].isdigit()):
        raise ArchiveFault("has a size that is not a number", name)
    if len(attributes["size"]) > 20:
        raise ArchiveFault("has an impossible size", name)
    return int(attributes["size"])


def _number(field: bytes, name: str) -> int:
    """Octal or, for large sizes, two's complement after a first bit."""
    size = int.from_bytes(field) - (0x80 << 88) if field[0] == 0x80 else _octal(field)
    if size is None or field[0] > 0x80:
        raise ArchiveFault("has a size that is not a number", name)
    return size


def _octal(field: bytes) -> int | None:
    digits = field.partition(b"\0")[0].strip()
    if not all(byte in b"01234567" for byte in digits):
        return None
    return int(digits or b"0", 8)


def _pax(content: bytes, name: str) -> dict[str, str]:
    """Lines of `length key=value`."""
    found: dict[str, str] = {}
    position = 0
    while position < len(content):
        end = content.find(b" ", position, position + 20)
        length = content[position:end] if end > 0 else b""
        if not length.isdigit() or not end - position < int(length) <= len(content) - position:
            raise ArchiveFault("has a damaged header", name)
        key, equals, value = content[end + 1 : position + int(length) - 1].partition(b"=")
        if not equals or content[position + int(length) - 1 : position + int(length)] != b"\n":
            raise ArchiveFault("has a damaged header", name)
        if key.startswith(b"GNU.sparse"):
            raise ArchiveFault(f"{_REFUSED[b'S']}, which no model has", name)
        found[_text(key)] = _text(value)
        position += int(length)
    return found


def _plain(name: str) -> str:
    """Empty for the folder that was packed."""
    if len(name) > _LONGEST_NAME:
        raise ArchiveFault("has a name that is too long", name)
    if name.startswith("/") or (name[1:2] == ":" and name[:1].isalpha()):
        raise ArchiveFault("has an absolute name", name)
    parts = [part for part in name.split("/") if part not in ("", ".")]
    if ".." in parts:
        raise ArchiveFault("leads out of the archive", name)
    if "\\" in name or any(ord(letter) < 32 for letter in name):
        raise ArchiveFault("has a name that is not allowed", name)
    return "/".join(parts)
