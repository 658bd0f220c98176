"""A training that nobody watches: what it uploads, says and costs when it is complete."""

import json

import pytest

from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from message_servers import hook

pytestmark = pytest.mark.nightly


def test_a_complete_training_uploads_its_best_tells_its_cost_and_runs_a_command(workspace, uploads):
    keys = workspace.folder / "aws-credentials"
    keys.write_text("[up]\naws_access_key_id = AKup\naws_secret_access_key = canary-secret\n")
    workspace.environment |= {
        "AWS_SHARED_CREDENTIALS_FILE": str(keys),
        "AWS_CONFIG_FILE": str(workspace.folder / "none"),
    }
    workspace.hyperparameters["term_cond_max_episodes"] = 2
    workspace.write_custom_files()
    with hook() as server:
        (workspace.folder / "system.env").write_text(
            "DR_CLOUD=local\nDR_LOCAL_S3_BUCKET=bucket\nDR_UPLOAD_S3_BUCKET=uploads\n"
            f"DR_UPLOAD_S3_PROFILE=up\nDR_UPLOAD_S3_ENDPOINT_URL={uploads.endpoint.url}\n"
            f"DR_SPOT_PRICE=3.6\nDR_MAX_COST=50\nDR_WEBHOOK_URL={server.url}\n"
            "DR_MESSAGE_EVENTS=end,upload\n"
        )
        workspace.write_run_env(
            DR_UPLOAD_MODEL_ON_COMPLETION=True, DR_UPLOAD_S3_PREFIX="team/done-1"
        )
        # In this process, so that the command ends when everything is done.
        command = 'echo "$DR_END_STATE $DR_END_COST" > ended.txt; echo "I am done"'
        done = workspace.run("start-training", "--foreground", "--on-end", command, "--json")

    assert done.returncode == 0, f"{done.stderr}\n{workspace.logs()}"
    best = CheckpointStore(ModelStore(uploads, "team/done-1")).best_name()
    report = json.loads(done.stdout.splitlines()[-1])
    assert best == report["best"]["name"]
    state, cost = (workspace.folder / "ended.txt").read_text().split()
    assert state == "finished"
    assert 0.0 < float(cost) < 1.0
    upload, end = server.bodies
    assert upload["event"] == "upload"
    assert "team/done-1" in upload["text"]
    assert end["event"] == "end"
    assert end["facts"]["cost"] == float(cost)

    status = workspace.status()
    assert status["spending"]["starts"] == 1
    assert status["spending"]["usd"] == pytest.approx(float(cost), abs=0.001)
    assert status["money_left"] == pytest.approx(50.0 - float(cost), abs=0.001)
    assert status["iterations"] == 2
    assert status["requests"]["puts"] > 20
    assert status["requests"]["night_usd"] is None  # the bucket is local
    shown = workspace.run("status").stdout
    assert "Spent: 2 iterations" in shown
    assert "that write or list" in shown

    log = workspace.log("supervisor")
    assert "on end: I am done" in log
    assert "Requests to the bucket" in log
    records = "".join(path.read_text("utf-8", "replace") for path in _texts(workspace.folder))
    assert "hook-secret" not in records
    assert "canary-secret" not in records


def _texts(folder):
    """Logs and records of the run, and what lies in the bucket as text."""
    return [
        path
        for path in (folder / "data").rglob("*")
        if path.is_file() and path.suffix in (".log", ".json", ".jsonl", ".yaml", ".csv")
    ]
