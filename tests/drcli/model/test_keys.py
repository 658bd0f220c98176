"""Names in the bucket are those of the console, and are read back as they were written."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drcli.config.value_types import RUN_FOLDERS
from drcli.model import keys, race_keys
from drcli.records.checkpoint import CheckpointName

PREFIX = "team/x/model-1"


def test_a_lone_worker_writes_its_trace_directly_below_the_prefix():
    key = keys.training_trace(PREFIX, 12)

    assert key == "team/x/model-1/training-simtrace/12-iteration.csv"


def test_each_of_several_workers_writes_its_trace_below_its_number():
    key = keys.training_trace(PREFIX, 12, worker=0, workers=2)

    assert key == "team/x/model-1/0/training-simtrace/12-iteration.csv"


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        (keys.model_metadata("m"), "m/model/model_metadata.json"),
        (keys.hyperparameters("m"), "m/ip/hyperparameters.json"),
        (keys.reward_function("m"), "m/reward_function.py"),
        (keys.parameter_file("m", "training_params.yaml"), "m/training_params.yaml"),
        (keys.training_metrics("m/metrics"), "m/metrics/TrainingMetrics.json"),
        (keys.training_metrics("m/metrics", 11), "m/metrics/TrainingMetrics_11.json"),
        (
            keys.evaluation_metrics("m/metrics", "20260102030405"),
            "m/metrics/evaluation/evaluation-20260102030405.json",
        ),
        (
            keys.evaluation_trace("m", "20260102030405"),
            "m/evaluation-20260102030405/evaluation-simtrace/0-iteration.csv",
        ),
        (keys.coach_checkpoint("m"), "m/model/.coach_checkpoint"),
        (keys.deepracer_checkpoints("m"), "m/model/deepracer_checkpoints.json"),
        (
            keys.checkpoint_tensors("m", "12_Step-7824.ckpt"),
            "m/model/12_Step-7824.ckpt.safetensors",
        ),
        (
            keys.checkpoint_optimizer("m", "12_Step-7824.ckpt"),
            "m/model/12_Step-7824.ckpt.optimizer.safetensors",
        ),
        (keys.rollout_manifest("m", 3, 1), "rollouts/m/3/1/manifest.json"),
        (keys.video("m", "camera-pip"), "m/mp4/camera-pip/0-video.mp4"),
        (keys.log("m", "robomaker", "sim-0.log"), "m/logs/robomaker/sim-0.log"),
    ],
)
def test_every_object_lies_where_the_console_puts_it(key, expected):
    assert key == expected


@pytest.mark.parametrize("stamp", ["latest", "2026010203040", "2026-01-02T03:04"])
def test_an_evaluation_is_named_by_fourteen_digits_only(stamp):
    with pytest.raises(ValueError, match="14 digits"):
        keys.evaluation_trace("m", stamp)


def test_a_folder_ends_with_one_slash_so_that_its_neighbour_is_no_part_of_it():
    assert keys.folder("model-1") == keys.folder("model-1/") == "model-1/"
    assert not "model-10/x".startswith(keys.folder("model-1"))


@pytest.mark.parametrize("prefix", ["a", "team/x/model-1", "a.b_c-d"])
def test_prefixes_that_tools_can_read_are_valid(prefix):
    assert keys.is_valid_prefix(prefix)


@pytest.mark.parametrize("prefix", ["", "/a", "a/", "a//b", "a+b", "a b", "../a", "a/./b"])
def test_prefixes_that_break_tools_or_leave_the_bucket_are_not_valid(prefix):
    assert not keys.is_valid_prefix(prefix)


@given(st.integers(0, 10**9), st.integers(0, 10**12))
def test_checkpoint_names_are_read_back_as_written(number, steps):
    name = CheckpointName(number, steps)

    assert CheckpointName.parse(str(name)) == name


def test_checkpoints_are_ordered_by_number_not_by_spelling():
    names = [CheckpointName(10, 1), CheckpointName(9, 5), CheckpointName(9, 40)]

    assert [str(name) for name in sorted(names)] == [
        "9_Step-5.ckpt",
        "9_Step-40.ckpt",
        "10_Step-1.ckpt",
    ]


@pytest.mark.parametrize("text", ["", "12", "12_Step-.ckpt", "x12_Step-1.ckpt", "1_Step-1.ckpt.x"])
def test_other_texts_are_no_checkpoint_names(text):
    assert CheckpointName.parse(text) is None


@pytest.mark.parametrize("ending", [".safetensors", ".optimizer.safetensors", ".json", ".index"])
def test_every_file_of_a_checkpoint_belongs_to_it(ending):
    key = f"{PREFIX}/model/10_Step-7.ckpt{ending}"

    assert keys.checkpoint_of(PREFIX, key) == CheckpointName(10, 7)


@pytest.mark.parametrize(
    "key", [f"{PREFIX}/model/model_10.pb", f"{PREFIX}/10_Step-7.ckpt.json", "model/1_Step-1.ckpt.x"]
)
def test_other_files_belong_to_no_checkpoint(key):
    assert keys.checkpoint_of(PREFIX, key) is None


@given(st.integers(0, 10**6), st.integers(0, 99), st.integers(0, 999))
def test_rollout_keys_are_read_back_as_written(iteration, worker, part):
    key = keys.rollout_part(PREFIX, iteration, worker, "abc", part)

    found = keys.rollout_key(PREFIX, key)

    assert found is not None
    assert (found.iteration, found.worker, found.is_manifest) == (iteration, worker, False)


def test_rollouts_of_a_model_whose_prefix_continues_ours_are_not_ours():
    key = keys.rollout_manifest("a/3", 0, 1)

    assert keys.rollout_key("a", key) is None
    assert keys.rollout_key("a/3", key) is not None


@pytest.mark.parametrize("prefix", ["m", "team/m", "a/training-records/b"])
def test_keys_of_records_of_trainings_are_read_back(prefix):
    assert keys.training_of(keys.training_record(prefix, "0123abcd")) == (prefix, "0123abcd")
    assert keys.training_of(keys.training_files(prefix, "0123abcd")) is None
    assert keys.training_of(keys.training_start(prefix)) is None


def test_what_lies_beside_the_models_is_no_name_for_a_model():
    folders = {
        keys.run_folder("m"),
        keys.rollouts_folder("m"),
        keys.training_records_folder("m"),
        race_keys.folder("m"),
    }

    assert {folder.partition("/")[0] for folder in folders} == set(RUN_FOLDERS)


@pytest.mark.parametrize(
    "key",
    [
        keys.coach_checkpoint("model"),
        keys.deepracer_checkpoints("model"),
        keys.history("model"),
        keys.finished("model"),
        keys.training_trace("model", 3),
        keys.training_metrics("model/metrics"),
        keys.evaluation_result("model", 3),
        keys.rollout_manifest("model", 3, 0),
    ],
)
def test_what_readers_go_by_decides(key):
    assert keys.decides(key)


@pytest.mark.parametrize(
    "key",
    [
        keys.checkpoint_tensors("model", "3_Step-9.ckpt"),
        keys.checkpoint_optimizer("model", "3_Step-9.ckpt"),
        keys.checkpoint_record("model", "3_Step-9.ckpt"),
        keys.rollout_part("model", 3, 0, "start-1-1", 0),
        keys.status("model", "trainer"),
        keys.log("model", "sagemaker", "trainer.log"),
    ],
)
def test_what_another_object_must_name_first_decides_nothing(key):
    assert not keys.decides(key)


def test_a_race_is_known_by_its_rules_and_a_copy_by_its_model():
    copy = race_keys.model("cup", "1-a", "team/model")

    assert race_keys.race_of(race_keys.rules("cup")) == "cup"
    assert race_keys.race_of(race_keys.submission("cup", "race")) is None
    assert (
        race_keys.submitted_model(copy) == race_keys.submitted_model("team/model") == "team/model"
    )
