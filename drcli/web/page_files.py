"""The files of the page, some shared with the report of dr-analyze."""

from importlib.resources import files
from importlib.resources.abc import Traversable

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

_TYPES = {
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "svg": "image/svg+xml",
    "png": "image/png",
}


def _collect(folder: Traversable, at: str) -> dict[str, Traversable]:
    found: dict[str, Traversable] = {}
    for item in folder.iterdir():
        if item.is_dir():
            found.update(_collect(item, f"{at}{item.name}/"))
        elif item.name.rpartition(".")[2] in _TYPES:
            found[f"{at}{item.name}"] = item
    return found


def page_routes() -> list[Route]:
    """Only for files of the package, whatever the path says."""
    known = _collect(files("drcli.web") / "pages", "/")
    shared = files("drcli.analysis.report") / "assets"
    known.update({f"/{name}": shared / name for name in ("colors.css", "graph_parts.js")})
    known.update(_collect(shared / "uplot", "/vendor/uplot/"))

    async def serve(request: Request) -> Response:
        path = request.url.path
        item = known.get("/index.html" if path == "/" else path)
        if item is None:
            return PlainTextResponse("There is no such page.", 404)
        # No cache: after an update of the package, old and new modules must not be mixed.
        return Response(
            item.read_bytes(),
            media_type=_TYPES[path.rpartition(".")[2] if path != "/" else "html"],
            headers={"cache-control": "no-cache"},
        )

    return [Route("/{path:path}", serve, methods=["GET"])]
