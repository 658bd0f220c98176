"""A training with the real trainer and simulation worker, on a bucket in memory."""

import json
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from drcli.config.loading import load_settings
from drcli.model import lease
from drcli.model.model_store import ModelStore
from drcli.records.job import Job
from drcli.run.plan import StartOptions, prepare
from drcli.train.sim import SimWorker
from drcli.train.trainer import learn
from drcli.workers.heartbeat_thread import Heartbeat
from drcli.workers.worker_process import StopRequested
from memory_bucket import MemoryBucket

PREFIX = "team/model"
REWARD = "def reward_function(params):\n    return 1.0\n"


class CopiedBucket(MemoryBucket):
    """Can be copied."""

    def copy_to(self, other: MemoryBucket) -> None:
        """Put all objects into another bucket."""
        for info in self.list(""):
            other.put(info.key, self.get(info.key))


class UntilFailure:
    """The stop_signal of workers that leave when one of them has failed."""

    def __init__(self) -> None:
        self.failures: list[BaseException] = []
        self.heartbeat = Heartbeat()
        self._deadline_s = time.monotonic() + 120.0

    def should_stop(self) -> bool:
        """Whether to leave."""
        return bool(self.failures) or time.monotonic() > self._deadline_s

    step_done = should_stop


class TrainingInMemory:
    """A working folder and a bucket for starts of one training."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch, **settings: Any) -> None:
        self.folder = folder
        self.bucket: Any = CopiedBucket()
        given = {
            "DR_WORLD_NAME": "reinvent_base",
            "DR_LOCAL_S3_MODEL_PREFIX": PREFIX,
            "DR_TRAIN_MIN_EVAL_TRIALS": 1,
            "DR_TRAIN_OVERLAP": "off",
            "DR_TRAIN_SEED": 7,
            **settings,
        }
        self.write("run.env", "".join(f"{name}={value}\n" for name, value in given.items()))
        self.write("system.env", "DR_CLOUD=local\n")
        parameters = {"batch_size": 32, "num_epochs": 1, "num_episodes_between_training": 2}
        actions = [{"steering_angle": s, "speed": 4.0} for s in (-30.0, 30.0)]
        metadata = {
            "action_space": actions,
            "action_space_type": "discrete",
            "sensor": ["FRONT_FACING_CAMERA"],
            "neural_network": "COMPACT_CONVOLUTIONAL_NETWORK",
            "training_algorithm": "clipped_ppo",
            "version": "5",
        }
        self.write("custom_files/hyperparameters.json", json.dumps(parameters))
        self.write("custom_files/model_metadata.json", json.dumps(metadata))
        self.write("custom_files/reward_function.py", REWARD)
        for module in ("run.plan", "workers.worker_process"):
            patch.setattr(f"drcli.{module}.open_bucket", lambda *_, **__: self.bucket)
        patch.setattr("drcli.checks.before_start.try_inputs", lambda *_: [])
        patch.setattr("drcli.model.run_metadata._git", lambda *_: None)

    def write(self, name: str, text: str) -> None:
        """Write a file of the folder."""
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)

    def planned(self, **options: Any) -> Job:
        """The job of a start; its prefix is free again."""
        plan = prepare(load_settings(self.folder, environ={}), StartOptions(**options))
        lease.release(ModelStore(self.bucket, PREFIX), plan.job.session)
        return plan.job

    def train(self, **options: Any) -> None:
        """Train until the end; raises what has ended trainer or simulation worker."""
        job = self.planned(**options)
        stop_signal: Any = UntilFailure()

        def run() -> None:
            try:
                learn(job, stop_signal)
            except BaseException as error:
                stop_signal.failures.append(error)

        # Before the trainer seeds torch for its first weights: this takes random numbers, too.
        worker = SimWorker(job, stop_signal, 0)
        learner = threading.Thread(target=run, daemon=True)
        learner.start()
        try:
            with suppress(StopRequested):
                worker.run()
        except BaseException as error:
            stop_signal.failures.append(error)
        learner.join(120)
        ended = [each for each in stop_signal.failures if not isinstance(each, StopRequested)]
        if ended:
            raise ended[0]
