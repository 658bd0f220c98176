"""Evaluations decide which checkpoint is the best, whenever they arrive."""

from typing import Any

import pytest

from drcli.model.best_checkpoint import read_scores, write_evaluation
from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import History
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName
from drcli.records.scores import EvaluationEpisodes, EvaluationResult, SecondEvaluation
from drcli.train import scoring
from drcli.train.goals import Target
from drcli.train.scoring import Scoring
from iterations import iteration_record
from memory_bucket import MemoryBucket

PREFIX = "model"


class Model:
    """A model with some checkpoints, of which the trainer has learned from all but the last."""

    def __init__(self, checkpoints: int) -> None:
        self.bucket = MemoryBucket()
        self.store = CheckpointStore(ModelStore(self.bucket, PREFIX))
        self.history = History(ModelStore(self.bucket, PREFIX))
        for number in range(checkpoints):
            self.store.save(number, 100 * number, b"weights")
            if number:
                self.history.add(iteration_record(number - 1))
        self.newest = CheckpointName(checkpoints - 1, 100 * (checkpoints - 1))
        self.scoring = self.new_scoring()

    def new_scoring(self, *args, **options) -> Scoring:
        return Scoring(
            ModelStore(self.bucket, PREFIX), self.store, self.history, "progress", *args, **options
        )

    def evaluate(
        self,
        number: int,
        progress: float,
        name: str = "",
        second: float | None = None,
        **changes: Any,
    ) -> None:
        result = EvaluationResult(
            checkpoint=name or f"{number}_Step-{100 * number}.ckpt",
            progress=[progress] * 5,
            reward=[1.0] * 5,
            lap_s=[10.0] * 5 if progress == 100.0 else [],
            second=None
            if second is None
            else SecondEvaluation([second] * 5, [1.0] * 5, [], "oval"),
            **changes,
        )
        write_evaluation(ModelStore(self.bucket, PREFIX), number, result)

    @property
    def best(self) -> str | None:
        return self.store.best_name()

    def progress_of(self, iteration: int) -> list[float]:
        return self.history.records[iteration].evaluation_progress


@pytest.fixture
def model() -> Model:
    return Model(4)


def test_what_was_evaluated_is_scored_before_the_trainer_leaves(model):
    model.scoring.expect(2, 1)
    model.evaluate(1, 50.0)
    model.scoring.score(model.newest)
    assert model.best.startswith("1_")
    model.evaluate(3, 100.0)  # whose training episodes were still being driven

    model.scoring.score_all(model.newest)

    assert model.best == str(model.newest)


def test_its_learning_curve_gets_the_evaluation_once_there_is_a_record_for_it(model):
    model.evaluate(3, 100.0)
    model.scoring.score_all(model.newest)
    model.history.add(iteration_record(3))

    model.scoring.expect(3, None)
    model.scoring.score(CheckpointName(4, 400))

    assert model.progress_of(3) == [100.0] * 5


def test_an_evaluation_that_arrived_while_no_trainer_lived_is_scored(model):
    model.evaluate(2, 70.0)
    model.evaluate(3, 60.0)

    after = model.new_scoring()
    after.restore(model.history.records)
    after.score_all(model.newest)

    assert model.best.startswith("2_")
    assert model.progress_of(2) == [70.0] * 5


def test_an_evaluation_of_another_checkpoint_with_that_number_counts_for_nothing(model):
    model.evaluate(3, 100.0, name="3_Step-999.ckpt")
    before = model.best

    model.scoring.score_all(model.newest)

    assert model.best == before


def test_evaluations_that_never_come_are_not_looked_for_for_ever(model):
    model.scoring.restore(model.history.records)
    for iteration in range(3, 8):
        model.scoring.expect(iteration, None)
    looked_for = []
    model.bucket.get = lambda key: looked_for.append(key)

    model.scoring.score(model.newest)

    assert looked_for == []


def test_the_last_evaluation_is_waited_for_while_it_is_being_driven(model, monkeypatch):
    looks = []

    def should_stop() -> bool:
        looks.append(None)
        if len(looks) == 3:
            model.evaluate(2, 100.0)
        return False

    monkeypatch.setattr(scoring, "LAST_EVALUATION_S", 30.0)
    model.scoring.wait(2, 0.0, should_stop)
    model.scoring.score(model.newest)

    assert len(looks) == 3
    assert model.best.startswith("2_")


def test_a_request_to_leave_ends_that_wait(model):
    model.scoring.wait(2, 1000.0, lambda: True)
    model.scoring.score(model.newest)

    assert model.progress_of(2) == []


def test_a_checkpoint_that_drives_again_is_waited_for_but_not_for_ever(model):
    model.scoring.expect(2, 2)
    model.evaluate(2, 100.0, confirms=40)

    model.scoring.score(model.newest)
    assert model.progress_of(2) == []
    model.scoring.score(CheckpointName(5, 500))
    assert model.best.startswith("2_")

    model.evaluate(2, 100.0, confirmation=EvaluationEpisodes([100.0] * 40, [1.0] * 40, [10.0] * 39))
    model.scoring.expect(2, 2)
    model.scoring.score(model.newest)
    assert str(model.history.records[2].confirmation).startswith("39 of 40 laps clean")


def test_what_a_worker_still_drives_counts_after_its_trainer_has_started_again(model):
    model.scoring.expect(2, 2)
    model.evaluate(2, 100.0, confirms=2)
    model.scoring.score_all(model.newest)
    assert model.progress_of(2) == [100.0] * 5

    model.evaluate(2, 100.0, confirmation=EvaluationEpisodes([100.0] * 2, [1.0] * 2, [10.0]))
    model.scoring.score(model.newest)

    assert str(model.history.records[2].all_laps).startswith("6 of 7 laps clean")


def test_a_checkpoint_that_reaches_a_target_is_the_best(model):
    model.scoring = model.new_scoring(targets=lambda: [Target("--until-laps 5", 5)])
    again = EvaluationEpisodes([100.0] * 40, [1.0] * 40, [10.0] * 38)
    whole = EvaluationEpisodes([100.0] * 55, [1.0] * 55, [9.0] * 55)
    for number, confirmation in ((1, whole), (2, again)):
        model.scoring.expect(number, number)
        model.evaluate(number, 100.0, confirmation=confirmation)
        model.scoring.score(model.newest)

    assert model.best.startswith("2_")


@pytest.mark.parametrize(
    ("world", "best"),
    [("training", "2_Step-200.ckpt"), ("evaluation", "0_Step-0.ckpt"), ("both", "1_Step-100.ckpt")],
)
def test_a_second_track_is_recorded_and_may_choose_the_best(model, world, best):  # 001-47
    model.scoring = model.new_scoring(world, second=True)
    for number, progress, second in ((0, 10.0, 60.0), (1, 50.0, 50.0), (2, 70.0, 5.0)):
        model.scoring.expect(number, number)
        model.evaluate(number, progress, second=second)
        model.scoring.score(model.newest)

    assert model.best == best
    record = model.history.records[1]
    assert (record.second_world, record.second_progress) == ("oval", [50.0] * 5)
    assert model.progress_of(1) == [50.0] * 5


def test_the_evaluation_on_the_second_track_is_waited_for_but_not_at_the_end(model):
    model.scoring = model.new_scoring("evaluation", second=True)
    model.scoring.expect(2, 2)
    model.evaluate(2, 50.0)

    model.scoring.score(model.newest)
    assert model.progress_of(2) == []
    model.scoring.score_all(model.newest)

    assert model.progress_of(2) == [50.0] * 5
    assert model.best == "2_Step-200.ckpt"


def test_a_stage_begins_without_a_best_and_late_evaluations_of_the_last_do_not_count(model):
    model.scoring.expect(1, 1)
    model.evaluate(1, 90.0)
    model.scoring.score(model.newest)
    assert model.store.best_of_stage(0).record.name == "1_Step-100.ckpt"

    model.scoring.begin_stage(3)
    model.scoring.expect(2, 2)
    model.evaluate(2, 100.0)
    model.scoring.score(model.newest)

    assert model.best == "3_Step-300.ckpt"
    assert model.store.best_of_stage(3) is None
    assert model.progress_of(2) == [100.0] * 5


@pytest.mark.parametrize(("world", "score"), [("training", None), ("evaluation", 90.0)])
def test_on_another_track_late_laps_and_the_best_score_count_only_if_they_were_not_driven_there(
    model, world, score
):
    scoring = model.new_scoring(world, second=True)
    scoring.expect(1, 1)
    model.evaluate(1, 100.0, second=90.0)
    scoring.score(model.newest)

    scoring.begin_track(3)
    scoring.expect(2, 2)
    model.evaluate(2, 100.0, second=80.0)
    scoring.score(model.newest)

    best = read_scores(ModelStore(model.bucket, PREFIX)).best_checkpoint
    assert (best.name, best.avg_eval_metric) == ("1_Step-100.ckpt", score)
    model.evaluate(3, 10.0, second=10.0)
    scoring.score_all(model.newest)
    assert model.best == ("3_Step-300.ckpt" if score is None else "1_Step-100.ckpt")
