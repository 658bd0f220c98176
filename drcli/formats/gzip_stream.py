"""Reads the bytes of an archive within limits."""

import bz2
import lzma
import zlib
from typing import Any, BinaryIO

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
