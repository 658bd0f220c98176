"""What lies at the target after an upload, and what is refused before one."""

import json

import pytest
import yaml

from drcli.base.errors import SettingsError, StorageError
from drcli.model import keys, lease
from drcli.model.best_checkpoint import read_scores
from drcli.model.checkpoint_choice import CheckpointGone
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from memory_bucket import MemoryBucket

from .conftest import driven, put_model

TARGET = "team/model-1"


def test_the_target_holds_one_checkpoint_and_all_that_belongs_to_it(mover, names):
    mover.upload()

    assert names(mover.there, TARGET) == [
        "ip/hyperparameters.json",
        "ip/run.json",
        "metrics/TrainingMetrics.json",
        "metrics/history.json",
        "model/.coach_checkpoint",
        "model/5_Step-500.ckpt.json",
        "model/5_Step-500.ckpt.optimizer.safetensors",
        "model/5_Step-500.ckpt.safetensors",
        "model/deepracer_checkpoints.json",
        "model/model_metadata.json",
        "model_metadata.json",
        "reward_function.py",
        "training_params.yaml",
    ]


@pytest.mark.parametrize(
    ("choice", "line", "weights"),
    [
        ("last", "Latest checkpoint = 5", "weights 5 of design a"),
        ("best", "Best checkpoint: 3", "weights 3 of design a"),
        (3, "Chosen checkpoint: 3", "weights 3 of design a"),
    ],
)
def test_the_chosen_checkpoint_is_the_one_that_drives(mover, choice, line, weights):
    from drcli.transfer.upload import UploadOptions, plan_upload

    planned = plan_upload(mover.settings(), UploadOptions(choice))
    report = mover.upload(choice=choice)

    assert planned.chosen.line == line
    assert driven(mover.there, TARGET) == weights
    assert report.metric == (90.0 if "3" in weights else 50.0)


def test_the_pointers_name_the_chosen_checkpoint_on_one_line(mover):
    mover.upload(choice="best")

    pointer = mover.there.get(keys.coach_checkpoint(TARGET))
    index = mover.there.get(keys.deepracer_checkpoints(TARGET))
    assert pointer == b"3_Step-300.ckpt"
    assert b"\n" not in index
    assert index.startswith(b'{"last_checkpoint": {"name": "3_Step-300.ckpt", "avg_eval_metric": 9')
    entry = json.loads(index)["best_checkpoint"]
    assert (entry["name"], entry["avg_comp_pct"]) == ("3_Step-300.ckpt", 90.0)
    scores = read_scores(ModelStore(mover.there, TARGET))
    assert scores is not None
    assert scores.best_checkpoint.avg_eval_metric == 90.0


def test_checkpoint_1_does_not_bring_10_along(mover, names):
    put_model(mover.here, "team/model", numbers=(1, 10))

    mover.upload(choice=1)

    assert [n for n in names(mover.there, TARGET) if "ckpt" in n] == [
        "model/1_Step-100.ckpt.json",
        "model/1_Step-100.ckpt.safetensors",
    ]


def test_the_parameter_file_names_the_target_and_what_the_model_was_trained_with(mover):
    mover.upload()

    values = yaml.safe_load(mover.there.get(f"{TARGET}/training_params.yaml"))
    assert values["WORLD_NAME"] == "Oval_track"
    assert values["SAGEMAKER_SHARED_S3_BUCKET"] == values["METRICS_S3_BUCKET"] == "uploads"
    assert values["SAGEMAKER_SHARED_S3_PREFIX"] == TARGET
    assert values["METRICS_S3_OBJECT_KEY"] == f"{TARGET}/metrics/TrainingMetrics.json"
    assert values["REWARD_FILE_S3_KEY"] == f"{TARGET}/reward_function.py"
    assert "S3_ENDPOINT_URL" not in values


def test_metrics_that_lie_elsewhere_come_along(mover):
    mover.run_env(
        "DR_WORLD_NAME=oval",
        "DR_LOCAL_S3_MODEL_PREFIX=team/model",
        "DR_LOCAL_S3_METRICS_PREFIX=numbers/of/it",
    )
    mover.here.put("numbers/of/it/evaluation/evaluation-20260101000000.json", b"{}")

    mover.upload()

    assert mover.there.exists(f"{TARGET}/metrics/evaluation/evaluation-20260101000000.json")


def test_a_checkpoint_of_the_reference_is_copied_with_its_three_parts_and_its_graph(mover, names):
    folder = "team/model/model/"
    mover.here.delete([o.key for o in mover.here.list(folder) if "ckpt" in o.key])
    for part in (".index", ".meta", ".data-00000-of-00001"):
        mover.here.put(f"{folder}5_Step-500.ckpt{part}", part.encode())
    mover.here.put(f"{folder}model_5.pb", b"graph")
    mover.here.put(f"{folder}model_50.pb", b"another")

    mover.upload()

    assert [n for n in names(mover.there, TARGET) if "ckpt." in n or ".pb" in n] == [
        "model/5_Step-500.ckpt.data-00000-of-00001",
        "model/5_Step-500.ckpt.index",
        "model/5_Step-500.ckpt.meta",
        "model/model_5.pb",
    ]


def test_p_takes_another_model_under_its_own_name_and_to_gives_it_another(mover):
    put_model(mover.here, "other", numbers=(7,))

    mover.upload(prefix="other")
    mover.upload(prefix="other", to="third")

    assert driven(mover.there, "other") == driven(mover.there, "third") == "weights 7 of design a"


def test_l_stays_in_the_local_bucket(mover):
    report = mover.upload(local=True)

    assert report.target == "s3://bucket/team/model-1"
    assert driven(mover.here, TARGET) == "weights 5 of design a"


def test_a_dry_run_writes_nothing_and_tells_what_an_upload_would_do(mover):
    mover.upload(choice="best")
    before = {o.key: o.etag for o in mover.there.list("")}

    report = mover.upload(dry_run=True, wipe=True)

    assert {o.key: o.etag for o in mover.there.list("")} == before
    assert "model/5_Step-500.ckpt.safetensors" in report.copied
    assert "reward_function.py" in report.unchanged
    assert report.deleted == ["model/3_Step-300.ckpt.json", "model/3_Step-300.ckpt.safetensors"]


def test_an_upload_that_was_made_already_sends_nothing_but_the_pointers(mover):
    mover.upload()

    again = mover.upload()

    assert again.copied == ["model/.coach_checkpoint", "model/deepracer_checkpoints.json"]


def test_older_checkpoints_stay_and_w_deletes_them(mover, names):
    mover.upload(choice="best")

    beside = mover.upload()
    wiped = mover.upload(wipe=True)

    assert (beside.older, beside.deleted) == (["3_Step-300.ckpt"], [])
    assert wiped.deleted == ["model/3_Step-300.ckpt.json", "model/3_Step-300.ckpt.safetensors"]
    assert wiped.older == []
    assert not [n for n in names(mover.there, TARGET) if "3_Step" in n]


@pytest.mark.parametrize(
    ("missing", "name"),
    [
        ("reward_function.py", "reward_function.py"),
        ("ip/hyperparameters.json", "ip/hyperparameters.json"),
        ("model/model_metadata.json", "model/model_metadata.json"),
    ],
)
def test_a_model_without_one_of_its_files_is_refused(mover, missing, name):
    mover.here.delete([f"team/model/{missing}"])

    with pytest.raises(
        SettingsError, match=r"^Meta-data files are not found\. Exiting\."
    ) as caught:
        mover.upload()

    assert name in str(caught.value)


@pytest.mark.parametrize("local", [False, True])
def test_a_model_that_is_not_there_is_refused_before_anything_else(mover, local):
    with pytest.raises(SettingsError, match="There is no model at s3://bucket/nosuch") as caught:
        mover.upload(prefix="nosuch", local=local)

    assert "`dr-list-models`" in caught.value.remedy


def test_a_reward_function_that_is_only_among_the_custom_files_is_found(mover):
    mover.here.delete(["team/model/reward_function.py"])
    mover.here.put("custom_files/reward_function.py", b"mine")

    mover.upload()

    assert mover.there.get(f"{TARGET}/reward_function.py") == b"mine"


def test_a_lost_index_is_written_again_before_an_upload(mover):
    index = keys.deepracer_checkpoints("team/model")
    mover.here.delete([index])

    mover.upload()

    assert mover.here.exists(index)


def test_a_folder_without_checkpoints_is_refused(mover):
    folder = keys.model_folder("team/model")
    everything = [info.key for info in mover.here.list(folder)]
    mover.here.delete(key for key in everything if not key.endswith("model_metadata.json"))

    with pytest.raises(
        SettingsError, match=r"^No checkpoint file available at s3://bucket/team/mod"
    ):
        mover.upload()


@pytest.mark.parametrize("index", [b"{", None])
def test_a_number_needs_no_index(mover, index):
    name = keys.deepracer_checkpoints("team/model")
    mover.here.delete([name])
    if index is not None:
        mover.here.put(name, index)

    report = mover.upload(choice=3)

    assert (report.checkpoint, report.metric) == ("3_Step-300.ckpt", None)
    assert driven(mover.there, TARGET) == "weights 3 of design a"


@pytest.mark.parametrize("name", ["reward_function.py", "model/model_metadata.json"])
def test_an_empty_file_is_not_uploaded(mover, name):
    mover.here.put(f"team/model/{name}", b"")

    with pytest.raises(StorageError, match=f"{name} is empty"):
        mover.upload()

    assert mover.there.list("") == []


@pytest.mark.parametrize("part", [".safetensors", ".json"])
def test_a_checkpoint_with_a_part_missing_is_refused(mover, part):
    mover.here.delete([f"team/model/model/5_Step-500.ckpt{part}"])

    with pytest.raises(CheckpointGone, match=r"^s3://\S+: s3://\S+ is missing\. It has "):
        mover.upload()


def test_a_number_that_is_not_there_is_refused_with_those_that_are(mover):
    with pytest.raises(CheckpointGone, match=r"4 was deleted, .* It has 3 \(best\), 5 \(last\)\."):
        mover.upload(choice=4)


def test_damaged_weights_are_not_uploaded(mover):
    mover.here.put("team/model/model/5_Step-500.ckpt.safetensors", b"something else")

    with pytest.raises(StorageError, match=r"5_Step-500.ckpt.safetensors is damaged"):
        mover.upload()

    assert mover.there.list("") == []


def test_a_damaged_optimizer_state_stays_behind(mover, names):
    mover.here.put("team/model/model/5_Step-500.ckpt.optimizer.safetensors", b"something else")

    mover.upload()

    assert not [n for n in names(mover.there, TARGET) if "optimizer" in n]
    assert (
        CheckpointStore(ModelStore(mover.there, TARGET)).record("5_Step-500.ckpt").optimizer is None
    )


@pytest.mark.parametrize("bucket", ["", "not-defined"])
def test_without_a_bucket_of_uploads_there_is_none(mover, bucket):
    (mover.folder / "system.env").write_text(f"DR_UPLOAD_S3_BUCKET={bucket}\n")

    with pytest.raises(SettingsError, match=r"^No upload bucket defined\. Exiting\."):
        mover.upload()


def test_a_bucket_of_uploads_with_a_folder_is_refused_with_where_to_write_it(mover):
    (mover.folder / "system.env").write_text("DR_UPLOAD_S3_BUCKET=bucket/folder\n")

    with pytest.raises(SettingsError, match="bucket/folder is not the name of a bucket") as caught:
        mover.upload()

    assert caught.value.remedy == "Write bucket, and begin DR_UPLOAD_S3_PREFIX with folder/."


def test_a_model_is_not_uploaded_onto_itself(mover):
    with pytest.raises(SettingsError, match=r"^Target equals source\. Exiting\.") as caught:
        mover.upload(local=True, prefix="team/model")

    assert caught.value.remedy == "Choose another prefix with --to."


def test_a_model_is_not_uploaded_into_itself(mover):
    with pytest.raises(SettingsError, match="wiping one would delete the other"):
        mover.upload(local=True, to="team/model/copy")


@pytest.mark.parametrize("target", ["other/copy", "custom_files", "custom_files/copy"])
def test_a_copy_in_our_own_bucket_must_not_overlap_with_anything(mover, target):
    mover.here.put("other/model/.coach_checkpoint", b"1_Step-5.ckpt")

    with pytest.raises(SettingsError, match="overlaps with"):
        mover.upload(local=True, to=target)


def test_a_copy_does_not_take_another_model_into_its_folder(mover):
    mover.here.put("group/other/model/.coach_checkpoint", b"1_Step-5.ckpt")

    with pytest.raises(SettingsError, match="group overlaps with the model group/other"):
        mover.upload(local=True, to="group")


def test_one_bucket_under_two_addresses_is_recognised(mover):
    class SameBucket(MemoryBucket):
        """The bucket of the working folder, as somebody else reaches it."""

        def __getattribute__(self, name):
            return getattr(mover.here, name)

    mover.use(SameBucket())

    with pytest.raises(SettingsError, match="Target equals source"):
        mover.upload(to="team/model")

    assert not [o for o in mover.here.list("") if "probe" in o.key]


def test_a_bucket_of_the_same_name_elsewhere_is_another_one(mover):
    mover.use(MemoryBucket("bucket"))

    mover.upload(prefix="team/model")

    assert driven(mover.there, "team/model") == "weights 5 of design a"


def test_a_model_that_is_being_trained_is_refused_as_a_target(mover):
    lease.take(ModelStore(mover.here, TARGET), "theirs")

    with pytest.raises(SettingsError, match="model-1 is being trained by process"):
        mover.upload(local=True)


def test_a_name_is_shown_in_the_letters_it_was_written_in(mover):
    with pytest.raises(SettingsError, match=r"^--to 'größe' cannot be the name of a model"):
        mover.upload(to="größe")


@pytest.mark.parametrize("flag", ["prefix", "to"])
def test_a_name_that_no_model_can_have_is_refused(mover, flag):
    with pytest.raises(SettingsError, match="cannot be the name of a model"):
        mover.upload(**{flag: "../etc"})
