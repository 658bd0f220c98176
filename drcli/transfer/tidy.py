"""Deletes what is left over in the bucket and here."""

import json
import re
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Annotated, Literal, get_args

from drcli.base.errors import SettingsError
from drcli.base.report import Col, View, bold, counted, size_text, table
from drcli.bucket.bucket import ObjectInfo, ObjectMissing
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.settings import Settings
from drcli.learn.algorithms import algorithm_named
from drcli.model import keys
from drcli.model.checkpoint_choice import ModelCheckpoints
from drcli.model.checkpoints import CheckpointStore
from drcli.model.milestones import KINDS
from drcli.model.model_list import fits
from drcli.model.model_prefix import kind_of
from drcli.model.model_store import ModelStore
from drcli.model.traces import models_in
from drcli.records.checkpoint import CheckpointName
from drcli.transfer.model_removal import (
    all_traces,
    local_files,
    logged_models,
    refuse_busy,
    remove_traces,
)

TidyKind = Literal["remains", "damaged", "rollouts", "traces", "checkpoints", "logs"]
KINDS_OF_TIDY: tuple[TidyKind, ...] = get_args(TidyKind)

USUAL: tuple[TidyKind, ...] = ("remains", "damaged", "rollouts")
"""What nobody misses."""

RECENT_S = 3600.0
"""Newer remains may belong to a copy that is going on."""

_TRACE = re.compile(r"(?:\d+/)?training-simtrace/\d+-iteration\.csv")

_RULE = re.compile(r"last(?:-[1-9]\d{0,6})?|best|every-[1-9]\d{0,6}|milestones|" + "|".join(KINDS))


_WHAT = {
    "remains": "remains of a model",
    "damaged": "damaged objects",
    "rollouts": "recorded episodes",
    "traces": "traces",
    "checkpoints": "checkpoints",
    "logs": "local logs",
}


@dataclass(frozen=True)
class TidyItem:
    """Something of one kind that one model has."""

    kind: Annotated[
        TidyKind,
        "remains, damaged, rollouts, traces, checkpoints or logs.",
        Col("what", lambda kind: _WHAT[kind]),
    ]
    model: Annotated[str, "Prefix of the model.", Col("model")]
    objects: Annotated[int, "How many objects or files.", Col("objects")]
    size_bytes: Annotated[int, "Their size.", Col("size", size_text)]
    names: Annotated[list[str], "Their keys or paths."]


@dataclass(frozen=True)
class TidyReport:
    """The result of `dr-tidy`."""

    bucket: Annotated[str, "Name of the bucket."]
    items: Annotated[list[TidyItem], "What was deleted."]
    busy: Annotated[
        list[str], "Models that were left alone because they are being trained or evaluated."
    ]
    dry_run: Annotated[bool, "Whether nothing was deleted."]
    size_bytes: Annotated[int, "Of everything."]

    def view(self, *, planned: bool) -> View:
        size = size_text(self.size_bytes)
        busy = f"Left alone, because they are in use: {', '.join(self.busy)}."
        if not self.items:
            yield f"Nothing is left over in s3://{self.bucket}."
        elif planned:
            order = ("model", "kind", "objects", "size_bytes")
            yield from (bold(f"s3://{self.bucket}"), table(self.items, *order), f"Together {size}.")
        else:
            yield f"Deleted {counted(sum(item.objects for item in self.items), 'object')}, {size}."
        yield self.busy and busy


@dataclass(frozen=True)
class TidyOptions:
    """`checkpoints`: rules for what stays, such as `last-2,best,first-lap`."""

    models: Sequence[str] = ()
    keep: Sequence[str] = ()
    kinds: Sequence[TidyKind] = USUAL
    checkpoints: str = ""
    older_than_s: float = 0.0
    dry_run: bool = False


def read_kinds(text: str | None, checkpoints: str) -> tuple[TidyKind, ...]:
    found = list(USUAL) if text is None and not checkpoints else []
    for word in filter(None, re.split(r"[,\s]+", text or "")):
        kind = next((each for each in KINDS_OF_TIDY if each == word.casefold()), None)
        if kind is None:
            raise SettingsError(
                f"--only {word} is nothing that can be left over.",
                remedy=f"Write some of {', '.join(KINDS_OF_TIDY)}, separated by commas.",
            )
        found.append(kind)
    if checkpoints:
        found.append("checkpoints")
    elif "checkpoints" in found:
        raise SettingsError(
            "--only checkpoints does not say which checkpoints stay.",
            remedy="Say so with --checkpoints, as in --checkpoints last-2,best,milestones.",
        )
    return tuple(dict.fromkeys(found))


def checked_rules(text: str) -> tuple[str, ...]:
    rules = tuple(word.casefold() for word in re.split(r"[,\s]+", text) if word)
    for rule in rules:
        if not _RULE.fullmatch(rule):
            raise SettingsError(
                f"--checkpoints {rule} is not a rule for what stays.",
                remedy="Write some of last, last-N, best, every-N, milestones, "
                f"{', '.join(KINDS)}, separated by commas.",
            )
    return rules


def find_surplus(settings: Settings, options: TidyOptions) -> TidyReport:
    """SettingsError for a wrong rule."""
    rules = checked_rules(options.checkpoints)
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    everything = bucket.list("")
    known = models_in(everything)
    here = logged_models(settings) if "logs" in options.kinds else set()
    wanted = [
        prefix
        for prefix in sorted({*known, *_run_prefixes(everything), *here})
        if (not options.models or any(fits(prefix, each) for each in options.models))
        and not any(fits(prefix, each) for each in options.keep)
    ]
    items: list[TidyItem] = []
    busy = []
    for prefix in wanted:
        if _is_busy(settings, ModelStore(bucket, prefix)):
            busy.append(prefix)
            continue
        for kind in options.kinds:
            found = _of_kind(
                settings, ModelStore(bucket, prefix), kind, rules, whole=known.get(prefix, False)
            )
            kept = [info for info in found if time.time() - info[2] > options.older_than_s]
            if kept and (kind != "remains" or len(kept) == len(found)):
                size = sum(info[1] for info in kept)
                items.append(TidyItem(kind, prefix, len(kept), size, [info[0] for info in kept]))
    size = sum(item.size_bytes for item in items)
    return TidyReport(bucket.name, items, busy, options.dry_run, size)


def tidy(report: TidyReport, settings: Settings) -> TidyReport:
    """Leaves alone what is being trained."""
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    done, busy = [], list(report.busy)
    for prefix, of_model in groupby(report.items, key=lambda item: item.model):
        if _is_busy(settings, ModelStore(bucket, prefix)):
            busy.append(prefix)
            continue
        for item in of_model:
            if item.kind == "remains":
                remove_traces(settings, bucket, all_traces(settings, ModelStore(bucket, prefix)))
            elif item.kind == "logs":
                for name in item.names:
                    Path(name).unlink(missing_ok=True)
            else:
                bucket.delete(item.names)
            done.append(item)
    size = sum(item.size_bytes for item in done)
    return TidyReport(report.bucket, done, busy, report.dry_run, size)


_Found = tuple[str, int, float]


def _of_kind(
    settings: Settings,
    model: ModelStore,
    kind: TidyKind,
    rules: tuple[str, ...],
    *,
    whole: bool,
) -> list[_Found]:
    if kind == "logs":
        return _orphaned_logs(settings, model.prefix) if not whole else []
    if not whole:
        if kind != "remains":
            return []
        objects = all_traces(settings, model).objects
        newest = max((info.modified.timestamp() for info in objects), default=0.0)
        recent = time.time() - newest < RECENT_S
        if recent or _is_of_another_system(model.prefix, [info.key for info in objects]):
            return []
        return [_found(info) for info in objects]
    if kind == "damaged":
        folder = keys.damaged_folder(model.prefix)
        own = all_traces(settings, model).objects  # `a/damaged` may be a model, too
        return [_found(info) for info in own if info.key.startswith(folder)]
    if kind == "rollouts":
        return list(_rollouts(model))
    if kind == "traces":
        start = keys.folder(model.prefix)
        own = all_traces(settings, model).objects  # and `a/1`, not only a worker of `a`
        return [_found(i) for i in own if _TRACE.fullmatch(i.key.removeprefix(start))]
    return _checkpoints(settings, model, rules) if kind == "checkpoints" else []


def _is_of_another_system(prefix: str, listed: Sequence[str]) -> bool:
    """Objects without a pointer may be all there is of a TensorFlow model."""
    folder = keys.folder(prefix)
    kind = kind_of([key.removeprefix(folder) for key in listed if key.startswith(folder)])
    ours = (keys.run_folder(prefix), keys.rollouts_folder(prefix), keys.training_start(prefix))
    begun_here = kind == "drcli" or any(key.startswith(ours) for key in listed)
    return kind == "tensorflow" or not begun_here


def _found(info: ObjectInfo) -> _Found:
    return info.key, info.size_bytes, info.modified.timestamp()


def _rollouts(model: ModelStore) -> Iterator[_Found]:
    """What has a replay buffer still needs its own to go on."""
    try:
        metadata = json.loads(model.bucket.get(keys.model_metadata(model.prefix)))
    except (ObjectMissing, ValueError):
        return
    name = metadata.get("training_algorithm") if isinstance(metadata, dict) else None
    if not isinstance(metadata, dict) or algorithm_named(name).replay:
        return
    for info in model.bucket.list(keys.rollouts_folder(model.prefix)):
        if keys.rollout_key(model.prefix, info.key) is not None:
            yield _found(info)


def _checkpoints(settings: Settings, model: ModelStore, rules: tuple[str, ...]) -> list[_Found]:
    """What the pointers name always stays."""
    checkpoints = ModelCheckpoints.read(ModelStore.of(settings.model, model.bucket, model.prefix))
    if checkpoints.scores is None:
        return []
    names = list(checkpoints.names)
    scored = (checkpoints.scores.best_checkpoint, checkpoints.scores.last_checkpoint)
    stay: set[CheckpointName | None] = {CheckpointName.parse(each.name) for each in scored}
    # A training that is killed between its two pointers leaves an index without the newest one.
    stay.add(CheckpointStore(model).pointed())
    for rule in rules:
        kind, _, number = rule.partition("-")
        if kind == "last":
            stay |= set(names[-int(number or 1) :])
        elif kind == "every":
            stay |= {name for name in names if name.number and name.number % int(number) == 0}
        else:
            reached = checkpoints.milestones.reached()
            stay |= {each.name for word, each in reached if rule in ("milestones", word)}
    gone = [name for name in names if name not in stay]
    numbers = {name.number for name in gone} - {name.number for name in names if name in stay}
    graphs = {keys.checkpoint_graph(model.prefix, number): number for number in numbers}
    doomed: list[tuple[int, ObjectInfo]] = []
    for info in checkpoints.listed:
        name = keys.checkpoint_of(model.prefix, info.key)
        if name is not None and name in gone:
            doomed.append((name.number, info))
        elif info.key in graphs:
            doomed.append((graphs[info.key], info))
    # A repair may have written one file of a checkpoint again: it goes whole, or stays whole.
    newest: dict[int, float] = {}
    for of, info in doomed:
        newest[of] = max(newest.get(of, 0.0), info.modified.timestamp())
    return [(info.key, info.size_bytes, newest[of]) for of, info in doomed]


def _orphaned_logs(settings: Settings, prefix: str) -> list[_Found]:
    files = [Path(name) for name in local_files(settings, settings.bucket, prefix)]
    logs = settings.directory / "data" / "logs"
    own = [(path, path.lstat()) for path in files if path.is_relative_to(logs)]
    return [(str(path), stat.st_size, stat.st_mtime) for path, stat in own]


def _run_prefixes(listed: Iterable[ObjectInfo]) -> set[str]:
    found = set()
    for info in listed:
        run = re.fullmatch(
            r"runs/(.+)/(?:lease|outcome)\.json|runs/(.+)/(?:status|damaged|evaluations|spending)/.+",
            info.key,
        )
        rollout = re.fullmatch(r"rollouts/(.+)/\d+/\d+/[^/]+", info.key)
        if run is not None:
            found.add(run[1] or run[2])
        elif rollout is not None:
            found.add(rollout[1])
    return found


def _is_busy(settings: Settings, model: ModelStore) -> bool:
    try:
        refuse_busy(settings, model)
    except SettingsError:
        return True
    return False
