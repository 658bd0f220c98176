"""Checks the settings files, even if they cannot be loaded."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from drcli.base.errors import BadValue, Problem, ProblemsError, Severity, shown
from drcli.checks.machine_rules import review_access
from drcli.config.fields import setting_problem
from drcli.config.loading import load_settings
from drcli.config.settings import Settings, catalogue
from drcli.config.value_types import upload_bucket
from drcli.transfer.transfer_buckets import UNDEFINED

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
            several = "settings for windows and displays"
            found.append(Problem("V-06", "warning", *place, what, remedy, name, several))
    access = review_access(settings.storage, settings.directory)
    return [*found, *upload_problems(settings), *access]


def upload_problems(settings: Settings) -> list[Problem]:
    """V-12: uploads have a bucket to go to; one that cannot be one is an error only for them.

    An import has a site to go to, if somebody asks for it.
    """
    return [*_import_problems(settings), *_bucket_problems(settings)]


def _import_problems(settings: Settings) -> list[Problem]:
    name = "DR_IMPORT_MODEL_ON_COMPLETION"
    wanted = settings.import_model_on_completion and name in settings.sources
    if not wanted or settings.droa_url:
        return []
    what = f"{name}=True, but DR_DROA_URL is empty, so the model will not be imported."
    remedy = f"Set DR_DROA_URL in system.env, or write {name}=False."
    return [setting_problem(name, settings.place(name), what, remedy, severity="warning")]


def _bucket_problems(settings: Settings) -> list[Problem]:
    wanted = {
        "DR_REGULAR_UPLOAD": settings.regular_upload > 0,
        "DR_UPLOAD_BEST_MODEL": settings.upload_best_model,
        "DR_UPLOAD_MODEL_ON_COMPLETION": settings.upload_model_on_completion,
    }
    name, bucket = "DR_UPLOAD_S3_BUCKET", settings.upload_s3_bucket
    if bucket not in ("", UNDEFINED):
        try:
            upload_bucket(bucket)
        except BadValue as bad:
            severity: Severity = "error" if any(wanted.values()) else "warning"
            what = f"{name}={shown(bucket)} {bad.reason}, so nothing can be uploaded."
            place = settings.place(name)
            return [setting_problem(name, place, what, bad.remedy, severity=severity)]
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
