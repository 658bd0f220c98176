"""Models that the racer drops on the page."""

import re
import secrets
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import anyio
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from drcli.base.errors import DiskFull, DrError
from drcli.web import model_work
from drcli.web.answers import BadRequest, accepts, error_of, status_of
from drcli.web.apart import WorkFailed, run_apart
from drcli.web.model_reader import ModelReader, checked
from drcli.web.tasks import Progress

LARGEST_UPLOAD = 2 << 30
"""Consoles refuse more than 1 GB."""

LEAST_FREE = 512 << 20
"""For a training."""

MOST_FILES = 8
KEPT_S = 3600.0
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,120}")
_ID = re.compile(r"[0-9a-f]{24}")


def import_routes(reader: ModelReader) -> Sequence[BaseRoute]:
    """`POST /api/uploads?name=FILE&upload=ID` takes a file, `POST /api/models/import` imports it.

    The answer to the first file has the ID for others.
    """
    place = reader.folder.directory / "data" / "viewer" / "uploads"

    async def upload(request: Request) -> Response:
        try:
            number, path = await anyio.to_thread.run_sync(_target, place, request)
            size = await _store(request, path)
        except Exception as error:
            return JSONResponse(error_of(error), status_of(error))
        return JSONResponse({"upload": number, "name": path.name, "size_bytes": size})

    def start(_: Request, body: dict[str, Any]) -> Any:
        prefix = checked(body.get("prefix"), "name of the new model")
        folder = _folder(place, body.get("upload"))
        files = sorted(folder.iterdir())
        if not files:
            raise BadRequest("No file has arrived. Drop it again.")
        source = files[0] if len(files) == 1 else _main_file(files)
        world = body.get("world") or None
        if world is not None and not isinstance(world, str):
            raise BadRequest("The track is a name.")

        def work(progress: Progress) -> Any:
            try:
                arguments = reader.folder.directory, source, prefix, world
                return run_apart(progress, model_work.import_archive, *arguments)
            except DrError as error:
                # The racer knows the file by its name alone.
                said = str(error).replace(f"{folder}/", "").replace(str(folder), "The files")
                raise WorkFailed(said, remedy=error.remedy, code=error.code) from None
            finally:
                shutil.rmtree(folder, ignore_errors=True)

        task = reader.folder.tasks.start("import", prefix, f"Import {prefix}", work)
        return {"task": task.id}

    return [
        Route("/api/uploads", upload, methods=["POST"]),
        Route("/api/models/import", accepts(start), methods=["POST"]),
    ]


def _main_file(files: Sequence[Path]) -> Path:
    others = {".json", ".py", ".yaml", ".yml", ".md", ".txt"}
    found = [path for path in files if path.suffix.lower() not in others]
    return found[0] if len(found) == 1 else files[0].parent


def _target(place: Path, request: Request) -> tuple[str, Path]:
    name = request.query_params.get("name", "")
    if _NAME.fullmatch(name) is None:
        raise BadRequest(
            "The file needs a name of letters, digits and . _ - without folders. Rename it."
        )
    number = request.query_params.get("upload") or ""
    if not number:
        _sweep(place)
        number = secrets.token_hex(12)
        (place / number).mkdir(parents=True, mode=0o700)
    folder = _folder(place, number)
    if len(list(folder.iterdir())) >= MOST_FILES:
        raise BadRequest(f"One import has at most {MOST_FILES} files; pack more as .tar.gz.")
    return number, folder / name


def _folder(place: Path, number: Any) -> Path:
    if not isinstance(number, str) or _ID.fullmatch(number) is None:
        raise BadRequest("The request needs the number of an upload.")
    folder = place / number
    if not folder.is_dir():
        raise BadRequest("These files are no longer kept. Drop them again.", 404)
    return folder


def _sweep(place: Path) -> None:
    if not place.is_dir():
        return
    for folder in place.iterdir():
        if time.time() - folder.stat().st_mtime > KEPT_S:
            shutil.rmtree(folder, ignore_errors=True)


async def _store(request: Request, path: Path) -> int:
    """Nothing is left of a body that is too large."""
    announced = request.headers.get("content-length", "")
    size = int(announced) if announced.isdecimal() and len(announced) < 16 else 0
    room = min(LARGEST_UPLOAD, shutil.disk_usage(path.parent).free - LEAST_FREE)
    _refuse_large(size, room)
    written = 0
    try:
        async with await anyio.open_file(path, "xb") as file:
            async for chunk in request.stream():
                written += len(chunk)
                _refuse_large(written, room)
                await file.write(chunk)
        if not written or (size and written != size):
            raise BadRequest("The file did not arrive as a whole. Drop it again.")
    except FileExistsError:
        raise BadRequest(f"{path.name} was sent twice.", 409) from None
    except ClientDisconnect:
        path.unlink(missing_ok=True)
        raise BadRequest("The file did not arrive as a whole. Drop it again.") from None
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    return written


def _refuse_large(size: int, room: int) -> None:
    if size > LARGEST_UPLOAD:
        raise BadRequest(f"A file has at most {LARGEST_UPLOAD >> 30} GB.", 413)
    if size > room:
        raise DiskFull("The disk has no room for this file.", remedy="Make room, then try again.")
