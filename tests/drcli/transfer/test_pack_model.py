"""Archives of models and logs, for downloads of the console."""

import tarfile

import pytest

from drcli.base.errors import SettingsError
from drcli.model.model_store import ModelStore
from drcli.web.model_work import pack_logs, pack_model
from memory_bucket import MemoryBucket
from removable_models import put_all


@pytest.fixture
def bucket():
    bucket = MemoryBucket()
    for prefix in ("team/model-1", "team/model-1/inner", "team/model-10"):
        put_all(bucket, prefix)
    bucket.put("team/model-1/mp4/camera-pip/0-video.mp4", b"video")
    return bucket


def names(path):
    with tarfile.open(path) as archive:
        return set(archive.getnames())


def test_a_model_is_packed_without_models_beside_and_inside_it(bucket, tmp_path):
    packed = pack_model(ModelStore(bucket, "team/model-1"), tmp_path / "model.tar.gz")

    found = names(packed.file)
    assert {"reward_function.py", "model/.coach_checkpoint", "metrics/history.json"} <= found
    assert not any(name.startswith(("inner", "..", "/")) for name in found)
    assert not any("simtrace" in name or name.endswith(".mp4") for name in found)
    assert packed.files == len(found)


def test_traces_and_videos_are_packed_if_they_are_wanted(bucket, tmp_path):
    packed = pack_model(ModelStore(bucket, "team/model-1"), tmp_path / "model.tar.gz", traces=True)

    assert {"training-simtrace/0-iteration.csv", "mp4/camera-pip/0-video.mp4"} <= names(packed.file)


def test_logs_of_this_machine_come_before_those_of_the_bucket(bucket, tmp_path):
    log = tmp_path / "data" / "logs" / "sagemaker" / "team" / "model-1" / "trainer.log"
    log.parent.mkdir(parents=True)
    log.write_text("newest\n")
    bucket.put("team/model-1/logs/robomaker/sim-0.log", b"elsewhere")

    packed = pack_logs(ModelStore(bucket, "team/model-1"), tmp_path, tmp_path / "logs.tar.gz")

    with tarfile.open(packed.file) as archive:
        own = archive.extractfile("logs/sagemaker/trainer.log")
        assert own is not None
        assert own.read() == b"newest\n"
        assert len(archive.getnames()) == packed.files == 2


def test_what_does_not_exist_leaves_no_file(bucket, tmp_path):
    for pack in (
        lambda path: pack_model(ModelStore(bucket, "team/none"), path),
        lambda path: pack_logs(ModelStore(bucket, "team/none"), tmp_path, path),
        lambda path: pack_logs(ModelStore(bucket, "../.."), tmp_path, path),
    ):
        with pytest.raises(SettingsError, match="has no"):
            pack(tmp_path / "x.tar.gz")
        assert not (tmp_path / "x.tar.gz").exists()


def test_a_file_that_cannot_be_written_is_one_sentence(bucket, tmp_path):
    with pytest.raises(SettingsError, match="cannot be written"):
        pack_model(ModelStore(bucket, "team/model-1"), tmp_path / "missing" / "x.tar.gz")
