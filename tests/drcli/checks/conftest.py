"""A working folder in which nothing is wrong, to spoil in one place at a time."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drcli.base.errors import Problem
from drcli.checks.check_report import Report
from drcli.checks.validate import validate
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.rewards.try_inputs import try_inputs
from memory_bucket import MemoryBucket
from sandbox_here import SandboxHere

REWARD = "def reward_function(params):\n    return float(params['speed'])\n"


class Folder:
    """The racer's files, with the values that a test changes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.bucket = MemoryBucket()
        (path / "custom_files").mkdir()
        (path / "system.env").write_text("DR_CLOUD=local\n")
        self.settings()
        self.hyperparameters()
        self.metadata()
        self.reward(REWARD)

    def settings(self, **values: object) -> None:
        own = {"DR_WORLD_NAME": "reinvent_base", "DR_LOCAL_S3_MODEL_PREFIX": "model-1", **values}
        self.write("../run.env", "".join(f"{name}={value}\n" for name, value in own.items()))

    def hyperparameters(self, **values: Any) -> None:
        self.write("hyperparameters.json", json.dumps(values, indent=1))

    def metadata(self, **changes: Any) -> None:
        steering = (-20.0, 0.0, 20.0)
        values = {
            "action_space": [{"steering_angle": angle, "speed": 2.0} for angle in steering],
            "sensor": ["FRONT_FACING_CAMERA"],
            "version": "5",
        }
        self.write("model_metadata.json", json.dumps({**values, **changes}, indent=1))

    def reward(self, text: str) -> None:
        self.write("reward_function.py", text)

    def write(self, name: str, text: str) -> None:
        (self.path / "custom_files" / name).write_text(text, "utf-8")

    def remove(self, name: str) -> None:
        (self.path / "custom_files" / name).unlink()

    def train(self, prefix: str, **metadata: Any) -> None:
        """Put a trained model of these files into the bucket."""
        CheckpointStore(ModelStore(self.bucket, prefix)).save(3, 300, b"weights")
        self.metadata(**metadata)
        custom = self.path / "custom_files"
        for name, key in (
            ("model_metadata.json", f"{prefix}/model/model_metadata.json"),
            ("hyperparameters.json", f"{prefix}/ip/hyperparameters.json"),
        ):
            self.bucket.put(key, (custom / name).read_bytes())
        self.metadata()

    def report(self, *, console: bool = False) -> Report:
        return validate(self.path, console_compatible=console, environ={})

    def breaches(self, rule: str, *, console: bool = False) -> list[Problem]:
        report = self.report(console=console)
        return [
            item for item in (*report.errors, *report.warnings, *report.notes) if item.rule == rule
        ]


@pytest.fixture
def try_here(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Problem]]:
    """What a start finds about the worlds and the reward function, in this process."""

    def find(*arguments: Any, **options: float) -> list[Problem]:
        with monkeypatch.context() as patch:
            patch.setattr(SandboxHere, "options", options)
            patch.setattr("drcli.rewards.try_inputs.Sandbox", SandboxHere)
            return try_inputs(*arguments)

    return find


@pytest.fixture
def folder(
    working_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    try_here: Callable[..., list[Problem]],
) -> Folder:
    """A folder whose bucket is in memory and whose sandbox needs no process."""
    made = Folder(working_folder)

    monkeypatch.setattr("drcli.config.adoption.PROFILES", ())
    monkeypatch.delenv("DR_TRAIN_COMPOSE_FILE", raising=False)
    monkeypatch.setattr("drcli.checks.validate.open_bucket", lambda *_, **__: made.bucket)
    monkeypatch.setattr("drcli.checks.before_start.try_inputs", try_here)
    return made
