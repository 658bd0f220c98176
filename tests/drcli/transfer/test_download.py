"""A model that is fetched is the model that was there, and nothing of the racer's is lost."""

import hashlib
from dataclasses import replace

import pytest
import yaml

from drcli.base.errors import SettingsError, StorageError
from drcli.model import keys, lease
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.transfer.download import DownloadOptions, plan_download
from evaluations import evaluated
from memory_bucket import MemoryBucket

from .conftest import driven, put_model

URL = "s3://uploads/theirs/fast"


@pytest.fixture
def theirs(mover):
    """Somebody's model in the bucket of uploads."""
    put_model(mover.there, "theirs/fast", numbers=(2, 8))
    mover.use_as_source()
    return mover.there


def test_everything_but_the_signals_of_a_training_is_fetched(mover, theirs, names):
    report = mover.download(URL, "mine")

    fetched = names(mover.here, "mine")
    assert fetched == [n for n in names(theirs, "theirs/fast") if n != "model/.finished"]
    assert sorted(report.copied) == fetched
    assert driven(mover.here, "mine") == "weights 2 of design a"
    assert report.checkpoint == "8_Step-800.ckpt"


SAC = (
    b'{"training_algorithm": "sac", "action_space_type": "continuous", "action_space": '
    b'{"steering_angle": {"low": -20, "high": 20}, "speed": {"low": 1, "high": 2}}, '
    b'"sensor": ["FRONT_FACING_CAMERA"], "version": "5"}'
)


@pytest.mark.parametrize(("metadata", "left"), [(SAC, 3_000_000), (None, 0)])
def test_a_copy_of_a_sac_model_says_that_its_replay_buffer_stays_there(
    mover, theirs, metadata, left
):
    if metadata is not None:
        theirs.put(keys.model_metadata("theirs/fast"), metadata)
    theirs.put(keys.rollout_part("theirs/fast", 7, 0, "session", 0), bytes(3_000_000))
    theirs.put(keys.rollout_part("theirs/fast/other", 7, 0, "session", 0), bytes(5))

    report = mover.download(URL, "mine")

    assert report.replay_bytes == left
    assert (
        "Its replay buffer (3.0 MB) is not copied" in " ".join(map(str, report.view()))
    ) == bool(left)


@pytest.mark.parametrize(
    ("bucket", "local", "command"),
    [
        ("uploads", False, "`dr-list-models --upload`"),
        ("others", False, "`DR_UPLOAD_S3_BUCKET=others dr-list-models --upload`"),
        ("bucket", True, "`dr-list-models`"),
        ("others", True, "`DR_LOCAL_S3_BUCKET=others dr-list-models`"),
    ],
)
def test_a_model_that_is_not_there_is_refused_with_the_command_that_lists_those_that_are(
    mover, theirs, bucket, local, command
):
    with pytest.raises(SettingsError, match="There is nothing") as caught:
        mover.download(f"s3://{bucket}/nosuch", "mine", local=local)

    assert command in caught.value.remedy


def test_a_model_with_an_empty_file_is_refused(mover, theirs):
    theirs.put("theirs/fast/reward_function.py", b"")

    with pytest.raises(SettingsError, match=r"Exiting\. reward_function\.py is empty\."):
        mover.download(URL, "mine")


def test_damaged_weights_name_their_source_and_do_not_become_a_model_here(mover, theirs):
    theirs.put("theirs/fast/model/8_Step-800.ckpt.safetensors", b"")

    with pytest.raises(StorageError, match="s3://uploads/theirs/fast is damaged there"):
        mover.download(URL, "mine")

    assert driven(mover.here, "mine") is None


def test_the_parameter_file_names_the_copy(mover, theirs):
    mover.download(URL, "mine")

    values = yaml.safe_load(mover.here.get("mine/training_params.yaml"))
    assert values["SAGEMAKER_SHARED_S3_BUCKET"] == "bucket"
    assert values["SAGEMAKER_SHARED_S3_PREFIX"] == "mine"


def test_other_objects_stay_and_w_deletes_them(mover, theirs, names):
    mover.here.put("mine/note.txt", b"?")

    beside = mover.download(URL, "mine")
    wiped = mover.download(URL, "mine", wipe=True)

    assert beside.strays == ["note.txt"]
    assert wiped.deleted == ["note.txt"]
    assert "note.txt" not in names(mover.here, "mine")


def test_a_dry_run_writes_nothing(mover, theirs):
    before = [o.key for o in mover.here.list("")]

    report = mover.download(URL, "mine", dry_run=True)

    assert [o.key for o in mover.here.list("")] == before
    assert "model/8_Step-800.ckpt.safetensors" in report.copied


def test_a_dry_run_lists_what_exists_already_and_what_would_be_deleted(mover):
    class WithMd5(MemoryBucket):
        """Its listings tell MD5s, as those of most servers do."""

        def list(self, folder):
            return [
                replace(info, etag=hashlib.md5(self.get(info.key)).hexdigest())
                for info in super().list(folder)
            ]

    mover.use(WithMd5("uploads"))
    mover.use_as_source()
    put_model(mover.there, "theirs/fast", numbers=(2, 8))
    mover.download(URL, "mine")
    mover.here.put("mine/note.txt", b"?")

    wiping = mover.download(URL, "mine", dry_run=True, wipe=True)
    keeping = mover.download(URL, "mine", dry_run=True)

    assert "model/8_Step-800.ckpt.safetensors" in wiping.unchanged
    assert "model/8_Step-800.ckpt.safetensors" not in wiping.copied
    assert (wiping.deleted, wiping.strays) == (["note.txt"], [])
    assert (keeping.deleted, keeping.strays) == ([], ["note.txt"])
    assert mover.here.exists("mine/note.txt")


def test_an_interrupted_download_is_not_a_model_until_it_is_repeated(mover, theirs):
    class CutError(Exception):
        pass

    class Breaking(MemoryBucket):
        left = 9

        def put(self, key, data, *, watch=None):
            self.left -= 1
            if not self.left:
                raise CutError
            super().put(key, data, watch=watch)

    mover.here = Breaking("bucket")
    with pytest.raises(CutError):
        mover.download(URL, "mine")
    halfway = driven(mover.here, "mine")

    report = mover.download(URL, "mine")

    assert halfway is None
    assert driven(mover.here, "mine") == "weights 2 of design a"
    assert report.unchanged


def test_c_fills_custom_files_and_keeps_what_was_different(mover, theirs):
    custom = mover.folder / "custom_files"
    custom.mkdir()
    (custom / "reward_function.py").write_text("mine")
    (custom / "model_metadata.json").write_bytes(
        theirs.get("theirs/fast/model/model_metadata.json")
    )

    report = mover.download(URL, "mine", custom_files=True)

    assert report.custom_files == [
        str(custom / "reward_function.py"),
        str(custom / "hyperparameters.json"),
    ]
    assert (custom / "reward_function.py").read_bytes() == theirs.get(
        "theirs/fast/reward_function.py"
    )
    assert (custom / "reward_function.py.bak").read_text() == "mine"
    assert not (custom / "model_metadata.json.bak").exists()


def test_c_fills_the_folder_of_the_experiment(mover, theirs):
    experiment = mover.folder / "experiments" / "first"
    experiment.mkdir(parents=True)
    (experiment / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model\n")
    (mover.folder / "system.env").write_text("DR_EXPERIMENT_NAME=first\n")

    mover.download(URL, "mine", custom_files=True)

    assert (experiment / "custom_files" / "reward_function.py").is_file()
    assert not (mover.folder / "custom_files").exists()


@pytest.mark.parametrize(
    "missing", ["reward_function.py", "ip/hyperparameters.json", "model/model_metadata.json"]
)
def test_a_model_that_lacks_one_of_its_files_is_refused(mover, theirs, missing):
    theirs.delete([f"theirs/fast/{missing}"])

    with pytest.raises(SettingsError) as caught:
        mover.download(URL, "mine")

    assert str(caught.value).startswith(
        f"Meta-data files are not found. Source model {URL} not valid. Exiting."
    )
    assert missing in str(caught.value)


@pytest.mark.parametrize("url", ["theirs/fast", "s3://uploads", "s3://uploads/", "http://x/y", ""])
def test_an_address_that_is_none_is_refused(mover, theirs, url):
    with pytest.raises(SettingsError, match="is not the address of a model"):
        mover.download(url, "mine")


def test_a_slash_at_the_end_of_address_and_name_does_not_matter(mover, theirs):
    mover.download(URL + "/", "mine/")

    assert driven(mover.here, "mine") == "weights 2 of design a"


def test_a_model_that_is_being_trained_is_not_overwritten(mover, theirs):
    lease.take(ModelStore(mover.here, "mine"), "session")

    with pytest.raises(SettingsError, match="is being trained"):
        mover.download(URL, "mine")


def test_a_model_whose_index_names_a_missing_checkpoint_is_refused(mover, theirs):
    theirs.delete([keys.checkpoint_tensors("theirs/fast", "8_Step-800.ckpt")])

    with pytest.raises(StorageError, match=r"8_Step-800\.ckpt\.safetensors is missing"):
        mover.download(URL, "mine")

    assert driven(mover.here, "mine") is None


def test_an_incomplete_source_does_not_damage_the_model_at_the_target(mover, theirs):
    put_model(mover.here, "mine", design="b")
    theirs.delete([keys.checkpoint_tensors("theirs/fast", "8_Step-800.ckpt")])

    with pytest.raises(StorageError, match=r"theirs/fast/model/8_Step-800\.ckpt\.safetensors is"):
        mover.download(URL, "mine", wipe=True)

    assert driven(mover.here, "mine") == "weights 3 of design b"


@pytest.mark.parametrize(
    ("name", "best"),
    [("coach_checkpoint", "weights 2"), ("deepracer_checkpoints", "weights 8")],
)
def test_a_source_whose_pointer_is_damaged_comes_with_one_that_is_worked_out(
    mover, theirs, name, best, told
):
    theirs.put(getattr(keys, name)("theirs/fast"), b"\xff")

    mover.download(URL, "mine")

    assert driven(mover.here, "mine") == f"{best} of design a"
    assert any(getattr(keys, name)("theirs/fast") in sentence for sentence in told)
    assert theirs.get(getattr(keys, name)("theirs/fast")) == b"\xff"


def test_a_source_that_is_pruned_while_it_is_looked_at_is_looked_at_again(mover):
    class Pruning(MemoryBucket):
        pruned = False

        def list(self, folder):
            if not self.pruned:
                self.pruned = True
                store = CheckpointStore(ModelStore(self, "theirs/fast"))
                store.save(9, 900, b"weights 9 of design a")
                store.record_evaluation(evaluated("9_Step-900.ckpt", 95.0), "progress")
                doomed = keys.checkpoint_part("theirs/fast", "2_Step-200.ckpt", "")
                self.delete([o.key for o in super().list(folder) if o.key.startswith(doomed)])
            return super().list(folder)

    bucket = Pruning("uploads")
    bucket.pruned = True
    put_model(bucket, "theirs/fast", numbers=(2,))
    bucket.pruned = False
    mover.use(bucket)
    mover.use_as_source()

    mover.download(URL, "mine")

    assert driven(mover.here, "mine") == "weights 9 of design a"


def test_weights_that_are_damaged_at_the_source_are_found_out(mover, theirs):
    theirs.put(keys.checkpoint_tensors("theirs/fast", "2_Step-200.ckpt"), b"?")

    with pytest.raises(StorageError, match="is damaged"):
        mover.download(URL, "mine")

    assert driven(mover.here, "mine") is None


@pytest.mark.parametrize("data", [b"", b"as many but other bytes"])
def test_damaged_weights_do_not_replace_a_whole_model(mover, theirs, data):
    put_model(mover.here, "mine", design="b")
    theirs.put(keys.checkpoint_tensors("theirs/fast", "8_Step-800.ckpt"), data)

    with pytest.raises(StorageError, match="damaged"):
        mover.download(URL, "mine", wipe=True)

    assert driven(mover.here, "mine") == "weights 3 of design b"


def test_a_model_that_trains_on_while_it_is_fetched_comes_with_its_newest_checkpoint(mover):
    class Training(MemoryBucket):
        steps = 4

        def get(self, key, *, watch=None):
            if self.steps and key.endswith(".coach_checkpoint"):
                number, self.steps = 10 * (5 - self.steps), self.steps - 1
                left, self.steps = self.steps, 0
                put_model(self, "theirs/fast", numbers=(number,))
                self.steps = left
            return super().get(key, watch=watch)

    bucket = Training("uploads")
    bucket.steps = 0
    put_model(bucket, "theirs/fast", numbers=(2,))
    bucket.steps = 4
    mover.use(bucket)
    mover.use_as_source()

    mover.download(URL, "mine")

    assert driven(mover.here, "mine") == "weights 40 of design a"


def test_a_model_of_the_reference_is_recognised(mover):
    put_model(mover.there, "theirs", numbers=(3,))
    folder = "theirs/model/3_Step-300.ckpt"
    mover.there.delete([f"{folder}.safetensors", f"{folder}.json"])
    for end in (".index", ".meta", ".data-00000-of-00001"):
        mover.there.put(folder + end, b"tensors")
    mover.use_as_source()
    options = DownloadOptions("s3://uploads/theirs", "model-1")

    plan_download(mover.settings(), options)  # a copy drives and trains, as the model does

    mover.there.delete(["theirs/ip/hyperparameters.json"])
    with pytest.raises(SettingsError, match=r"hyperparameters\.json is missing") as caught:
        plan_download(mover.settings(), options)
    assert "`dr-import s3://uploads/theirs -t theirs-imported`" in caught.value.remedy
