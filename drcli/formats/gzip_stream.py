"""Reads the bytes of an archive, compressed or not, piece by piece and within limits."""

import zlib
from typing import BinaryIO

LARGEST_BYTES = 1 << 30
"""Of an unpacked archive. Importers of models have the same limit."""

READ_BYTES = 1 << 18

LARGEST_RATIO = 100
RATIO_FROM_BYTES = 16 << 20
"""Weights hardly shrink when they are compressed; a small archive that grows a lot is a trap."""

_GZIP = b"\x1f\x8b"
_OTHER_FORMATS = {
    b"PK\x03\x04": "ZIP",
    b"PK\x05\x06": "ZIP",
    b"BZh": "bzip2",
    b"\xfd7zXZ\x00": "xz",
    b"\x28\xb5\x2f\xfd": "Zstandard",
    b"7z\xbc\xaf": "7-Zip",
    b"Rar!": "RAR",
}


class ArchiveFault(Exception):
    """What is wrong with an archive, to be read after its name, or after that of a member."""

    def __init__(self, reason: str, member: str = "") -> None:
        super().__init__(reason)
        self.member = member


class Stream:
    """The unpacked bytes of an archive, from the first to the last; `position` counts them."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._piece = memoryview(b"")
        self.position = 0
        self._produced = 0

    def read(self, size: int) -> bytes:
        """Read so many bytes, fewer only at the end.

        Raises:
            ArchiveFault: The archive is damaged or too large.
        """
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
        """Some more bytes; none at the end."""
        return self._file.read(READ_BYTES)


class _Gzip(Stream):
    """The same for a compressed archive."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)
        self._unpack = zlib.decompressobj(wbits=31)
        self._waiting = b""
        self._consumed = 0

    def _next(self) -> bytes:
        while True:
            if self._unpack.eof and not self._continues():
                return b""
            packed = self._waiting or self._file.read(READ_BYTES)
            if not packed:
                raise ArchiveFault("is truncated")
            try:
                piece = self._unpack.decompress(packed, READ_BYTES)
            except zlib.error:
                raise ArchiveFault("is damaged: it cannot be decompressed") from None
            self._waiting = self._unpack.unconsumed_tail
            self._consumed += len(packed) - len(self._waiting)
            grown = self._produced + len(piece)
            if grown > max(RATIO_FROM_BYTES, LARGEST_RATIO * self._consumed):
                raise ArchiveFault(f"unpacks to more than {LARGEST_RATIO} times its size")
            if piece:
                return piece

    def _continues(self) -> bool:
        """Whether another compressed part follows; zeros after the last one are allowed."""
        rest = self._unpack.unused_data or self._file.read(READ_BYTES)
        if len(rest) == 1:
            rest += self._file.read(READ_BYTES)
        self._consumed -= len(self._unpack.unused_data)
        if rest.startswith(_GZIP):
            self._unpack, self._waiting = zlib.decompressobj(wbits=31), rest
            return True
        while rest:
            if any(rest):
                raise ArchiveFault("is damaged: other data follows its end")
            rest = self._file.read(READ_BYTES)
        return False


def open_stream(file: BinaryIO) -> Stream:
    """Read a file from its beginning, decompressed if it is a gzip file.

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
    return _Gzip(file) if start.startswith(_GZIP) else Stream(file)
