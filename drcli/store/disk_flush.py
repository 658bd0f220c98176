"""Brings the objects of a local bucket to its disk, so that a power cut leaves them.

rclone writes files without flushing, and deletes an old file before renaming the new one, so file
systems ignore their order: for half a minute, a power cut leaves an empty file. So each process
flushes what it wrote at once, in a thread; who relies on it waits (`flush`).
"""

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from drcli.base import notices
from drcli.base.errors import DiskFull, StorageError
from drcli.base.system_calls import flush_to_disk, is_disk_full


class DiskFlush:
    """Flushes the files of a bucket's folder. Thread-safe."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.absolute()
        self._lock = threading.Lock()
        self._written: dict[str, None] = {}
        self._known_folders: set[Path] = set()
        self._failure: tuple[Path, OSError] | None = None
        # Python waits for it at the end of a process.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="disk-flush")

    def note(self, key: str) -> None:
        """Flush an object that was just written, soon."""
        if not outlives_power_cut(key):
            return
        with self._lock:
            is_expected = bool(self._written)
            self._written[key] = None
        if not is_expected:
            self._begin()

    def flush(self) -> None:
        """Wait until all noted objects are on the disk.

        Raises:
            StorageError: One is not, or was not earlier.
        """
        self._begin().result()
        with self._lock:
            failure, self._failure = self._failure, None
        if failure is not None:
            raise _explained(*failure)

    def _begin(self) -> Future[None]:
        try:
            return self._thread.submit(self._flush_written)
        except RuntimeError:  # the process is ending, and starts no thread any more
            self._flush_written()
            done: Future[None] = Future()
            done.set_result(None)
            return done

    def _flush_written(self) -> None:
        with self._lock:
            written, self._written = list(self._written), {}
        folders: dict[Path, None] = {}
        for key in written:
            path = self._folder / key
            self._flush(path)
            folders[path.parent] = None
            # A name is on the disk when its folder is, and that of a new folder when its own is.
            for folder in path.parents:
                if folder in self._known_folders or folder == self._folder.parent.parent:
                    break
                self._known_folders.add(folder)
                folders[folder] = None
        for folder in folders:
            self._flush(folder)

    def _flush(self, path: Path) -> None:
        try:
            flush_to_disk(path)
        except FileNotFoundError:
            pass  # it was deleted, or another one is taking its place, which will be noted
        except OSError as error:
            with self._lock:
                self._failure = path, error
            notices.warn(str(_explained(path, error)))


def _explained(path: Path, error: OSError) -> StorageError:
    if is_disk_full(error):
        return DiskFull(
            f"{path} was written, but has no room on the disk.",
            remedy="Make room, for example by deleting old models, then continue the run.",
        )
    return StorageError(
        f"{path} was written, but it is not on the disk: {error.strerror or error} "
        "(DR_S3_DATA_DIR).",
        remedy="Check that disk (`dmesg` tells of its errors), or set DR_S3_DATA_DIR to a folder "
        "on another one.",
    )


def outlives_power_cut(key: str) -> bool:
    """Whether an object is flushed to the disk: all but those that are of no use afterwards.

    Rollouts are many and driven again, and processes write anew what they say of themselves.
    """
    of_processes = key.startswith("runs/") and key.split("/")[-2] in ("status", "members")
    return not (key.startswith("rollouts/") or of_processes)
