"""Reads the embedded server's bucket directly, as its objects are plain files.

An S3 client takes half a second to create. Only the server writes: it would notice other changes
late.
"""

import os
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from fnmatch import fnmatch
from pathlib import Path
from typing import NoReturn

from drcli.base.errors import StorageError
from drcli.store.bucket import (
    Listing,
    ObjectInfo,
    ObjectMissing,
    Watch,
    checked_folder,
    without_placeholders,
)
from drcli.store.server.engines import LEFTOVERS


class FolderBucket:
    """Raises TypeError on writing."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.name = folder.name

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        path = self._folder / key
        try:
            data = path.read_bytes()
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError) as e:
            raise ObjectMissing(
                f"The object {self.name}/{key} does not exist in {self._folder.parent}.",
                remedy="Check the name, and DR_LOCAL_S3_MODEL_PREFIX.",
            ) from e
        except OSError as e:
            raise self._unreadable(path, e) from e
        if watch is not None:
            watch(len(data))
        return data

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        data = self.get(key)
        try:
            modified_s = (self._folder / key).stat().st_mtime
        except OSError:  # deleted in the meantime
            return data, None
        return data, time.time() - modified_s

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> NoReturn:
        raise self._read_only()

    def delete(self, keys: Iterable[str]) -> NoReturn:
        raise self._read_only()

    def exists(self, key: str) -> bool:
        return (self._folder / key).is_file()

    def list(self, folder: str) -> Listing:
        top = self._folder / checked_folder(folder)
        found = []
        for place, _, names in os.walk(top):
            for name in names:
                path = Path(place, name)
                if not fnmatch(name, LEFTOVERS):
                    found += self._info(path)
        return without_placeholders(found)

    def _info(self, path: Path) -> Listing:
        try:
            facts = path.stat()
        except FileNotFoundError:  # deleted in the meantime
            return []
        except OSError as e:
            raise self._unreadable(path, e) from e
        key = path.relative_to(self._folder).as_posix()
        modified = datetime.fromtimestamp(facts.st_mtime, UTC)
        return [ObjectInfo(key, facts.st_size, "", modified)]

    def _unreadable(self, path: Path, error: OSError) -> StorageError:
        return StorageError(
            f"Cannot read {path}: {error.strerror or error} (DR_S3_DATA_DIR).",
            remedy="Check that you can read that file and its folders.",
        )

    def _read_only(self) -> TypeError:
        return TypeError(f"The bucket in {self._folder} is read-only; write through its server.")
