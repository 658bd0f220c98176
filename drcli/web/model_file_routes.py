"""Files of a model that a browser shows or keeps."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import FileResponse
from starlette.routing import BaseRoute, Route

from drcli.analysis.report_place import report_file, report_folder
from drcli.base.replaceable import safe_name
from drcli.runs.evaluation_list import is_video
from drcli.store import keys
from drcli.web.answers import BadRequest, answers
from drcli.web.download_folder import DownloadFolder
from drcli.web.model_reader import ModelReader, prefix_of
from drcli.web.object_range import ObjectCopies

REPORT_POLICY = (
    "sandbox allow-scripts; default-src 'none'; img-src data:; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The report's own policy allows its scripts by hash. The sandbox has no origin, so a script in it
could neither read nor ask anything of the console.
"""


def file_routes(
    reader: ModelReader, downloads: DownloadFolder, analyses: dict[str, Any]
) -> Sequence[BaseRoute]:
    videos = ObjectCopies(reader.folder.directory / "data" / "viewer" / "videos")

    def video(request: Request) -> Any:
        prefix, name = prefix_of(request), request.query_params.get("name", "")
        if not is_video(name):
            raise BadRequest("This is not the name of a video of a model.", 404)
        _, bucket = reader.open(prefix)
        key = keys.folder(prefix) + name
        file = ""
        if "download" in request.query_params:
            file = f"{safe_name(prefix)}-{safe_name(name.removesuffix('.mp4'))}.mp4"
        return videos.answer(bucket, key, media_type="video/mp4", filename=file)

    def report(request: Request) -> Any:
        path = _report(reader.folder.directory, prefix_of(request))
        if path is None:
            raise BadRequest("There is no report of this model yet. Analyse it first.", 404)
        headers = {"content-security-policy": REPORT_POLICY}
        if "download" in request.query_params:
            return FileResponse(path, media_type="text/html", filename=path.name, headers=headers)
        return FileResponse(path, media_type="text/html; charset=utf-8", headers=headers)

    def about(request: Request) -> Any:
        prefix = prefix_of(request)
        path = _report(reader.folder.directory, prefix)
        written = None if path is None else path.stat().st_mtime
        return {"written": written, "analysis": analyses.get(prefix)}

    def download(request: Request) -> Any:
        return downloads.answer(request.path_params["name"])

    return [
        Route("/api/model/video", answers(video)),
        Route("/api/model/report", answers(report)),
        Route("/api/model/report/about", answers(about)),
        Route("/api/download/{name}", answers(download)),
    ]


def _report(directory: Path, prefix: str) -> Path | None:
    """A link out of the folder is none."""
    path = report_file(directory, prefix)
    inside = path.resolve().is_relative_to(report_folder(directory).resolve())
    return path if inside and path.is_file() else None
