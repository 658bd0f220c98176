"""Forms of run.env and system.env, and a new working folder."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from drcli.base.plain_json import plain
from drcli.base.problems import ProblemsError
from drcli.config.editing import FilesChanged, set_values
from drcli.config.example_files import ready_made
from drcli.config.fields import FileName
from drcli.config.new_folder import plan_folder
from drcli.config.presets import explain, preset_of
from drcli.config.setting_problems import hidden
from drcli.config.settings import catalogue
from drcli.config.write_folder import write
from drcli.models.begin_with_model import check_place, put_into_bucket, values_with
from drcli.models.ready_made import read_ready_made, read_recipe
from drcli.store.bucket import Watch
from drcli.web.answers import BadRequest, accepts, answers, error_of, placed
from drcli.web.served_folder import ServedFolder
from drcli.web.settings_forms import FolderFiles, form_of, written_values

MOST_VALUES = 400


def _texts(body: Mapping[str, Any], key: str) -> dict[str, str]:
    found = body.get(key, {})
    good = isinstance(found, dict) and len(found) <= MOST_VALUES
    if not good or not all(isinstance(value, str) for value in found.values()):
        raise BadRequest(f"The request needs {key}: texts by name.")
    return dict(found)


def _wanted(body: Mapping[str, Any]) -> dict[str, str]:
    """Only settings, because a shell may run other lines."""
    values = _texts(body, "values")
    for name, value in values.items():
        if name not in catalogue() or "\0" in value:
            raise BadRequest(f"{name[:60]} is not a setting of this version.", 422)
    return values


def _file(body: Mapping[str, Any]) -> FileName | None:
    match body.get("file"):
        case None | "":
            return None
        case "run.env":
            return "run.env"
        case "system.env":
            return "system.env"
    raise BadRequest("A setting belongs in run.env or system.env.")


def _name(body: Mapping[str, Any], key: str) -> str:
    value = body.get(key) or ""
    if not isinstance(value, str):
        raise BadRequest(f"{key} is a name.")
    return value


def _unseen(title: str, size: int) -> AbstractContextManager[Watch]:
    return nullcontext(lambda _: None)


def is_folder(directory: Path) -> bool:
    try:
        FolderFiles.read(directory)
    except Exception:
        return (directory / "run.env").exists()
    return True


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def show(_: Request) -> Any:
        return form_of(folder.directory)

    def save(_: Request, body: dict[str, Any]) -> Any:
        values, seen = _wanted(body), _texts(body, "versions")
        try:
            edit = set_values(
                folder.directory, values, file=_file(body), seen=_known(seen), keep_old=True
            )
        except FilesChanged as error:
            return _conflict(error, values)
        return {**plain(edit), "versions": FolderFiles.read(folder.directory).versions}

    def _known(seen: dict[str, str]) -> dict[str, str]:
        files = FolderFiles.read(folder.directory)
        return {name: version for name, version in seen.items() if name in files.versions}

    def _conflict(error: FilesChanged, values: dict[str, str]) -> Response:
        there = written_values(folder.directory, list(values))
        both = [
            {"name": name, "yours": hidden(name, value), "disk": there[name]}
            for name, value in values.items()
        ]
        versions = FolderFiles.read(folder.directory).versions
        return JSONResponse({**error_of(error), "conflict": both, "versions": versions}, 409)

    def check(_: Request, body: dict[str, Any]) -> Any:
        try:
            edit = set_values(folder.directory, _wanted(body), file=_file(body), write=False)
        except ProblemsError as error:
            return {"problems": [placed(each) for each in error.errors], "warnings": []}
        return {"problems": [], "warnings": edit.warnings}

    def about_folder(_: Request) -> Any:
        return {
            "exists": is_folder(folder.directory),
            "directory": str(folder.directory),
            "presets": [
                {"name": each.name, "about": each.summary} for each in explain([], None).presets
            ],
            "models": [{"name": name, "about": read_recipe(name).summary} for name in ready_made()],
        }

    def create(_: Request, body: dict[str, Any]) -> Any:
        values = _wanted(body)
        preset, name = _name(body, "preset"), _name(body, "model")
        model = read_ready_made(name) if name else None
        if model is not None:
            values = values_with(model, values)
        plan = plan_folder(
            folder.directory,
            values,
            preset_of(preset) if preset else None,
            None if model is None else model.files,
        )
        if is_folder(folder.directory):
            raise BadRequest(f"{folder.directory} is a working folder already.", 409)
        if plan.clashes and body.get("replace") is not True:
            names = ", ".join(plan.clashes)
            message = f"{plan.folder} already has {names}."
            remedy = "Agree to replace them; the old ones are kept as .bak."
            found = {"message": message, "remedy": remedy, "code": 2, "clashes": plan.clashes}
            return JSONResponse({"error": found}, 409)
        if model is None:
            return write(plan)
        check_place(plan, None, nullcontext())
        return put_into_bucket(write(plan), plan, None, model, _unseen)

    return [
        Route("/api/settings", answers(show), methods=["GET"]),
        Route("/api/settings", accepts(save), methods=["PUT"]),
        Route("/api/settings/check", accepts(check), methods=["POST"]),
        Route("/api/new-folder", answers(about_folder), methods=["GET"]),
        Route("/api/new-folder", accepts(create), methods=["POST"]),
    ]
