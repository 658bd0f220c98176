"""SAC, several sensors and several workers with races of their own, through the real commands."""

import csv
import json

import pytest

from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore

pytestmark = pytest.mark.nightly

METADATA = {
    "action_space": {
        "steering_angle": {"low": -30, "high": 30},
        "speed": {"low": 0.8, "high": 1.6},
    },
    "action_space_type": "continuous",
    "sensor": ["STEREO_CAMERAS", "SECTOR_LIDAR"],
    "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
    "training_algorithm": "sac",
    "version": "5",
}


def test_sac_learns_from_two_workers_in_two_worlds_and_goes_on_with_its_memory(workspace, log_guru):
    workspace.hyperparameters |= {
        "term_cond_max_episodes": 2,
        "stack_size": 2,
        "exploration_type": "additive_noise",
        "sac_learning_starts": 20,
        "sac_updates_per_step": 0.05,
    }
    workspace.write_custom_files()
    (workspace.folder / "custom_files" / "model_metadata.json").write_text(json.dumps(METADATA))
    workspace.write_run_env(DR_WORKERS=2, DR_TRAIN_MULTI_CONFIG=True, DR_TRAIN_OVERLAP="on")
    (workspace.folder / "worker-2.env").write_text(
        "DR_WORLD_NAME=bean\n\nDR_RACE_TYPE=OBJECT_AVOIDANCE\nDR_OA_NUMBER_OF_OBSTACLES=2\n"
    )

    trained = workspace.run("start-training", "--json")
    workspace.hyperparameters["term_cond_max_episodes"] = 3
    (workspace.folder / "custom_files" / "hyperparameters.json").write_text(
        json.dumps(workspace.hyperparameters)
    )
    resumed = workspace.run("start-training", "--resume", "--json")
    evaluated = workspace.run("evaluate", "--json")

    assert trained.returncode == 0, trained.stderr + workspace.logs()
    assert resumed.returncode == 0, resumed.stderr + workspace.logs()
    assert evaluated.returncode == 0, evaluated.stderr
    model = workspace.model
    assert (model / "0" / "training-simtrace" / "0-iteration.csv").exists()
    assert (model / "1" / "training-simtrace" / "0-iteration.csv").exists()
    assert (model / "metrics" / "TrainingMetrics_1.json").exists()
    assert "'WORLD_NAME': 'bean'" in (model / "training_params_2.yaml").read_text()
    names = [r["checkpoint"] for r in json.loads(resumed.stdout.splitlines()[-1])["history"]]
    # Each was driven while the one before was learned from. Whether the third had been driven
    # before the stop, or was driven anew by the newest, is a matter of time.
    assert [name.split("_")[0] for name in names[:2]] == ["0", "0"]
    assert names[2].split("_")[0] in ("1", "2")
    assert "steps of iteration 1." in workspace.log("trainer")  # remembered after the resume
    latest = CheckpointStore(ModelStore(workspace.bucket(), workspace.prefix)).load_latest(
        with_optimizer=True
    )
    assert latest is not None
    assert latest.optimizer is not None
    assert latest.record.counters.number_format in ("fp32", "bf16")
    rows = list(csv.DictReader((model / "metrics" / "learner.csv").read_text().splitlines()))
    assert [row["iteration"] for row in rows] == ["0", "1", "2"]
    assert all(float(row["losses/actor_loss"]) and float(row["losses/alpha"]) for row in rows)
    assert "losses/approx_kl" not in rows[0]
    assert "KL" not in workspace.log("trainer")
    # Driven again after the resume or not, each of a worker's episodes is in its log once; where
    # driving and learning overlap, one iteration more may have been driven.
    for worker in ("sim-0", "sim-1"):
        reading = log_guru(workspace.log(worker))
        assert reading.continuous
        assert len(reading.episodes) in (6, 8)
