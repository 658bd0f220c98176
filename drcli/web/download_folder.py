"""Files of tasks that the page may download, for a while."""

import secrets
import shutil
import threading
from dataclasses import dataclass
from pathlib import Path

from starlette.responses import FileResponse

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
