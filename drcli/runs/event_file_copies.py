"""TensorBoard event files in the bucket, where they outlive a spot machine."""

import re
from collections.abc import Callable
from pathlib import Path

from drcli.base.atomic_file import rewrite
from drcli.base.errors import SettingsError
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.tracking.event_file import FROM_HISTORY, PATTERN

_NAME = re.compile(r"events\.out\.tfevents\.[A-Za-z0-9._-]+")


class EventFileCopies:
    """Uploads event files that have grown; above `max_bytes`, the oldest go.

    The files of other machines stay: TensorBoard drops what a later file has again.
    """

    def __init__(self, bucket: Bucket, prefix: str, folder: Path, max_bytes: int) -> None:
        self._bucket = bucket
        self._prefix = prefix
        self._folder = folder
        self._max_bytes = max_bytes
        self._copied: dict[str, int] | None = None

    def update(self, over: Callable[[], bool] = lambda: False, *, hurried: bool = False) -> None:
        """Upload until `over()`; if `hurried`, the newest file comes first.

        Raises:
            StorageError: The bucket does not answer, or refuses.
            OSError: A file cannot be read.
        """
        if not self._folder.is_dir():
            return
        if self._copied is None:
            self._copied = copied_sizes(self._bucket, self._prefix)
        kept = self._kept(self._copied)
        for name in sorted(kept, reverse=hurried):
            path = self._folder / name
            if over() or not path.is_file():
                continue
            if path.stat().st_size > self._copied.get(name, -1):
                data = path.read_bytes()
                self._bucket.put(keys.event_file(self._prefix, name), data)
                self._copied[name] = len(data)
        for name in sorted(set(self._copied) - kept):
            self._bucket.delete([keys.event_file(self._prefix, name)])
            del self._copied[name]

    def left_bytes(self) -> int:
        copied = self._copied or {}
        sizes = local_sizes(self._folder)
        return sum(max(0, sizes.get(n, 0) - copied.get(n, 0)) for n in self._kept(copied))

    def _kept(self, copied: dict[str, int]) -> set[str]:
        sizes, kept, total = copied | local_sizes(self._folder), set(), 0
        for name in sorted(sizes, reverse=True):
            total += sizes[name]
            if total > self._max_bytes:
                break
            kept.add(name)
        return kept


def fetch_event_files(bucket: Bucket, prefix: str, folder: Path, max_bytes: int) -> bool:
    """Download a model's event files that this machine lacks; whether any was new.

    Older files than those here stay away: the first file of a machine begins with all earlier
    iterations. One made of the history gives way to real ones.

    Raises:
        StorageError: The bucket cannot be read.
        SettingsError: A file cannot be written.
    """
    there = copied_sizes(bucket, prefix)
    here = local_sizes(folder)
    made_here = {name for name in here if name.endswith(FROM_HISTORY) and name not in there}
    replaced = made_here if there and made_here == set(here) else set()
    oldest_wanted = max(set(here) - replaced, default="")
    fetched, total = False, 0
    wanted = [name for name, size in there.items() if size > here.get(name, -1)]
    for name in sorted(wanted, reverse=True):
        total += there[name]
        if name < oldest_wanted or total > max_bytes:
            continue
        data = bucket.get(keys.event_file(prefix, name))
        path = folder / name
        try:
            fetched = _extend(path, data) or fetched
        except OSError as error:
            raise SettingsError(
                f"{path}: cannot be written ({error.strerror or error}).",
                remedy=f"Check that you can write {folder}, and that its disk has room.",
            ) from None
    if fetched:
        for name in replaced:
            (folder / name).unlink(missing_ok=True)
    return fetched


def copied_sizes(bucket: Bucket, prefix: str) -> dict[str, int]:
    folder = keys.event_folder(prefix)
    return {
        name: info.size_bytes
        for info in bucket.list(folder)
        if _NAME.fullmatch(name := info.key.removeprefix(folder))
    }


def local_sizes(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_size for path in folder.glob(PATTERN) if path.is_file()}


def _extend(path: Path, data: bytes) -> bool:
    """Only what it lacks at its end: TensorBoard may be reading it."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        rewrite(path, data)
        return True
    own = path.read_bytes()
    if len(data) <= len(own) or not data.startswith(own):
        return False
    with path.open("ab") as file:
        file.write(data[len(own) :])
    return True
