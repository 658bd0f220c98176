"""Which models a bucket holds."""

import pytest

from drcli.model import keys, lease
from drcli.model.model_list import CheckpointEntry, list_models
from drcli.model.model_store import ModelStore
from drcli.records.training_record import TrainingStart
from memory_bucket import MemoryBucket

from .conftest import put_model


@pytest.fixture
def bucket():
    bucket = MemoryBucket()
    put_model(bucket, "team/model-1")
    put_model(bucket, "team/model-1/inside", numbers=(4,))
    put_model(bucket, "other", numbers=(9,))
    bucket.put("custom_files/reward_function.py", b"")
    lease.take(ModelStore(bucket, "other"), "session")
    return bucket


def test_models_are_found_wherever_they_lie_and_nothing_else_is(bucket):
    found = list_models(bucket)

    assert [m.prefix for m in found.models] == ["other", "team/model-1", "team/model-1/inside"]


def test_a_model_has_its_checkpoints_size_and_time(bucket):
    model = list_models(bucket, "team/model-1").models[0]

    own = [o for o in bucket.list("team/model-1/") if "/inside/" not in o.key]
    assert model.checkpoints == 2
    assert model.best == CheckpointEntry("3_Step-300.ckpt", 90.0, "score 90", "0 of 1 lap clean")
    assert model.last == CheckpointEntry("5_Step-500.ckpt", 50.0, "score 50")
    assert (model.objects, model.size_bytes) == (len(own), sum(o.size_bytes for o in own))
    assert model.modified == max(o.modified for o in own).isoformat(timespec="seconds")


def test_a_model_in_training_says_so(bucket):
    training = {model.prefix: model.training for model in list_models(bucket).models}

    assert training == {"other": True, "team/model-1": False, "team/model-1/inside": False}


@pytest.mark.parametrize(
    ("pattern", "prefixes"),
    [
        ("mod", ["team/model-1", "team/model-1/inside"]),
        ("*-1", ["team/model-1"]),
        ("?ther", ["other"]),
        ("nothing", []),
    ],
)
def test_a_pattern_chooses(bucket, pattern, prefixes):
    assert [m.prefix for m in list_models(bucket, pattern).models] == prefixes


def test_a_damaged_index_hides_no_model(bucket):
    bucket.put(keys.deepracer_checkpoints("other"), b"{")

    (model,) = list_models(bucket, "other").models

    assert model.best is not None
    assert model.last is not None
    assert (model.best.name, model.last.name) == ("9_Step-900.ckpt", "9_Step-900.ckpt")
    assert "other/model/deepracer_checkpoints.json" in model.damaged[0]


@pytest.mark.parametrize(
    ("settings", "score"),
    [
        ({}, "90.0 %"),
        ({"DR_TRAIN_BEST_MODEL_METRIC": "laptime"}, "0.09 s"),
        ({"DR_TRAIN_BEST_MODEL_METRIC": "reward"}, "reward 90"),
        (None, "score 90"),
    ],
)
def test_a_score_has_the_unit_of_the_metric_of_its_training(bucket, settings, score):
    start = TrainingStart(1, settings=settings)
    bucket.put(keys.training_start("team/model-1"), start.encode())

    assert list_models(bucket, "team/model-1").models[0].best.score == score
