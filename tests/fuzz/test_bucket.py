"""No damaged object of the bucket ends in a traceback, a hang, or half of a change."""

from typing import Any

import pytest
from hypothesis import strategies as st

import damage
from exploring import explore

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(0)]

SHARE = 0.15
"""Of the time of the long form, for all objects together."""

COMMANDS = (
    *("status", "status --json", "summary", "validate", "list-models", "list-models --json", "url"),
    *("start-training -q", "start-training --resume -q", "start-training -w -q", "evaluate -q"),
    *("upload-model -f", "upload-model -f -b", "upload-model -d", "export pb -f --out policy.pb"),
    *("export car -o car.tar.gz", "export droa --out there", "export tf-checkpoint --out there"),
    *("download-model -s s3://bucket/model -t new -f", "increment-training -f", "stop-training"),
    *(
        "import s3://bucket/model -t new -f --no-drive",
        "download-custom-files",
        "upload-car-zip -f",
    ),
    *("list-aws-models", "stop-evaluation"),
)

OBJECTS = {
    "model/model/deepracer_checkpoints.json": damage.json_file,
    "model/model/1_Step-144.ckpt.json": damage.json_file,
    "model/model/1_Step-144.ckpt.safetensors": damage.any_bytes,
    "model/model/.coach_checkpoint": damage.text,
    "model/model/.finished": damage.json_file,
    "model/model/model_metadata.json": damage.json_file,
    "model/reward_function.py": damage.program,
    "model/metrics/TrainingMetrics.json": damage.json_file,
    "model/metrics/history.json": damage.json_file,
    "model/ip/run.json": damage.json_file,
    "model/ip/hyperparameters.json": damage.json_file,
    "model/training-simtrace/0-iteration.csv": damage.text,
    "model/training_params.yaml": damage.text,
    "runs/model/status/sim-0.json": damage.json_file,
    "runs/model/status/trainer.json": damage.json_file,
    "runs/model/evaluations/0.json": damage.json_file,
    "runs/model/lease.json": damage.json_file,
    "custom_files/hyperparameters.json": damage.json_file,
}
"""Objects, and the damage that they meet."""


@pytest.mark.parametrize("key", OBJECTS)
def test_any_damage_to_an_object(space, key):
    def check(example: Any) -> None:
        change, command = example
        space.restore()
        path = space.bucket / key
        space.put("bucket", key, change(path.read_bytes()))
        space.call(command.split())

    explore(
        st.tuples(OBJECTS[key], st.sampled_from(COMMANDS)),
        check,
        few=1,
        share=SHARE / len(OBJECTS),
    )
