"""Measures driving and learning in a process without a bucket.

`python -m drcli.checks.bench.measure_process` reads a `WorkOrder` from standard input, and writes
`Ready` and `Rates` to standard output, a line of JSON each.
"""

import itertools
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import IO

import numpy as np
import psutil
import torch

from drcli.base.json_record import decode_json
from drcli.base.processes import lower_priority
from drcli.base.system_calls import peak_memory_bytes
from drcli.checks.bench.work_order import Rates, Ready, WorkOrder
from drcli.convert.build_network import build_policy
from drcli.drive.build_race import (
    actions_of,
    build_simulation,
    choose_worker_device,
    load_world,
    longest_episode,
)
from drcli.drive.driving import Driven, Driver, Plan, Racer, episodes_of
from drcli.learn.compute import choose_compute, driving_format, flush_denormals
from drcli.learn.cuda import GpuPolicy
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.learn.encoders import compute_in
from drcli.learn.learner import Learner
from drcli.learn.rollout_buffer import Rollout
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.records.rollout import encode_episodes
from drcli.train.learner_group import build_learner
from drcli.workers.cores import driving_threads, learning_threads, overlaps
from drsim.car.actions import Actions, ContinuousActions
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.load_reward import load_reward_function
from drsim.episode.simulation import Simulation

SHARES = (0.15, 0.4, 0.45)
"""For bare simulation, driving and learning."""

LEAST_S = 3.0
LEAST_SAMPLES = 1024
"""Steps for measuring learning; fewer are repeated."""


class _Clock:
    def __init__(self) -> None:
        self._wall_s, self._core_s = time.perf_counter(), time.process_time()

    @property
    def wall_s(self) -> float:
        return time.perf_counter() - self._wall_s

    @property
    def core_s(self) -> float:
        return time.process_time() - self._core_s


def main() -> None:
    flush_denormals()
    order = decode_json(WorkOrder, sys.stdin.buffer.read())
    if order.train.priority == "low":
        lower_priority()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # a reward function may print
    metadata = ModelMetadata.from_bytes(order.metadata.encode())
    parameters = Hyperparameters.from_bytes(order.hyperparameters.encode())
    threads = driving_threads(order.train)
    learning = learning_threads(order.train)
    compute = choose_compute(order.train.torch_precision, parameters.batch_size, learning)
    torch.manual_seed(0)
    learner = build_learner(metadata, parameters, compute)
    torch.set_num_threads(1)
    policy = build_policy(metadata, parameters)
    weights = sum(t.numel() * t.element_size() for t in policy.state_dict().values())
    worker_device = choose_worker_device(order.train.worker_device, 0)
    chooser: GpuPolicy | DataParallelPolicy
    if worker_device.gpu is None:
        compute_in(policy, driving_format(compute.number_format))
        chooser = DataParallelPolicy(policy, threads)
    else:
        chooser = GpuPolicy(policy, worker_device.gpu)
        chooser.follow(torch.bfloat16 if compute.bf16 else torch.float32)
    track = load_world(order.race)
    actions = actions_of(metadata)
    count = parameters.num_episodes_between_training
    reward_file = Path(order.reward_file)
    simulation = build_simulation(
        order.race,
        "training",
        metadata,
        track,
        num_cars=order.race.train_lanes or count,
        reward=[load_reward_function(reward_file) for _ in range(order.race.train_lanes or count)],
        rules=EpisodeRules(max_steps=longest_episode(track, actions)),
        num_threads=threads,
        seed=0,
        gpu=worker_device.gpu is not None,
    )
    driver = Driver(simulation, [Racer(chooser, actions)], 0)
    drawn = _DrawnActions(simulation, actions)
    drawn.begin()
    drawn.step()  # compiles what is not in the cache
    rounds = _Rounds(driver, count)
    rounds.drive()
    device = torch.cuda.get_device_name() if compute.device.type == "cuda" else "cpu"
    prepared_s = time.time() - psutil.Process().create_time()
    ready = Ready(
        prepared_s=prepared_s,
        device=device,
        number_format=compute.number_format,
        driving_threads=threads,
        learning_threads=learning,
        overlaps=overlaps(order.train),
        cars=order.race.train_lanes or count,
        episodes=count,
        epochs=parameters.num_epochs,
        batch_size=parameters.batch_size,
        weight_bytes=weights,
    )
    _say(answers, ready)
    seconds = min(order.seconds, max(LEAST_S, order.most_seconds - prepared_s))
    bare_s, driving_s, learning_s = (share * seconds for share in SHARES)
    drawn.begin()
    bare = _repeated(drawn.step, bare_s)
    clock = _Clock()
    steps = 0
    while clock.wall_s < driving_s or rounds.steps < LEAST_SAMPLES:
        steps += rounds.drive()
    driving = (steps / clock.wall_s, steps / max(clock.core_s, 1e-9))
    episodes = episodes_of(rounds.newest)
    step_bytes = len(encode_episodes(episodes)) / max(1, episodes.rollout.steps)
    minibatches, clock = _learn(learner, episodes.rollout, learning, learning_s)
    samples = minibatches * min(parameters.batch_size, episodes.rollout.steps)
    rates = Rates(
        simulation_steps_per_s=bare,
        driving_steps_per_s=driving[0],
        driving_steps_per_core_s=driving[1],
        learning_samples_per_s=samples / clock.wall_s,
        learning_samples_per_core_s=samples / max(clock.core_s, 1e-9),
        gradient_steps_per_s=minibatches / clock.wall_s,
        core_s=time.process_time(),
        memory_bytes=peak_memory_bytes(),
        step_bytes=step_bytes,
    )
    _say(answers, rates)
    os._exit(0)  # the end of torch's threads takes longer than the answer


class _Rounds:
    def __init__(self, driver: Driver, count: int) -> None:
        self._driver, self._count, self._number = driver, count, 0
        self.newest: list[Driven] = []
        self.steps = 0

    def drive(self) -> int:
        numbers = range(self._number, self._number + self._count)
        driven: list[Driven] = []
        plans = [Plan(n, "training", (0.05 * n) % 1.0) for n in numbers]
        self._driver.drive(plans, driven.append)
        self._number = numbers.stop
        steps = sum(episode.steps for episode in driven)
        if self.steps >= LEAST_SAMPLES:
            self.newest, self.steps = [], 0
        self.newest += driven
        self.steps += steps
        return steps


class _DrawnActions:
    def __init__(self, simulation: Simulation, actions: Actions) -> None:
        self._simulation = simulation
        self._random = np.random.default_rng(0)
        if isinstance(actions, ContinuousActions):
            (low, high), (slow, fast) = actions.steering_deg, actions.speed_mps
        else:
            steering, speeds = zip(*actions.choices, strict=True)
            low, high, slow, fast = min(steering), max(steering), min(speeds), max(speeds)
        self._least, self._most = (low, slow), (high, fast)

    def begin(self) -> None:
        everybody = np.arange(self._simulation.num_cars)
        self._simulation.reset(everybody, self._random.random(len(everybody)))

    def step(self) -> int:
        """Cars off the track start again."""
        simulation, random = self._simulation, self._random
        drawn = random.uniform(self._least, self._most, (simulation.num_cars, 2))
        row = simulation.step(drawn[:, 0], drawn[:, 1])
        over = np.flatnonzero(row.done)
        if len(over):
            simulation.reset(over, random.random(len(over)))
        return int(row.driven.sum())


def _repeated(step: Callable[[], int], seconds: float) -> float:
    clock, done = _Clock(), 0
    while clock.wall_s < seconds:
        done += step()
    return done / clock.wall_s


def _learn(
    learner: Learner, rollout: Rollout, threads: int, seconds: float
) -> tuple[int, "_Clock"]:
    torch.set_num_threads(threads)
    calls, clock = 0, _Clock()

    def should_stop() -> bool:
        """The first minibatch, which takes fresh memory, does not count."""
        nonlocal calls, clock
        calls += 1
        if calls == 1:
            clock = _Clock()
        return calls > 1 and clock.wall_s >= seconds

    seeds = itertools.count()
    while calls < 2 or clock.wall_s < seconds:
        learner.update(rollout, next(seeds), should_stop=should_stop)
    return calls - 1, clock


def _say(answers: IO[str], answer: Ready | Rates) -> None:
    answers.write(json.dumps({type(answer).__name__: asdict(answer)}) + "\n")
    answers.flush()


if __name__ == "__main__":
    main()
