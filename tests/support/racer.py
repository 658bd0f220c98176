"""A racer's folder whose bucket is in memory and whose files need no trial."""

import json
from pathlib import Path
from typing import Any

from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.model import lease
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.run.plan import RunPlan, StartOptions, prepare
from memory_bucket import MemoryBucket

ACTIONS = [{"steering_angle": angle, "speed": 2.0} for angle in (-20.0, 0.0, 20.0)]


class Racer:
    """Writes the racer's files and plans trainings from them."""

    def __init__(self, folder: Path, bucket: MemoryBucket) -> None:
        self.folder = folder
        self.bucket = bucket
        (folder / "custom_files").mkdir()
        (folder / "custom_files" / "reward_function.py").write_text("def reward_function(p): ...")
        (folder / "system.env").write_text("")
        self.model_metadata()
        self.hyperparameters()
        self.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1")

    def run_env(self, *lines: str) -> None:
        (self.folder / "run.env").write_text("\n".join(lines) + "\n")

    def model_metadata(self, **changes: Any) -> None:
        values = {
            "action_space": ACTIONS,
            "action_space_type": "discrete",
            "sensor": ["FRONT_FACING_CAMERA"],
            "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
            "training_algorithm": "clipped_ppo",
            "version": "5",
        }
        path = self.folder / "custom_files" / "model_metadata.json"
        path.write_text(json.dumps({**values, **changes}))

    def hyperparameters(self, **values: Any) -> None:
        path = self.folder / "custom_files" / "hyperparameters.json"
        path.write_text(json.dumps(values))

    def settings(self) -> Settings:
        return load_settings(self.folder)

    def start(self, **options: Any) -> RunPlan:
        """Plan a training that ends at once: the prefix is free again."""
        plan = prepare(self.settings(), StartOptions(**options))
        lease.release(ModelStore(self.bucket, plan.job.config.model.prefix), plan.job.session)
        return plan

    def store(self, prefix: str) -> CheckpointStore:
        return CheckpointStore(ModelStore(self.bucket, prefix))

    def note(self, prefix: str) -> dict[str, Any]:
        note: dict[str, Any] = json.loads(self.bucket.get(f"{prefix}/ip/run.json"))
        return note
