"""Trainings for `bench learn`: what is trained, in memory, and by real workers over a bucket."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from drcli.bucket.server import server
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.convert.build_network import policy_spec
from drcli.drive.build_race import actions_of, load_world, longest_episode
from drcli.drive.driving import Driven, Driver, Plan, Racer, rollout_of
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import PPOConfig, algorithm_config
from drcli.learn.compute import Compute, choose_compute, driving_format, flush_denormals
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.learn.encoders import compute_in
from drcli.learn.policy import PolicySpec
from drcli.learn.ppo import PPO
from drcli.learn.rollout_buffer import Rollout
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.records.job import PROCESS_TUNING
from drcli.train.trainer import SEED_STRIDE
from drsim import Actions, EpisodeRules, RewardFunction, Simulation, Track, load_reward_function

PROJECT = Path(__file__).resolve().parents[2]

SHIPPED_FILES = PROJECT / "defaults"

FILES = ("reward_function.py", "hyperparameters.json", "model_metadata.json")

FEWEST_EVALUATIONS = {"DR_TRAIN_EVAL_LAPS": "1", "DR_TRAIN_EVAL_SHARE": "0.001"}
"""One evaluation episode, and that with the first checkpoint only: workers always drive one."""


def become_like_a_worker() -> None:
    """Give this process the settings of a training's workers; starts it again if it lacks some."""
    if any(name not in os.environ for name in PROCESS_TUNING):
        # Read by the C library and OpenMP before the first line of Python.
        os.execve(sys.executable, sys.orig_argv, {**PROCESS_TUNING, **os.environ})
    flush_denormals()


class Pace(NamedTuple):
    """How long it took to drive and learn so many steps."""

    steps: int
    seconds: float

    @property
    def steps_per_s(self) -> float:
        """Steps driven and learned from per second of wall time."""
        return self.steps / self.seconds


def together(paces: Sequence[Pace]) -> Pace:
    """Several iterations as one."""
    return Pace(sum(pace.steps for pace in paces), sum(pace.seconds for pace in paces))


@dataclass(frozen=True)
class Work:
    """What trainings have in common: the shipped files but for the network, on one track.

    Attributes:
        environment: Settings that differ from the shipped ones.
        files: The racer's files by name.
        settings: Of a training in the project's folder.
        parameters: hyperparameters.json.
        spec: The network.
        actions: What its outputs mean.
        reward_file: The reward function, of which each car gets its own copy.
        track: Where the cars drive.
        threads: For simulation and learner, which take turns.
        compute: Device and number format that a training chooses here.
        reward_factor: What every reward is multiplied by.
    """

    environment: dict[str, str]
    files: dict[str, bytes]
    settings: Settings
    parameters: Hyperparameters
    spec: PolicySpec
    actions: Actions
    reward_file: Path
    track: Track
    threads: int
    compute: Compute
    reward_factor: float = 1.0

    @staticmethod
    def load(
        environment: dict[str, str],
        network: str | None,
        threads: int,
        folder: Path = SHIPPED_FILES,
    ) -> "Work":
        """Read the shipped files.

        Args:
            environment: Settings that differ from the shipped ones.
            network: `neural_network` instead of that in model_metadata.json.
            threads: For simulation and learner.
            folder: Where the three files are.
        """
        settings = load_settings(PROJECT, environ={**os.environ, **environment})
        files = {name: (folder / name).read_bytes() for name in FILES}
        if network is not None:
            written = json.loads(files["model_metadata.json"]) | {"neural_network": network}
            files["model_metadata.json"] = json.dumps(written).encode()
        parameters = Hyperparameters.from_bytes(files["hyperparameters.json"])
        metadata = ModelMetadata.from_bytes(files["model_metadata.json"])
        spec = policy_spec(metadata, parameters)
        return Work(
            environment,
            files,
            settings,
            parameters,
            spec,
            actions_of(metadata),
            folder / "reward_function.py",
            load_world(settings.race),
            threads,
            choose_compute(settings.torch_precision, parameters.batch_size, threads),
        )

    def changed(self, change: Mapping[str, Any]) -> "Work":
        """The same work with other hyperparameters."""
        parameters = self.parameters.model_copy(update=dict(change))
        metadata = ModelMetadata.from_bytes(self.files["model_metadata.json"])
        return replace(self, parameters=parameters, spec=policy_spec(metadata, parameters))

    @property
    def config(self) -> PPOConfig:
        """Our learner's knobs."""
        return algorithm_config(PPOConfig, self.parameters)

    @property
    def rules(self) -> EpisodeRules:
        """When episodes end, as in a training."""
        return EpisodeRules(max_steps=longest_episode(self.track, self.actions))

    def simulation(self, cars: int) -> Simulation:
        """As many cars on the track."""
        return Simulation(
            self.track,
            num_cars=cars,
            reward_function=self.rewards(cars),
            rules=self.rules,
            num_threads=self.threads,
        )

    def rewards(self, cars: int) -> list[RewardFunction]:
        """A reward function for each car: they may keep things in globals."""
        return [self._reward() for _ in range(cars)]

    def _reward(self) -> RewardFunction:
        function, factor = load_reward_function(self.reward_file), self.reward_factor
        return function if factor == 1.0 else lambda params: factor * float(function(params))


class MemoryTraining:
    """Drives and learns in this process, with the workers' own pieces and without a bucket.

    It does what the workers do with the same seed, iteration for iteration.

    Attributes:
        rollout: What was driven last.
        evaluation: Evaluation episodes driven during it.
        steps: Steps learned from.
    """

    rollout: Rollout
    evaluation: Sequence[Driven]

    def __init__(self, work: Work, seed: int, trials: int = 0) -> None:
        """Begin with fresh weights.

        Args:
            work: What to train.
            seed: Of everything random.
            trials: Evaluation episodes of each checkpoint; 0: one, of the first checkpoint only.
        """
        self._work = work
        self._seed = seed
        self._trials = trials
        self._number = 0
        self.steps = 0
        cars = work.parameters.num_episodes_between_training + max(1, trials)
        self._simulation = work.simulation(cars)
        torch.manual_seed(seed)
        self._ppo = PPO(ActorCritic(work.spec), work.config, work.compute)
        self._driving = ActorCritic(work.spec).eval()
        compute_in(self._driving, driving_format(work.compute.number_format))
        torch.set_num_threads(1)
        racer = Racer(DataParallelPolicy(self._driving, work.threads), work.actions)
        self._driver = Driver(self._simulation, [racer], seed)

    def iterate(self) -> Pace:
        """Drive the episodes of an iteration and learn from them."""
        started_s = time.perf_counter()
        self._driving.load_state_dict(self._ppo.model.state_dict())
        driven: list[Driven] = []
        self._driver.drive(self._plans(), driven.append)
        self.rollout = rollout_of([e for e in driven if e.phase == "training"])
        self.evaluation = [e for e in driven if e.phase == "evaluation"]
        seed = self._seed + SEED_STRIDE * self._number
        self._ppo.update(self.rollout, seed, steps_before=self.steps)
        self._number += 1
        self.steps += self.rollout.steps
        return Pace(self.rollout.steps, time.perf_counter() - started_s)

    def close(self) -> None:
        """Free the threads."""
        self._simulation.close()

    def _plans(self) -> list[Plan]:
        """The episodes that the only simulation worker of a training would drive now."""
        s = self._work.settings
        advance = s.train_round_robin_advance_dist if s.train_change_start_position else 0.0
        count = self._work.parameters.num_episodes_between_training
        plans = [
            Plan(
                number,
                "training",
                (s.train_start_position_offset + number * advance) % 1.0,
                reverse=s.train_alternate_driving_direction and number % 2 == 1,
            )
            for number in range(self._number * count, (self._number + 1) * count)
        ]
        trials = self._trials or int(self._number == 0)
        return plans + [
            Plan(trial, "evaluation", (s.train_start_position_offset + trial / trials) % 1.0)
            for trial in range(trials)
        ]


def train_through_bucket(work: Work, seed: int, iterations: int) -> list[Pace]:
    """Train in an empty folder with the real command, supervisor, workers and embedded bucket.

    Args:
        work: What to train.
        seed: Of the training.
        iterations: How many.

    Returns:
        The pace of each iteration, from the end of an update to the end of the next.

    Raises:
        RuntimeError: The training ended otherwise.
    """
    with tempfile.TemporaryDirectory(prefix="bench-learn-") as name:
        folder = Path(name)
        for file in ("run.env", "system.env"):
            shutil.copy(PROJECT / file, folder / file)
        (folder / "custom_files").mkdir()
        for file, content in work.files.items():
            (folder / "custom_files" / file).write_bytes(content)
        environment = {
            **os.environ,
            **work.environment,
            "DR_TRAIN_MAX_ITERATIONS": str(iterations),
        }
        program = Path(sys.executable).parent / "dr"
        try:
            subprocess.run(
                [str(program), "start-training", "-q", "--seed", str(seed)],
                cwd=folder,
                env=environment,
                stdout=subprocess.DEVNULL,
                check=True,
            )
            run_file = folder / "data" / "runs" / "0" / "run.json"
            while (record := json.loads(run_file.read_text()))["state"] in ("starting", "running"):
                time.sleep(0.5)
        finally:
            server.stop(load_settings(folder, environ=environment).storage)
        if record["state"] != "finished":
            raise RuntimeError(f"The training ended as {record['state']}: {record['message']}")
        curve = next((folder / "data" / "s3").rglob("metrics/history.json"))
        history = json.loads(curve.read_text())["iterations"]
    return [Pace(record["steps"], record["steps"] / record["steps_per_s"]) for record in history]


def beginning(rollout: Rollout, steps: int) -> Rollout:
    """The first steps of a rollout, as if they were one episode: for arithmetic, not to learn."""
    steps = min(steps, rollout.steps)
    columns = {
        name: getattr(rollout, name)[:steps]
        for name in ("frames", "actions", "log_probs", "values", "rewards", "scans", "states")
    }
    return replace(
        rollout,
        **columns,
        lengths=np.array([steps]),
        last_values=np.zeros(1),
        cut=np.zeros(1, np.bool_),
    )
