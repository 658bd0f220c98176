"""What lies under a prefix, and which command works on it."""

import pytest

from drcli.model.model_prefix import ModelListing, import_command, kind_of, what_helps
from drcli.model.model_store import ModelStore
from memory_bucket import MemoryBucket

FILES = ["reward_function.py", "model/model_metadata.json", "ip/hyperparameters.json"]
POINTERS = ["model/.coach_checkpoint", "model/deepracer_checkpoints.json"]
TENSORFLOW = [f"model/3_Step-9.ckpt{end}" for end in (".index", ".meta", ".data-00000-of-00001")]
OURS = ["model/4_Step-99.ckpt.safetensors", "model/4_Step-99.ckpt.json"]


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        ([], "nothing"),
        (FILES, "files"),
        ([*FILES, *POINTERS, *OURS], "drcli"),
        ([*FILES, *POINTERS, *TENSORFLOW, "model/model_3.pb"], "tensorflow"),
        ([*FILES, *POINTERS, *TENSORFLOW, *OURS], "drcli"),
        ([*FILES, "model/model_3.pb"], "upload"),
        (["3_Step-9.ckpt.index", "model_metadata.json"], "upload"),
        (["training-simtrace/0-iteration.csv"], "traces"),
        (["metrics/TrainingMetrics.json", *FILES], "traces"),
        (["evaluation-20250101120000/evaluation-simtrace/0-iteration.csv"], "traces"),
        (["inner/model/3_Step-9.ckpt.index", "inner/model/model_3.pb"], "files"),
    ],
)
def test_the_kind_follows_from_the_names_of_the_objects(names, kind):
    assert kind_of(names) == kind


@pytest.mark.parametrize(
    ("names", "says"),
    [
        ([], "There is nothing at s3://bucket/team/m: train it with `dr-start-training`"),
        (["holiday.jpg"], "wait for its first iteration; otherwise correct SETTING"),
        (["model/model_3.pb"], "`dr-import -L s3://bucket/team/m -t team/m-imported`"),
        (["metrics/TrainingMetrics.json"], "`dr-analyze team/m`"),
        (TENSORFLOW, "`dr-import -L s3://bucket/team/m -t team/m-imported`"),
        (OURS, "`dr-start-training --resume` reconstructs"),
    ],
)
def test_the_advice_is_one_command_that_works_and_never_to_delete(names, says):
    bucket = MemoryBucket("bucket")
    for name in names:
        bucket.put(f"team/m/{name}", b"")

    told = what_helps(ModelStore(bucket, "team/m"), setting="SETTING")

    assert says in told
    assert "-w" not in told
    assert "delet" not in told


def test_an_import_goes_to_a_name_that_is_free():
    bucket = MemoryBucket("bucket")
    bucket.put("m/model/model_3.pb", b"")
    bucket.put("m-imported/reward_function.py", b"")

    assert (
        import_command(ModelStore(bucket, "m"), local=True)
        == "dr-import -L s3://bucket/m -t m-imported-2"
    )


def test_a_test_object_of_the_doctor_is_no_model():
    bucket = MemoryBucket("bucket")
    bucket.put("m/.drcli-test-1/x", b"")

    assert ModelListing(ModelStore(bucket, "m")).kind == "nothing"
