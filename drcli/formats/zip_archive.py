"""Reads ZIP archives that anybody may have made, in memory and within limits."""

import lzma
import zipfile
import zlib
from collections.abc import Callable
from typing import BinaryIO

from drcli.formats.archive import LARGEST_MEMBER_BYTES, MOST_MEMBERS
from drcli.formats.gzip_stream import LARGEST_BYTES, LARGEST_RATIO, RATIO_FROM_BYTES, ArchiveFault

_ENCRYPTED = 0x1

_DAMAGE = (
    *(zipfile.BadZipFile, EOFError, NotImplementedError, ValueError),
    *(zlib.error, lzma.LZMAError, OSError),  # OSError: what is wrong with a bzip2 stream
)
"""What `zipfile` raises for a damaged archive, by the compression of its members."""


def unzip_readable(
    file: BinaryIO, wanted: Callable[[str], bool]
) -> tuple[dict[str, bytes], ArchiveFault | None]:
    """Read some files of a ZIP archive, as `unpack_readable` does for other archives.

    The sizes that its directory states may be wrong, so the bytes are counted as they come.
    """
    found: dict[str, bytes] = {}
    try:
        with zipfile.ZipFile(file) as archive:
            infos = archive.infolist()
            if len(infos) > MOST_MEMBERS:
                raise ArchiveFault(f"has more than {MOST_MEMBERS:,} members")
            budget = LARGEST_BYTES
            for info in infos:
                name = info.filename.replace("\\", "/").removeprefix("./")
                if info.is_dir() or not wanted(name):
                    continue
                found[name] = _content(archive, info, budget)
                budget -= len(found[name])
    except ArchiveFault as fault:
        return found, fault
    except _DAMAGE as error:
        return found, ArchiveFault(f"is damaged: {error or 'it ends too early'}")
    return found, None


def _content(archive: zipfile.ZipFile, info: zipfile.ZipInfo, budget: int) -> bytes:
    if info.flag_bits & _ENCRYPTED:
        raise ArchiveFault("is encrypted", info.filename)
    with archive.open(info) as member:
        limit = min(budget, LARGEST_MEMBER_BYTES)
        data = member.read(limit + 1)
    if len(data) > limit:
        raise ArchiveFault(f"unpacks to more than {limit >> 20:,} MB", info.filename)
    if len(data) > max(RATIO_FROM_BYTES, LARGEST_RATIO * info.compress_size):
        raise ArchiveFault(f"unpacks to more than {LARGEST_RATIO} times its size", info.filename)
    return data
