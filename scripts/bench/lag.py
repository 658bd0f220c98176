"""What driving ahead of the learner costs: steps until a lap, by policy lag and number of workers.

    python scripts/bench lag [--workers 1 2 4 8] [--lags 0 1 2 4] [--seeds 1 2 3] [--results FILE]
        [--learner 0.95] [--cap 60000] [--threads 1] [--precision fp32] [--json]

One process drives and learns as the workers and the trainer do, in the order in which they would:
a clock that is only counted says when each worker begins and ends its share of an iteration, and
when a checkpoint is there. A worker needs as long as its steps, so some are faster than others and
drive ahead, up to DR_TRAIN_MAX_LAG iterations. --learner is what the learner needs for a step, as
a share of what eight workers need: from 1 on it is too slow for them, and all of them are always as
far ahead as they may be.

Every checkpoint drives five evaluation laps, and a training ends with the first one that completes
three of them, or at --cap steps. Steps are counted and no time, so other programs change nothing.

With --results each finished training is appended to a file, a JSON object a line, and one that
stands there already is not repeated.
"""

import argparse
import json
import statistics
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from learn_runs import SHIPPED_FILES, Work, become_like_a_worker
from machine import print_json
from steps_to_lap import TRIALS, add_options, append, records, settings_of

from drcli.drive.driving import Driven, Driver, Plan, Racer, rollout_of
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.compute import driving_format
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.learn.encoders import compute_in
from drcli.learn.ppo import PPO
from drcli.train.trainer import SEED_STRIDE

LAPS = (1, 3)
"""Of the evaluation laps of a checkpoint, how many it completes."""

SATURATING = 8
"""Workers that a learner with --learner 1 is just fast enough for."""


@dataclass(frozen=True)
class Case:
    """A training to be measured.

    Attributes:
        workers: Simulation workers.
        lag: DR_TRAIN_MAX_LAG; 0 is DR_TRAIN_OVERLAP=off.
        learner: What the learner needs for a step, as a share of what eight workers need.
        seed: Of the training.
    """

    workers: int
    lag: int
    learner: float
    seed: int


@dataclass(frozen=True)
class Result:
    """How it went.

    Attributes:
        case: What was trained.
        steps: Steps learned from by the first checkpoint that completed so many evaluation laps,
            for each of `LAPS`; None where there was none.
        mean_lag: How many checkpoints older than the newest one the policy was that drove, when
            its steps were learned from; mean of all shares.
    """

    case: Case
    steps: list[int | None]
    mean_lag: float


class LaggedTraining:
    """Trains in this process as several workers and a learner would.

    Attributes:
        steps: Steps learned from.
        lags: Of each share that was learned from.
    """

    def __init__(self, work: Work, case: Case) -> None:
        self._work, self._case = work, case
        self.steps, self.lags = 0, list[int]()
        count, workers = work.parameters.num_episodes_between_training, case.workers
        self._counts = [count // workers + (k < count % workers) for k in range(workers)]
        self._simulation = work.simulation(max(self._counts))
        self._evaluation = work.simulation(TRIALS)
        torch.manual_seed(case.seed)
        self._ppo = PPO(ActorCritic(work.spec), work.config, work.compute)
        self._model = ActorCritic(work.spec).eval()
        compute_in(self._model, driving_format(work.compute.number_format))
        torch.set_num_threads(1)
        racer = Racer(DataParallelPolicy(self._model, work.threads), work.actions)
        self._driver = Driver(self._simulation, [racer], case.seed)
        self._evaluator = Driver(self._evaluation, [racer], case.seed)
        self._newest = 0
        self._weights = {0: self._copy()}
        self._published = [0.0]
        self._free = [0.0] * workers
        self._next = [0] * workers
        self._learner_free = 0.0
        self._driven: dict[int, dict[int, tuple[int, list[Driven]]]] = defaultdict(dict)
        self._ended: dict[int, float] = defaultdict(float)

    def evaluate(self) -> int:
        """How many laps the newest checkpoint completes."""
        self._model.load_state_dict(self._weights[self._newest])
        driven: list[Driven] = []
        plans = [Plan(trial, "evaluation", trial / TRIALS) for trial in range(TRIALS)]
        self._evaluator.drive(plans, driven.append)
        return sum(episode.completed for episode in driven)

    def iterate(self) -> None:
        """Drive until an iteration is complete, and learn from it."""
        number, case = self._newest, self._case
        while len(self._driven[number]) < case.workers:
            self._drive_next()
        shares = self._driven.pop(number)
        rollout = rollout_of([each for k in sorted(shares) for each in shares[k][1]])
        self.lags += [number - checkpoint for checkpoint, _ in shares.values()]
        self._ppo.update(rollout, case.seed + SEED_STRIDE * number, steps_before=self.steps)
        self.steps += rollout.steps
        began = max(self._learner_free, self._ended.pop(number))
        self._learner_free = began + rollout.steps * case.learner / SATURATING
        self._newest += 1
        self._published.append(self._learner_free)
        self._weights[self._newest] = self._copy()
        self._weights.pop(self._newest - case.lag - 1, None)

    def close(self) -> None:
        """Free the threads."""
        self._simulation.close()
        self._evaluation.close()

    def _drive_next(self) -> None:
        """Let the worker that begins next drive its share."""
        lag = self._case.lag
        ready = [k for k, i in enumerate(self._next) if i - lag <= self._newest]
        begins = {
            k: max(self._free[k], self._published[max(0, self._next[k] - lag)]) for k in ready
        }
        worker = min(ready, key=lambda k: begins[k])
        iteration = self._next[worker]
        # What is not published yet comes later: the share of the slowest worker is missing.
        known = [n for n in self._weights if self._published[n] <= begins[worker]]
        checkpoint = max(known)
        self._model.load_state_dict(self._weights[checkpoint])
        driven: list[Driven] = []
        self._driver.drive(self._plans(iteration, worker), driven.append)
        self._free[worker] = begins[worker] + sum(len(each.samples) for each in driven)
        self._ended[iteration] = max(self._ended[iteration], self._free[worker])
        self._driven[iteration][worker] = checkpoint, driven
        self._next[worker] += 1

    def _plans(self, iteration: int, worker: int) -> list[Plan]:
        s, total = self._work.settings, sum(self._counts)
        first = iteration * total + sum(self._counts[:worker])
        return [
            Plan(number, "training", number * s.train_round_robin_advance_dist % 1.0)
            for number in range(first, first + self._counts[worker])
        ]

    def _copy(self) -> dict[str, torch.Tensor]:
        return {name: t.clone() for name, t in self._ppo.model.state_dict().items()}


def main() -> None:
    """Train, and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--workers", nargs="+", type=int, default=[1, 2, 4, 8])
    parser.add_argument("--lags", nargs="+", type=int, default=[0, 1, 2, 4])
    parser.add_argument("--learner", type=float, default=0.95, help="its time for a step")
    add_options(parser, cap=60_000)
    options = parser.parse_args()
    become_like_a_worker()
    done = {Case(**each["case"]): each for each in records(options.results)}
    results = []
    for seed in options.seeds:
        for workers in options.workers:
            for lag in options.lags:
                case = Case(workers, lag, options.learner, seed)
                if case not in done:
                    result = train(case, options)
                    append(options.results, result)
                    done[case] = asdict(result)
                results.append(done[case])
                told = f"{workers} workers, lag {lag}, seed {seed}: {done[case]['steps']}"
                print(told, file=sys.stderr)
    figures = report(results)
    for row in figures:
        print(json.dumps(row), file=sys.stderr)
    if options.json:
        print_json({"rows": figures})


def train(case: Case, options: argparse.Namespace) -> Result:
    """Train until a checkpoint completes three evaluation laps."""
    network = json.loads((SHIPPED_FILES / "model_metadata.json").read_text())["neural_network"]
    work = Work.load(settings_of(options), network, options.threads)
    training = LaggedTraining(work, case)
    steps: list[int | None] = [None] * len(LAPS)
    try:
        while training.steps < options.cap and None in steps:
            laps = training.evaluate()
            for index, wanted in enumerate(LAPS):
                if steps[index] is None and laps >= wanted:
                    steps[index] = training.steps
            training.iterate()
    finally:
        training.close()
    return Result(case, steps, float(np.mean(training.lags)))


def report(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Medians of the steps by lag, for each number of workers and for all."""
    groups: dict[tuple[int, str], list[dict[str, Any]]] = defaultdict(list)
    for each in results:
        lag = each["case"]["lag"]
        groups[lag, str(each["case"]["workers"])].append(each)
        groups[lag, "all"].append(each)
    return [
        {
            "lag": lag,
            "workers": workers,
            "trainings": len(each),
            "mean lag": round(statistics.fmean(one["mean_lag"] for one in each), 2),
            **{
                f"steps to {laps} laps": statistics.median(
                    float("inf") if one["steps"][k] is None else one["steps"][k] for one in each
                )
                for k, laps in enumerate(LAPS)
            },
        }
        for (lag, workers), each in groups.items()
    ]


if __name__ == "__main__":
    main()
