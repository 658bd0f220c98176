"""What a model has, whatever is damaged; reads and computes, writes nothing.

Weights with their records, the learning curve, evaluations and traces are the truth. Pointer,
scores, milestones and metrics are worked out from them, and so is what the curve has lost.
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TypeVar

from drcli.base.installation import lazy_imports
from drcli.base.json_record import Fingerprint, decode_json
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.model import keys
from drcli.model.best_checkpoint import (
    evaluated_numbers,
    read_evaluation,
    read_scores,
    score_of,
    with_evaluation,
)
from drcli.model.checkpoints import KEEP, CheckpointStore
from drcli.model.growing_file import combined_history, list_parts
from drcli.model.history import HistoryReader
from drcli.model.history import with_evaluation as evaluated_record
from drcli.model.milestones import (
    NO_MILESTONES,
    Milestone,
    Milestones,
    read_milestones,
    with_history,
    with_results,
)
from drcli.model.model_prefix import ModelListing
from drcli.model.model_store import ModelStore
from drcli.model.training_state import read_rollbacks
from drcli.records.checkpoint import CheckpointName, CheckpointRecord, Counters
from drcli.records.episode_metrics import EpisodeMetrics
from drcli.records.iteration import EVALUATION_FIELDS, IterationRecord, decode_iteration
from drcli.records.scores import EvaluationResult, Score, Scores
from drcli.records.trace import read_csv

with lazy_imports():
    import safetensors

K = TypeVar("K")
T = TypeVar("T")


def readable_history(
    model: ModelStore, reader: HistoryReader | None = None
) -> tuple[list[IterationRecord], list[str]]:
    """Like the next two, for readers that never write; and a sentence on damage."""
    reader = reader or HistoryReader()
    return _or_rebuilt(partial(reader.read, model), partial(reconstruct_history, model))


def readable_scores(model: ModelStore) -> tuple[Scores | None, list[str]]:
    return _or_rebuilt(
        partial(read_scores, model), partial(reconstruct_scores, model, model.metric)
    )


def readable_milestones(
    model: ModelStore, records: Iterable[IterationRecord]
) -> tuple[Milestones, list[str]]:
    """Filled in from the learning curve."""
    known, damaged = _or_rebuilt(partial(read_milestones, model), lambda: NO_MILESTONES)
    return with_history(known or NO_MILESTONES, records), damaged


def _or_rebuilt(read: Callable[[], T], rebuild: Callable[[], T]) -> tuple[T, list[str]]:
    try:
        return read(), []
    except ObjectDamaged as error:
        return rebuild(), [f"{error} {error.remedy}"]


def _readable(read: Callable[[K], T], items: Iterable[K]) -> dict[K, T]:
    found = {}
    for item in items:
        with suppress(ObjectMissing, ObjectDamaged):
            found[item] = read(item)
    return found


def readable_records(model: ModelStore) -> list[CheckpointRecord]:
    names = map(str, ModelListing(model).whole)
    return list(_readable(CheckpointStore(model).record, names).values())


def readable_evaluations(model: ModelStore) -> dict[int, EvaluationResult]:
    return _readable(partial(read_evaluation, model), evaluated_numbers(model))


def _whole_records(
    model: ModelStore, keys_: Iterable[str], read: Callable[[bytes], T]
) -> list[list[T]]:
    """What can be read of each object, however damaged the rest is."""
    decoder = json.JSONDecoder()
    found: list[list[T]] = []
    for data in _readable(model.bucket.get, keys_).values():
        text = data.decode("utf-8", "replace")
        records: list[T] = []
        begin = text.find("{")
        while begin >= 0:
            try:
                _, end = decoder.raw_decode(text, begin)
                records.append(read(text[begin:end].encode()))
            except (ValueError, RecursionError):  # RecordError is a ValueError
                end = begin + 1
            begin = text.find("{", end)
        found.append(records)
    return found


def _with_parts(model: ModelStore, key: str) -> list[str]:
    return [key, *list_parts(model.bucket, key)]


def reconstruct_history(model: ModelStore) -> list[IterationRecord]:
    """From records, its own objects and traces."""
    records = readable_records(model)
    objects = _with_parts(model, keys.history(model.prefix))
    parts = _whole_records(model, objects, decode_iteration)
    known = {record.iteration: record for record in combined_history([], parts)}
    learned = [r.counters.learned for r in records if r.counters.learned is not None]
    stated = known | {record.iteration: record for record in learned}
    known |= {r.iteration: r for r in _traced_history(model, stated)}
    for record in learned:
        before = known.get(record.iteration, record)
        evaluated = {name: getattr(before, name) for name in EVALUATION_FIELDS}
        known[record.iteration] = replace(record, **evaluated)
    for number, result in readable_evaluations(model).items():
        if number in known:
            known[number] = evaluated_record(known[number], result)
    newest = max((r.number for r in records), default=None)
    return [known[n] for n in sorted(known) if newest is None or n < newest]


def reconstruct_record(
    model: ModelStore, name: CheckpointName, history: Iterable[IterationRecord]
) -> CheckpointRecord | None:
    """From the weights and known iterations.

    None if weights are damaged or episodes unknown: an older checkpoint is used.
    """
    past = [r for r in history if r.iteration < name.number]
    if len(past) != name.number:
        return None
    tensors = _safetensors(model, keys.checkpoint_tensors(model.prefix, str(name)))
    optimizer = _safetensors(model, keys.checkpoint_optimizer(model.prefix, str(name)))
    if tensors is None:
        return None
    last = past[-1] if past else None
    rollbacks, _ = _or_rebuilt(lambda: read_rollbacks(model).count, lambda: 0)
    return CheckpointRecord(
        str(name),
        tensors,
        optimizer,
        counters=Counters(
            episodes=sum(r.episodes for r in past),
            elapsed_s=0.0 if last is None else last.elapsed_s,
            learned=last,
            rollbacks=rollbacks or None,
        ),
    )


def _safetensors(model: ModelStore, key: str) -> Fingerprint | None:
    """None if missing or damaged."""
    # The type is ignored because safetensors has no type for it.
    with suppress(ObjectMissing, safetensors.SafetensorError, ValueError):
        data = model.bucket.get(key)
        if safetensors.deserialize(data):  # type: ignore[no-untyped-call]
            return Fingerprint.of(data)
    return None


def reconstruct_scores(model: ModelStore, metric: str) -> Scores | None:
    """Newest and best by DR_TRAIN_BEST_MODEL_METRIC, or None.

    Without laps of an earlier stage or track.
    """
    by_name = {r.name: r for r in readable_records(model)}
    if not by_name:
        return None
    records = list(by_name.values())
    newest = by_name.get(str(CheckpointStore(model).pointed()), records[-1])
    last = Score(newest.name, None, newest.sim_time_s)
    scores = Scores(Score(records[0].name, None, records[0].sim_time_s), last)
    driven = {each.iteration: each for each in reconstruct_history(model)}
    for number, result in readable_evaluations(model).items():
        record = by_name.get(result.checkpoint)
        compares = number not in driven or driven[number].compares_with(driven[max(driven)])
        if record is not None and compares:
            episodes = result.on("training")
            score = score_of(result.checkpoint, episodes, metric, record.sim_time_s)
            scores = with_evaluation(scores, score, metric)
    if scores.best_checkpoint.avg_eval_metric is None:
        return Scores(last, last)
    return scores


def reconstruct_milestones(model: ModelStore) -> Milestones:
    """From learning curve, evaluations and the record's rest.

    All checkpoints stay: every n-th are unknown.
    """
    names = map(str, ModelListing(model).whole[:-KEEP])
    scores = reconstruct_scores(model, "progress")
    best = None if scores is None else scores.best_checkpoint.name
    known = replace(NO_MILESTONES, spaced=[name for name in names if name != best])
    known = with_history(known, reconstruct_history(model))
    known = with_results(known, readable_evaluations(model).values())
    key = keys.milestones(model.prefix)
    for found in _whole_records(model, [key], partial(decode_json, Milestone)):
        for each in found:
            known = known.with_evaluation(
                each.checkpoint,
                [each.progress] * max(1, each.episodes),
                [each.best_lap_s] * each.laps,
            )
    return known


def reconstruct_metrics(model: ModelStore, worker: int) -> list[EpisodeMetrics]:
    """From its own objects and traces."""
    objects = _with_parts(model, keys.training_metrics(model.metrics_prefix, worker))
    found = [r for part in _whole_records(model, objects, EpisodeMetrics.decode) for r in part]
    # The whole file and a part may both have an episode.
    own = {(r.iteration, r.phase, r.trial, r.episode, r.metric_time): r for r in found}
    kept = list(own.values())
    training = [r for r in kept if r.phase == "training"]
    known = {(r.iteration, r.trial) for r in training if r.iteration is not None}
    numbers = {r.episode for r in training if r.iteration is None}  # of version 0.1.0
    most = max((r.trial for r in training), default=0)
    counts = Counter(iteration for iteration, _ in known)
    for iteration, of_iteration in ModelListing(model).traces.items():
        if worker not in of_iteration or (most and counts[iteration] == most):
            continue  # a trace of a known iteration need not be read
        traced = read_csv(model.bucket.get(of_iteration[worker]))
        kept += [
            EpisodeMetrics.of(episode, iteration=iteration, episode=episode.number + 1, trial=trial)
            for trial, episode in enumerate(traced, start=1)
            if (iteration, trial) not in known and episode.number + 1 not in numbers
        ]
    return sorted(kept, key=lambda r: (r.metric_time, r.phase != "training"))


def _traced_history(
    model: ModelStore, known: Mapping[int, IterationRecord]
) -> list[IterationRecord]:
    found: list[IterationRecord] = []
    traced = ModelListing(model).traces
    total: int | None = 0
    elapsed_s, began_s = 0.0, math.nan
    for iteration in range(max([*traced, *known], default=-1) + 1):
        if iteration in known:
            total, elapsed_s = known[iteration].total_steps, known[iteration].elapsed_s
            began_s = math.nan
            continue
        of_worker = traced.get(iteration, {})
        wanted = of_worker.values() if total is not None else ()
        driven = [e for key in wanted for e in read_csv(model.bucket.get(key))]
        episodes = [e for e in driven if e.status != "discarded"]  # nobody learned from the others
        if total is None or not episodes:
            total = None  # it is unknown after a gap, until the next known iteration
            continue
        begin_s = min(e.wall_s[0] for e in episodes)
        end_s = max(e.wall_s[1] for e in episodes)
        began_s = begin_s - elapsed_s if math.isnan(began_s) else min(began_s, begin_s)
        checkpoint = str(CheckpointName(iteration, total))
        steps = sum(e.steps for e in episodes)
        total += steps
        laps = [e.duration_s for e in episodes if e.status == "lap_complete"]
        record = IterationRecord(
            iteration=iteration,
            checkpoint=checkpoint,
            episodes=len(episodes),
            steps=steps,
            total_steps=total,
            mean_reward=sum(e.reward for e in episodes) / len(episodes),
            mean_progress=sum(e.progress for e in episodes) / len(episodes),
            full_laps=len(laps),
            best_lap_s=min(laps, default=None),
            drive_s=end_s - begin_s,
            elapsed_s=end_s - began_s,
            discarded=len(driven) - len(episodes),
        )
        found.append(record)
    return found
