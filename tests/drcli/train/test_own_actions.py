"""A checkpoint keeps the actions that it was trained with, whatever files a later start had."""

import json
from typing import Any

import pytest

from drcli.base.errors import ProblemsError
from drcli.config.loading import load_settings
from drcli.drive.evaluator import Entry, enter
from drcli.model import keys
from drcli.model.best_checkpoint import evaluated_numbers, read_scores
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters, checkpoint_name
from drcli.records.scores import EvaluationResult
from drcli.transfer.export_model import Selection, read_export_source
from memory_bucket import MemoryBucket
from training_in_memory import PREFIX, REWARD, TrainingInMemory

TRAINED, NEW = 4.0, 2.0
NEW_REWARD = REWARD.replace("1.0", "2.0")


@pytest.fixture
def training(tmp_path, monkeypatch):
    training = TrainingInMemory(tmp_path, monkeypatch, DR_TRAIN_MAX_ITERATIONS=1)
    for module in ("export_model", "transfer_buckets"):
        monkeypatch.setattr(
            f"drcli.transfer.{module}.open_bucket", lambda *_, **__: training.bucket
        )
    training.train()
    return training


def set_speed(training: TrainingInMemory, speed: float) -> None:
    path = training.folder / "custom_files" / "model_metadata.json"
    values = json.loads(path.read_text())
    for action in values["action_space"]:
        action["speed"] = speed
    path.write_text(json.dumps(values))


def allow_iterations(training: TrainingInMemory, number: int) -> None:
    path = training.folder / "run.env"
    path.write_text(f"{path.read_text()}DR_TRAIN_MAX_ITERATIONS={number}\n")


def speeds(metadata: Any) -> set[float]:
    return {action["speed"] for action in json.loads(metadata)["action_space"]}


def model_file(training: TrainingInMemory) -> set[float]:
    return speeds(training.bucket.get(keys.model_metadata(PREFIX)))


def exported(training: TrainingInMemory, number: int) -> set[float]:
    settings = load_settings(training.folder, environ={})
    source = read_export_source(settings, Selection(number))
    return speeds(source.design.files["model_metadata.json"])


def test_a_start_that_learns_nothing_leaves_the_actions_and_the_reward_of_the_model(training):
    set_speed(training, NEW)
    training.write("custom_files/reward_function.py", NEW_REWARD)
    training.write("run.env", (training.folder / "run.env").read_text() + "DR_CAR_COLOR=Blue\n")
    before = training.bucket.get(keys.parameter_file(PREFIX, "training_params.yaml"))
    job = training.planned(resume=True)
    name = str(CheckpointStore(ModelStore(training.bucket, PREFIX)).pointed())

    assert exported(training, 1) == model_file(training) == {TRAINED}
    racer, _ = enter(training.bucket, Entry(PREFIX, name, "trace", "metrics"), job.config)
    assert {speed for _, speed in racer.actions.choices} == {TRAINED}
    assert training.bucket.get(keys.reward_function(PREFIX)) == REWARD.encode()
    assert training.bucket.get(keys.parameter_file(PREFIX, "training_params.yaml")) == before


def test_new_actions_become_the_models_with_the_first_checkpoint_that_learned_with_them(training):
    training.bucket.delete([keys.evaluation_result(PREFIX, 1)])
    set_speed(training, NEW)
    training.write("custom_files/reward_function.py", NEW_REWARD)
    allow_iterations(training, 3)
    training.train(resume=True)

    assert training.bucket.get(keys.reward_function(PREFIX)) == NEW_REWARD.encode()
    assert model_file(training) == exported(training, 2) == {NEW}
    assert exported(training, 1) == {TRAINED}
    # While it drove with the new actions, checkpoint 1 got no score for that.
    assert 1 not in evaluated_numbers(ModelStore(training.bucket, PREFIX))
    assert 2 in evaluated_numbers(ModelStore(training.bucket, PREFIX))


def test_a_trainer_that_learns_nothing_leaves_the_reward_and_the_world_of_the_model(training):
    world = keys.parameter_file(PREFIX, "training_params.yaml")
    before = training.bucket.get(world)
    training.write("custom_files/reward_function.py", NEW_REWARD)
    training.write("run.env", (training.folder / "run.env").read_text() + "DR_CAR_COLOR=Blue\n")

    training.train(resume=True)

    assert training.bucket.get(keys.reward_function(PREFIX)) == REWARD.encode()
    assert training.bucket.get(world) == before


def test_a_trainer_that_was_cut_off_after_its_checkpoint_gives_the_model_its_files(training):
    training.bucket.put(keys.reward_function(PREFIX), NEW_REWARD.encode())

    training.train(resume=True)

    assert training.bucket.get(keys.reward_function(PREFIX)) == REWARD.encode()


@pytest.mark.nightly
@pytest.mark.parametrize("iterations", [1, 6])
def test_on_another_track_the_best_stays_without_its_score_until_another_is_evaluated(
    training, iterations
):
    allow_iterations(training, 2)
    training.train(resume=True)
    store = CheckpointStore(ModelStore(training.bucket, PREFIX))
    store.record_evaluation(EvaluationResult("0_Step-0.ckpt", [100.0], [1.0], [0.1]), "progress")
    assert store.best_name() == "0_Step-0.ckpt"
    path = training.folder / "run.env"
    path.write_text(path.read_text() + "DR_WORLD_NAME=bean\n")
    allow_iterations(training, iterations)

    training.train(resume=True)

    best = read_scores(ModelStore(training.bucket, PREFIX)).best_checkpoint
    if iterations == 1:
        assert (best.name, best.avg_eval_metric) == ("0_Step-0.ckpt", None)
        assert store.load(best.name)
    else:
        assert checkpoint_name(best.name).number >= 2
        assert best.avg_eval_metric is not None


def test_an_error_in_a_parameter_file_names_the_place_where_it_was_read():
    bucket, wrong = MemoryBucket(), {"model_metadata.json": "{", "hyperparameters.json": "{}"}
    bucket.put(keys.model_metadata(PREFIX), b"{")
    bucket.put(keys.hyperparameters(PREFIX), b"{}")
    record = CheckpointStore(ModelStore(bucket, PREFIX)).save(
        1, 100, b"", counters=Counters(inputs=wrong)
    )

    for read, place in (
        (
            lambda: Design.of_model(ModelStore(bucket, PREFIX)),
            f"bucket/{keys.model_metadata(PREFIX)}",
        ),
        (
            lambda: Design.of_model(ModelStore(bucket, PREFIX), wrong),
            "model_metadata.json of this start",
        ),
        (
            lambda: Design.of_checkpoint(ModelStore(bucket, PREFIX), record.name),
            f"model_metadata.json in bucket/{keys.checkpoint_record(PREFIX, record.name)}",
        ),
    ):
        with pytest.raises(ProblemsError) as refused:
            read()
        assert str(refused.value).startswith(place)
