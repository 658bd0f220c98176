"""Lists the models in a bucket with their checkpoints."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Annotated

from drcli.base.report import Col, Styled, View, abridged, bold, size_text, table
from drcli.bucket.bucket import Bucket, ObjectInfo
from drcli.model import keys, lease, race_keys
from drcli.model.model_prefix import Kind, kind_of
from drcli.model.model_store import ModelStore
from drcli.model.notes import headline
from drcli.model.reconstruct import readable_scores
from drcli.model.run_metadata import metric_of
from drcli.records.iteration import Laps
from drcli.records.scores import Score

_MARKS = ("/model/deepracer_checkpoints.json", "/model/.coach_checkpoint")


@dataclass(frozen=True)
class CheckpointEntry:
    """A checkpoint in the list."""

    name: Annotated[str, "Such as `12_Step-7824.ckpt`."]
    metric: Annotated[
        float | None, "Mean score of its evaluation episodes; None before the first evaluation."
    ]
    score: Annotated[
        str, "The same with its unit: percent, seconds or reward; empty without one."
    ] = ""
    laps: Annotated[str, "Its evaluation laps in words; empty if unknown."] = ""
    clean: Annotated[int, "How many of them are clean; 0 if unknown."] = 0
    text: Annotated[str, "Its number, its laps, and what these do not tell of its score."] = field(
        init=False
    )

    def __post_init__(self) -> None:
        """Put it into words."""
        text = self.name.partition("_")[0]
        if self.score and not (self.clean and self.score.endswith((" %", " s"))):
            text += f" ({self.score})"
        object.__setattr__(self, "text", f"{text}: {self.laps}" if self.laps else text)

    @staticmethod
    def of(score: Score, metric: str, laps: Laps | None = None) -> "CheckpointEntry":
        """`laps` are those of its training track."""
        value = score.avg_eval_metric
        if laps is None and score.episodes is not None:
            laps = score.episodes.laps
        return CheckpointEntry(
            score.name,
            value,
            score_text(metric, value),
            "" if laps is None else str(laps),
            0 if laps is None else laps.clean,
        )

    def short(self) -> str:
        number = self.name.partition("_")[0]
        told = self.laps.partition(", slowest")[0] if self.clean else self.score
        return f"{number} ({told})" if told else number


def score_text(metric: str, value: float | None) -> str:
    if value is None:
        return ""
    if metric == "laptime":
        return f"{value / 1000.0:.2f} s"
    if metric == "progress":
        return f"{value:.1f} %"
    return f"{metric or 'score'} {value:.4g}"


@dataclass(frozen=True)
class ModelEntry:
    """A model in the list."""

    prefix: Annotated[str, "Its folder.", Col("model", of=lambda model: model.title(), side="left")]
    checkpoints: Annotated[int, "How many checkpoints it has.", Col("ckpts")]
    best: Annotated[
        CheckpointEntry | None,
        "The best of them; None if unknown.",
        Col("best", CheckpointEntry.short),
    ]
    last: Annotated[
        CheckpointEntry | None, "The newest; None if unknown.", Col("last", CheckpointEntry.short)
    ]
    objects: Annotated[int, "How many objects it has, logs and traces included."]
    size_bytes: Annotated[int, "Their size.", Col("size", size_text)]
    modified: Annotated[
        str,
        "When the newest object was written, ISO 8601.",
        Col("modified", lambda text: text[:16].replace("T", " ")),
    ]
    training: Annotated[bool, "Whether it is being trained now."]
    damaged: Annotated[
        list[str],
        "What is wrong with its scores, and what to do about it; `best` and `last` are "
        "reconstructed then.",
    ] = field(default_factory=list)
    note: Annotated[
        str, "Its description, else its newest note; empty without one.", Col("note", abridged)
    ] = ""
    kind: Annotated[
        Kind,
        "drcli for a model of ours, tensorflow for one of DeepRacer-for-Cloud or a "
        "console, upload for the file of a policy, traces for traces or metrics without "
        "a checkpoint, files for anything else.",
    ] = "drcli"

    def title(self) -> tuple[str, ...]:
        kind = " (TensorFlow)" if self.kind == "tensorflow" else ""
        return self.prefix, Styled(" (training)" if self.training else "", "green"), kind


@dataclass(frozen=True)
class ModelList:
    """The models of a bucket."""

    bucket: Annotated[str, "Its name."]
    pattern: Annotated[
        str, "Part of a prefix, or a whole one with `*` and `?`; empty for all models."
    ]
    models: Annotated[list[ModelEntry], "Sorted by prefix."]

    def view(self) -> View:
        matching = f" that matches {self.pattern}" if self.pattern else ""
        none = f"There is no model in s3://{self.bucket}{matching}."
        return [bold(f"s3://{self.bucket}"), table(self.models)] if self.models else [none]


def list_models(bucket: Bucket, pattern: str = "") -> ModelList:
    """`pattern` is part of a prefix, or has `*` and `?`."""
    return ModelListReader().read(bucket, pattern)


class ModelListReader:
    def __init__(self) -> None:
        self._known: dict[str, tuple[Signature, ModelEntry]] = {}

    def read(
        self, bucket: Bucket, pattern: str = "", listed: Iterable[ObjectInfo] | None = None
    ) -> ModelList:
        objects = list(bucket.list("") if listed is None else listed)
        prefixes = {prefix for prefix in _prefixes(objects) if _fits(prefix, pattern)}
        own = _by_model(objects, _prefixes(objects))
        leases = {info.key for info in objects}.intersection(map(keys.lease, prefixes))
        known = {}
        for prefix in sorted(prefixes):
            model, signature = ModelStore(bucket, prefix), signature_of(own[prefix])
            before = self._known.get(prefix)
            unchanged = before is not None and before[0] == signature
            entry = before[1] if before is not None and unchanged else _entry(model, own[prefix])
            training = keys.lease(prefix) in leases and lease.live_holder(model) is not None
            known[prefix] = signature, replace(entry, training=training)
        self._known = known
        return ModelList(bucket.name, pattern, [entry for _, entry in known.values()])


Signature = tuple[int, int, float]


def signature_of(objects: Iterable[ObjectInfo]) -> Signature:
    count, size, newest = 0, 0, 0.0
    for info in objects:
        count += 1
        size += info.size_bytes
        newest = max(newest, info.modified.timestamp())
    return count, size, newest


def model_prefixes(bucket: Bucket) -> set[str]:
    return _prefixes(bucket.list(""))


def fits(prefix: str, pattern: str) -> bool:
    return prefix == pattern or fnmatchcase(prefix, pattern)


def _prefixes(listed: Iterable[ObjectInfo]) -> set[str]:
    copies = race_keys.folder()  # submissions to races: nobody trains them on
    return {
        info.key.removesuffix(mark)
        for info in listed
        for mark in _MARKS
        if info.key.endswith(mark) and not info.key.startswith(copies)
    }


def _by_model(listed: Iterable[ObjectInfo], prefixes: set[str]) -> dict[str, list[ObjectInfo]]:
    """A model inside another keeps its own objects."""
    own: dict[str, list[ObjectInfo]] = {prefix: [] for prefix in prefixes}
    for info in listed:
        folder = info.key
        while "/" in folder:
            folder = folder.rpartition("/")[0]
            if folder in own:
                own[folder].append(info)
                break
    return own


def _fits(prefix: str, pattern: str) -> bool:
    has_wildcards = any(character in pattern for character in "*?[")
    return fnmatchcase(prefix, pattern) if has_wildcards else pattern in prefix


def _entry(model: ModelStore, objects: list[ObjectInfo]) -> ModelEntry:
    names = {keys.checkpoint_of(model.prefix, info.key) for info in objects} - {None}
    scores, damaged = readable_scores(model)
    metric = ""
    if scores is not None and any(
        info.key == keys.training_start(model.prefix) for info in objects
    ):
        metric = metric_of(model)
    return ModelEntry(
        prefix=model.prefix,
        checkpoints=len(names),
        best=None if scores is None else CheckpointEntry.of(scores.best_checkpoint, metric),
        last=None if scores is None else CheckpointEntry.of(scores.last_checkpoint, metric),
        objects=len(objects),
        size_bytes=sum(info.size_bytes for info in objects),
        modified=max(info.modified for info in objects).isoformat(timespec="seconds"),
        training=False,
        damaged=damaged,
        note=headline(model, {info.key: info for info in objects}),
        kind=kind_of([info.key.removeprefix(keys.folder(model.prefix)) for info in objects]),
    )
