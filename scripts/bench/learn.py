"""Speed of the learner, compared with other libraries and bare arithmetic.

    python scripts/bench learn [--world NAME] [--rounds 7] [--bucket-rounds 3] [--json]

All trainings have the shipped files: one camera, minibatches of 64, 3 epochs and the network that
--network names, the shipped one by default. The others have the same layers, written as
their users would. Arithmetic is measured on the shallow network, which others call NatureCNN.
Everything is measured in turns, round by round, because other programs slow a machine down for a
while; ratios are medians over the rounds. With --json the last line of stdout is one object with

    throughput_ratio_to_sb3      steps/s driven and learned from, evaluation excluded, of our
                                 training in one process, over those of Stable-Baselines3's PPO on
                                 the same cars; null where that library is missing
    throughput_ratio_to_cleanrl  the same over a script in the manner of CleanRL
    bucket_ratio_to_memory       steps/s of a real training (supervisor, simulation worker and
                                 trainer that meet in the embedded bucket) over those of the very
                                 same iterations in one process
    bucket_equal_iterations      share of those iterations that had equally many steps
    flops_ratio_fp32             arithmetic per second of our update over that of `torch.mm`, the
                                 best of several sizes; operations are counted from the layers
    flops_ratio_bf16             the same in bfloat16; a few samples where that is emulated
    *_steps_per_s, *_gflops      the medians behind them
    sb3_cars, cleanrl_cars       cars side by side with which they were fastest
    sb3_autocast, ...            whether they were fastest with their body in bfloat16 by
                                 torch.autocast
    ranges                       least and greatest ratio of a round

The others may choose among 8, 16 and 32 cars and, where the processor has instructions for
bfloat16, between float32 and torch.autocast; their iterations have 1,024 steps, ours the 20
episodes of hyperparameters.json, whole ones, from the first iteration on that has as many steps.
They run as their users would run them, in processes of their own that wait for their turn, with
as many threads as ours; with --lend they get the process settings of our workers as well.
"""

import argparse
import importlib.util
import os
import platform
import statistics
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from learn_arithmetic import Arithmetic
from learn_peers import STEPS, Choice, Peer, Training
from learn_runs import (
    FEWEST_EVALUATIONS,
    MemoryTraining,
    Pace,
    Work,
    become_like_a_worker,
    together,
    train_through_bucket,
)
from machine import print_json

from drcli.learn.rollout_buffer import Rollout

RATIOS = (
    "throughput_ratio_to_sb3",
    "throughput_ratio_to_cleanrl",
    "bucket_ratio_to_memory",
    "flops_ratio_fp32",
    "flops_ratio_bf16",
)

SHIPPED, SHALLOW = "COMPACT_CONVOLUTIONAL_NETWORK", "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"

TRIALS = 3
"""Iterations of each number of cars by which the others choose; the best one counts."""

MOST_WARM_UP = 40
"""Iterations after which ours counts however short its episodes still are."""

SKIPPED = 2
"""First iterations of a training that do not count: evaluation, first pages, compilation."""


EMULATED_ROUNDS = 2


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--world", default="reinvent_base", help="world to drive in")
    parser.add_argument("--tracks-dir", type=Path, help="folder with further routes")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--cars", type=int, nargs="+", default=[8, 16, 32], help="of the others")
    parser.add_argument("--lend", action="store_true", help="lend them our process settings")
    parser.add_argument("--rounds", type=int, default=7, help="0 leaves the others out")
    parser.add_argument("--flops-rounds", type=int, default=7, help="0 leaves arithmetic out")
    parser.add_argument("--bucket-rounds", type=int, default=3, help="0 leaves the bucket out")
    parser.add_argument("--network", default=SHIPPED, help="neural_network of all trainings")
    parser.add_argument("--iterations", type=int, default=15, help="of a training over the bucket")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    become_like_a_worker()
    environment = FEWEST_EVALUATIONS | {
        "DR_WORLD_NAME": options.world,
        "DR_TRACKS_DIR": str(options.tracks_dir.absolute()) if options.tracks_dir else "",
    }
    parts = []
    if options.bucket_rounds:
        work = Work.load(environment, options.network, options.threads)
        parts.append(measure_bucket(work, options.bucket_rounds, options.iterations))
    work = Work.load(environment, options.network, options.threads)
    say(work.compute.reason)
    ours = warmed_up(work)
    if options.rounds:
        parts.append(
            measure_throughput(
                work, ours, options.rounds, choices(work, options.cars), options.lend
            )
        )
    if options.flops_rounds:
        shallow = Work.load(environment, SHALLOW, options.threads)
        parts.append(measure_arithmetic(shallow, ours.rollout, options.flops_rounds))
    ours.close()
    figures = report(parts) | {"threads": options.threads, "versions": versions()}
    for name, value in figures.items():
        say(f"{name:28} {value}")
    if options.json:
        print_json(figures)


@dataclass
class Measured:
    """A part of the results.

    Attributes:
        ratios: Those of all rounds, by name; empty where there was nothing to compare with.
        figures: Everything else.
    """

    ratios: dict[str, list[float]] = field(default_factory=dict)
    figures: dict[str, Any] = field(default_factory=dict)


def report(parts: Sequence[Measured]) -> dict[str, Any]:
    """All parts as one object: medians of the ratios, figures, ranges of the ratios."""
    ratios: dict[str, list[float]] = {name: [] for name in RATIOS}
    for part in parts:
        ratios |= part.ratios
    medians = {
        name: round(statistics.median(values), 3) if values else None
        for name, values in ratios.items()
    }
    ranges = {
        name: [round(min(values), 3), round(max(values), 3)]
        for name, values in ratios.items()
        if values
    }
    figures = {name: value for part in parts for name, value in part.figures.items()}
    return {**medians, **figures, "ranges": ranges}


def pairs(ours: Sequence[float], theirs: Sequence[float]) -> list[float]:
    """Ratios of what was measured in the same round."""
    return [one / other for one, other in zip(ours, theirs, strict=True)]


def warmed_up(work: Work) -> MemoryTraining:
    """Our training in one process, once its episodes are long enough for a whole iteration."""
    training = MemoryTraining(work, seed=0)
    for _ in range(MOST_WARM_UP):
        if training.iterate().steps >= STEPS:
            break
    return training


def measure_throughput(
    work: Work, ours: MemoryTraining, rounds: int, choices: Sequence[Choice], lend: bool
) -> Measured:
    """Our training in one process, and those of the others, which choose how they run."""
    measured = Measured(figures={"network": work.spec.network})
    contestants: dict[str, Training] = {"ours": ours}
    for name, script in scripts().items():
        choice, contestants[name] = fastest(work, script, choices, lend=lend)
        measured.figures[f"{name}_cars"] = choice.cars
        measured.figures[f"{name}_autocast"] = choice.autocast
    paces: dict[str, list[Pace]] = {name: [] for name in contestants}
    for count in range(rounds + 1):
        for name, training in contestants.items():
            pace = training.iterate()
            if count > 0:  # the first one takes fresh pages
                paces[name].append(pace)
                say(f"{name:8} {pace.steps:6} steps {pace.steps_per_s:7.1f} steps/s")
    rates = {name: [pace.steps_per_s for pace in paces[name]] for name in contestants}
    for name, training in contestants.items():
        measured.figures[f"{name}_steps_per_s"] = round(statistics.median(rates[name]), 1)
        if name != "ours":
            training.close()
            measured.ratios[f"throughput_ratio_to_{name}"] = pairs(rates["ours"], rates[name])
    return measured


def scripts() -> dict[str, str]:
    """Modules of the others, by name, as far as what they need is installed."""
    known = {"sb3": "learn_peer_sb3.py", "cleanrl": "learn_peer_cleanrl.py"}
    if importlib.util.find_spec("stable_baselines3") is None:
        say("No Stable-Baselines3 to compare with: pip install stable-baselines3")
        del known["sb3"]
    return known


def choices(work: Work, cars: Sequence[int]) -> list[Choice]:
    """How the others may run, with one of these numbers of cars."""
    formats = (False, True) if work.compute.bf16 else (False,)
    return [Choice(number, autocast) for autocast in formats for number in cars]


def fastest(
    work: Work, script: str, choices: Sequence[Choice], *, lend: bool
) -> tuple[Choice, Training]:
    """How a training is fastest, and that training."""
    candidates = {choice: Peer(script, work, choice, lend=lend) for choice in choices}
    rates: dict[Choice, list[float]] = {choice: [] for choice in choices}
    for _ in range(TRIALS if len(choices) > 1 else 0):
        for choice, training in candidates.items():
            rates[choice].append(training.iterate().steps_per_s)
            say(f"{script}, {choice}: {rates[choice][-1]:.1f} steps/s")
    best = max(choices, key=lambda choice: max(rates[choice], default=0.0))
    for choice, training in candidates.items():
        if choice != best:
            training.close()
    return best, candidates[best]


def measure_arithmetic(work: Work, rollout: Rollout, rounds: int) -> Measured:
    """Our update compared with bare matrix products, in both number formats."""
    measured = Measured(figures={"flops_network": work.spec.network})
    for name in ("fp32", "bf16"):
        arithmetic = Arithmetic(work, rollout, bf16=name == "bf16")
        arithmetic.update()
        updates, products = [], []
        for _ in range(min(rounds, EMULATED_ROUNDS) if arithmetic.emulated else rounds):
            products.append(arithmetic.product())
            updates.append(arithmetic.update())
            say(f"{name}: {updates[-1] / 1e9:.1f} of {products[-1] / 1e9:.1f} GFLOP/s")
        measured.ratios[f"flops_ratio_{name}"] = pairs(updates, products)
        measured.figures[f"{name}_update_gflops"] = round(statistics.median(updates) / 1e9, 1)
        measured.figures[f"{name}_mm_gflops"] = round(statistics.median(products) / 1e9, 1)
    measured.figures["bf16_emulated"] = arithmetic.emulated
    return measured


def measure_bucket(work: Work, rounds: int, iterations: int) -> Measured:
    """Trainings of two processes that meet in a bucket, and the same ones in this process."""
    bucket, memory, equal = [], [], []
    for seed in range(1, rounds + 1):
        here: list[Pace] = []
        there: list[Pace] = []
        # In turns also who begins.
        for turn in (seed, seed + 1):
            if turn % 2:
                there = train_through_bucket(work, seed, iterations)
            else:
                training = MemoryTraining(work, seed)
                here = [training.iterate() for _ in range(iterations)]
                training.close()
        bucket.append(together(there[SKIPPED:]).steps_per_s)
        memory.append(together(here[SKIPPED:]).steps_per_s)
        equal += [a.steps == b.steps for a, b in zip(here, there, strict=True)]
        say(f"bucket {bucket[-1]:.1f} steps/s, memory {memory[-1]:.1f} steps/s")
    return Measured(
        {"bucket_ratio_to_memory": pairs(bucket, memory)},
        {
            "bucket_network": work.spec.network,
            "bucket_steps_per_s": round(statistics.median(bucket), 1),
            "memory_steps_per_s": round(statistics.median(memory), 1),
            "bucket_equal_iterations": round(statistics.mean(equal), 3),
        },
    )


def versions() -> dict[str, str | None]:
    """What was measured with what."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for name in ("drcli", "torch", "numpy", "mujoco", "stable_baselines3"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def say(text: str) -> None:
    """A line about how it goes, for people."""
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
