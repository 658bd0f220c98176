"""A bucket with models that tests may delete."""

import pytest

from removable_models import OTHERS, MortalBucket, put_all


@pytest.fixture
def bucket(working_folder, monkeypatch):
    bucket = MortalBucket()
    for module in ("model_removal", "tidy"):
        monkeypatch.setattr(f"drcli.transfer.{module}.open_bucket", lambda *_, **__: bucket)
    (working_folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model-1\n")
    (working_folder / "system.env").write_text("")
    for prefix in ("model-1", *OTHERS):
        put_all(bucket, prefix)
    bucket.put("custom_files/reward_function.py", b"mine")
    return bucket


@pytest.fixture
def settings(bucket, working_folder):
    from drcli.config.loading import load_settings

    return lambda: load_settings(working_folder)
