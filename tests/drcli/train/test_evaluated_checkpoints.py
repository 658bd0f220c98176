"""Which checkpoints a simulation worker evaluates, by the way that the training shall end."""

from dataclasses import replace

import pytest

from drcli.drive.driving import Driver
from drcli.model.checkpoints import CheckpointStore
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.train import sim
from drcli.train.sim import SimWorker
from training_in_memory import PREFIX, TrainingInMemory

pytestmark = pytest.mark.nightly

ITERATIONS = 4


@pytest.mark.parametrize("goals", [{}, {"until_laps": 1}, {"until_lap_time_s": 3.0}])
def test_evaluations_keep_to_their_share_whatever_ends_the_training(
    working_folder, monkeypatch, goals
):
    training = TrainingInMemory(working_folder, monkeypatch, DR_TRAIN_MAX_ITERATIONS=ITERATIONS)
    share = iter([True, False, True])
    monkeypatch.setattr(sim.EvaluationBudget, "allows_another", lambda *_, **__: next(share, False))

    training.train(goals=goals)

    history = read_history(ModelStore(training.bucket, PREFIX))
    assert len(history) == ITERATIONS
    assert [r.iteration for r in history if r.evaluation_progress] == [0, 2]


def test_a_checkpoint_that_completes_its_laps_by_luck_does_not_end_the_training(
    working_folder, monkeypatch
):
    clean = {0: 2, 1: 1, 2: 2, 3: 2}  # of two laps of each checkpoint; another may be on its way
    clean_again = {2: 37, 3: 38}  # of forty others
    training = TrainingInMemory(working_folder, monkeypatch, DR_TRAIN_EVAL_LAPS=2)
    iterate, drive, driving, starts = SimWorker._iterate, Driver.drive, [], []

    def noted(worker, iteration, name, counters):
        driving.append(name.number)
        iterate(worker, iteration, name, counters)

    def lucky(driver, plans, on_episode, *args, **options):
        laps = clean.get(driving[-1], 0)
        if all(plan.phase == "evaluation" for plan in plans):
            laps = clean_again.get(driving[-1], 0)
            starts.append({(plan.start_fraction, plan.offset_m, plan.angle_deg) for plan in plans})

        def end(episode):
            nonlocal laps
            if episode.phase == "evaluation" and laps:
                laps -= 1
                episode.rows[-1] = replace(episode.rows[-1], status="lap_complete", progress=100.0)
            on_episode(episode)

        drive(driver, plans, end, *args, **options)

    monkeypatch.setattr(sim.EvaluationBudget, "allows_another", lambda *_, **__: True)
    monkeypatch.setattr(SimWorker, "_iterate", noted)
    monkeypatch.setattr(Driver, "drive", lucky)

    training.train(goals={"until_laps": 2})

    history = read_history(ModelStore(training.bucket, PREFIX))[:4]
    assert [len(r.evaluation_progress) for r in history] == [2, 2, 2, 2]
    assert [len(r.confirmation_lap_s) for r in history] == [0, 0, 37, 38]
    assert [len(r.confirmation_progress) for r in history] == [40, 2, 40, 40]  # 1 may be the best
    assert len(set.union(*starts)) == 122  # no start is driven twice
    assert CheckpointStore(ModelStore(training.bucket, PREFIX)).best_name() == history[3].checkpoint
