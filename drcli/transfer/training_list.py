"""Lists a bucket's trainings, recorded or not."""

import csv
import io
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import Annotated, Any, get_args

from drcli.base.clock import moment
from drcli.base.errors import SettingsError
from drcli.base.report import Col, View, bold, counted, dim, printable, table
from drcli.bucket.bucket import Bucket, ObjectDamaged, ObjectNewer
from drcli.config.settings import catalogue
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.model.run_metadata import read_start
from drcli.model.traces import models_in
from drcli.model.training_records import at_once, ended_elsewhere, read_trainings
from drcli.records.training_record import TrainingRecord, TrainingState
from drcli.transfer.record_training import (
    derived_training,
    evaluations_by_folder,
    model_of,
    origin_of,
    with_evaluations,
    with_results,
)

# A training in short, and its settings with defaults.


STATE_STYLES = {
    "running": "green",
    "failed": "red",
    "lost": "red",
    "interrupted": "yellow",
    "unknown": "dim",
}


@dataclass(frozen=True)
class TrainingEntry:
    """A training in the list."""

    id: Annotated[str, "Eight hexadecimal digits.", Col("id")]
    model: Annotated[
        str, "Prefix of the model.", Col("model", of=lambda each: each.title(), side="left")
    ]
    state: Annotated[
        str,
        "running, finished, stopped, interrupted, failed, lost or unknown.",
        Col("ended", style=STATE_STYLES),
    ]
    message: Annotated[str, "Why it ended."]
    began_at: Annotated[
        str,
        "Time of its first start in UTC, ISO 8601; empty if unknown.",
        Col("began", lambda text: text[:10] or "-"),
    ]
    ended_at: Annotated[str, "Time of its end, likewise."]
    exists: Annotated[bool, "Whether its model is still there."]
    derived: Annotated[
        bool, "Whether this was worked out from the model, as nobody wrote a record."
    ]
    world: Annotated[str, "Track.", Col("track", lambda text: printable(text) or "-")]
    race_type: Annotated[str, "DR_RACE_TYPE."]
    algorithm: Annotated[str, "clipped_ppo or sac."]
    action_space: Annotated[str, "Kind and number of actions."]
    workers: Annotated[int | None, "Simulation workers."]
    starts: Annotated[int, "How often it was started."]
    iterations: Annotated[int, "Finished iterations.", Col("iters")]
    episodes: Annotated[int, "Training episodes."]
    steps: Annotated[int, "Steps learned from."]
    elapsed_s: Annotated[float, "Wall time of training."]
    hours: Annotated[
        float | None, "Machine hours of all starts.", Col("hours", "{:.2f} h", wide=True)
    ]
    usd: Annotated[float | None, "What these cost.", Col("cost", "{:.2f} USD", wide=True)]
    best_lap_s: Annotated[
        float | None,
        "Fastest clean lap of an evaluation on `world`, during the training or later.",
        Col("best lap", "{:.2f} s"),
    ]
    best_training_lap_s: Annotated[float | None, "Fastest lap of a training episode on `world`."]
    best_progress: Annotated[
        float | None,
        "Highest mean progress of an evaluation on `world`, percent.",
        Col("progress", "{:.0f} %"),
    ]
    best_checkpoint: Annotated[str | None, "Name of the best checkpoint."]
    best_score: Annotated[float | None, "Its score."]
    mean_reward: Annotated[float | None, "Of the last iteration."]
    mean_progress: Annotated[float | None, "Of the last iteration, percent."]
    parent: Annotated[str, "The model with whose weights it began; empty for fresh ones."]
    parent_checkpoint: Annotated[str, "Name of that checkpoint."]
    parent_training: Annotated[str, "Id of the training that made it; empty if unknown."]
    host: Annotated[str, "Machine of the newest start."]
    processor: Annotated[str, "Of that machine."]
    drcli: Annotated[str, "Version of drcli of the newest start."]
    commit: Annotated[str, "Git commit of the working folder, with + if files were changed."]
    seed: Annotated[int | None, "Of its random numbers."]
    description: Annotated[str, "DR_MODEL_DESCRIPTION."]
    metric: Annotated[str, "DR_TRAIN_BEST_MODEL_METRIC, of which the score is; empty if unknown."]

    def title(self) -> tuple[str, ...]:
        return printable(self.model), dim("" if self.exists else " (gone)")


def entry_of(record: TrainingRecord, *, exists: bool) -> TrainingEntry:
    newest, results, parent = record.newest, record.results, record.parent
    git = newest.git.get("working_folder")
    return TrainingEntry(
        id=record.id,
        model=record.prefix,
        state=record.state,
        message=record.message,
        began_at=moment_text(record.began_at),
        ended_at=moment_text(record.ended_at),
        exists=exists,
        derived=record.derived,
        world=record.world,
        race_type=record.race_type,
        algorithm=record.algorithm,
        action_space=record.action_space,
        workers=record.workers,
        starts=record.number_of_starts,
        iterations=results.iterations,
        episodes=results.episodes,
        steps=results.steps,
        elapsed_s=results.elapsed_s,
        hours=record.hours,
        usd=record.usd,
        best_lap_s=results.clean_lap_s(record.world),
        best_training_lap_s=results.best_training_lap_s,
        best_progress=results.best_progress,
        best_checkpoint=results.best_checkpoint,
        best_score=results.best_score,
        mean_reward=results.mean_reward,
        mean_progress=results.mean_progress,
        parent="" if parent is None else parent.prefix,
        parent_checkpoint="" if parent is None else parent.name,
        parent_training=record.parent_training,
        host=newest.host,
        processor=str(newest.machine.get("processor") or ""),
        drcli=newest.versions.get("drcli") or "",
        commit="" if git is None else f"{git.commit[:12]}{'+' if git.dirty else ''}",
        seed=newest.seed,
        description=record.description,
        metric=record.metric,
    )


def moment_text(at: float | None) -> str:
    """A time in Unix seconds as ISO 8601 in UTC; empty if unknown."""
    if not at:
        return ""
    try:
        return datetime.fromtimestamp(at, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    except (ValueError, OverflowError, OSError):
        return ""


def settings_of(record: TrainingRecord) -> dict[str, Any]:
    given = record.newest.settings
    if given is None:
        return {}
    defaults = {
        name: setting.default_text if setting.kind in ("path", "list") else setting.default
        for name, setting in catalogue().items()
        if setting.effect == "used"
    }
    return {**defaults, **given}


MOST_EVALUATIONS = 1000
"""At a time, of all models: each is a request."""

LEAST_ID, FULL_ID = 4, 8
"""Digits of an id that name a training, and all of them."""


@dataclass(frozen=True)
class TrainingList:
    """The trainings of a bucket."""

    bucket: Annotated[str, "Its name."]
    trainings: Annotated[list[TrainingEntry], "The chosen ones, in the chosen order."]
    total: Annotated[int, "How many trainings there are."]
    damaged: Annotated[list[str], "A sentence for each record that cannot be read."] = field(
        default_factory=list
    )

    def view(self) -> View:
        place, shown = f"s3://{self.bucket}", len(self.trainings)
        if not self.total:
            return [f"There is no training in {place} yet."]
        if not self.trainings:
            none = f"No training in {place} fits; it has {self.total}."
            return [f"{none} The subcommands are show, compare, tree and forget."]
        order = ("id", "model", "began_at", "world", "iterations", "best_progress", "best_lap_s")
        part = f"{shown} of {self.total:,} trainings."
        return [
            bold(place),
            table(self.trainings, *order, "hours", "usd", "state"),
            part if shown < self.total else f"{counted(shown, 'training')}.",
        ]


@dataclass(frozen=True)
class KnownTrainings:
    """All trainings by start; `existing` are ids whose model is still there."""

    bucket: str
    records: tuple[TrainingRecord, ...] = ()
    existing: frozenset[str] = frozenset()
    models: frozenset[str] = frozenset()
    damaged: tuple[str, ...] = ()

    def entries(self) -> list[TrainingEntry]:
        return [entry_of(record, exists=record.id in self.existing) for record in self.records]

    def find(self, name: str) -> TrainingRecord:
        """By id or its beginning, or by model for its newest training, with ~1 for the one before.

        A name that is both means the model, unless it is a whole id.

        Raises:
            SettingsError: None or several have this name.
        """
        prefix, _, back = name.rstrip("/").partition("~")
        of_model = [record for record in self.records if record.prefix == prefix]
        digits = name.casefold()
        # A model may be called `cafe`: its name comes before the beginning of an id.
        shortest = FULL_ID if of_model else LEAST_ID
        if len(digits) >= shortest and not set(digits) - set("0123456789abcdef"):
            found = [record for record in self.records if record.id.startswith(digits)]
            if len(found) == 1:
                return found[0]
            if len(found) > 1:
                raise SettingsError(
                    f"{name} is the beginning of {len(found)} trainings: "
                    f"{', '.join(record.id for record in found[:5])}.",
                    remedy="Write more digits.",
                )
        count = int(back) if back.isdecimal() and len(back) < 6 else 0
        if not of_model or (back and not back.isdecimal()):
            raise SettingsError(
                f"There is no training {name} in s3://{self.bucket}.",
                remedy="`dr-history` lists all trainings.",
            )
        if count >= len(of_model):
            how_many = "one training" if len(of_model) == 1 else f"{len(of_model)} trainings"
            raise SettingsError(
                f"There is no training {name}: {prefix} has {how_many}.",
                remedy=f"`dr-history {prefix}` lists them.",
            )
        return of_model[-1 - count]


def known_trainings(bucket: Bucket) -> KnownTrainings:
    listed = bucket.list("")
    present = {info.key for info in listed}
    models = models_in(listed)
    records, damaged = read_trainings(bucket)
    left = {record.prefix for record in records if record.gone_at is None}
    trained = [p for p in models if p not in left and keys.training_start(p) in present]

    recorded = {(record.prefix, record.id) for record in records}

    def derive(prefix: str) -> TrainingRecord | None:
        try:
            start = read_start(ModelStore(bucket, prefix))
            origin = prefix if start is None else origin_of(prefix, start)
            if start is not None and origin != prefix and (origin, start.training) in recorded:
                return None  # a copy
            return derived_training(ModelStore(bucket, prefix), start)
        except (ObjectDamaged, ObjectNewer) as error:
            damaged.append(f"{error} {error.remedy}")
            return None

    records += [record for record in at_once(derive, sorted(trained)) if record is not None]
    evaluations = evaluations_by_folder(listed)
    if surplus := _surplus(records, bucket, evaluations):
        damaged.append(
            f"{len(surplus):,} older results of dr-evaluate were not read, only the newest "
            f"{MOST_EVALUATIONS:,} of those that no record contains yet."
        )
        evaluations = {
            folder: [key for key in found if key not in surplus]
            for folder, found in evaluations.items()
        }
    records = at_once(lambda record: _as_it_is_now(bucket, evaluations, record), records)
    records.sort(key=lambda record: (record.began_at, record.prefix, record.id))
    # Only the newest training of a model can be the one whose model is there.
    newest = {record.prefix: record for record in records if record.gone_at is None}
    return KnownTrainings(
        bucket.name,
        tuple(records),
        frozenset(record.id for record in newest.values() if record.prefix in models),
        frozenset(models),
        tuple(damaged),
    )


def _surplus(
    records: Sequence[TrainingRecord], bucket: Bucket, evaluations: Mapping[str, Sequence[str]]
) -> set[str]:
    fresh: list[str] = []
    for record in records:
        if record.gone_at is None:
            folder = keys.evaluation_metrics_folder(model_of(record, bucket).metrics_prefix)
            fresh += evaluations.get(folder, [])[record.results.read_evaluations :]
    fresh.sort(key=lambda key: key.rpartition("/")[2])
    return set(fresh[:-MOST_EVALUATIONS])


def _as_it_is_now(
    bucket: Bucket, evaluations: Mapping[str, Sequence[str]], record: TrainingRecord
) -> TrainingRecord:
    if record.gone_at is not None:
        return ended_elsewhere(bucket, record) if record.state == "running" else record
    model = model_of(record, bucket)
    if record.state == "running":
        if lease.live_holder(ModelStore(bucket, record.prefix)) is None:
            record = ended_elsewhere(bucket, record)
        return with_results(record, model)
    found = evaluations.get(keys.evaluation_metrics_folder(model.metrics_prefix), [])
    return replace(record, results=with_evaluations(record.results, model, found))


# Chooses and sorts trainings for a list.


def values_of(record: TrainingRecord, entry: TrainingEntry) -> Mapping[str, Any]:
    return {**settings_of(record), **record.hyperparameters, **vars(entry)}


def chosen(
    known: KnownTrainings,
    conditions: Sequence[Callable[[Mapping[str, Any]], bool]],
    sort: str = "began",
    limit: int = 0,
) -> TrainingList:
    """Sorted so that the best, newest or largest come last; `limit` keeps the last."""

    def fits(record: TrainingRecord, entry: TrainingEntry) -> bool:
        values = values_of(record, entry) if conditions else {}
        return all(condition(values) for condition in conditions)

    pairs = zip(known.records, known.entries(), strict=True)
    found = ordered([entry for record, entry in pairs if fits(record, entry)], sort)
    return TrainingList(
        known.bucket, found[-limit:] if limit else found, len(known.records), list(known.damaged)
    )


ORDERS: Mapping[str, Callable[[TrainingEntry], Any]] = {
    "began": lambda entry: entry.began_at or None,
    "lap": lambda entry: None if entry.best_lap_s is None else -entry.best_lap_s,
    "progress": lambda entry: entry.best_progress,
    "score": lambda entry: entry.best_score,
    "iterations": lambda entry: entry.iterations,
    "hours": lambda entry: entry.hours,
    "cost": lambda entry: entry.usd,
    "model": lambda entry: entry.model,
}
"""Missing values come first."""


def ordered(entries: Iterable[TrainingEntry], sort: str) -> list[TrainingEntry]:
    key = ORDERS[sort]
    known = [(key(entry), entry) for entry in entries]
    without = [entry for value, entry in known if value is None]
    with_value = [pair for pair in known if pair[0] is not None]
    return without + [entry for _, entry in sorted(with_value, key=lambda pair: pair[0])]


# Conditions that choose trainings: time, state, comparison.


Condition = Callable[[Mapping[str, Any]], bool]

STATES: tuple[str, ...] = get_args(TrainingState)

_COMPARISON = re.compile(r"\s*([A-Za-z][A-Za-z0-9_]*)\s*(<=|>=|!=|==|=|<|>)\s*(.*?)\s*")


def of_model(pattern: str) -> Condition:
    """By a part of the prefix, or `*` and `?`."""
    has_wildcards = any(character in pattern for character in "*?[")

    def fits(values: Mapping[str, Any]) -> bool:
        model = str(values["model"])
        return fnmatchcase(model, pattern) if has_wildcards else pattern in model

    return fits


def in_state(words: str) -> Condition:
    """States separated by commas; raises SettingsError."""
    wanted = [word.casefold() for word in re.split(r"[,\s]+", words) if word]
    for word in wanted:
        if word not in STATES:
            raise SettingsError(
                f"--state {word} is no state of a training.",
                remedy=f"Write some of {', '.join(STATES)}, separated by commas.",
            )
    return lambda values: values["state"] in wanted


def began(option: str, text: str, now: datetime, *, after: bool) -> Condition:
    """By a date in UTC, or an age; raises SettingsError."""
    limit = moment(option, text, now).strftime("%Y-%m-%dT%H:%M:%SZ")

    def fits(values: Mapping[str, Any]) -> bool:
        at = str(values["began_at"])
        return bool(at) and (at >= limit if after else at < limit)

    return fits


def where(text: str, names: Collection[str]) -> Condition:
    """A comparison such as `lr<0.001` or `DR_WORLD_NAME=reinvent*`.

    Texts are compared without case; = and != know `*` and `?`. A missing value fulfils only !=.

    Raises:
        SettingsError: It is not one, or no training can have such a value.
    """
    found = _COMPARISON.fullmatch(text)
    if found is None:
        raise SettingsError(
            f"--where {text} is no comparison.",
            remedy="Write one with =, !=, <, <=, > or >=, as in --where 'lr<0.001'.",
        )
    name, sign, wanted = found[1], found[2], found[3]
    known = {each.casefold(): each for each in names}
    if name.casefold() not in known:
        close = get_close_matches(name.casefold(), known, 3)
        likely = f"Did you mean {', '.join(known[each] for each in close)}? " if close else ""
        raise SettingsError(
            f"--where {text}: no training has a value {name}.",
            remedy=f"{likely}Use a setting, a hyperparameter, or a key of `dr-history --json`.",
        )
    name = known[name.casefold()]
    return lambda values: _holds(values.get(name), sign, wanted)


def _holds(value: Any, sign: str, wanted: str) -> bool:
    if value is None or value == "":
        return sign == "!=" and wanted != ""
    left, right = _number(value), _number(wanted)
    if left is not None and right is not None:
        return {
            "=": left == right,
            "==": left == right,
            "!=": left != right,
            "<": left < right,
            "<=": left <= right,
            ">": left > right,
            ">=": left >= right,
        }[sign]
    one, other = str(value).casefold(), wanted.casefold()
    if sign in ("=", "==", "!="):
        return fnmatchcase(one, other) == (sign != "!=")
    return {"<": one < other, "<=": one <= other, ">": one > other, ">=": one >= other}[sign]


def _number(value: Any) -> float | None:
    if isinstance(value, bool):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return None if number != number else number


# Trainings as a CSV table.


def csv_table(known: KnownTrainings, chosen: Collection[TrainingEntry]) -> str:
    """With each hyperparameter and each setting that was given."""
    records = {record.id: record for record in known.records}
    found = [records[entry.id] for entry in chosen]
    parameters = sorted({name for record in found for name in record.hyperparameters})
    settings = sorted({name for record in found for name in record.newest.settings or {}})
    names = [each.name for each in fields(TrainingEntry)]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([*names, *parameters, *settings])
    for entry, record in zip(chosen, found, strict=True):
        given = record.newest.settings or {}
        cells = [getattr(entry, name) for name in names]
        cells += [record.hyperparameters.get(name) for name in parameters]
        cells += [given.get(name) for name in settings]
        table.writerow(["" if cell is None else cell for cell in cells])
    return text.getvalue()
