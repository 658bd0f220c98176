"""Files of tasks that the page may download, for a while."""

import hashlib
import secrets
import shutil
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path

from starlette.responses import FileResponse

from drcli.bucket.bucket import Bucket, ObjectInfo
from drcli.web.answers import BadRequest

MOST_KEPT = 12


@dataclass(frozen=True)
class Download:
    """Ready."""

    url: str
    name: str
    size_bytes: int
    report: object = None


class DownloadFolder:
    """Files below `data/viewer/downloads`; those of an earlier console are deleted."""

    def __init__(self, directory: Path) -> None:
        self._folder = directory / "data" / "viewer" / "downloads"
        self._lock = threading.Lock()
        self._known: dict[str, Path] = {}
        self._is_clean = False

    def new_folder(self) -> Path:
        with self._lock:
            if not self._is_clean:
                shutil.rmtree(self._folder, ignore_errors=True)
                self._is_clean = True
            path = self._folder / secrets.token_hex(12)
            path.mkdir(parents=True, mode=0o700)
            return path

    def offer(self, path: Path, report: object = None) -> Download:
        name = path.parent.name
        with self._lock:
            self._known[name] = path
            for old in list(self._known)[:-MOST_KEPT]:
                shutil.rmtree(self._known.pop(old).parent, ignore_errors=True)
        return Download(f"/api/download/{name}", path.name, path.stat().st_size, report)

    def answer(self, name: str) -> FileResponse:
        """BadRequest once it is gone."""
        with self._lock:
            path = self._known.get(name)
        if path is None or not path.is_file():
            raise BadRequest("This download is no longer kept. Start it again.", 404)
        return FileResponse(path, media_type="application/octet-stream", filename=path.name)


# Answers with parts of an object, as a browser asks for a video.


MOST_COPIES = 8


class ObjectCopies:
    """Copies of objects; those of an earlier console are deleted."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        self._known: dict[str, Path] = {}

    def answer(
        self, bucket: Bucket, key: str, *, media_type: str, filename: str = ""
    ) -> FileResponse:
        """The object, or a range of it; `filename` makes it a download.

        The caller checks `key`: every object can be read with it.

        Raises:
            BadRequest: There is no such object.
            StorageError: It cannot be read.
        """
        folder = key.rpartition("/")[0] + "/"
        info = next((each for each in bucket.list(folder) if each.key == key), None)
        if info is None:
            raise BadRequest("There is no such file; it may have been deleted.", 404)
        return FileResponse(
            self.path_of(bucket, info), media_type=media_type, filename=filename or None
        )

    def path_of(self, bucket: Bucket, info: ObjectInfo) -> Path:
        version = f"{bucket.name}\n{info.key}\n{info.size_bytes}\n{info.modified.isoformat()}"
        name = hashlib.sha256(version.encode()).hexdigest()[:32]
        with self._lock:
            path = self._known.pop(name, None)
            if path is None or not path.is_file():
                if not self._known:
                    shutil.rmtree(self._folder, ignore_errors=True)
                self._folder.mkdir(parents=True, exist_ok=True)
                path = self._folder / name
                with tempfile.NamedTemporaryFile(dir=self._folder, delete=False) as file:
                    file.write(bucket.get(info.key))
                Path(file.name).replace(path)
            self._known[name] = path  # the newest last
            for old in list(self._known)[:-MOST_COPIES]:
                self._known.pop(old).unlink(missing_ok=True)
            return path
