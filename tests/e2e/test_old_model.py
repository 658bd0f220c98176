"""Models that earlier versions trained go on here: evaluated, trained further, uploaded."""

import json

import pytest

from old_model import extract_old_model

pytestmark = pytest.mark.nightly


@pytest.fixture
def racer(workspace):
    """A working folder whose bucket holds that model."""
    bucket = workspace.model.parent
    extract_old_model(bucket)
    for name in ("model_metadata.json", "reward_function.py", "hyperparameters.json"):
        (workspace.folder / "custom_files" / name).write_bytes(
            (bucket / "custom_files" / name).read_bytes()
        )
    return workspace


def test_a_model_of_version_0_1_0_is_evaluated_and_trained_further(racer):
    driven = racer.run("evaluate", "--json")
    path = racer.folder / "custom_files" / "hyperparameters.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"term_cond_max_episodes": 2}))
    resumed = racer.run("start-training", "--resume", "--foreground")

    assert driven.returncode == 0, driven.stderr
    assert json.loads(driven.stdout.splitlines()[-1])["trials"]
    assert resumed.returncode == 0, resumed.stderr
    assert [entry["iteration"] for entry in racer.status()["history"]] == [0, 1]
    assert (racer.model / "training-simtrace" / "1-iteration.csv").exists()
    assert "2_Step-" in (racer.model / "model" / "deepracer_checkpoints.json").read_text()


def test_a_model_of_version_0_1_0_can_be_uploaded(racer, uploads):
    racer.environment |= {
        "AWS_ACCESS_KEY_ID": "AKup",
        "AWS_SECRET_ACCESS_KEY": "secret",
    }
    with (racer.folder / "system.env").open("a") as file:
        file.write(
            f"DR_UPLOAD_S3_BUCKET=uploads\nDR_UPLOAD_S3_ENDPOINT_URL={uploads.endpoint.url}\n"
        )

    sent = racer.run("upload-model", "-f")

    stored = {entry.key for entry in uploads.list("model-1/")}
    assert sent.returncode == 0, sent.stderr
    assert "model-1/model/1_Step-144.ckpt.safetensors" in stored


@pytest.mark.parametrize("prefix", ["ppo", "teacher"])
def test_a_model_from_before_msgspec_is_listed_evaluated_and_trained_further(workspace, prefix):
    bucket = workspace.model.parent
    extract_old_model(bucket, "two-models")
    for path in (bucket / "custom_files").iterdir():
        (workspace.folder / "custom_files" / path.name).write_bytes(path.read_bytes())
    workspace.hyperparameters = json.loads(
        (bucket / prefix / "ip/hyperparameters.json").read_text()
    )
    (workspace.folder / "custom_files" / "hyperparameters.json").write_text(
        json.dumps(workspace.hyperparameters | {"num_episodes_between_training": 2})
    )
    workspace.write_run_env(DR_LOCAL_S3_MODEL_PREFIX=prefix, DR_TRAIN_MAX_ITERATIONS=4)

    listed = workspace.run("list-models", "--json")
    driven = workspace.run("evaluate", "--json")
    resumed = workspace.run("start-training", "--resume", "--foreground")

    assert [model["prefix"] for model in json.loads(listed.stdout)["models"]] == ["ppo", "teacher"]
    assert driven.returncode == 0, driven.stderr
    assert json.loads(driven.stdout.splitlines()[-1])["trials"]
    assert resumed.returncode == 0, resumed.stderr
    assert [entry["iteration"] for entry in workspace.status()["history"]] == [0, 1, 2, 3]
