"""Loads system.env and run.env into typed, frozen settings, with all problems at once.

The order is flag, process environment, run.env, system.env, default.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from drcli.base.errors import BadValue, Place, Problem, ProblemsError, Severity, shown
from drcli.config import activation
from drcli.config.fields import Setting, file_problem, hidden, setting_problem
from drcli.config.race_types import RACE_TYPES
from drcli.config.run_config import DriveConfig
from drcli.config.settings import Override, Settings, catalogue
from drcli.config.settings_files import EXPERIMENT, Entry, Layers, SettingsFiles, given, references
from drcli.config.track_names import track_problem
from drcli.config.unused_names import effect_warnings, old_names, rename_old, unknown_names
from drcli.config.value_types import (
    BUCKET_RULE,
    LOOPBACK_HOSTS,
    RUN_FOLDERS,
    follows_s3,
    object_key,
    without_slashes,
)

# Checks whether the values of settings fit each other.


def contradictions(settings: Settings) -> Iterator[Problem]:
    """Values that do not fit together, and one that the reference refuses."""

    def problem(
        names: tuple[str, ...], message: str, remedy: str, severity: Severity = "error"
    ) -> Problem:
        name = next((name for name in names if name in settings.sources), names[-1])
        return setting_problem(name, settings.place(name), message, remedy, severity=severity)

    if settings.eval_max_resets == 1:
        yield problem(
            ("DR_EVAL_MAX_RESETS",),
            "DR_EVAL_MAX_RESETS=1 puts a car back once here; the reference refuses 1.",
            "Write 0, or 2 or more, for a training on the reference.",
            severity="warning",
        )
    if settings.cloud == "remote" and not settings.remote_minio_url:
        yield problem(
            ("DR_CLOUD",),
            f"DR_CLOUD={settings.cloud} needs an address, but DR_REMOTE_MINIO_URL is empty.",
            "Set DR_REMOTE_MINIO_URL, as in http://192.168.1.5:9000, or write DR_CLOUD=local.",
        )
    if settings.cloud in ("local", "aws") and not follows_s3(settings.bucket):
        yield problem(
            ("DR_LOCAL_S3_BUCKET",),
            f"DR_LOCAL_S3_BUCKET={settings.bucket} is not the name of a bucket with "
            f"DR_CLOUD={settings.cloud}.",
            BUCKET_RULE,
        )
    if settings.webviewer_auth == "none" and settings.webviewer_host not in LOOPBACK_HOSTS:
        yield problem(
            ("DR_WEBVIEWER_AUTH",),
            f"DR_WEBVIEWER_AUTH=none would let every machine that reaches "
            f"{settings.webviewer_host} (DR_WEBVIEWER_HOST) run code here.",
            "Remove one of the two.",
        )
    if settings.train_overlap == "off" and settings.train_max_lag > 1:
        yield problem(
            ("DR_TRAIN_MAX_LAG",),
            f"DR_TRAIN_MAX_LAG={settings.train_max_lag} lets workers drive while the trainer "
            "learns, but DR_TRAIN_OVERLAP=off forbids that.",
            "Remove DR_TRAIN_MAX_LAG, or set DR_TRAIN_OVERLAP to auto.",
        )
    bots = settings.race_type == "HEAD_TO_BOT"
    if bots and settings.h2b_lower_lane_change_time > settings.h2b_upper_lane_change_time:
        yield problem(
            ("DR_H2B_LOWER_LANE_CHANGE_TIME", "DR_H2B_UPPER_LANE_CHANGE_TIME"),
            f"DR_H2B_LOWER_LANE_CHANGE_TIME={settings.h2b_lower_lane_change_time} is more than "
            f"DR_H2B_UPPER_LANE_CHANGE_TIME={settings.h2b_upper_lane_change_time}.",
            "Swap the two, or set both to the same time.",
        )
    if f"{settings.custom_files_prefix}/".startswith(f"{settings.model_prefix}/"):
        yield problem(
            ("DR_LOCAL_S3_MODEL_PREFIX", "DR_LOCAL_S3_CUSTOM_FILES_PREFIX"),
            f"DR_LOCAL_S3_MODEL_PREFIX={settings.model_prefix} is the folder of your own files, or "
            f"contains it (DR_LOCAL_S3_CUSTOM_FILES_PREFIX={settings.custom_files_prefix}).",
            "Give the model a separate folder; otherwise -w would delete your files.",
        )
    for name, prefix in _models_named(settings):
        if prefix.startswith(f"{settings.custom_files_prefix}/"):
            yield problem(
                (name, "DR_LOCAL_S3_CUSTOM_FILES_PREFIX"),
                f"{name}={prefix} is inside the folder of your own files "
                f"(DR_LOCAL_S3_CUSTOM_FILES_PREFIX={settings.custom_files_prefix}).",
                "Give the model a folder outside it; otherwise they could overwrite each other.",
            )
    first, slash, _ = settings.model_prefix.partition("/")
    if slash and first in RUN_FOLDERS:
        yield problem(
            ("DR_LOCAL_S3_MODEL_PREFIX",),
            f"DR_LOCAL_S3_MODEL_PREFIX={settings.model_prefix} is inside {first}/, where "
            "trainings and races keep files of their own.",
            f"Choose a prefix that starts with another name, such as my-{first}/.",
        )
    if settings.max_cost > 0.0 and not settings.spot_price:
        yield problem(
            ("DR_MAX_COST",),
            f"DR_MAX_COST={settings.max_cost:g} cannot be kept: the price of this machine is not "
            "known.",
            "Set DR_SPOT_PRICE in system.env: USD per hour, or auto on EC2.",
        )
    if settings.daily_budget_money > 0.0 and not settings.spot_price:
        yield problem(
            ("DR_DAILY_BUDGET_MONEY",),
            f"DR_DAILY_BUDGET_MONEY={settings.daily_budget_money:g} cannot be kept: the price of "
            "this machine is not known.",
            "Set DR_SPOT_PRICE in system.env: USD per hour, or auto on EC2.",
        )
    if settings.train_best_model_world != "training" and not settings.train_eval_world:
        yield problem(
            ("DR_TRAIN_BEST_MODEL_WORLD",),
            f"DR_TRAIN_BEST_MODEL_WORLD={settings.train_best_model_world} needs a second track, "
            "but DR_TRAIN_EVAL_WORLD is empty.",
            "Set DR_TRAIN_EVAL_WORLD to a track, or DR_TRAIN_BEST_MODEL_WORLD to training.",
        )
    if settings.sim_grow and not _has_ranges(settings):
        yield problem(
            ("DR_SIM_GROW",),
            "DR_SIM_GROW=True has no effect: training episodes draw from no range that could grow.",
            "Set a range such as DR_SIM_BRIGHTNESS=0.3, with DR_SIM_EXTRAS_IN=both or training.",
            severity="warning",
        )
    if settings.mail_to and not settings.smtp_url:
        yield problem(
            ("DR_MAIL_TO",),
            "DR_MAIL_TO is set, but DR_SMTP_URL is empty, so no mail can be sent.",
            "Set DR_SMTP_URL in system.env, as in smtps://user:password@mail.example.com:465.",
        )
    if settings.pretrained and settings.pretrained_prefix == settings.model_prefix:
        yield problem(
            ("DR_LOCAL_S3_PRETRAINED_PREFIX",),
            f"DR_LOCAL_S3_PRETRAINED_PREFIX={settings.pretrained_prefix} is the model to train.",
            f"Give DR_LOCAL_S3_MODEL_PREFIX a new name, such as {settings.model_prefix}-clone.",
        )


def _has_ranges(settings: Settings) -> bool:
    ranges = {name for name in catalogue() if name.startswith("DR_SIM_")} - _NO_RANGES
    fields = [catalogue()[name].field for name in ranges]
    is_on = settings.sim_extras_in != "evaluation"
    return is_on and any(getattr(settings, field) for field in fields)


_NO_RANGES = {"DR_SIM_CAR", "DR_SIM_EXTRAS_IN", "DR_SIM_GROW", "DR_SIM_LATENCY"}


def _models_named(settings: Settings) -> Iterator[tuple[str, str]]:
    yield "DR_LOCAL_S3_MODEL_PREFIX", settings.model_prefix
    if settings.pretrained:
        yield "DR_LOCAL_S3_PRETRAINED_PREFIX", settings.pretrained_prefix
    if settings.upload_s3_bucket == settings.bucket:
        yield "DR_UPLOAD_S3_PREFIX", settings.upload_s3_prefix


WORKER_NAMES = (
    "DR_WORLD_NAME",
    "DR_RACE_TYPE",
    "DR_CAR_COLOR",
    "DR_CAR_BODY_SHELL_TYPE",
    "DR_ENABLE_DOMAIN_RANDOMIZATION",
    "DR_RANDOMIZE_TEXTURES",
    "DR_TRAIN_CHANGE_START_POSITION",
    "DR_TRAIN_ALTERNATE_DRIVING_DIRECTION",
    "DR_TRAIN_ROUND_ROBIN_ADVANCE_DIST",
    "DR_TRAIN_START_POSITION_OFFSET",
    "DR_TRAIN_REVERSE_DIRECTION",
    "DR_TRAIN_LANES",
    "DR_PHYSICS",
    "DR_CAMERA_MAIN_ENABLE",
    "DR_CAMERA_SUB_ENABLE",
    "DR_ENABLE_EXTRA_KVS_OVERLAY",
    "DR_CAR_STEERING_LEFT",
    "DR_CAR_STEERING_RIGHT",
    "DR_CAR_STEERING_TRIM",
    "DR_CAR_MAX_SPEED",
    "DR_CAR_BATTERY",
)
"""In worker-N.env, besides those that begin as follows."""

WORKER_STEMS = ("DR_OA_", "DR_H2B_", "DR_SIM_")


def load_settings(
    directory: Path,
    *,
    flags: Mapping[str, str] | None = None,
    environ: Mapping[str, str] | None = None,
    contents: Mapping[str, bytes] | None = None,
) -> Settings:
    """Read and check all settings; `contents` replace files on the disk.

    Raises:
        ProblemsError: Something is wrong, or there is no run.env.
    """
    files = SettingsFiles(directory.absolute(), contents)
    return _Loader(files).load(_outside(flags or {}, environ))


def active_run_file(
    directory: Path,
    *,
    flags: Mapping[str, str] | None = None,
    environ: Mapping[str, str] | None = None,
) -> str:
    """Name of the active run.env: that of the experiment, if there is one.

    Raises:
        SettingsError: There is no such experiment, or system.env cannot be read.
    """
    files = SettingsFiles(directory.absolute())
    system = files.read("system.env") if files.exist("system.env") else {}
    layers = _outside(flags or {}, environ)
    return files.run_file(layers, files.experiment([*layers, system]))


def _outside(flags: Mapping[str, str], environ: Mapping[str, str] | None) -> list[dict[str, Entry]]:
    chosen = activation.chosen(os.environ if environ is None else environ)
    return [given(flags, "flag"), given(chosen, "environment")]


class _Loader:
    def __init__(self, files: SettingsFiles) -> None:
        self._files = files
        self._problems = files.problems

    def load(self, outside: list[dict[str, Entry]], worker: int | None = None) -> Settings:
        system = self._system()
        experiment = self._files.experiment([*outside, system])
        run = self._files.read(self._files.run_file(outside, experiment))
        self._refuse_late_experiment(run, experiment)

        folder = f"experiments/{experiment}/" if experiment else ""
        own = self._worker_file(folder, worker, run) if worker is not None else {}
        if not self._files.complete:
            self._refuse_errors()
        entries = [own, *outside, run, system]
        for layer in entries:
            _drop_empty(layer)
        self._problems += [*rename_old(entries), *leave_out_slashes(entries)]
        layers, values = self._resolve(entries)
        self._serve_azure_here(layers, values)
        others, problems = unknown_names(layers, entries)
        self._problems += problems

        sources = {
            name: entry.place
            for name in (*catalogue(), *others)
            if (entry := layers.find(name)) is not None
        }
        defaults = {setting.field: setting.default for setting in catalogue().values()}
        chosen = {"DR_REWARD_ON_ERROR", "DR_REWARD_MAX_ERROR_SHARE"} & sources.keys()
        if chosen == {"DR_REWARD_ON_ERROR"} and values.get("reward_on_error") == "count":
            values["reward_max_error_share"] = 1.0  # who asks for it knows that calls fail
        settings = Settings(
            **defaults | values,
            directory=self._files.directory,
            extra=others,
            written={name: entry.value for name, entry in run.items()},
            sources=sources,
            problems=(),
            overrides=(),
        )
        self._refuse_errors(settings.race)
        self._problems += contradictions(settings)
        self._refuse_errors(settings.race)
        overrides: tuple[Override, ...] = ()
        if worker is not None:
            overrides = (_override(layers, own, values),)
        else:
            if settings.train_multi_config:
                overrides = self._overrides(settings, outside)
                self._refuse_errors(settings.race)
            self._problems += effect_warnings(settings)
        return settings.replaced(problems=tuple(self._problems), overrides=overrides)

    def _refuse_errors(self, race: DriveConfig | None = None) -> None:
        """An unknown track is told then too; alone, it keeps no settings from loading."""
        if any(problem.severity == "error" for problem in self._problems):
            track = track_problem(race) if race is not None else None
            if track is not None and track.severity == "error":
                self._add([track])
            raise ProblemsError(sorted(self._problems, key=lambda p: (p.file, p.line or 0)))

    def _system(self) -> dict[str, Entry]:
        if self._files.exist("system.env"):
            return self._files.read("system.env")
        what = "is missing, so its settings have their defaults."
        place, remedy = Place("system.env"), "`dr-init` writes one."
        self._problems.append(file_problem(place, what, remedy, severity="warning"))
        return {}

    def _worker_file(self, folder: str, worker: int, run: Mapping[str, Entry]) -> dict[str, Entry]:
        name = f"{folder}worker-{worker}.env"
        if not self._files.exist(name):
            what = (
                f"there is no such file in {self._files.directory}, but DR_TRAIN_MULTI_CONFIG is "
                f"True and there is a worker {worker}."
            )
            remedy = (
                f"Write the track and race of that worker into {name}, or set DR_WORKERS to "
                f"{worker - 1}."
            )
            self._problems.append(setting_problem("DR_WORKERS", Place(name), what, remedy))
            return {}
        entries = self._files.read(name)
        shared = {key: entries.pop(key) for key in list(entries) if not is_of_worker(key)}
        # These files are copies of run.env, mostly.
        idle = {
            key: entry
            for key, entry in shared.items()
            if key not in run or run[key].value != entry.value
        }
        if idle:
            first = next(iter(idle.values())).place
            names, are = shown(", ".join(idle)), "are" if len(idle) > 1 else "is"
            what = f"{len(idle)} of the settings {are} the same for all workers: {names}."
            remedy = "They are ignored in this file: move the lines to run.env, or remove them."
            self._problems.append(file_problem(first, what, remedy, severity="warning"))
        return entries

    def _overrides(
        self, settings: Settings, outside: list[dict[str, Entry]]
    ) -> tuple[Override, ...]:
        overrides: list[Override] = []
        for worker in range(2, settings.workers + 1):
            loader = _Loader(SettingsFiles(self._files.directory, self._files.contents))
            try:
                loaded = loader.load([dict(layer) for layer in outside], worker)
            except ProblemsError as error:
                self._add(error.problems)
                continue
            overrides += loaded.overrides
            own_file = f"worker-{worker}.env"
            self._add(problem for problem in loaded.problems if problem.file.endswith(own_file))
        return tuple(overrides)

    def _add(self, problems: Iterable[Problem]) -> None:
        self._problems += [each for each in problems if each not in self._problems]

    def _refuse_late_experiment(self, run: dict[str, Entry], experiment: str) -> None:
        entry = run.pop(EXPERIMENT, None)
        if entry is not None and entry.value not in ("", experiment):
            what = f"{EXPERIMENT}={shown(entry.value)} is set in the run.env that it should choose."
            remedy = "Move the line to system.env."
            self._problems.append(setting_problem(EXPERIMENT, entry.place, what, remedy))

    def _serve_azure_here(self, layers: Layers, values: dict[str, Any]) -> None:
        """As the reference, which keeps the bucket on this machine with `azure`."""
        entry = layers.find("DR_CLOUD")
        if values.get("cloud") != "azure" or values.get("remote_minio_url") or entry is None:
            return
        values["cloud"] = "local"
        what = "DR_CLOUD=azure without DR_REMOTE_MINIO_URL is read as DR_CLOUD=local."
        remedy = (
            "Write DR_CLOUD=local, or set DR_REMOTE_MINIO_URL to the address of an S3 server, such "
            "as http://localhost:9000."
        )
        problem = setting_problem("DR_CLOUD", entry.place, what, remedy, severity="warning")
        self._add([problem])

    def _resolve(self, entries: list[dict[str, Entry]]) -> tuple[Layers, dict[str, Any]]:
        # Other values refer to defaults, and some defaults refer to other names.
        defaults = {name: setting.default_text for name, setting in catalogue().items()}
        while True:
            layers = Layers(entries, defaults)
            values, bad = self._values(layers)
            dropped = bad & set().union(*entries)
            if not dropped:
                return layers, values
            for layer in entries:
                for name in dropped:
                    layer.pop(name, None)

    def _values(self, layers: Layers) -> tuple[dict[str, Any], set[str]]:
        dropped: set[str] = set()
        texts: dict[str, str] = {}
        values: dict[str, Any] = {}
        bad: dict[str, BadValue] = {}
        faults: dict[str, Problem] = {}
        for name, setting in catalogue().items():
            text = layers.text(name)
            if name in layers.problems:
                faults[name] = layers.problems[name]
            elif text is not None and (text.strip() or setting.kind == "text"):
                texts[name] = text.strip()
                try:
                    values[setting.field] = self._value(setting, texts[name])
                except BadValue as error:
                    bad[name] = error
        for name, fault in bad.items():
            entry = layers.find(name)
            place = Place("default") if entry is None else entry.place
            written = catalogue()[name].default_text if entry is None else entry.value.strip()
            if references(written) & bad.keys():
                continue  # the name it refers to has to be corrected
            what = f"{name}={shown(hidden(name, texts[name]))} {fault.reason}"
            if written != texts[name]:
                what += f" (written {shown(hidden(name, written))})"
            faults[name] = setting_problem(name, place, f"{what}.", fault.remedy)
        for name, problem in faults.items():
            harmless = _harmless(name, values)
            if harmless:
                message = f"{problem.message} {harmless}"
                problem = replace(problem, severity="warning", message=message)
                dropped.add(name)
            self._add([problem])
        return values, dropped

    def _value(self, setting: Setting, text: str) -> Any:
        value = setting.read(text)
        if not all(character >= " " for character in text):
            remedy = f"Remove it from {setting.name}."
            raise BadValue("contains a line break or control character", remedy)
        if setting.kind != "path":
            return value
        try:
            return self._files.directory / (value.expanduser() if text.startswith("~/") else value)
        except RuntimeError as e:  # neither HOME nor the list of users has it
            reason = "begins with ~, but the home folder of this user is not known"
            raise BadValue(reason, "Write the whole path, or set HOME.") from e


def _harmless(name: str, values: Mapping[str, Any]) -> str:
    """Why a wrong value of a setting does not matter, in a sentence; empty if it does."""
    setting = catalogue()[name]
    if setting.effect != "used":
        return "It has no effect here."
    if setting.cosmetic:
        return f"{setting.default_text} is used instead."
    if name == "DR_LOCAL_S3_PRETRAINED_PREFIX" and values.get("pretrained") is False:
        return "It has no effect with DR_LOCAL_S3_PRETRAINED=False."
    uploads = ("regular_upload", "upload_best_model", "upload_model_on_completion")
    if name == "DR_UPLOAD_S3_BUCKET" and not any(values.get(field, True) for field in uploads):
        return "It has no effect as long as no upload is asked for."
    race_type = values.get("race_type")
    for kind, race in RACE_TYPES.items():
        if race.settings and name.startswith(race.settings) and race_type not in (kind, None):
            return f"It has no effect with DR_RACE_TYPE={race_type}."
    return ""


def leave_out_slashes(layers: Iterable[dict[str, Entry]]) -> Iterator[Problem]:
    """Shorten names in the bucket before others refer to them, with a warning about each."""
    keys = [name for name, setting in catalogue().items() if setting.check is object_key]
    for layer in layers:
        for name in keys:
            written = layer[name].value.strip() if name in layer else ""
            plain = without_slashes(written)
            if plain not in (written, ""):
                layer[name] = replace(layer[name], value=plain)
                what = f"{name}={shown(written)} is read as {plain}, without the extra slashes."
                remedy = "Write names without / at the start or the end."
                yield setting_problem(name, layer[name].place, what, remedy, severity="warning")


def is_of_worker(name: str) -> bool:
    """Whether a setting, also by an old name, may differ from worker to worker."""
    present = old_names().get(name, name)
    return present in WORKER_NAMES or present.startswith(WORKER_STEMS)


def _override(layers: Layers, own: dict[str, Entry], values: dict[str, Any]) -> Override:
    known = [name for name in own if name in catalogue() and layers.find(name) is own[name]]
    fields = [catalogue()[name].field for name in known]
    return Override(
        values={field: values[field] for field in fields if field in values},
        sources={name: own[name].place for name in known},
    )


def _drop_empty(layer: dict[str, Entry]) -> None:
    """An empty value means not set, except where a text may be empty."""
    for name, setting in catalogue().items():
        if setting.kind != "text" and name in layer and not layer[name].value.strip():
            del layer[name]
