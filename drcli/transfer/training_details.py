"""Shows one training, gives its files back, and forgets trainings."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from drcli.base.errors import SettingsError
from drcli.base.files import make_folder, refuse_existing, rewrite
from drcli.base.report import (
    Col,
    Rows,
    Styled,
    View,
    bold,
    counted,
    dim,
    printable,
    table,
    utc_minute,
)
from drcli.bucket.bucket import Bucket
from drcli.model import keys, lease
from drcli.model.model_list import score_text
from drcli.model.model_store import ModelStore
from drcli.model.training_records import forget_training
from drcli.records.training_record import RecordedStart, TrainingRecord
from drcli.transfer.record_training import texts_of
from drcli.transfer.training_list import (
    STATE_STYLES,
    KnownTrainings,
    TrainingEntry,
    entry_of,
    settings_of,
)

# Compares two trainings: inputs, machine, results.


NOT_COMPARED = ("DR_RUN_ID", "DR_LOCAL_S3_MODEL_PREFIX", "DR_LOCAL_S3_METRICS_PREFIX")
"""These say which training it is, not how it trains."""

_RESULTS = (
    "world",
    "state",
    "iterations",
    "episodes",
    "steps",
    "elapsed_s",
    "hours",
    "usd",
    "best_lap_s",
    "best_training_lap_s",
    "best_progress",
    "best_checkpoint",
    "best_score",
    "mean_reward",
    "mean_progress",
)

_CONTEXT = 2


_RESULT_NAMES = {
    "world": "track",
    "elapsed_s": "time",
    "hours": "machine hours",
    "usd": "cost",
    "best_lap_s": "best clean lap",
    "best_training_lap_s": "best training lap",
}
_MOST_DIFF = 60


def _value(value: Any) -> str:
    if value is None or value == "":
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else printable(str(value))


def _result(name: str, value: Any, metric: str) -> str:
    if value is None:
        return "-"
    if name == "elapsed_s":
        return _duration(value)
    if name == "best_score":
        return score_text(metric, value)
    units = {"hours": "{:.2f} h", "usd": "{:.2f} USD", "lap_s": "{:.2f} s", "progress": "{:.1f} %"}
    for end, form in units.items():
        if name.endswith(end):
            return form.format(value)
    return f"{value:,}" if isinstance(value, int) else _value(value)


def _when(moment: str) -> str:
    return moment[:16].replace("T", " ")


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"


def _start(start: RecordedStart) -> str:
    machine, version = start.machine, start.versions.get("drcli")
    cores = f"{machine['cores']} cores" if machine.get("cores") else ""
    words = (start.host, machine.get("processor"), cores, f"drcli {version}" if version else "")
    where = ", ".join(str(word) for word in words if word) or "an unknown machine"
    begins = f"resumes {start.resumes}" if start.resumes else "begins"
    end = f"{start.state}: {start.message}" if start.message else start.state
    began = utc_minute(start.started_at) if start.started_at else "?"
    return printable(f"{began} {begins} on {where}; {end}")


@dataclass(frozen=True)
class Difference:
    """A value of two trainings."""

    name: Annotated[str, "What it is."]
    before: Annotated[Any, "Its value in the first training; None if it is not there."]
    after: Annotated[Any, "Its value in the second."]

    def line(self) -> tuple[str, ...]:
        return dim(f"{self.name} "), f"{_value(self.before)} -> {_value(self.after)}"


@dataclass(frozen=True)
class FileDifference:
    """A file of a training that differs."""

    name: Annotated[str, "Of the file."]
    diff: Annotated[list[str], "Lines of a unified diff; empty if a text was not kept."] = field(
        default_factory=list
    )

    def view(self) -> View:
        styles = {"+": "green", "-": "red", "@": "cyan"}
        lines = [
            Styled(printable(line), styles.get(line[:1], "")) for line in self.diff[:_MOST_DIFF]
        ]
        more = len(self.diff) - _MOST_DIFF
        lines += [dim(f"and {more:,} more lines; --json has them")] if more > 0 else []
        return bold(self.name), lines or ["It differs; a text was not kept."]


@dataclass(frozen=True)
class TrainingComparison:
    """Two trainings side by side."""

    before: Annotated[TrainingEntry, "The first."]
    after: Annotated[TrainingEntry, "The second."]
    results: Annotated[list[Difference], "What they came to, equal values included."]
    settings: Annotated[list[Difference], "Settings that differ, with the values of defaults."]
    worker_settings: Annotated[
        list[Difference], "The same for files of other workers, such as `worker-2.env DR_...`."
    ]
    hyperparameters: Annotated[list[Difference], "Those that differ."]
    model: Annotated[list[Difference], "Differences of algorithm, actions, network and sensors."]
    start: Annotated[list[Difference], "Differences of the weights that they began with."]
    versions: Annotated[list[Difference], "Of Python and packages."]
    machine: Annotated[list[Difference], "Processor, cores and others."]
    files: Annotated[list[FileDifference], "Files that differ, except hyperparameters.json."]

    def result_rows(self) -> list[tuple[str, str, str]]:
        """What it is, and both values, as texts."""
        return [
            (
                _RESULT_NAMES.get(each.name, each.name.replace("_", " ")),
                _result(each.name, each.before, self.before.metric),
                _result(each.name, each.after, self.after.metric),
            )
            for each in self.results
        ]

    def sections(self) -> dict[str, list[Difference]]:
        """By their headings."""
        return {
            "Settings": self.settings,
            "Settings of other workers": self.worker_settings,
            "Hyperparameters": self.hyperparameters,
            "Model": self.model,
            "Weights and seed": self.start,
            "Versions": self.versions,
            "Machine": self.machine,
        }

    def view(self) -> View:
        both = (self.before, self.after)
        titles = ["", *(f"{printable(each.model)} {each.id}" for each in both)]
        sections = self.sections()
        yield Rows(titles, self.result_rows(), left=titles)
        for title, changed in sections.items():
            yield changed and bold(title)
            yield [each.line() for each in changed]
        for file in self.files:
            yield from file.view()
        if not (self.files or any(sections.values())):
            yield "Settings, hyperparameters, files, versions and machine are equal."


@dataclass(frozen=True)
class Compared:
    record: TrainingRecord
    entry: TrainingEntry
    texts: Mapping[str, str | None]


def compare(one: Compared, other: Compared) -> TrainingComparison:
    a, b = one.record, other.record
    return TrainingComparison(
        one.entry,
        other.entry,
        [
            Difference(name, getattr(one.entry, name), getattr(other.entry, name))
            for name in _RESULTS
        ],
        setting_differences(a, b),
        differences(_by_worker(a), _by_worker(b)),
        differences(a.hyperparameters, b.hyperparameters),
        differences(_model_of(a), _model_of(b)),
        differences(_weights_of(a), _weights_of(b)),
        differences(_versions_of(a), _versions_of(b)),
        differences(a.newest.machine, b.newest.machine),
        _files(one, other),
    )


def setting_differences(a: TrainingRecord, b: TrainingRecord) -> list[Difference]:
    """None if those of one are unknown."""
    if a.newest.settings is None or b.newest.settings is None:
        return []
    found = differences(settings_of(a), settings_of(b))
    return [each for each in found if each.name not in NOT_COMPARED]


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[Difference]:
    names = sorted({*before, *after})
    return [
        Difference(name, before.get(name), after.get(name))
        for name in names
        if before.get(name) != after.get(name)
    ]


def changed_files(a: TrainingRecord, b: TrainingRecord) -> list[str]:
    one, other = a.newest.files, b.newest.files
    return [name for name in one if name in other and one[name] != other[name]]


def _by_worker(record: TrainingRecord) -> dict[str, Any]:
    return {
        f"worker-{number}.env {name}": value
        for number, settings in enumerate(record.newest.worker_settings, start=2)
        for name, value in settings.items()
    }


def _model_of(record: TrainingRecord) -> dict[str, Any]:
    return {
        "algorithm": record.algorithm,
        "action_space": record.action_space,
        "network": record.network,
        "sensors": ", ".join(record.sensors),
        "stages": record.stages,
    }


def _weights_of(record: TrainingRecord) -> dict[str, Any]:
    parent = record.parent
    return {
        "pretrained model": None if parent is None else parent.prefix,
        "pretrained checkpoint": None if parent is None else parent.name,
        "seed": record.newest.seed,
    }


def _versions_of(record: TrainingRecord) -> dict[str, Any]:
    git = {
        f"git {name.replace('_', ' ')}": f"{state.commit[:12]}{' + changes' if state.dirty else ''}"
        for name, state in record.newest.git.items()
        if state is not None
    }
    return {**record.newest.versions, **git}


def _files(one: Compared, other: Compared) -> list[FileDifference]:
    found = []
    for name in sorted({*one.record.newest.files, *other.record.newest.files}):
        same = one.record.newest.files.get(name) == other.record.newest.files.get(name)
        if same or name == keys.HYPERPARAMETERS_FILE:
            continue
        a, b = one.texts.get(name), other.texts.get(name)
        lines: list[str] = []
        if a is not None and b is not None:
            titles = f"{one.entry.model} {name}", f"{other.entry.model} {name}"
            lines = list(
                difflib.unified_diff(
                    a.splitlines(), b.splitlines(), *titles, lineterm="", n=_CONTEXT
                )
            )
        found.append(FileDifference(name, lines))
    return found


@dataclass(frozen=True)
class TrainingDetails:
    """One training."""

    training: Annotated[TrainingEntry, "In short."]
    record: Annotated[TrainingRecord, "Everything that was recorded."]
    files: Annotated[list[str], "Names of its files whose texts were kept."] = field(
        default_factory=list
    )
    saved: Annotated[list[str], "Files on this machine that they were written to."] = field(
        default_factory=list
    )
    damaged: Annotated[
        list[str], "A sentence for each record of the bucket that cannot be read."
    ] = field(default_factory=list)

    def view(self) -> View:
        each, record = self.training, self.record
        where = "" if each.exists else ", its model is gone"
        state = Styled(f" ({each.state}{where})", STATE_STYLES.get(each.state, ""))
        yield (bold(f"Training {each.id} of {printable(each.model)}"), state)
        derived = "Nobody wrote a record; this was worked out from the model."
        yield each.derived and dim(derived)
        learned = ", ".join(
            counted(number, word)
            for number, word in (
                (each.iterations, "iteration"),
                (each.episodes, "episode"),
                (each.steps, "step"),
            )
        )
        trials = f"{counted(record.results.evaluations, 'evaluation')} with "
        trials += counted(record.results.trials, "trial")
        pairs = {
            "description": printable(each.description),
            "began": _when(each.began_at),
            "ended": " ".join(filter(None, (_when(each.ended_at), each.message))),
            "track": " ".join(filter(None, (printable(each.world), each.race_type))),
            "model": ", ".join(filter(None, (each.algorithm, each.action_space, record.network))),
            "sensors": ", ".join(record.sensors),
            "began with": self._weights(),
            "learned": f"{learned} in {_duration(each.elapsed_s)}",
            "best": self._best(),
            "fastest clean lap": self._laps(),
            "evaluations": trials if record.results.evaluations else "",
            "machine hours": "" if each.hours is None else f"{each.hours:.2f} h",
            "cost": "" if each.usd is None else f"{each.usd:.2f} USD",
        }
        yield [pairs]
        workers = enumerate(record.newest.worker_settings, start=2)
        groups = {"Settings that differ from their defaults": record.newest.settings}
        groups |= {f"worker-{number}.env": own for number, own in workers}
        for title, changed in groups.items():
            yield changed and bold(title)
            yield [{name: _value(changed[name]) for name in sorted(changed)}] if changed else ""
        values = sorted(record.hyperparameters.items())
        yield values and bold("Hyperparameters")
        yield [", ".join(f"{name} {_value(value)}" for name, value in values)]
        yield record.starts and bold(counted(each.starts, "start"))
        yield [_start(start) for start in record.starts]
        yield self.files and f"Files: {', '.join(self.files)} (--save FOLDER writes them)."
        yield from (f"Wrote {path}" for path in self.saved)

    def _weights(self) -> str:
        each = self.training
        if not each.parent:
            return "fresh weights"
        made = f" (training {each.parent_training})" if each.parent_training else ""
        return f"{printable(each.parent)}, {each.parent_checkpoint}{made}"

    def _best(self) -> str:
        each = self.training
        score = score_text(self.record.metric, each.best_score) if each.best_checkpoint else ""
        return ", ".join(filter(None, (each.best_checkpoint, score)))

    def _laps(self) -> str:
        results, world = self.record.results, self.record.world
        trials = dict(results.clean_trial_lap_s or {})
        known = (
            ("in evaluations of the training", results.best_lap_s),
            ("in stand-alone evaluations", trials.pop(world, None)),
            ("in training episodes", results.best_training_lap_s),
            *(
                (f"on {printable(name) or 'an unknown track'}", trials[name])
                for name in sorted(trials)
            ),
        )
        return ", ".join(f"{lap:.3f} s {where}" for where, lap in known if lap is not None)


@dataclass(frozen=True)
class ForgottenTrainings:
    """The result of `dr-history forget`."""

    bucket: Annotated[str, "Its name."]
    trainings: Annotated[list[TrainingEntry], "Those whose records were deleted."]
    dry_run: Annotated[bool, "Whether nothing was deleted."]

    def view(self) -> View:
        began = Col("began", of=lambda each: _when(each.began_at), side="left")
        return [bold(f"s3://{self.bucket}"), table(self.trainings, "id", "model", began, "state")]


def details_of(
    bucket: Bucket,
    known: KnownTrainings,
    name: str,
    *,
    save: Path | None = None,
    force: bool = False,
) -> TrainingDetails:
    """Everything about a training; its files are written to `save`.

    Raises:
        SettingsError: There is none, or a file exists without `force`.
    """
    record = known.find(name)
    texts = {file: text for file, text in texts_of(bucket, record).items() if text is not None}
    saved = [] if save is None else _saved(save, texts, name, force=force)
    entry = entry_of(record, exists=record.id in known.existing)
    return TrainingDetails(entry, record, sorted(texts), saved, list(known.damaged))


def compared(bucket: Bucket, known: KnownTrainings, name: str) -> Compared:
    """Raises SettingsError if there is no such training."""
    record = known.find(name)
    entry = entry_of(record, exists=record.id in known.existing)
    return Compared(record, entry, texts_of(bucket, record))


def plan_forgetting(known: KnownTrainings, names: Sequence[str]) -> list[TrainingRecord]:
    """SettingsError if one is missing, running, or without record."""
    found: dict[str, TrainingRecord] = {}
    for name in names:
        record = known.find(name)
        if record.state == "running":
            raise SettingsError(
                f"The training {record.id} of {record.prefix} is running.",
                remedy="Forget it when it has ended, or stop it with `dr-stop-training`.",
            )
        if record.derived:
            raise SettingsError(
                f"The training {record.id} of {record.prefix} has no record; what is known about "
                "it is in the model.",
                remedy=f"Delete the model with `dr-delete-model {record.prefix} --forget`.",
            )
        found[record.id] = record
    return list(found.values())


def forget(bucket: Bucket, records: Sequence[TrainingRecord]) -> None:
    """SettingsError if somebody has begun to train."""
    for record in records:
        if record.gone_at is None:
            lease.refuse_other_owner(ModelStore(bucket, record.prefix))
        forget_training(ModelStore(bucket, record.prefix), record.id)


def _saved(folder: Path, texts: dict[str, str], name: str, *, force: bool) -> list[str]:
    if not texts:
        raise SettingsError(
            f"The files of the training {name} were not kept.",
            remedy=f"Look for {keys.REWARD_FUNCTION_FILE} in copies of the model.",
        )
    for file in texts:
        refuse_existing(folder / file, force=force)
    try:
        make_folder(folder)
        for file, text in texts.items():
            rewrite(folder / file, text.encode())
    except OSError as error:
        raise SettingsError(
            f"{folder}: the files cannot be written there ({error.strerror or error}).",
            remedy="Name another folder with --save.",
        ) from error
    return [str(folder / file) for file in texts]
