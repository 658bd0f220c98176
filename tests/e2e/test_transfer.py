"""A model moves between two servers and drives the same laps there."""

import json
from pathlib import Path

import pytest

from drcli.bucket.s3_bucket import S3Bucket
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore

pytestmark = pytest.mark.nightly

URL = "s3://uploads/team/fast-2"


def write_profile(folder: Path, *lines: str) -> dict[str, str]:
    """AWS files with one profile, and the environment that leads there."""
    config, keys = folder / "aws-config", folder / "aws-credentials"
    config.write_text("[profile up]\nregion = us-east-1\n" + "".join(f"{x}\n" for x in lines))
    keys.write_text("[up]\naws_access_key_id = AKup\naws_secret_access_key = secret\n")
    return {"AWS_CONFIG_FILE": str(config), "AWS_SHARED_CREDENTIALS_FILE": str(keys)}


def whole(bucket: S3Bucket, prefix: str) -> str:
    """The checkpoint that a model's pointers agree on, read and checked."""
    store = CheckpointStore(ModelStore(bucket, prefix))
    name = store.best_name()
    assert name is not None
    assert name == str(store.pointed())
    return store.load(name).record.name


def test_an_uploaded_model_drives_the_same_laps_elsewhere(new_workspace, uploads):
    home, away = new_workspace(), new_workspace()
    home.hyperparameters["term_cond_max_episodes"] = 2
    home.write_custom_files()
    home.write_run_env(DR_UPLOAD_S3_PREFIX="team/fast-1", DR_EVAL_CHECKPOINT="best")
    common = "DR_CLOUD=local\nDR_LOCAL_S3_BUCKET={}\nDR_UPLOAD_S3_BUCKET=uploads\n"
    common += "DR_UPLOAD_S3_PROFILE=up\n"
    (home.folder / "system.env").write_text(common.format("bucket"))
    (away.folder / "system.env").write_text(
        common.format("other-bucket") + f"DR_UPLOAD_S3_ENDPOINT_URL={uploads.endpoint.url}\n"
    )
    home.environment |= write_profile(home.folder, f"endpoint_url = {uploads.endpoint.url}")
    away.environment |= write_profile(away.folder)
    assert home.run("start-training", "-q").returncode == 0
    home.wait_for(lambda: home.iterations() >= 1, "the first iteration")

    running = home.run("upload-model", "-f", "--json")
    home.wait_for(lambda: home.record()["state"] == "finished", "the end of the training")
    stepped = home.run("increment-upload-model", "-f")
    sent = [home.start("upload-model", *options) for options in (("-bf",), ("-fw",), ("-bfw",))]
    crossed = [process.communicate(timeout=60) for process in sent]
    from_running, after_crossing = (whole(uploads, f"team/fast-{n}") for n in (1, 2))
    last = home.run("upload-model", "-bf", "--json")
    fetched = away.run("download-model", "-fc", "-s", URL, "-t", "mine", "--json")
    away.write_run_env(DR_LOCAL_S3_MODEL_PREFIX="mine", DR_EVAL_CHECKPOINT="last")
    at_home = home.run("evaluate", "--json")
    abroad = away.run("evaluate", "--json")

    assert running.returncode == 0, running.stderr
    assert stepped.returncode == 0, stepped.stderr
    assert [p.returncode for p in sent] == [0, 0, 0], crossed
    assert last.returncode == 0, last.stderr
    assert fetched.returncode == 0, fetched.stderr
    checkpoint = json.loads(last.stdout)["checkpoint"]
    assert from_running == json.loads(running.stdout)["checkpoint"]
    assert after_crossing
    assert json.loads(fetched.stdout)["checkpoint"] == checkpoint
    reward = "custom_files/reward_function.py"
    assert (away.folder / reward).read_text() == (home.folder / reward).read_text()
    assert (at_home.returncode, abroad.returncode) == (0, 0), at_home.stderr + abroad.stderr
    here, there = (json.loads(done.stdout.splitlines()[-1]) for done in (at_home, abroad))
    assert here["checkpoint"] == there["checkpoint"] == checkpoint
    assert here["trials"]
    assert here["trials"] == there["trials"]
    kept = away.folder / "data" / "s3" / "other-bucket"
    assert [path.name for path in kept.iterdir()] == ["mine"]
