"""A training whose episodes are driven on several tracks, and judged on others."""

import json

import numpy as np
import pytest

from drcli.model import keys
from drcli.model.best_checkpoint import read_evaluation
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.records.trace import read_rows
from drcli.train.training_simulation import TrackChoice
from drsim.track.worlds import load_track
from training_in_memory import PREFIX, TrainingInMemory

REWARD = "def reward_function(params):\n    return params['track_length']\n"


@pytest.mark.parametrize("method", ["camera", "teacher"])
def test_episodes_drive_all_tracks_and_checkpoints_are_judged_on_others(
    working_folder, monkeypatch, method
):
    training = TrainingInMemory(
        working_folder,
        monkeypatch,
        DR_WORLD_NAME="bean",
        DR_TRAIN_WORLDS="willow, zoo:1",
        DR_TRAIN_EVAL_WORLD="paddle, zoo:5-6",
        DR_TRAIN_BEST_MODEL_WORLD="evaluation",
        DR_TRAIN_MAX_ITERATIONS=2,
        DR_TRAIN_EVAL_LAPS=1,
    )
    training.write("custom_files/reward_function.py", REWARD)
    parameters = {
        "batch_size": 32,
        "num_epochs": 1,
        "num_episodes_between_training": 12,
        "training_method": method,
    }
    training.write("custom_files/hyperparameters.json", json.dumps(parameters))

    training.train()

    model = ModelStore(training.bucket, PREFIX)
    text = training.bucket.get(keys.training_trace(PREFIX, 0))
    rows = read_rows(text).rows
    lengths = {round(load_track(name).length_m, 3) for name in ("bean", "willow", "zoo-0")}
    assert {round(row.track_length_m, 3) for row in rows} == lengths
    driven = [row for row in rows if row.steps > 1]
    assert all(row.reward == pytest.approx(row.track_length_m) for row in driven), "its own"
    if method == "camera":  # a teacher is not evaluated
        assert read_history(model)[0].second_world == "3 tracks"
        second = read_evaluation(model, 0).second
        assert second is not None
        assert len(second.progress) == 3, "each of them once"
        assert set(second.failed) <= {"paddle", "zoo-5", "zoo-6"}
        assert len(second.failed) == 3 - len(second.lap_s)


def test_a_track_on_which_cars_come_less_far_is_driven_more_often():
    choice = TrackChoice(3)
    for _ in range(50):
        for track, progress in enumerate((100.0, 100.0, 20.0)):
            choice.note(track, progress)

    drawn = np.bincount([choice.draw(7, number) for number in range(600)], minlength=3)

    assert drawn[2] > 2.5 * drawn[:2].max()
    assert drawn.min() > 40, "nothing is forgotten"
    again = [choice.draw(7, number) for number in range(20)]
    assert again == [choice.draw(7, number) for number in range(20)]
