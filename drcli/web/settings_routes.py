"""Forms of run.env and system.env, and a new working folder."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from drcli.base.errors import Problem, ProblemsError
from drcli.base.json_record import plain
from drcli.bucket.bucket import Watch
from drcli.config import activation
from drcli.config.editing import FilesChanged, replace_line, set_values, version_of
from drcli.config.fields import HIDDEN, FileName, Setting, hidden
from drcli.config.loading import active_run_file, load_settings
from drcli.config.new_folder import plan_folder, write
from drcli.config.presets import explain, preset_of, ready_made
from drcli.config.settings import Settings, catalogue
from drcli.config.settings_files import Entry, Layers, SettingsFiles, content_of, given
from drcli.config.settings_report import check_settings
from drcli.transfer.ready_made import (
    check_place,
    put_into_bucket,
    read_ready_made,
    read_recipe,
    values_with,
)
from drcli.web.answers import BadRequest, Body, Text, accepts, answers, error_of, placed
from drcli.web.served_folder import ServedFolder

# run.env and system.env for the page.


SYSTEM = "system.env"
_LABELS = {
    "model": {
        "DR_LOCAL_S3_MODEL_PREFIX": "Name of the model",
        "DR_MODEL_DESCRIPTION": "Description",
        "DR_LOCAL_S3_PRETRAINED": "Begin with the weights of another model",
        "DR_LOCAL_S3_PRETRAINED_PREFIX": "That model",
        "DR_LOCAL_S3_PRETRAINED_CHECKPOINT": "Its checkpoint",
    },
    "race": {
        "DR_WORLD_NAME": "Name of the track",
        "DR_TRAIN_WORLDS": "Further tracks that are trained",
        "DR_TRAIN_EVAL_WORLD": "Tracks for evaluation only",
        "DR_RACE_TYPE": "Race type",
        "DR_TRAIN_REVERSE_DIRECTION": "Against the direction of the track",
        "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION": "Turn round after every episode",
        "DR_TRAIN_CHANGE_START_POSITION": "Start each episode further along the track",
        "DR_OA_NUMBER_OF_OBSTACLES": "Number of boxes",
        "DR_OA_MIN_DISTANCE_BETWEEN_OBSTACLES": "Least distance between boxes, m",
        "DR_OA_RANDOMIZE_OBSTACLE_LOCATIONS": "Move the boxes in each episode",
        "DR_OA_IS_OBSTACLE_BOT_CAR": "Parked cars instead of boxes",
        "DR_OA_OBJECT_POSITIONS": "Fixed positions",
        "DR_H2B_NUMBER_OF_BOT_CARS": "Number of bots",
        "DR_H2B_BOT_CAR_SPEED": "Speed of the bots, m/s",
        "DR_H2B_MIN_DISTANCE_BETWEEN_BOT_CARS": "Least distance between bots, m",
        "DR_H2B_RANDOMIZE_BOT_CAR_LOCATIONS": "Put bots elsewhere in each episode",
        "DR_H2B_IS_LANE_CHANGE": "Bots change lanes",
        "DR_H2B_LOWER_LANE_CHANGE_TIME": "Least time between lane changes, s",
        "DR_H2B_UPPER_LANE_CHANGE_TIME": "Greatest time between lane changes, s",
    },
    "stop": {
        "DR_TRAIN_MAX_MINUTES": "Minutes",
        "DR_TRAIN_MAX_ITERATIONS": "Iterations",
        "DR_TRAIN_MAX_EPISODES": "Training episodes",
        "DR_TRAIN_MAX_STEPS": "Steps",
        "DR_TRAIN_STOP_PROGRESS": "Mean progress of evaluations, %",
        "DR_TRAIN_STOP_EVALUATIONS": "For so many evaluations in a row",
        "DR_TRAIN_STOP_LAP_TIME": "Mean lap time of evaluations, s",
        "DR_MAX_COST": "Cost, USD",
        "DR_SPOT_PRICE": "Price of this machine, USD per hour",
        "DR_TRAIN_EVAL_LAPS": "Evaluation laps per checkpoint",
    },
}
"""The settings in the steps of a new training, as the page calls them."""

_TITLES = {
    "model": (
        "Model",
        "The name is the folder of the model in the bucket: letters, digits and . _ - /. Give each "
        "training a new name.",
    ),
    "race": ("Track and race", ""),
    "stop": (
        "Stop conditions",
        "The training ends as soon as one of them is met; 0 or empty is no limit. It can be "
        "stopped by hand at any time, and resumed. A number of laps is asked for at the start, in "
        "step 9.",
    ),
}
_ONLY = {
    "DR_OA_": ("DR_RACE_TYPE", ["OBJECT_AVOIDANCE"]),
    "DR_H2B_": ("DR_RACE_TYPE", ["HEAD_TO_BOT"]),
    "DR_LOCAL_S3_PRETRAINED_": ("DR_LOCAL_S3_PRETRAINED", ["True"]),
}
"""Beginnings of names, and the values of another setting with which they have a meaning."""

_TEMPLATE = 'The template "{}" of the reward function is made for this race.'
_KIND_NOTES = {
    "OBJECT_AVOIDANCE": _TEMPLATE.format("object avoidance"),
    "HEAD_TO_BOT": _TEMPLATE.format("head to bot"),
    "HEAD_TO_MODEL": "Two trained models race; it is for evaluations only. Choose another race to "
    "train.",
}


def _steps() -> dict[str, Any]:
    def step_field(name: str, label: str) -> dict[str, Any]:
        only = (each for start, each in _ONLY.items() if name.startswith(start))
        return {"name": name, "label": label, "only": next(only, None)}

    return {
        step: {
            "title": _TITLES[step][0],
            "hint": _TITLES[step][1],
            "fields": [step_field(*each) for each in labels.items()],
        }
        for step, labels in _LABELS.items()
    }


@dataclass(frozen=True)
class FolderFiles:
    """The settings files of a working folder.

    Attributes:
        run_file: The active run.env, below the folder.
        versions: By name; empty for a missing file.
        entries: By file and name.
    """

    run_file: str
    versions: Mapping[str, str]
    entries: Mapping[str, Mapping[str, Entry]]

    @staticmethod
    def read(directory: Path) -> "FolderFiles":
        """Leaves out wrong lines; ProblemsError if there is no run.env or experiment."""
        directory = directory.absolute()
        run_file = active_run_file(directory)
        files = SettingsFiles(directory)
        entries = {run_file: files.read(run_file)}
        entries[SYSTEM] = files.read(SYSTEM) if files.exist(SYSTEM) else {}
        versions = {name: _version(directory, name) for name in entries}
        return FolderFiles(run_file, versions, entries)


def _version(directory: Path, name: str) -> str:
    path = directory / name
    # As in `set_values`, a file that does not exist is an empty one.
    return version_of(content_of(path, name) if os.path.lexists(path) else b"")


def form_of(directory: Path) -> dict[str, Any]:
    files = FolderFiles.read(directory)
    try:
        settings: Settings | None = load_settings(directory)
    except ProblemsError:
        settings = None
    outside = given(activation.chosen(os.environ), "environment")
    layers = Layers(
        [outside, files.entries[files.run_file], files.entries[SYSTEM]],
        {name: setting.default_text for name, setting in catalogue().items()},
    )
    groups: dict[str, list[dict[str, Any]]] = {}
    for name, setting in catalogue().items():
        groups.setdefault(setting.group, []).append(_field(name, setting, files, layers, settings))
    check = check_settings(directory)
    return {
        "directory": str(directory),
        "run_file": files.run_file,
        "versions": files.versions,
        "steps": _steps(),
        "kind_notes": _KIND_NOTES,
        "groups": [{"title": title, "settings": fields} for title, fields in groups.items()],
        "problems": [placed(problem) for problem in shown_problems(check.problems)],
    }


def shown_problems(problems: tuple[Problem, ...]) -> list[Problem]:
    """Errors first; notes are for the start."""
    found = [problem for problem in problems if problem.severity != "note"]
    return sorted(found, key=lambda problem: problem.severity != "error")


def is_secret(name: str, text: str) -> bool:
    """May be replaced, but not shown."""
    return hidden(name, "x") == HIDDEN or hidden(name, text) != text


_YES, _NO = ("true", "1", "yes", "on", "t", "y"), ("false", "0", "no", "off", "f", "n")


def _field(
    name: str, setting: Setting, files: FolderFiles, layers: Layers, settings: Settings | None
) -> dict[str, Any]:
    entry = layers.find(name)
    place = next((places[name] for places in files.entries.values() if name in places), None)
    value = layers.text(name) or ""
    if settings is not None and setting.kind != "path":
        value = setting.text(getattr(settings, setting.field))
    written = None if place is None else place.value
    secret = is_secret(name, value) or is_secret(name, written or "")
    control, start = _control(setting, value if written is None else written)
    return {
        "name": name,
        "kind": control,
        "options": _options(setting, control),
        "meaning": setting.meaning,
        "help": _help(setting, control, secret=secret),
        "origin": " ".join(_origin(name, entry, value, written or "", secret=secret)),
        "start": "" if secret else start,
        "value": hidden(name, value),
        "placeholder": ("set; not shown" if value else "not set") if secret else None,
        "secret": secret,
        "file": files.run_file if setting.file == "run.env" else SYSTEM,
        "place": None if place is None else place.place.file,
        "environment": entry is not None and entry.place.file == "environment",
    }


def _control(setting: Setting, text: str) -> tuple[str, str]:
    """What shows a text, and what it begins with. A value such as $NAME is shown as text."""
    words = {word.casefold(): word for word in setting.choices or ()}
    if setting.kind == "flag" and (not text or text.casefold() in (*_YES, *_NO)):
        return "flag", str(text.casefold() in _YES)
    if setting.kind == "choice" and (not text or text.casefold() in words):
        return "choice", words.get(text.casefold(), text)
    return ("number" if setting.kind in ("whole", "number") else "text"), text


def _options(setting: Setting, control: str) -> Sequence[Any] | None:
    if control == "flag":
        return [("True", "Yes (True)"), ("False", "No (False)")]
    return setting.choices if control == "choice" else None


def _help(setting: Setting, control: str, *, secret: bool) -> str:
    said = [setting.meaning if setting.meaning[-1:] in ".!?" else f"{setting.meaning}."]
    if control not in ("flag", "choice") and setting.kind != "text":
        said.append(f"Allowed: {setting.expected}.")
    if setting.default_text and not secret:
        said.append(f"Default: {setting.default_text}.")
    if setting.effect != "used":
        said.append(f"No effect here: {setting.reason}.")
    return " ".join(said)


def _origin(
    name: str, entry: Entry | None, value: str, written: str, *, secret: bool
) -> Iterator[str]:
    yield "Not set, so the default counts." if entry is None else f"From {entry.place.file}."
    if "$" in written and not secret:
        yield f"Filled in: {value or 'empty'}."
    if entry is not None and entry.place.file == "environment":
        yield (
            "The environment of the console sets it and overrides the files; "
            f"`unset {name}` and `dr console restart` take that back."
        )


def written_values(directory: Path, names: list[str]) -> dict[str, str | None]:
    files = FolderFiles.read(directory)
    found: dict[str, str | None] = {}
    for name in names:
        entry = next((each[name] for each in files.entries.values() if name in each), None)
        found[name] = None if entry is None else hidden(name, entry.value)
    return found


MOST_VALUES = 400


Texts = Annotated[dict[str, Text], Field(max_length=MOST_VALUES)]


class Change(Body):
    values: Texts = Field(default_factory=dict)
    file: FileName | None = None

    def wanted(self) -> dict[str, str]:
        """Only settings, because a shell may run other lines."""
        for name in self.values:
            if name not in catalogue():
                raise BadRequest(f"{name[:60]} is not a setting of this version.", 422)
        return dict(self.values)


class SaveSettings(Change):
    versions: Texts = Field(default_factory=dict)


class Mend(Body):
    file: str
    line: int
    text: Text
    version: str


class NewFolder(Change):
    preset: str | None = None
    model: str | None = None
    replace: bool = False


def _unseen(title: str, size: int) -> AbstractContextManager[Watch]:
    return nullcontext(lambda _: None)


def is_folder(directory: Path) -> bool:
    try:
        FolderFiles.read(directory)
    except Exception:
        return (directory / "run.env").exists()
    return True


def _begin() -> list[tuple[str, Any]]:
    """What a new folder may begin with, in groups."""
    presets = {each.name: each.summary for each in explain([], None).presets}
    models = {name: read_recipe(name).summary for name in ready_made()}

    def named(kind: str, known: dict[str, str]) -> list[tuple[str, str]]:
        return [(f"{kind}:{name}", f"{name}: {about}") for name, about in known.items()]

    return [
        ("preset:", "The usual start: stay near the middle of the road"),
        ("Settings and files for a purpose", named("preset", presets)),
        ("A trained model, to drive at once or to train on", named("model", models)),
    ]


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def show(_: Request) -> Any:
        return form_of(folder.directory)

    def save(_: Request, body: SaveSettings) -> Any:
        values, seen = body.wanted(), _known(body.versions)
        try:
            edit = set_values(folder.directory, values, file=body.file, seen=seen, keep_old=True)
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

    def check(_: Request, body: Change) -> Any:
        try:
            edit = set_values(folder.directory, body.wanted(), file=body.file, write=False)
        except ProblemsError as error:
            return {"problems": [placed(each) for each in error.errors], "warnings": []}
        return {"problems": [], "warnings": edit.warnings}

    def mend(_: Request, body: Mend) -> Any:
        if body.file not in FolderFiles.read(folder.directory).versions:
            raise BadRequest("The request needs a line of run.env or system.env.")
        replace_line(folder.directory, body.file, body.line, body.text, body.version)
        return {"file": body.file, "line": body.line}

    def about_folder(_: Request) -> Any:
        return {
            "exists": is_folder(folder.directory),
            "directory": str(folder.directory),
            "begin": _begin(),
        }

    def create(_: Request, body: NewFolder) -> Any:
        values = body.wanted()
        model = read_ready_made(body.model) if body.model else None
        if model is not None:
            values = values_with(model, values)
        plan = plan_folder(
            folder.directory,
            values,
            preset_of(body.preset) if body.preset else None,
            None if model is None else model.files,
        )
        if is_folder(folder.directory):
            raise BadRequest(f"{folder.directory} is a working folder already.", 409)
        if plan.clashes and not body.replace:
            names = ", ".join(plan.clashes)
            message = f"{plan.folder} already has {names}."
            remedy = "Agree to replace this; what it was is kept as .bak."
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
        Route("/api/settings/line", accepts(mend), methods=["PUT"]),
        Route("/api/new-folder", answers(about_folder), methods=["GET"]),
        Route("/api/new-folder", accepts(create), methods=["POST"]),
    ]
