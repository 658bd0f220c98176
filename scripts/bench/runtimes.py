"""Compares exported policies with PyTorch on frames of real drives, for every network and head.

    python scripts/bench runtimes [--frames 1000] [--runtimes pb,onnx,openvino] [--network NAME]
        [--all] [--batches] [--json]

Each head of each network is tried with one camera, and with two and a lidar; with --all in all four
combinations.

Cars drive along `reinvent_base` with random steering. Each network has fresh weights, changed so
that its actions differ. With --json the last line of stdout is one object: `frames`, and `cases`
with `network`, `eyes`, `lidar`, `head`, `runtime`, `same_actions` and `greatest_difference`.

With --batches every runtime is compared with itself instead: a frame must get the same bits in a
batch of any size and at any place in it. `cases` then have `differing`, the sizes in which a frame
got others than in a batch of 64, `before`, the same sizes for a network whose products have as
many rows as there are cars, and `ratios`, the time that such a network takes for 1, 4, 20 and 64
cars over that of ours, on one thread. Both are for PyTorch only, in each number format that cars
are driven in here.
"""

import argparse
import copy
import itertools
import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any, cast, get_args

import numpy as np
import torch
from machine import print_json
from numpy.typing import NDArray

import drsim
from drcli.convert.runtimes import EnginePolicy, policy_of_model
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.compute import bfloat16_units, driving_format
from drcli.learn.encoders import compute_in
from drcli.learn.policy import Observation, Policy, PolicySpec, decide
from drcli.learn.sac_networks import SACAgent
from drcli.model.files import model_metadata
from drcli.model.files.model_metadata import ModelMetadata
from drcli.records.evaluation_task import Runtime
from drcli.transfer.export_forms import Network, compare_outputs, torch_outputs

CARS = 20

SIZES = (*range(1, 21), 24, 31, 32, 33, 48, 63, 64)
"""Cars of the batches that are compared."""

TIMED = (1, 4, 20, 64)
"""Cars for which the time is measured."""

ROUNDS = 15
"""Measurements, in turns. The least counts, because other programs only make them longer."""

HEADS = ("discrete", "continuous", "sac")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--runtimes", default="pb,onnx,openvino")
    parser.add_argument("--network", help="only this one")
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--batches", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()

    torch.set_num_threads(1)
    frames, scans = real_inputs(arguments.frames)
    cases = []
    networks = [arguments.network] if arguments.network else get_args(model_metadata.Network)
    inputs = [(eyes, lidar) for eyes in (1, 2) for lidar in (False, True)]
    if not arguments.all:
        inputs = [(1, False), (2, True)]
    for network, (eyes, lidar), head in itertools.product(networks, inputs, HEADS):
        metadata = metadata_of(network, eyes, lidar, head)
        model = random_network(metadata)
        spec = model.spec
        seen = frames[:, : spec.eyes], scans[:, : spec.scan_dims]
        case = {"network": network, "eyes": eyes, "lidar": lidar, "head": head}
        about = f"{network:36} {eyes} {'lidar' if lidar else '-----'} {head:10}"
        if arguments.batches:
            for compared in compare_batches(model, metadata, *seen, arguments.runtimes.split(",")):
                cases.append({**case, **compared})
                print(about, *(f"{name} {value}" for name, value in compared.items()), flush=True)
            continue
        ours = torch_outputs(model, *seen)
        for runtime in arguments.runtimes.split(","):
            policy = policy_of_model(model, metadata, runtime, "the network")
            assert isinstance(policy, EnginePolicy)
            compared = asdict(compare_outputs(ours, policy, *seen, continuous=spec.continuous))
            cases.append({**case, "runtime": runtime, **compared})
            print(
                f"{about} {runtime:9}"
                f"{compared['same_actions']:8.2%} {compared['greatest_difference']:9.1e}",
                flush=True,
            )
    if arguments.json:
        print_json({"frames": len(frames), "cases": cases})


def compare_batches(
    model: Network,
    metadata: ModelMetadata,
    frames: NDArray[np.uint8],
    scans: NDArray[np.float32],
    runtimes: Sequence[str],
) -> Iterator[dict[str, Any]]:
    """What a network makes of frames in batches of every size, in PyTorch and in other engines."""
    for number_format in ("fp32", "bf16") if bfloat16_units() else ("fp32",):
        twin = copy.deepcopy(model)
        compute_in(twin, driving_format(number_format))
        now = differing(twin, frames, scans)
        # In training mode a network is the same but for its products, which get all rows at once.
        before = differing(copy.deepcopy(twin).train(), frames, scans)
        ratios = {cars: round(time_ratio(twin, frames[:cars], scans[:cars]), 2) for cars in TIMED}
        named = {"runtime": "torch", "format": number_format}
        yield {**named, "differing": now, "before": before, "ratios": ratios}
    for runtime in runtimes:
        policy = policy_of_model(model, metadata, cast(Runtime, runtime), "the network")
        yield {"runtime": runtime, "differing": differing(policy, frames, scans)}


def differing(policy: Policy, frames: NDArray[np.uint8], scans: NDArray[np.float32]) -> list[int]:
    """The sizes of batches in which a frame gets other bits than in a batch of all."""
    most = max(SIZES)
    wanted = chosen(policy, frames[:most], scans[:most])
    random = np.random.default_rng(0)

    def differs(rows: NDArray[np.int64]) -> bool:
        return not np.array_equal(chosen(policy, frames[rows], scans[rows]), wanted[rows])

    return [
        cars
        for cars in SIZES
        if differs(np.arange(cars)) or differs(random.permutation(most)[:cars])
    ]


def chosen(
    policy: Policy, frames: NDArray[np.uint8], scans: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Actions, log-probabilities and values, side by side, float64. Shape (n, k)."""
    cars = len(frames)
    seen = Observation.of_arrays(frames, scans, np.empty((cars, 0), np.float32))
    noise = np.zeros((cars, policy.spec.noise_dims), np.float32)
    decision = decide(policy, seen, noise, np.ones(cars, np.bool_))
    columns = decision.actions, decision.log_probs, decision.values
    return np.column_stack([column.astype(np.float64) for column in columns])


def time_ratio(model: Network, frames: NDArray[np.uint8], scans: NDArray[np.float32]) -> float:
    """Processor time with products of all rows at once, over that with products of one shape."""
    least_s = {True: math.inf, False: math.inf}
    for _ in range(ROUNDS):
        for training in least_s:
            model.train(training)
            began_s = time.thread_time()
            chosen(model, frames, scans)
            least_s[training] = min(least_s[training], time.thread_time() - began_s)
    model.eval()
    return least_s[True] / least_s[False]


def real_inputs(count: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Stereo pictures and lidar values of cars that drive with random steering."""
    sensors = drsim.Sensors(("STEREO_CAMERAS", "LIDAR"))
    simulation = drsim.Simulation(
        drsim.load_track("reinvent_base"),
        num_cars=CARS,
        reward_function=drsim.centre_line_reward,
        sensors=sensors,
    )
    random = np.random.default_rng(0)
    frames, scans = [], []
    free = np.arange(CARS)
    steering = np.zeros(CARS)
    while len(frames) * CARS < count:
        if len(free):
            simulation.reset(free, random.random(len(free)))
        steering = np.clip(steering + random.normal(0.0, 8.0, CARS), -30.0, 30.0)
        result = simulation.step(steering, random.uniform(1.0, 3.0, CARS))
        frames.append(simulation.frames.copy())
        scans.append(simulation.scans.copy())
        free = np.flatnonzero(result.done)
    simulation.close()
    return np.concatenate(frames)[:count], np.concatenate(scans)[:count]


def metadata_of(network: str, eyes: int, lidar: bool, head: str) -> ModelMetadata:
    """The metadata of a model with this network and head."""
    ranges = {"steering_angle": {"low": -30, "high": 30}, "speed": {"low": 1, "high": 3}}
    listed = [
        {"steering_angle": float(a), "speed": 1.0 + (a % 20) / 20} for a in range(-30, 31, 10)
    ]
    values = {
        "version": "5",
        "neural_network": network,
        "training_algorithm": "sac" if head == "sac" else "clipped_ppo",
        "sensor": ["STEREO_CAMERAS" if eyes == 2 else "observation", *(["LIDAR"] if lidar else [])],
        "action_space_type": "discrete" if head == "discrete" else "continuous",
        "action_space": listed if head == "discrete" else ranges,
    }
    return ModelMetadata.from_bytes(json.dumps(values).encode())


def random_network(metadata: ModelMetadata, seed: int = 0) -> Network:
    """A network whose output depends on its input as much as a trained one's."""
    torch.manual_seed(seed)
    space = metadata.action_space
    spec = PolicySpec(
        space.num_actions,
        space.continuous,
        metadata.neural_network,
        metadata.eyes,
        scan_dims=metadata.scan_dims,
    )
    kind = SACAgent if metadata.training_algorithm == "sac" else ActorCritic
    model = kind(spec).eval()
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.dim() == 1:
                parameter += 0.02 * torch.randn_like(parameter)
            elif parameter.dim() > 1:
                parameter *= 1.3
        if isinstance(model, ActorCritic):
            model.policy_head.weight *= 30.0
    return model


if __name__ == "__main__":
    main()
