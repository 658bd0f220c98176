"""Checks hyperparameters.json and model_metadata.json."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from drcli.base.errors import Problem, ProblemsError
from drcli.checks.machine_rules import review_access
from drcli.config.fields import setting_problem
from drcli.config.loading import load_settings
from drcli.config.settings import Settings, catalogue
from drcli.model.files.custom_files import InputFile
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.transfer.transfer_buckets import UNDEFINED

T = TypeVar("T", Hyperparameters, ModelMetadata)


@dataclass(frozen=True)
class ParametersReview:
    """The two files as far as usable; `design` has both."""

    parameters: Hyperparameters | None
    metadata: ModelMetadata | None
    design: Design | None
    problems: list[Problem]


def review_parameters(
    hyperparameters: InputFile | None, metadata: InputFile | None, settings: Settings | None
) -> ParametersReview:
    """Read the files that exist, and compare them with the settings."""
    found: list[Problem] = []
    learning = _read(Hyperparameters, hyperparameters, found)
    model = _read(ModelMetadata, metadata, found)
    design: Design | None = None
    if settings is not None and learning is not None and hyperparameters is not None:
        found += _idle_workers(settings, learning, hyperparameters.origin)
        found += _idle_learners(settings, learning)
    if learning is not None and model is not None and hyperparameters and metadata:
        found = [each for each in found if each.severity == "error" or _matters(each, model)]
        design = Design(model, learning, metadata.origin, hyperparameters.origin)
        found += design.conflicts()
    return ParametersReview(learning, model, design, found)


def _matters(problem: Problem, model: ModelMetadata) -> bool:
    if problem.key == "num_episodes_between_training":
        return not model.algorithm.replay
    return model.algorithm.reads(problem.key)


def _read(kind: type[T], file: InputFile | None, found: list[Problem]) -> T | None:
    if file is None:
        return None
    try:
        content = kind.from_bytes(file.data, file.origin)
    except ProblemsError as error:
        found += error.problems
        return None
    found += content.problems
    return content


def _idle_workers(settings: Settings, parameters: Hyperparameters, origin: str) -> list[Problem]:
    """V-45: all others would wait for them."""
    episodes = parameters.num_episodes_between_training
    if settings.workers <= episodes:
        return []
    what = (
        f"DR_WORKERS={settings.workers} is more than num_episodes_between_training={episodes} in "
        f"{origin}."
    )
    remedy = f"Set DR_WORKERS to at most {episodes}, or drive more episodes per iteration."
    return [setting_problem("DR_WORKERS", settings.place("DR_WORKERS"), what, remedy)]


def _idle_learners(settings: Settings, parameters: Hyperparameters) -> list[Problem]:
    """A training with a teacher has one process that learns."""
    name, count = "DR_TRAIN_LEARNERS", settings.train_learners
    if not parameters.taught or count == 1:
        return []
    what = (
        f"{name}={count}: with training_method=teacher, the trainer learns in one process, with "
        "all cores."
    )
    remedy = f"Set {name}=1, or train without a teacher (--no-teacher)."
    return [setting_problem(name, settings.place(name), what, remedy, severity="warning")]


# Checks the settings files, even if they cannot be loaded.


MOST_REPAIRS = 5
"""A removed line may reveal another problem."""

SCREEN = ("DR_HOST_X", "DR_DISPLAY", "DR_GUI_ENABLE")
"""V-06: not needed here."""


@dataclass(frozen=True)
class SettingsReview:
    """The settings without wrong lines; `whole`: there are none."""

    settings: Settings | None
    whole: bool
    problems: list[Problem]


def review_settings(directory: Path, environ: Mapping[str, str] | None = None) -> SettingsReview:
    names = dict(os.environ if environ is None else environ)
    contents: dict[str, bytes] = {}
    problems: list[Problem] = []
    for attempt in range(MOST_REPAIRS):
        try:
            settings = load_settings(directory, environ=names, contents=contents)
        except ProblemsError as error:
            problems += error.problems
            if not _take_out(error.errors, directory, contents, names):
                break
        else:
            problems += [*settings.problems, *_judged(settings)]
            return SettingsReview(settings, attempt == 0, problems)
    return SettingsReview(None, False, problems)


def _judged(settings: Settings) -> list[Problem]:
    found = []
    for name in SCREEN:
        setting = catalogue()[name]
        if name in settings.sources and getattr(settings, setting.field) != setting.default:
            value = getattr(settings, setting.field)
            what = f"{name}={value} is accepted and not needed: {setting.reason}."
            place, remedy = settings.place(name), "Keep or remove the line."
            found.append(Problem("V-06", "warning", *place, what, remedy, name))
    access = review_access(settings.storage, settings.directory)
    return [*found, *upload_problems(settings), *access]


def upload_problems(settings: Settings) -> list[Problem]:
    """V-12: uploads have a bucket to go to."""
    wanted = {
        "DR_REGULAR_UPLOAD": settings.regular_upload > 0,
        "DR_UPLOAD_BEST_MODEL": settings.upload_best_model,
        "DR_UPLOAD_MODEL_ON_COMPLETION": settings.upload_model_on_completion,
    }
    if settings.upload_s3_bucket not in ("", UNDEFINED):
        return []
    remedy = "Set DR_UPLOAD_S3_BUCKET in system.env, or switch these uploads off."
    return [
        Problem(
            "V-12",
            "warning",
            *settings.place(name),
            f"{name} asks for uploads, but DR_UPLOAD_S3_BUCKET names no bucket, so they will fail.",
            remedy,
            name,
        )
        for name, is_wanted in wanted.items()
        if is_wanted
    ]


def _take_out(
    errors: Iterable[Problem], directory: Path, contents: dict[str, bytes], names: dict[str, str]
) -> bool:
    for error in errors:
        if error.file == "environment" and error.key in names:
            del names[error.key]
        elif error.file.endswith(".env"):
            contents[error.file] = _without(error, directory, contents)
        else:
            return False
    return True


def _without(error: Problem, directory: Path, contents: Mapping[str, bytes]) -> bytes:
    path = directory / error.file
    if error.line is None or not (error.file in contents or path.is_file()):
        return b""
    content = contents[error.file] if error.file in contents else path.read_bytes()
    lines = content.splitlines(keepends=True)
    if error.line <= len(lines):
        lines[error.line - 1] = b"\n"
    return b"".join(lines)
