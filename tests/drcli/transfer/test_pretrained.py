"""A new model that starts with the weights of another one."""

import json

import pytest

from drcli.base.errors import SettingsError
from drcli.model import keys
from drcli.records.checkpoint import Counters
from reference_model import METADATA

CLONE = (
    "DR_LOCAL_S3_MODEL_PREFIX=model-2",
    "DR_LOCAL_S3_PRETRAINED=True",
    "DR_LOCAL_S3_PRETRAINED_PREFIX=model-1",
)
BEST = (*CLONE, "DR_LOCAL_S3_PRETRAINED_CHECKPOINT=best")


@pytest.mark.parametrize(("lines", "weights"), [(CLONE, b"weights 5"), (BEST, b"weights 3")])
def test_the_chosen_weights_become_checkpoint_0_with_a_fresh_optimizer(trained, lines, weights):
    trained.run_env(*lines)

    trained.start()

    found = trained.store("model-2").load_latest(with_optimizer=True)
    assert found is not None
    assert (found.tensors, found.optimizer) == (weights, None)
    assert found.record.name == "0_Step-0.ckpt"
    assert found.record.counters == Counters(inputs=found.record.counters.inputs)


def test_everybody_finds_the_first_checkpoint_of_a_clone(trained):
    trained.run_env(*CLONE)

    trained.start()

    scores = json.loads(trained.bucket.get(keys.deepracer_checkpoints("model-2")))
    assert str(trained.store("model-2").pointed()) == "0_Step-0.ckpt"
    assert {entry["name"] for entry in scores.values()} == {"0_Step-0.ckpt"}
    assert {entry["avg_eval_metric"] for entry in scores.values()} == {None}


def test_the_other_model_is_left_as_it_was(trained):
    before = {item.key: trained.bucket.get(item.key) for item in trained.bucket.list("model-1/")}
    trained.run_env(*BEST)

    trained.start()

    after = {item.key: trained.bucket.get(item.key) for item in trained.bucket.list("model-1/")}
    assert after == before


def test_a_model_keeps_where_its_weights_came_from_when_it_is_resumed(trained):
    trained.run_env(*BEST)
    plan = trained.start()

    again = trained.start(resume=True)

    origin = trained.note("model-2")["pretrained"]
    assert plan.pretrained is not None
    assert again.pretrained is None
    assert origin["sha256"] == plan.pretrained.sha256
    assert (origin["prefix"], origin["checkpoint"]) == ("model-1", "best")
    assert (origin["name"], origin["metric"]) == ("3_Step-300.ckpt", 90.0)


def test_a_resumed_clone_goes_on_with_its_own_weights(trained):
    trained.run_env(*CLONE)
    trained.start()
    trained.store("model-2").save(1, 70, b"learned")

    trained.start(resume=True)

    found = trained.store("model-2").load_latest()
    assert found is not None
    assert found.tensors == b"learned"


def test_without_pretrained_weights_the_trainer_makes_its_own(racer):
    racer.start()

    assert racer.store("model-1").load_latest() is None
    assert racer.note("model-1")["pretrained"] is None


def test_other_values_of_the_actions_are_allowed_with_a_warning(trained):
    trained.model_metadata(
        action_space=[{"steering_angle": angle, "speed": 3.0} for angle in (-30.0, 0.0, 30.0)]
    )
    trained.run_env(*CLONE)

    plan = trained.start()

    [warning] = [text for text in plan.warnings if "action_space" in text]
    assert "model_metadata.json: s3://bucket/model-1 was trained with other values" in warning


def test_two_names_of_one_camera_fit(trained):
    trained.model_metadata(sensor=["observation"])
    trained.run_env(*CLONE)

    trained.start()

    assert str(trained.store("model-2").pointed()) == "0_Step-0.ckpt"


@pytest.mark.parametrize(
    ("metadata", "parameters", "sentence"),
    [
        (
            {"action_space": [{"steering_angle": 0, "speed": 1.0}]},
            {},
            "was trained with 3 discrete actions, but action_space has 1 discrete action here.",
        ),
        (
            {
                "action_space_type": "continuous",
                "action_space": {
                    "steering_angle": {"low": -30, "high": 30},
                    "speed": {"low": 1.0, "high": 2.0},
                },
            },
            {},
            "was trained with 3 discrete actions, but action_space has 2 continuous actions here.",
        ),
        (
            {"neural_network": "DEEP_CONVOLUTIONAL_NETWORK"},
            {},
            "neural_network=DEEP_CONVOLUTIONAL_NETWORK, but s3://bucket/model-1 was trained with "
            "neural_network=DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
        ),
        (
            {"sensor": ["STEREO_CAMERAS", "LIDAR"]},
            {},
            "sensor=STEREO_CAMERAS+LIDAR, but s3://bucket/model-1 was trained with "
            "sensor=FRONT_FACING_CAMERA",
        ),
        ({}, {"stack_size": 4}, "stack_size=4, but s3://bucket/model-1 was trained with"),
        ({}, {"critic": "state"}, "critic=state, but s3://bucket/model-1 was trained with"),
    ],
)
@pytest.mark.parametrize("way", ["clone", "resume"])
def test_weights_that_do_not_fit_are_refused_before_anything_is_written(
    trained, metadata, parameters, sentence, way
):
    trained.model_metadata(**metadata)
    trained.hyperparameters(**parameters)
    if way == "clone":
        trained.run_env(*CLONE)
    before = {item.key: trained.bucket.get(item.key) for item in trained.bucket.list("")}

    with pytest.raises(SettingsError) as caught:
        trained.start(resume=way == "resume")

    after = {item.key: trained.bucket.get(item.key) for item in trained.bucket.list("")}
    assert sentence in str(caught.value)
    assert str(trained.folder / "custom_files") in str(caught.value)
    assert "start a new model" in caught.value.remedy
    assert after == before


def test_sectors_of_a_lidar_must_be_the_same(racer):
    sensor = ["FRONT_FACING_CAMERA", "DISCRETIZED_SECTOR_LIDAR"]
    racer.model_metadata(sensor=sensor, lidar_config={"num_sectors": 8})
    racer.start()
    racer.store("model-1").save(0, 0, b"weights")
    racer.model_metadata(sensor=sensor, lidar_config={"num_sectors": 16})
    racer.run_env(*CLONE)

    with pytest.raises(SettingsError, match=r"\(16 x 8\), but .*\(8 x 8\)"):
        racer.start()


def test_a_model_that_does_not_exist_is_named_with_its_line(racer):
    racer.run_env(*CLONE)

    with pytest.raises(SettingsError) as caught:
        racer.start()

    assert str(caught.value) == (
        "run.env line 3: DR_LOCAL_S3_PRETRAINED_PREFIX=model-1: there is no checkpoint at "
        "s3://bucket/model-1/model/."
    )
    assert racer.bucket.list("model-2/") == []


def test_a_model_whose_name_only_starts_alike_is_another_one(trained):
    trained.run_env(*CLONE[:2], "DR_LOCAL_S3_PRETRAINED_PREFIX=model")

    with pytest.raises(SettingsError, match="there is no checkpoint"):
        trained.start()


def test_a_number_that_there_is_not_is_one_sentence(trained):
    trained.run_env(*CLONE, "DR_LOCAL_S3_PRETRAINED_CHECKPOINT=99")

    with pytest.raises(SettingsError) as caught:
        trained.start()

    assert "There is no checkpoint 99: the newest is 5." in str(caught.value)
    assert "s3://" not in str(caught.value)  # the setting names the model
    assert "cannot be used" not in str(caught.value)


def test_a_damaged_checkpoint_is_refused_and_the_other_one_offered(trained):
    trained.bucket.put(keys.checkpoint_tensors("model-1", "5_Step-500.ckpt"), b"weights ?")
    trained.run_env(*CLONE)

    with pytest.raises(SettingsError) as caught:
        trained.start()

    assert "its last checkpoint cannot be used: " in str(caught.value)
    assert "5_Step-500.ckpt.safetensors is damaged" in str(caught.value)
    assert "DR_LOCAL_S3_PRETRAINED_CHECKPOINT=best" in caught.value.remedy


def test_a_damaged_checkpoint_of_tensorflow_is_named(racer):
    racer.bucket.put("model-1/model/.coach_checkpoint", b"12_Step-7824.ckpt")
    racer.bucket.put("model-1/model/12_Step-7824.ckpt.index", b"")
    racer.bucket.put(keys.model_metadata("model-1"), json.dumps(METADATA).encode())
    racer.bucket.put(keys.hyperparameters("model-1"), b"{}")
    racer.run_env(*CLONE)

    with pytest.raises(SettingsError, match=r"12_Step-7824\.ckpt\.index is not"):
        racer.start()


def test_a_model_without_its_metadata_is_not_complete(trained):
    trained.bucket.delete([keys.model_metadata("model-1")])
    trained.run_env(*CLONE)

    with pytest.raises(SettingsError, match="not complete"):
        trained.start()


def test_a_wipe_that_would_delete_the_pretrained_model_is_refused(trained):
    trained.run_env(
        "DR_LOCAL_S3_MODEL_PREFIX=team",
        "DR_LOCAL_S3_PRETRAINED=True",
        "DR_LOCAL_S3_PRETRAINED_PREFIX=team/model-1",
    )
    for item in trained.bucket.list("model-1/"):
        trained.bucket.put(f"team/{item.key}", trained.bucket.get(item.key))

    with pytest.raises(SettingsError, match="-w would delete that model"):
        trained.start(wipe=True)

    assert trained.store("team/model-1").load_latest() is not None


def test_a_best_checkpoint_that_was_never_evaluated_is_warned_of(racer):
    racer.start()
    racer.store("model-1").save(0, 0, b"weights")
    racer.run_env(*BEST)

    plan = racer.start()

    assert any(
        "no checkpoint of s3://bucket/model-1 has been evaluated yet" in w for w in plan.warnings
    )
