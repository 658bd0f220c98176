"""Files of a folder or archive as a bucket, for readers that expect one."""

from collections.abc import Callable, Mapping
from datetime import UTC, datetime

from drcli.base.errors import SettingsError
from drcli.models.download_source import Source
from drcli.models.put_model import POINTERS
from drcli.models.source_files import SourceFiles
from drcli.store.bucket import Listing, ObjectInfo, ObjectMissing

_NEVER = datetime.fromtimestamp(0, UTC)

_MODEL = "model"
"""Prefix of the model in the bucket that stands for a folder or archive."""


class FilesAsBucket:
    """Reads files by their names; raises TypeError on writing.

    Args:
        name: What messages call it.
        sizes: The size of each file by its key.
        read: Reads one of them.
    """

    def __init__(self, name: str, sizes: Mapping[str, int], read: Callable[[str], bytes]) -> None:
        self.name = name
        self._sizes = sizes
        self._read = read

    def get(self, key: str, *, watch: object = None) -> bytes:
        """Read a whole file; ObjectMissing if it does not exist."""
        if key not in self._sizes:
            raise ObjectMissing(f"There is no {key}.", remedy="Check the name.")
        data = self._read(key)
        if callable(watch):
            watch(len(data))
        return data

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        """Read a whole file, whose age is unknown."""
        return self.get(key), None

    def put(self, key: str, data: bytes, *, watch: object = None) -> None:
        """Refused."""
        raise TypeError("These files are only read.")

    def delete(self, keys: object) -> None:
        """Refused."""
        raise TypeError("These files are only read.")

    def exists(self, key: str) -> bool:
        """Whether there is a file with this key."""
        return key in self._sizes

    def list(self, folder: str) -> Listing:
        """All files below a folder, sorted by key."""
        return [
            ObjectInfo(key, self._sizes[key], "", _NEVER)
            for key in sorted(self._sizes)
            if key.startswith(folder)
        ]


def source_on_disk(files: SourceFiles) -> Source:
    """The model of ours in a folder or archive, which may have it in a folder of its own.

    Raises:
        SettingsError: There is none, or more than one.
    """
    roots = {
        name.removesuffix(pointer)
        for name in files.sizes
        for pointer in POINTERS
        if f"/{name}".endswith(f"/{pointer}")
    }
    if len(roots) != 1:
        raise SettingsError(
            f"{files.origin} has {len(roots) or 'no'} models of drcli.",
            remedy="Name the folder or archive of one model; `dr-import` takes those of other "
            "systems.",
        )
    root = roots.pop()
    names = {f"{_MODEL}/{n.removeprefix(root)}": n for n in files.sizes if n.startswith(root)}
    sizes = {key: files.sizes[name] for key, name in names.items()}
    bucket = FilesAsBucket(files.origin, sizes, lambda key: files.read(names[key]))
    return Source(bucket, _MODEL, "dr-list-models", file=files.origin)
