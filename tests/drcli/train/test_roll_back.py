"""A training that goes back to a good checkpoint, and is killed while it does so (001-32, W-32)."""

import csv
import io
from dataclasses import replace
from typing import Any

import pytest

from drcli.base.errors import TrainingFailed
from drcli.base.json_record import Fingerprint
from drcli.learn.ppo import PPO
from drcli.learn.update_result import NonFiniteLossError
from drcli.model import keys
from drcli.model.best_checkpoint import write_evaluation
from drcli.model.checkpoints import CheckpointStore
from drcli.model.growing_file import read_all_metrics
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.model.training_state import Rollback, Rollbacks, read_rollbacks
from drcli.records.checkpoint import CheckpointName, CheckpointRecord, Counters
from drcli.records.iteration import IterationRecord
from drcli.records.scores import EvaluationResult
from drcli.records.trace import read_csv
from drcli.train.checkpoint_publisher import RollbackControl
from drcli.train.rollouts import Collected, Collector
from drcli.train.trainer import learn
from training_in_memory import PREFIX, CopiedBucket, TrainingInMemory, UntilFailure

ITERATIONS = 5
SICK = 3
"""The iteration whose update fails."""


class MadeUp:
    """A rollout that no update looks at."""

    steps = 10


def driven_record(iteration: int, checkpoint: str, progress: float) -> IterationRecord:
    return IterationRecord(
        iteration=iteration,
        checkpoint=checkpoint,
        episodes=1,
        steps=MadeUp.steps,
        total_steps=0,
        mean_reward=1.0,
        mean_progress=progress,
        full_laps=0,
        best_lap_s=None,
        drive_s=0.1,
        elapsed_s=0.0,
    )


class Killed(BaseException):
    """Stands for kill -9."""


class DyingBucket(CopiedBucket):
    """The process that writes is killed at its n-th write, before or after it has taken effect."""

    def __init__(self, fatal: int = 0, *, takes_effect: bool = False) -> None:
        super().__init__()
        self.fatal = fatal
        self.takes_effect = takes_effect
        self.writes: list[str] = []

    def put(self, key, data, *, watch=None):
        self._write(key, lambda: super(DyingBucket, self).put(key, data, watch=watch))

    def delete(self, keys):
        doomed = list(keys)
        self._write(f"delete {doomed}", lambda: super(DyingBucket, self).delete(doomed))

    def _write(self, what, act):
        self.writes.append(what)
        fatal = 0 < self.fatal <= len(self.writes)
        if (self.takes_effect and len(self.writes) == self.fatal) or not fatal:
            act()
        if fatal:
            raise Killed


@pytest.fixture
def sick(monkeypatch):
    """Updates fail in one iteration until the learning rate was lowered so often."""
    failures: list[float] = []

    def update(self: PPO, rollout: Any, seed: int, **_: Any) -> list[Any]:
        if (seed - 7) // 1_000_003 == SICK and self.lr_factor > limit[0]:
            failures.append(self.lr_factor)
            raise NonFiniteLossError("The loss is nan.")
        return []

    limit = [0.5]
    monkeypatch.setattr(PPO, "update", update)
    return limit, failures


def numbers(bucket) -> list[int]:
    return [record.iteration for record in read_history(ModelStore(bucket, PREFIX))]


def test_a_training_goes_back_and_on_and_says_so(working_folder, monkeypatch, sick):  # 001-32
    training = TrainingInMemory(
        working_folder, monkeypatch, DR_TRAIN_MAX_ITERATIONS=ITERATIONS, DR_TRAIN_MAX_ROLLBACKS=2
    )

    training.train()

    bucket = training.bucket
    [rollback] = read_rollbacks(ModelStore(bucket, PREFIX)).entries
    assert rollback.reason == "nan"
    assert CheckpointName.parse(rollback.left).number == SICK
    assert rollback.factor == pytest.approx(1.0 / 3.0)
    assert sick[1] == [1.0]
    assert numbers(bucket) == list(range(ITERATIONS))
    rows = list(csv.DictReader(io.StringIO(bucket.get(keys.learner_metrics(PREFIX)).decode())))
    assert [int(row["iteration"]) for row in rows] == list(range(ITERATIONS))
    records = read_all_metrics(bucket, keys.training_metrics(keys.metrics_prefix(PREFIX)))
    driven = [(r.iteration, r.trial) for r in records if r.phase == "training"]
    assert driven == [(n, trial) for n in range(ITERATIONS) for trial in (1, 2)]
    for iteration in range(ITERATIONS):
        assert read_csv(bucket.get(keys.training_trace(PREFIX, iteration)))
    last = CheckpointStore(ModelStore(bucket, PREFIX)).load_latest().record
    assert last.counters.rollbacks == 1
    assert last.counters.elapsed_s >= rollback.elapsed_s, "time that was given up counts, too"


def test_without_the_setting_nan_ends_the_training_as_ever(working_folder, monkeypatch, sick):
    training = TrainingInMemory(working_folder, monkeypatch, DR_TRAIN_MAX_ITERATIONS=ITERATIONS)

    with pytest.raises(TrainingFailed, match="NaN detected in loss function") as failed:
        training.train()

    assert "Lower `lr` to a third" in failed.value.remedy
    assert read_rollbacks(ModelStore(training.bucket, PREFIX)).entries == []
    assert numbers(training.bucket) == list(range(SICK))


@pytest.fixture
def offline(working_folder, monkeypatch, sick):
    """A trainer whose rollouts are made up, on a bucket that a test chooses."""
    training = TrainingInMemory(
        working_folder, monkeypatch, DR_TRAIN_MAX_ITERATIONS=ITERATIONS, DR_TRAIN_MAX_ROLLBACKS=2
    )

    def collect(self: Collector, iteration: int, checkpoints: Any, *_more: Any) -> Collected:
        return Collected(MadeUp(), driven_record(iteration, checkpoints[-1], 50.0), 1.0)

    monkeypatch.setattr(Collector, "collect", collect)
    monkeypatch.setattr("drcli.train.checkpoint_publisher.write_graph", lambda *_: None)
    job = training.planned()

    def run(bucket: DyingBucket, iterations: int = ITERATIONS) -> None:
        training.bucket = bucket
        train = job.config.train.replaced(train_max_iterations=iterations)
        learn(replace(job, config=replace(job.config, train=train)), UntilFailure())

    return training, run


def results(bucket) -> tuple[Any, ...]:
    history = [
        (r.iteration, r.checkpoint, r.steps) for r in read_history(ModelStore(bucket, PREFIX))
    ]
    rows = csv.DictReader(io.StringIO(bucket.get(keys.learner_metrics(PREFIX)).decode()))
    rollbacks = read_rollbacks(ModelStore(bucket, PREFIX)).entries
    return (
        history,
        [row["iteration"] for row in rows],
        [(r.reason, r.left, r.target, round(r.factor, 6)) for r in rollbacks],
        str(CheckpointStore(ModelStore(bucket, PREFIX)).pointed()),
    )


def test_a_rollback_may_be_killed_between_any_two_writes(offline):  # W-32
    training, run = offline
    start = DyingBucket()
    training.bucket.copy_to(start)
    run(undisturbed := copied(start))
    expected = results(undisturbed)
    decision = undisturbed.writes.index(keys.rollbacks(PREFIX)) + 1
    assert expected[2] == [("nan", "3_Step-30.ckpt", "1_Step-10.ckpt", 0.333333)]

    for fatal in range(decision - 1, decision + 12, 2):
        bucket = copied(start)
        bucket.fatal, bucket.takes_effect = fatal, fatal % 4 == 1
        with pytest.raises(Killed):
            run(bucket)
        bucket.fatal = 0
        run(bucket)
        assert results(bucket) == expected, f"killed at write {fatal}: {bucket.writes[fatal - 1]}"


def copied(bucket: CopiedBucket) -> DyingBucket:
    other = DyingBucket()
    bucket.copy_to(other)
    other.writes.clear()
    return other


def test_the_limit_counts_all_rollbacks_of_a_run(offline, sick):
    training, run = offline
    start = DyingBucket()
    training.bucket.copy_to(start)
    sick[0][0] = 0.0  # no learning rate helps

    with pytest.raises(TrainingFailed):
        run(start)
    assert [round(factor, 3) for factor in sick[1]] == [1.0, 0.333, 0.111]
    with pytest.raises(TrainingFailed):
        run(start)  # resumed: none is left

    assert read_rollbacks(ModelStore(start, PREFIX)).count == 2
    assert len(sick[1]) == 4


def test_a_collapse_goes_back_to_the_best_checkpoint(offline, sick, monkeypatch):  # 001-46
    training, run = offline
    sick[0][0] = 2.0
    driven: list[int] = []

    def collect(self: Any, iteration: int, checkpoints: Any, *_more: Any) -> Collected:
        driven.append(iteration)
        evaluates = None
        if driven == [0, 1, 2]:
            found = EvaluationResult(checkpoints[-1], [90.0], [1.0], [])
            write_evaluation(ModelStore(training.bucket, PREFIX), 2, found)
            evaluates = 2
        progress = 60.0 if iteration < 3 or 2 in driven[3:] else 10.0
        record = driven_record(iteration, checkpoints[-1], progress)
        return Collected(MadeUp(), record, 1.0, evaluates)

    monkeypatch.setattr(Collector, "collect", collect)
    bucket = DyingBucket()
    training.bucket.copy_to(bucket)
    run(bucket, iterations=8)

    [rollback] = read_rollbacks(ModelStore(bucket, PREFIX)).entries
    assert rollback.reason == "collapse"
    assert rollback.text == "Completion fell from 60 % to 27 %; best is 2"
    assert CheckpointName.parse(rollback.target).number == 2
    assert driven == [0, 1, 2, 3, 4, 2, 3, 4, 5, 6, 7]
    assert numbers(bucket) == list(range(8))
    assert {r.mean_progress for r in read_history(ModelStore(bucket, PREFIX))} == {60.0}


@pytest.mark.parametrize(("first", "target"), [(0, 4), (5, 5), (6, 6)])
def test_a_rollback_stays_in_its_stage(working_folder, monkeypatch, first, target):
    limit = {"DR_TRAIN_MAX_ROLLBACKS": 1}
    training = TrainingInMemory(working_folder, monkeypatch, **limit)
    job = training.planned()
    store = CheckpointStore(ModelStore(training.bucket, PREFIX))
    for number in range(7):
        store.save(number, 10 * number, b"weights")
    store.record_evaluation(EvaluationResult("3_Step-30.ckpt", [90.0], [1.0], []), "progress")
    control = RollbackControl(ModelStore(training.bucket, PREFIX), job, store)

    decided = control.decide("nan", "It is nan", CheckpointName(6, 60), 0.001, 5.0, first=first)

    assert decided is not None
    assert CheckpointName.parse(decided.target).number == target


def test_work_of_weights_that_were_given_up_does_not_count():
    back = Rollback(1.0, "nan", "x", "9_Step-90.ckpt", "6_Step-60.ckpt", 0.001, 1 / 3, 5.0)
    known = Rollbacks([back])

    assert known.allows(6, 0), "the checkpoint that it went back to"
    assert not known.allows(7, 0)
    assert known.allows(7, 1), "the new checkpoint of that number"
    nothing = Fingerprint.of(b"")
    assert known.pending(CheckpointRecord("8_Step-80.ckpt", nothing)) == CheckpointName(6, 60)
    marked = CheckpointRecord("8_Step-80.ckpt", nothing, counters=Counters(rollbacks=1))
    assert known.pending(marked) is None


def test_a_learning_rate_that_somebody_has_changed_counts_as_it_is():
    back = Rollback(1.0, "nan", "x", "9_Step-90.ckpt", "6_Step-60.ckpt", 0.001, 1 / 9, 5.0)

    assert Rollbacks([back]).factor(0.001) == pytest.approx(1 / 9)
    assert Rollbacks([back]).factor(0.0001) == 1.0
    assert Rollbacks().factor(0.001) == 1.0


def test_a_damaged_record_of_rollbacks_is_said_and_the_training_goes_on(offline, caplog):
    training, run = offline
    start = DyingBucket()
    training.bucket.copy_to(start)
    start.put(keys.rollbacks(PREFIX), b"{")

    run(start)

    assert numbers(start) == list(range(ITERATIONS))
    assert read_rollbacks(ModelStore(start, PREFIX)).count == 1
