"""What a training has done, and why it is complete."""

from types import SimpleNamespace

import pytest

from drcli.model.history import History
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName, Counters
from drcli.records.stage import Stage, StageGoal
from drcli.train import training_progress
from drcli.train.training_progress import TrainingProgress
from iterations import iteration_record
from memory_bucket import MemoryBucket


@pytest.fixture
def history():
    return History(ModelStore(MemoryBucket(), "model"))


@pytest.fixture
def now(monkeypatch):
    """Sets the time."""
    clock = SimpleNamespace(s=50.0)
    monkeypatch.setattr(training_progress.time, "monotonic", lambda: clock.s)
    return clock


def job(*goals: StageGoal) -> SimpleNamespace:
    race = SimpleNamespace(world_name="reinvent_base", sim_grow=False)
    stages = [Stage(f"s{n}", (race,), "", "r.py", "{}", goal) for n, goal in enumerate(goals)]
    return SimpleNamespace(stages=stages, config=SimpleNamespace(race=lambda: race, races=[race]))


def no_goal(*_: object, **__: object) -> None:
    """Goals that are never reached."""


def test_a_training_counts_on_from_its_checkpoint(history, now):
    record = SimpleNamespace(number=3, steps=300, counters=Counters(episodes=12))
    progress = TrainingProgress(job(), SimpleNamespace(record=record), history, 600.0)
    now.s += 7.0

    progress.advance(iteration_record(3, episodes=4, total_steps=420))

    assert progress.newest == CheckpointName(4, 420)
    assert progress.episodes == 16
    assert progress.elapsed_s == 607.0


def test_a_stage_is_over_with_the_iteration_that_was_just_driven(history, now):
    goals = StageGoal(steps=100), StageGoal(iterations=2)
    progress = TrainingProgress(job(*goals), None, history, 0.0)

    assert progress.stage_over(iteration_record(0, total_steps=99)) is None
    assert progress.stage_over(iteration_record(0, total_steps=100)) == "100 steps are done"


def test_laps_of_another_track_reach_no_goal(history, now):
    judged = []

    def goals(*_, **options):
        judged.extend(options["judged"])

    for number, world in enumerate(("", "Vegas_track", "reinvent_base")):
        history.add(iteration_record(number, world=world))
    progress = TrainingProgress(job(), None, history, 0.0)

    assert progress.reached(SimpleNamespace(reached=goals)) is None
    assert [record.iteration for record in judged] == [0, 2]


def test_the_end_of_the_last_stage_is_that_of_the_training(history, now):
    goals = StageGoal(steps=100), StageGoal(iterations=1)
    progress = TrainingProgress(job(*goals), None, history, 0.0)
    never = SimpleNamespace(reached=no_goal)
    progress.advance(iteration_record(0, total_steps=100))

    assert progress.reached(never) is None, "the first stage is over, but another one follows"
    progress.stages.begin_next(progress.counted())
    assert progress.reached(never) is None
    progress.advance(iteration_record(1, total_steps=200))
    assert progress.reached(never) == (
        "Training is complete: its last stage, s1, is over: 1 iteration is done."
    )
