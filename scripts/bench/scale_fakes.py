"""A training in one process whose workers, learner and bucket cost sleep instead of processor time.

The loops of workers and trainer, the exchange and all files are the real ones. Driving is replaced
by episodes of drawn lengths, an update by a pause, and each request to the bucket waits, as one to
Amazon's S3 would. So eight workers need no eight machines, and other programs hardly matter.
"""

import argparse
import json
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from drcli.bucket.bucket import Listing, Watch
from drcli.config.loading import load_settings
from drcli.drive.driving import Driven, Plan
from drcli.learn.ppo import PPO
from drcli.learn.rollout_buffer import Rollout
from drcli.learn.update_result import PPOStats
from drcli.model import lease
from drcli.model.history import read_history
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import checkpoint_name
from drcli.records.trace import STEP_S, Row
from drcli.run.plan import StartOptions, prepare
from drcli.train.sim import SimWorker
from drcli.train.trainer import learn
from drcli.train.training_simulation import TrainingSimulation
from drcli.workers.heartbeat_thread import Heartbeat
from drcli.workers.worker_process import StopRequested

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))
from memory_bucket import MemoryBucket

ROOT = Path(__file__).resolve().parents[2]

PREFIX = "scale"

PUT_S, GET_S, LIST_S = 0.04, 0.03, 0.05
"""Of a request: 20 ms round trip and the time that S3 needs."""

EPISODE_STEPS, EPISODE_SPREAD = 15.0, 0.4
"""Mean length of an episode, and its standard deviation as a share of it: those of a policy that
has not learned yet (measured: 14 steps, 0.40)."""


class SlowBucket(MemoryBucket):
    """Answers after some time.

    Attributes:
        requests: By kind, counted over all copies.
    """

    def __init__(self) -> None:
        super().__init__()
        self.requests = {"put": 0, "get": 0, "list": 0}

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        """Read an object."""
        self._wait("get", GET_S)
        return super().get(key, watch=watch)

    def get_with_age(self, key: str) -> tuple[bytes, float | None]:
        """Read an object and its age."""
        self._wait("get", GET_S)
        return super().get_with_age(key)

    def exists(self, key: str) -> bool:
        """Whether there is an object under this key."""
        self._wait("get", GET_S)
        return super().exists(key)

    def put(self, key: str, data: bytes, *, watch: Watch | None = None) -> None:
        """Write an object."""
        self._wait("put", PUT_S)
        super().put(key, data, watch=watch)

    def delete(self, keys: Iterable[str]) -> None:
        """Delete objects."""
        doomed = list(keys)
        if doomed:
            self._wait("put", PUT_S)
        super().delete(doomed)

    def list(self, folder: str) -> Listing:
        """List a folder."""
        self._wait("list", LIST_S)
        return super().list(folder)

    def probe(self, folder: str) -> None:
        """It always answers."""

    def _wait(self, kind: str, seconds: float) -> None:
        self.requests[kind] += 1
        time.sleep(seconds)


class Together:
    """The stop_signal of all workers: they leave when one of them has failed."""

    def __init__(self) -> None:
        self.failures: list[BaseException] = []
        self.heartbeat = Heartbeat()

    def should_stop(self) -> bool:
        """Whether to leave."""
        return bool(self.failures)

    step_done = should_stop


def sleeping_drive(step_s: float) -> Callable[..., None]:
    """A stand-in for `TrainingSimulation.drive`: cars take turns, each step takes so long."""

    def drive(
        self: TrainingSimulation,
        plans: list[Plan],
        on_end: Callable[[Driven], None],
        should_stop: Callable[[], bool],
        policy_steps: int,
    ) -> None:
        for plan in plans:
            draw = np.random.default_rng([self.share.worker, plan.number])
            shape = EPISODE_SPREAD**-2
            steps = max(1, round(draw.gamma(shape, EPISODE_STEPS / shape)))
            evaluates = plan.phase == "evaluation"
            time.sleep(0.0 if evaluates else steps * step_s)
            if should_stop():
                raise StopRequested
            on_end(_episode(plan, steps))

    return drive


def _episode(plan: Plan, steps: int) -> Driven:
    rows = [
        Row(
            steps=step + 1,
            x=0.0,
            y=0.0,
            yaw_deg=0.0,
            steering_deg=0.0,
            speed_mps=1.0,
            action="0",
            reward=1.0,
            done=step == steps,
            all_wheels_on_track=True,
            progress=float(step),
            closest_waypoint=0,
            status="off_track" if step == steps else "in_progress",
            pause_s=0.0,
            time_s=step * STEP_S,
            crashes=0,
        )
        for step in range(steps + 1)
    ]
    frame, nothing = np.zeros((1, 12, 16), np.uint8), np.zeros(0, np.float32)
    samples = [(frame, nothing, nothing, 0, -1.0, 0.0, True)] * steps
    return Driven(plan.number, plan.phase, rows=rows, samples=samples)


def sleeping_update(step_s: float) -> Callable[..., list[PPOStats]]:
    """A stand-in for `PPO.update`: each step takes so long."""

    def update(self: PPO, rollout: Rollout, seed: int, **_: Any) -> list[PPOStats]:
        time.sleep(rollout.steps * step_s)
        return []

    return update


def measured(
    workers: int, lag: int, episodes: int, step_s: float, learn_step_s: float, iterations: int
) -> dict[str, Any]:
    """Train for so many iterations; the first ones do not count.

    Args:
        workers: Simulation workers.
        lag: DR_TRAIN_MAX_LAG, 0 for DR_TRAIN_OVERLAP=off.
        episodes: Of an iteration.
        step_s: Time of a worker for a step of a car.
        learn_step_s: Time of the learner for a step.
        iterations: How many.
    """
    bucket, stop_signal = SlowBucket(), Together()
    together: Any = stop_signal
    with tempfile.TemporaryDirectory(prefix="scale-") as folder, ExitStack() as patches:
        for module in ("run.plan", "workers.worker_process"):
            patches.enter_context(patch(f"drcli.{module}.open_bucket", lambda *_, **__: bucket))
        patches.enter_context(patch("drcli.checks.before_start.try_inputs", lambda *_: []))
        patches.enter_context(patch.object(TrainingSimulation, "drive", sleeping_drive(step_s)))
        patches.enter_context(patch.object(PPO, "update", sleeping_update(learn_step_s)))
        job = _job(Path(folder), workers, lag, episodes, iterations)
        lease.release(ModelStore(bucket, PREFIX), job.session)
        for kind in bucket.requests:
            bucket.requests[kind] = 0

        def run(part: Callable[[], object]) -> None:
            try:
                part()
            except StopRequested:
                pass
            except BaseException as error:
                stop_signal.failures.append(error)

        sims = [SimWorker(job, together, number) for number in range(workers)]
        parts = [lambda: learn(job, together), *(sim.run for sim in sims)]
        threads = [threading.Thread(target=run, args=(part,)) for part in parts]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for failure in stop_signal.failures:
            raise failure
        # Before the first iterations are over, nobody is ahead yet.
        counted = read_history(ModelStore(bucket, PREFIX))[max(1, lag) :]
    seconds = counted[-1].elapsed_s - counted[0].elapsed_s
    counted = counted[1:]
    steps, count = sum(each.steps for each in counted), len(counted)
    lags = [each.iteration - checkpoint_name(each.checkpoint).number for each in counted]
    return {
        "workers": workers,
        "ahead": lag,
        "learn_step_s": learn_step_s,
        "iterations": count,
        "iteration_s": seconds / count,
        "steps": steps / count,
        "drive_s": statistics.fmean(each.drive_s for each in counted),
        "learn_s": statistics.fmean(each.learn_s for each in counted),
        "oldest": statistics.fmean(lags),
        **{name: number / (iterations + 1) for name, number in bucket.requests.items()},
    }


def _job(folder: Path, workers: int, lag: int, episodes: int, iterations: int) -> Any:
    settings = {
        "DR_WORLD_NAME": "reinvent_base",
        "DR_LOCAL_S3_MODEL_PREFIX": PREFIX,
        "DR_WORKERS": workers,
        "DR_TRAIN_OVERLAP": "on" if lag else "off",
        "DR_TRAIN_MAX_LAG": max(1, lag),
        "DR_TRAIN_MAX_ITERATIONS": iterations,
        "DR_TRAIN_EVAL_SHARE": 0.001,
        "DR_TRAIN_FROZEN_GRAPH": False,
        "DR_CLOUD": "remote",  # so that requests are as rare as they are where they cost money
        "DR_REMOTE_MINIO_URL": "http://127.0.0.1:1",
    }
    (folder / "run.env").write_text("".join(f"{name}={v}\n" for name, v in settings.items()))
    own = folder / "custom_files"
    own.mkdir()
    for name in ("reward_function.py", "model_metadata.json", "hyperparameters.json"):
        (own / name).write_bytes((ROOT / "defaults" / name).read_bytes())
    parameters = json.loads((own / "hyperparameters.json").read_text())
    parameters["num_episodes_between_training"] = episodes
    (own / "hyperparameters.json").write_text(json.dumps(parameters))
    job = prepare(load_settings(folder, environ={}), StartOptions(seed=1)).job
    return replace(job, config=replace(job.config, live_view=False))


def main() -> None:
    """Measure, and print an object."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--workers", type=int, default=8)
    parser.add_argument("--lag", type=int, default=4)
    parser.add_argument("--episodes", type=int, default=80)
    parser.add_argument("--step-s", type=float, default=0.05)
    parser.add_argument("--learn-step-s", type=float, default=0.0005)
    parser.add_argument("--iterations", type=int, default=10)
    chosen = parser.parse_args()
    with suppress(KeyboardInterrupt):
        print(json.dumps(measured(**vars(chosen))))


if __name__ == "__main__":
    main()
