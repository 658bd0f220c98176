"""Keys that may only use the folders of one model are enough for a training of it."""

import pytest

from drcli.base.errors import StorageError
from drcli.bucket.s3_bucket import S3Bucket
from drcli.checks.doctor.bucket_health import try_bucket
from drcli.checks.start_rules import probe
from drcli.model.model_store import ModelStore
from racer import Racer
from refusing_s3 import refusing_server

FOLDERS = ("model-1/", "runs/model-1/", "rollouts/model-1/", "custom_files/")


@pytest.fixture
def limited():
    """A bucket whose keys may use the folders of model-1 and no other."""
    with refusing_server() as (endpoint, refusals):
        bucket = S3Bucket(endpoint, "bucket", patience_s=0.2)
        bucket.ensure_exists()
        refusals.only = FOLDERS
        yield bucket
        refusals.only = ()
        bucket.delete([info.key for info in bucket.list("")])  # all servers here share their memory
        bucket.close()


def test_a_training_starts_with_keys_for_its_own_folders(
    limited, working_folder, monkeypatch, told
):
    monkeypatch.setattr("drcli.run.plan.open_bucket", lambda *_, **__: limited)
    monkeypatch.setattr("drcli.checks.before_start.try_inputs", lambda *_: [])

    plan = Racer(working_folder, limited).start()

    assert plan.job.config.model.prefix == "model-1"
    assert limited.exists("model-1/ip/run.json")
    # These keys may not write records of trainings, which is told and keeps nothing from starting.
    assert plan.job.training == ""
    assert any("The record of this training could not be written" in text for text in told)


def test_such_keys_pass_the_checks_and_the_doctor(limited):
    assert probe(ModelStore(limited, "model-1")) == []
    assert try_bucket(limited, FOLDERS, seconds=5).worked == list(FOLDERS)


def test_the_folders_of_another_model_stay_refused(limited):
    with pytest.raises(StorageError, match="lack the permission"):
        probe(ModelStore(limited, "model-2"))
