"""Measure what an NVIDIA GPU brings: camera, policy and learner, beside the same on the processor.

    python scripts/bench gpu [--json]

Without a GPU it says so and measures nothing. Everything is measured in turns, round by round, and
the medians are printed, each with its ratio to the first of its group.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from learn_peers import plain_body
from learners import made_up_rollout
from machine import facts, print_json
from torch import nn

from drcli.drive.driving import Driven, Driver, Plan, Racer
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import PPOConfig
from drcli.learn.compute import Compute
from drcli.learn.cuda import GpuPolicy
from drcli.learn.data_parallel import DataParallelPolicy, parts_of
from drcli.learn.policy import PolicySpec
from drcli.learn.ppo import PPO
from drcli.learn.rollout_buffer import Rollout
from drcli.workers.cores import cores
from drsim import Simulation, centre_line_reward, load_track
from drsim.car.actions import DiscreteActions
from drsim.sensing.scene import build_scene, lens_parts, lens_pose, render

ACTIONS = [
    (steering, speed) for steering in (-30.0, -15.0, 0.0, 15.0, 30.0) for speed in (1.0, 2.0)
]
NETWORKS = ("COMPACT_CONVOLUTIONAL_NETWORK", "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW")
WORLD = "reinvent_base"

Figures = dict[str, Any]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3, help="how often everything is measured")
    parser.add_argument("--steps", type=int, default=2048, help="steps of a rollout")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    for name, value in facts().items():
        print(f"{name}: {value}")
    if not torch.cuda.is_available():
        print("PyTorch finds no NVIDIA GPU here: nothing to measure.")
        return
    print(f"GPU: {torch.cuda.get_device_name()}, PyTorch {torch.__version__}")
    figures: Figures = {}
    for cars in (20, 100, 1000):
        figures |= measure_camera(cars, options.rounds)
    for cars in (20, 100):
        figures |= measure_driving(cars, options.rounds)
    for network in NETWORKS:
        for batch_size in (64, 512):
            figures |= measure_learner(network, batch_size, options.steps, options.rounds)
    if options.json:
        print_json(figures | {"gpu": torch.cuda.get_device_name()})


def measure_camera(cars: int, rounds: int) -> Figures:
    """Frames/s of one core, of the GPU with a copy in main memory, and of the GPU alone."""
    from drsim.sensing.cuda_camera import CudaCamera

    track = load_track(WORLD)
    scene = build_scene(track)
    draw = np.random.default_rng(1)
    points = track.center[draw.integers(0, len(track.center), cars)]
    pos = np.column_stack([points + draw.uniform(-0.4, 0.4, (cars, 2)), np.zeros(cars)])
    yaw = draw.uniform(-np.pi, np.pi, cars)
    cos, sin, zero, one = np.cos(yaw), np.sin(yaw), np.zeros(cars), np.ones(cars)
    mat = np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]).transpose(2, 0, 1)
    lens_pos, lens_mat = lens_pose(pos, np.ascontiguousarray(mat))
    frames = np.zeros((cars, 120, 160), np.uint8)
    gpu = CudaCamera(scene, cars)
    everybody = np.arange(cars)
    lenses = lens_parts(lens_pos, lens_mat)

    def on_processor() -> None:
        render(scene, lens_pos, lens_mat, frames)

    def on_gpu() -> None:
        gpu.draw([lenses], everybody, None)
        gpu.wait()

    def with_copy() -> None:
        gpu.draw([lenses], everybody, None)
        gpu.fetch()
        gpu.wait()

    on_processor()
    with_copy()
    apart = np.abs(frames.astype(int) - gpu.frames[:, 0])
    print(f"camera, {cars} cars: greys differ by {apart.max()} at most, {(apart > 0).mean():.2%}")
    work = {"one core": on_processor, "GPU and copy": with_copy, "GPU": on_gpu}
    return measured(f"camera, {cars} cars", "frames/s", cars, work, rounds)


def measure_driving(cars: int, rounds: int) -> Figures:
    """Driven steps/s with a fresh policy: motion, camera, reward and policy, all cores."""
    track = load_track(WORLD)
    scene = build_scene(track)
    spec = PolicySpec(len(ACTIONS), network=NETWORKS[0])
    torch.manual_seed(0)
    model = ActorCritic(spec)
    threads = cores()
    torch.set_num_threads(1)
    on_gpu = GpuPolicy(model, torch.device("cuda"))
    on_gpu.follow(torch.float32)
    work = {}
    for name, gpu, policy in (
        ("processor", False, DataParallelPolicy(model, threads)),
        ("camera on GPU", True, DataParallelPolicy(model, threads)),
        ("camera and policy on GPU", True, on_gpu),
    ):
        simulation = Simulation(
            track,
            num_cars=cars,
            reward_function=centre_line_reward,
            num_threads=threads,
            scene=scene,
            gpu=gpu,
        )
        driver = Driver(simulation, [Racer(policy, DiscreteActions(ACTIONS))], 0)
        work[name] = DriveOnce(driver, cars)
    return measured(f"driving, {cars} cars", "steps/s", 0, work, rounds)


class DriveOnce:
    """Drives an episode with each car; returns the steps."""

    def __init__(self, driver: Driver, cars: int) -> None:
        self._driver, self._cars = driver, cars

    def __call__(self) -> int:
        driven: list[Driven] = []
        plans = [Plan(n, "training", n / self._cars) for n in range(self._cars)]
        self._driver.drive(plans, driven.append)
        return sum(episode.steps for episode in driven)


def measure_learner(network: str, batch_size: int, steps: int, rounds: int) -> Figures:
    """Samples/s of updates of 3 epochs."""
    rollout = made_up_rollout(steps, len(ACTIONS))
    gpu = torch.device("cuda")
    threads = cores()
    computes = {
        "processor, fp32": Compute(
            torch.device("cpu"), False, "", threads, parts_of(batch_size, threads)
        ),
        "GPU, fp32": Compute(gpu, False, ""),
        "GPU, bf16": Compute(gpu, True, ""),
        "GPU, fp32, graph": Compute(gpu, False, "", graphs=True),
        "GPU, bf16, graph": Compute(gpu, True, "", graphs=True),
    }
    spec = PolicySpec(len(ACTIONS), network=network)
    config = PPOConfig(batch_size=batch_size, num_epochs=3)
    work: dict[str, Callable[[], Any]] = {}
    for name, compute in computes.items():
        torch.manual_seed(0)
        work[name] = UpdateOnce(PPO(ActorCritic(spec), config, compute), rollout)
    work["plain PyTorch, autocast"] = PlainUpdate(spec, rollout, batch_size)
    samples = 3 * (steps // batch_size) * batch_size
    found = measured(f"{network}, minibatches of {batch_size}", "samples/s", samples, work, rounds)
    for name, update in work.items():
        if isinstance(update, UpdateOnce) and update.learner.capture_failure:
            print(f"  {name}: {update.learner.capture_failure}")
    return found


class UpdateOnce:
    """An update of the same rollout."""

    def __init__(self, learner: PPO, rollout: Rollout) -> None:
        self.learner, self._rollout = learner, rollout

    def __call__(self) -> None:
        self.learner.update(self._rollout, 1)


class PlainUpdate:
    """The same losses in the usual few lines of PyTorch, frames on the GPU as bytes."""

    def __init__(self, spec: PolicySpec, rollout: Rollout, batch_size: int) -> None:
        torch.manual_seed(0)
        body, features = plain_body(spec, autocast=False)
        self._body = body.cuda()
        self._actor = nn.Linear(features, spec.num_actions).cuda()
        self._critic = nn.Linear(features, 1).cuda()
        self._parameters = [
            p for m in (self._body, self._actor, self._critic) for p in m.parameters()
        ]
        self._optimizer = torch.optim.Adam(self._parameters, 3e-4, fused=True)
        self._rollout, self._batch_size = rollout, batch_size

    def __call__(self) -> None:
        rollout, gpu = self._rollout, torch.device("cuda")
        frames = torch.from_numpy(rollout.frames).to(gpu)
        actions = torch.from_numpy(rollout.actions).to(gpu)
        before = torch.from_numpy(rollout.log_probs).to(gpu)
        returns = torch.from_numpy(rollout.rewards).float().to(gpu)
        for _ in range(3):
            order = torch.randperm(len(frames), device=gpu)
            for rows in order.split(self._batch_size):
                if len(rows) < self._batch_size:
                    break
                with torch.autocast("cuda", torch.bfloat16):
                    hidden = self._body(frames[rows] / 255.0)
                logits, value = self._actor(hidden.float()), self._critic(hidden.float())
                log_probs = logits.log_softmax(-1)
                chosen = log_probs.gather(1, actions[rows, None]).squeeze(1)
                ratio = (chosen - before[rows]).exp()
                advantage = returns[rows] - returns.mean()
                surrogate = torch.minimum(
                    ratio * advantage, ratio.clamp(0.8, 1.2) * advantage
                ).mean()
                entropy = -(log_probs.exp() * log_probs).sum(-1).mean()
                error = nn.functional.huber_loss(value.squeeze(1), returns[rows])
                self._optimizer.zero_grad()
                (error - surrogate - 0.01 * entropy).backward()
                self._optimizer.step()


def measured(
    title: str, unit: str, count: int, work: dict[str, Callable[[], Any]], rounds: int
) -> Figures:
    """Rates of several kinds of work, in turns; `count` is the work of a call, 0 if it returns it.

    Each call is repeated for a second at least.
    """
    for call in work.values():
        call()
        call()
    torch.cuda.synchronize()
    rates: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(rounds):
        for name, call in work.items():
            done, began = 0, time.perf_counter()
            while (took_s := time.perf_counter() - began) < 1.0:
                done += call() or count
                torch.cuda.synchronize()
            rates[name].append(done / took_s)
    medians = {name: statistics.median(each) for name, each in rates.items()}
    first = next(iter(medians.values()))
    print(title)
    for name, rate in medians.items():
        low, high = min(rates[name]), max(rates[name])
        print(f"  {name:28} {rate:12,.0f} {unit} ({low:,.0f} to {high:,.0f}), {rate / first:.2f}")
    return {f"{title}, {name}": rate for name, rate in medians.items()}


if __name__ == "__main__":
    main()
