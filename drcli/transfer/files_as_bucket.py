"""Files of a folder or archive as a bucket."""

from collections.abc import Callable, Mapping
from datetime import UTC, datetime

from drcli.base.errors import SettingsError
from drcli.bucket.bucket import Listing, ObjectInfo, ObjectMissing
from drcli.transfer.download_source import Source
from drcli.transfer.find_checkpoint import SourceFiles
from drcli.transfer.put_model import POINTERS

_NEVER = datetime.fromtimestamp(0, UTC)

_MODEL = "model"


class FilesAsBucket:
    """Raises TypeError on writing."""

    def __init__(self, name: str, sizes: Mapping[str, int], read: Callable[[str], bytes]) -> None:
        self.name = name
        self._sizes = sizes
        self._read = read

    def get(self, key: str, *, watch: object = None) -> bytes:
        if key not in self._sizes:
            raise ObjectMissing(f"There is no {key}.", remedy="Check the name.")
        data = self._read(key)
        if callable(watch):
            watch(len(data))
        return data

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        return self.get(key), None

    def put(self, key: str, data: bytes, *, watch: object = None) -> None:
        raise TypeError("These files are only read.")

    def delete(self, keys: object) -> None:
        raise TypeError("These files are only read.")

    def exists(self, key: str) -> bool:
        return key in self._sizes

    def list(self, folder: str) -> Listing:
        return [
            ObjectInfo(key, self._sizes[key], "", _NEVER)
            for key in sorted(self._sizes)
            if key.startswith(folder)
        ]


def source_on_disk(files: SourceFiles) -> Source:
    """The model there, maybe in its own folder; SettingsError unless there is one."""
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
