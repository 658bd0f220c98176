"""Checkpoints of a model in the bucket, written so that no reader uses an incomplete one.

Tensors, maybe an optimizer state, then a record with sizes, hashes and counters; last the pointer,
from which readers start. Only the trainer writes here.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

from drcli.base.errors import StorageError
from drcli.base.json_record import Fingerprint
from drcli.bucket.bucket import (
    ObjectDamaged,
    ObjectMissing,
    read_record,
    readable_record,
    remedy_of,
)
from drcli.bucket.s3_bucket import S3Bucket
from drcli.model import best_checkpoint, keys
from drcli.model.best_checkpoint import read_scores, write_scores
from drcli.model.milestones import (
    NO_MILESTONES,
    Milestones,
    read_milestones,
    with_history,
    with_results,
    write_milestones,
)
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import (
    CheckpointName,
    CheckpointRecord,
    Counters,
    checkpoint_name,
    decode_pointer,
)
from drcli.records.iteration import IterationRecord
from drcli.records.scores import EvaluationResult, JudgedWorld, Score, Scores
from drcli.records.stage import StageMark

# Which checkpoints of a training stay besides the newest and the best.
#
# Milestones and every n-th, up to a size. Beyond it, every n-th go first, so that the rest stays
# evenly spread; then first lap, three laps, and last the fastest lap.


@dataclass(frozen=True)
class KeepRules:
    """What stays.

    Attributes:
        milestones: DR_TRAIN_KEEP_MILESTONES.
        every: DR_TRAIN_KEEP_EVERY; 0 for none.
        max_bytes: DR_TRAIN_KEEP_MAX_MB; 0 for no limit.
    """

    milestones: bool = True
    every: int = 0
    max_bytes: int = 0

    def spaces(self, name: CheckpointName) -> bool:
        """Whether it is an n-th; the first has learned nothing."""
        return self.every > 0 and name.number > 0 and name.number % self.every == 0


KEEP_ALL_MARKED = KeepRules()


@dataclass(frozen=True)
class KeptCheckpoints:
    names: frozenset[CheckpointName]
    spaced: tuple[str, ...]


def kept_besides(
    sizes: Mapping[CheckpointName, int],
    always: Collection[CheckpointName],
    milestones: Milestones,
    rules: KeepRules,
    newest: CheckpointName,
) -> KeptCheckpoints:
    """What the rules keep besides those that `always` stay; sizes in bytes."""
    known = {checkpoint_name(name) for name in milestones.spaced}
    spaced = {name for name in sizes if name in known or rules.spaces(name)}
    reached = [m.name for _, m in milestones.reached()] if rules.milestones else []
    order = [*_by_crowding(spaced - set(reached), newest), *dict.fromkeys(_last_first(reached))]
    extra = [name for name in order if name in sizes and name not in always]
    if rules.max_bytes:
        total = sum(sizes[name] for name in extra)
        while extra and total > rules.max_bytes:
            gone = extra.pop(0)
            spaced.discard(gone)
            total -= sizes[gone]
    return KeptCheckpoints(frozenset(extra), tuple(str(name) for name in sorted(spaced)))


def _last_first(reached: list[CheckpointName]) -> list[CheckpointName]:
    """At the place of its last milestone: the fastest lap goes last."""
    return list(reversed(list(dict.fromkeys(reversed(reached)))))


def _by_crowding(names: Iterable[CheckpointName], newest: CheckpointName) -> list[CheckpointName]:
    """Next goes the one with the closest neighbours; of equals, the oldest."""
    left = sorted(names)
    order = []
    while left:
        ends = [0, *(name.number for name in left), newest.number]
        gaps = [ends[at + 2] - ends[at] for at in range(len(left))]
        order.append(left.pop(gaps.index(min(gaps))))
    return order


KEEP = 4
"""As in the reference simulator; the best stays besides."""


class CheckpointsLost(StorageError):
    """None of a trained model's checkpoints can be read."""

    final = True


@dataclass(frozen=True)
class Checkpoint:
    """A complete checkpoint; `damaged` are skipped newer ones, with reasons."""

    record: CheckpointRecord
    tensors: bytes
    optimizer: bytes | None = None
    damaged: tuple[str, ...] = ()


class CheckpointStore:
    """The checkpoints below a prefix: the newest `keep`, and those by `rules`, stay."""

    def __init__(
        self, model: ModelStore, rules: KeepRules = KEEP_ALL_MARKED, keep: int = KEEP
    ) -> None:
        self._keep = keep
        self._model = model
        self._rules = rules
        self._milestones: Milestones | None = None

    def save(
        self,
        number: int,
        steps: int,
        tensors: bytes,
        *,
        optimizer: bytes | None = None,
        sim_time_s: float = 0.0,
        counters: Counters | None = None,
        on_pointed: Callable[[], None] = lambda: None,
    ) -> CheckpointRecord:
        """Write a checkpoint, point to it, and delete old ones.

        `on_pointed` is called as soon as others can load the weights.
        """
        name = str(CheckpointName(number, steps))
        record = CheckpointRecord(
            name,
            Fingerprint.of(tensors),
            None if optimizer is None else Fingerprint.of(optimizer),
            sim_time_s,
            counters or Counters(),
        )
        self._model.bucket.put(keys.checkpoint_tensors(self._model.prefix, name), tensors)
        if optimizer is not None:
            self._model.bucket.put(keys.checkpoint_optimizer(self._model.prefix, name), optimizer)
        self._model.bucket.put(keys.checkpoint_record(self._model.prefix, name), record.encode())
        if isinstance(self._model.bucket, S3Bucket):
            # After a power cut, the pointer must not name what is lost, nor the checkpoints before
            # be deleted.
            self._model.bucket.flush()
        self._put_pointer(record)
        on_pointed()
        self._put_last_score(record)
        self._prune(record)
        return record

    def attach_optimizer(self, record: CheckpointRecord, optimizer: bytes) -> CheckpointRecord:
        """Add the optimizer state to a published checkpoint, and delete older ones.

        Workers wait for the weights, so for a bucket elsewhere these come first; the state, twice
        their size, follows while they drive.
        """
        complete = replace(record, optimizer=Fingerprint.of(optimizer))
        self._model.bucket.put(
            keys.checkpoint_optimizer(self._model.prefix, record.name), optimizer
        )
        self._model.bucket.put(
            keys.checkpoint_record(self._model.prefix, record.name), complete.encode()
        )
        self.forget_older_states(record.name)
        return complete

    def forget_older_states(self, name: str) -> None:
        """Keeps that of the one before, too: a trainer may go back to it."""
        newest = checkpoint_name(name)
        objects = checkpoint_objects(self._model)
        states = {key: name for key, name in objects.items() if keys.is_optimizer(key)}
        before = max((name for name in states.values() if name < newest), default=None)
        self._model.bucket.delete(
            key for key, name in states.items() if name not in (before, newest)
        )

    def rewrite(self, record: CheckpointRecord) -> None:
        self._model.bucket.put(
            keys.checkpoint_record(self._model.prefix, record.name), record.encode()
        )

    def drop_newer(self, name: CheckpointName) -> None:
        """Delete checkpoints after the pointer's, which nobody uses."""
        objects, theirs = self._own(checkpoint_objects(self._model))
        newer = {key: each for key, each in objects.items() if each.number > name.number}
        numbers = {each.number for each in newer.values()} - theirs
        graphs = {keys.checkpoint_graph(self._model.prefix, number) for number in numbers}
        self._model.bucket.delete([*newer, *sorted(graphs)])

    def attach_graph(self, number: int, graph: bytes) -> None:
        self._model.bucket.put(keys.checkpoint_graph(self._model.prefix, number), graph)

    def point_to(self, record: CheckpointRecord) -> None:
        """`save` does it; a trainer that goes back, too, so that workers follow."""
        self._put_pointer(record)
        self._put_last_score(record)

    def _put_pointer(self, record: CheckpointRecord) -> None:
        self._model.bucket.put(keys.coach_checkpoint(self._model.prefix), record.name.encode())

    def _put_last_score(self, record: CheckpointRecord) -> None:
        try:
            known = read_scores(self._model)
        except ObjectDamaged:
            known = None  # the best is forgotten; the training can go on
        metric = None if known is None else known.metric_of(record.name)
        last = Score(record.name, metric, record.sim_time_s)
        best = last if known is None else known.best_checkpoint
        if known is not None and best == known.last_checkpoint and best.avg_eval_metric is None:
            best = last  # until one is evaluated, the newest has learned most
        write_scores(self._model, Scores(best, last))

    def repair_pointer(self, name: CheckpointName) -> bool:
        """Write a missing, damaged or older pointer again; True if written.

        If it names a newer checkpoint, another trainer has continued from this one.
        """
        pointed = self.pointed()
        if pointed is not None and pointed.number >= name.number:
            return False
        self.point_to(self.record(str(name)))
        return True

    def pointed(self) -> CheckpointName | None:
        """None before the first, or if damaged: the trainer repairs it."""
        key = keys.coach_checkpoint(self._model.prefix)
        return readable_record(self._model.bucket, key, decode_pointer)

    def stage_of_newest(self) -> StageMark | None:
        return self.counters_of_newest().stage

    def counters_of_newest(self) -> Counters:
        name = self.pointed()
        try:
            return Counters() if name is None else self.record(str(name)).counters
        except (ObjectMissing, ObjectDamaged):
            return Counters()

    def behaviour_checkpoints(self, newest: CheckpointName, oldest: int) -> list[str]:
        """Checkpoints whose rollouts still count: the newest, back to `oldest`.

        Workers drive while the trainer learns.
        """
        if oldest >= newest.number:
            return [str(newest)]
        names = set(checkpoint_objects(self._model).values())
        before = sorted(name for name in names if oldest <= name.number < newest.number)
        return [*map(str, before), str(newest)]

    def record(self, name: str) -> CheckpointRecord:
        key = keys.checkpoint_record(self._model.prefix, name)
        decode = partial(CheckpointRecord.decode_of, name)
        # `attach_optimizer` writes it a second time, just when the workers read it.
        return read_record(self._model.bucket, key, decode, written=True)

    def load(self, name: str, *, with_optimizer: bool = False) -> Checkpoint:
        """Raises ObjectMissing or ObjectDamaged, with the file."""
        record = self.record(name)
        tensors = self.tensors(record)
        optimizer = self._optimizer(record) if with_optimizer else None
        return Checkpoint(record, tensors, optimizer)

    def tensors(self, record: CheckpointRecord) -> bytes:
        """Safetensors; raises ObjectMissing or ObjectDamaged."""
        return self._checked(
            keys.checkpoint_tensors(self._model.prefix, record.name), record.tensors
        )

    def load_latest(
        self, *, with_optimizer: bool = False, newest: CheckpointName | None = None
    ) -> Checkpoint | None:
        """The pointer's (or `newest`), else the next older undamaged checkpoint, or None.

        Raises:
            CheckpointsLost: All are damaged.
        """
        damaged: list[str] = []
        for name in self._newest_first(newest):
            try:
                found = self.load(name, with_optimizer=with_optimizer)
            except (ObjectMissing, ObjectDamaged) as e:
                damaged.append(f"{name}: {e}")
            else:
                return Checkpoint(found.record, found.tensors, found.optimizer, tuple(damaged))
        if not damaged:
            return None
        folder = f"{self._model.bucket.name}/{keys.model_folder(self._model.prefix)}"
        raise CheckpointsLost(
            f"{folder} has only damaged checkpoints: " + " ".join(damaged),
            remedy="Restore one from a copy, or train a new model under another "
            "DR_LOCAL_S3_MODEL_PREFIX.",
        )

    def best_name(self) -> str | None:
        """None also if damaged: it is forgotten then, or worked out again."""
        with suppress(ObjectDamaged):
            scores = read_scores(self._model)
            return None if scores is None else scores.best_checkpoint.name
        return None

    def record_evaluation(
        self,
        result: EvaluationResult,
        metric: str,
        world: JudgedWorld = "training",
        *,
        reaches_goal: bool = False,
    ) -> bool:
        """Record an evaluation; True if the checkpoint is now the best, unless deleted.

        Milestones are of the training track whatever `world` says.
        """
        scores = read_scores(self._model)
        try:
            time_stamp = self.record(result.checkpoint).sim_time_s
        except ObjectMissing:
            return False
        self._mark(with_results(self._marked(), [result]))
        if scores is None:
            return False
        episodes = result.on(world)
        score = best_checkpoint.score_of(result.checkpoint, episodes, metric, time_stamp)
        after = best_checkpoint.with_evaluation(scores, score, metric, reaches_goal=reaches_goal)
        write_scores(self._model, after)
        return after.best_checkpoint == score

    def restore_milestones(
        self, newest: CheckpointName, records: Sequence[IterationRecord]
    ) -> None:
        """Find the milestones again when a trainer starts.

        It may have ended between evaluation and record, or have gone back. If the record is lost,
        every checkpoint stays.
        """
        if not self._model.bucket.exists(keys.milestones(self._model.prefix)):
            self._milestones = self._all_spaced()
        self._mark(with_history(self._marked().until(newest), records))

    def _marked(self) -> Milestones:
        if self._milestones is None:
            try:
                self._milestones = read_milestones(self._model) or NO_MILESTONES
            except ObjectDamaged:
                self._milestones = self._all_spaced()
        return self._milestones

    def _mark(self, milestones: Milestones) -> None:
        if milestones != self._milestones:
            write_milestones(self._model, milestones)
        self._milestones = milestones

    def _all_spaced(self) -> Milestones:
        names = sorted(set(checkpoint_objects(self._model).values()))
        best = self.best_name()
        spaced = [str(name) for name in names[: -self._keep] if str(name) != best]
        return replace(NO_MILESTONES, spaced=spaced)

    def forget_damaged_best(self) -> str | None:
        """If damaged, the last becomes the best; says so in a sentence."""
        known = read_scores(self._model)
        if known is None:
            return None
        try:
            self.load(known.best_checkpoint.name)
        except (ObjectMissing, ObjectDamaged) as error:
            last = best_checkpoint.unscored(known.last_checkpoint)
            write_scores(self._model, Scores(last, last))
            return str(error)
        return None

    def begin_stage(self, first: int) -> None:
        """Forget best and fastest lap from before; until evaluated, the last is best."""
        self._mark(self._marked().of_stage(first))
        known = read_scores(self._model)
        if known is None or checkpoint_name(known.best_checkpoint.name).number >= first:
            return
        last = best_checkpoint.unscored(known.last_checkpoint)
        write_scores(self._model, Scores(last, last))

    def begin_track(self, first: int, *, judged: bool) -> None:
        """Forget the fastest lap from before, which was on another track.

        If such laps are `judged`, the best stays, without its score.
        """
        self._mark(self._marked().of_stage(first))
        known = read_scores(self._model) if judged else None
        best = None if known is None else known.best_checkpoint
        if (
            best is not None
            and best.avg_eval_metric is not None
            and checkpoint_name(best.name).number < first
        ):
            best_checkpoint.forget_scores(self._model)

    def best_of_stage(self, first: int) -> Checkpoint | None:
        try:
            known = read_scores(self._model)
            if known is None or known.best_checkpoint.avg_eval_metric is None:
                return None
            name = known.best_checkpoint.name
            return None if checkpoint_name(name).number < first else self.load(name)
        except (ObjectMissing, ObjectDamaged):
            return None

    def _optimizer(self, record: CheckpointRecord) -> bytes | None:
        if record.optimizer is None:
            return None
        key = keys.checkpoint_optimizer(self._model.prefix, record.name)
        try:
            return self._checked(key, record.optimizer)
        except (ObjectMissing, ObjectDamaged):
            return None

    def _checked(self, key: str, fingerprint: Fingerprint) -> bytes:
        data = self._model.bucket.get(key)
        fault = fingerprint.fault(data)
        if fault is not None:
            raise ObjectDamaged(
                f"{self._model.bucket.name}/{key} is damaged: {fault}.", remedy=remedy_of(key)
            )
        return data

    def _newest_first(self, newest: CheckpointName | None) -> list[str]:
        objects = checkpoint_objects(self._model)
        found = {name for key, name in objects.items() if key.endswith(".ckpt.json")}
        pointed = self.pointed()
        if pointed is not None:
            found = {name for name in found if name < pointed} | {pointed}
        if newest is not None:
            found = {name for name in found if name <= newest}
        return [str(name) for name in sorted(found, reverse=True)]

    def _own(
        self, objects: dict[str, CheckpointName]
    ) -> tuple[dict[str, CheckpointName], set[int]]:
        theirs = {key for key in objects if keys.is_tensorflow_part(key)}
        own = {key: name for key, name in objects.items() if key not in theirs}
        return own, {objects[key].number for key in theirs}

    def _prune(self, newest: CheckpointRecord) -> None:
        listed = self._model.bucket.list(keys.model_folder(self._model.prefix))
        objects, theirs = self._own(
            checkpoints_among(self._model.prefix, [info.key for info in listed])
        )
        names = set(objects.values())
        older = sorted(name for name in names if name.number < newest.number)
        always = {str(name) for name in older[-(self._keep - 1) :]} | {
            newest.name,
            self.best_name(),
        }
        here = checkpoint_name(newest.name)
        sizes = dict.fromkeys((*older, here), 0)
        graphs = {keys.checkpoint_graph(self._model.prefix, name.number): name for name in sizes}
        for info in listed:
            name = objects.get(info.key, graphs.get(info.key))
            if name in sizes:
                sizes[name] += info.size_bytes
        pinned = {name for name in names if str(name) in always} | {here}
        marked = self._marked()
        kept = kept_besides(sizes, pinned, marked, self._rules, here)
        # First of all: what is not marked goes with the next checkpoint at the latest.
        self._mark(replace(marked, spaced=list(kept.spaced)))
        old = names - pinned - kept.names
        # The graph of the newest one is written later; what is there belongs to a lost checkpoint.
        gone = {name.number for name in old} - {name.number for name in names - old}
        unused = {
            keys.checkpoint_graph(self._model.prefix, n) for n in {*gone, newest.number} - theirs
        }
        results = [keys.evaluation_result(self._model.prefix, number) for number in sorted(gone)]
        self._model.bucket.delete(
            [key for key, name in objects.items() if name in old]
            + sorted(unused & {info.key for info in listed})
            + results
        )


def checkpoint_objects(model: ModelStore) -> dict[str, CheckpointName]:
    return checkpoints_among(
        model.prefix, [info.key for info in model.bucket.list(keys.model_folder(model.prefix))]
    )


def checkpoints_among(prefix: str, listed: Iterable[str]) -> dict[str, CheckpointName]:
    found = {key: keys.checkpoint_of(prefix, key) for key in listed}
    return {key: name for key, name in found.items() if name is not None}
