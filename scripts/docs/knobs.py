"""Draws how the knobs of hyperparameters.json change learning: docs/pictures/knob-*.png.

    python scripts/docs knobs [--knob NAME ...] [--steps 10000] [--seeds 2]
                                 [--curves DIR] [--into docs/pictures] [--json]

For every knob a few values are trained, each with as many seeds, and everything else as shipped:
`reinvent_base`, the shipped reward, actions and network, 20 episodes an iteration on 20 cars. Each
training runs in this process on one core, with the workers' own pieces and without a bucket. A
picture shows mean progress over the steps driven. Solid: the training episodes of an iteration,
thin lines the seeds and thick lines their mean. Dotted: the mean of evaluations, 5 episodes with
the most likely actions every 2,000 steps.

With --curves, curves are kept in that folder, one .json file a training, and those found there that
are long enough are not trained again. With --json the last line of stdout is one object: for each
knob and value, means over the seeds of

    mean_progress      percent, of training episodes, over all steps: how early and how high
    last_progress      percent, of training episodes, over the last fifth of the steps
    mean_evaluation    percent, over all evaluations
    last_evaluation    percent, of the last one
    cpu_s              processor time of driving and learning, seconds
"""

import argparse
import hashlib
import json
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from learn_runs import Work
from numpy.typing import NDArray

from drcli.convert.build_network import policy_spec
from drcli.drive.driving import Driven, Driver, Plan, Racer, rollout_of
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.compute import flush_denormals
from drcli.learn.ppo import PPO
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.train.trainer import SEED_STRIDE

Floats = NDArray[np.float64]
Change = Mapping[str, Any]
"""Keys of hyperparameters.json, or `neural_network` of model_metadata.json, with their values."""

CARS = 20
ADVANCE = 0.05
"""From one start to the next, laps; as in run.env."""
TRIALS, TRIALS_EVERY = 5, 2_000
"""Episodes of an evaluation, and steps from one to the next."""

GRID_STEPS = 250
"""Distance of the points at which the curves of several seeds are averaged."""


def _values(key: str, *values: Any) -> dict[str, Change]:
    return {str(value): {key: value} for value in values}


KNOBS: dict[str, dict[str, Change]] = {
    "lr": _values("lr", 0.0001, 0.0003, 0.001),
    "discount_factor": _values("discount_factor", 0.9, 0.95, 0.999),
    "num_epochs": _values("num_epochs", 1, 3, 10),
    "batch_size": _values("batch_size", 32, 64, 256),
    "beta_entropy": _values("beta_entropy", 0.0, 0.01, 0.1),
    "num_episodes_between_training": _values("num_episodes_between_training", 5, 20, 40),
    "gae_lambda": _values("gae_lambda", 0.8, 0.95, 1.0),
    "clip_range": _values("clip_range", 0.05, 0.2, 0.5),
    "exploration_type": {
        "categorical": {"exploration_type": "categorical"},
        "e-greedy, epsilon_steps 10000": {"exploration_type": "e-greedy"},
        "e-greedy, epsilon_steps 2000": {"exploration_type": "e-greedy", "epsilon_steps": 2000},
    },
    "loss_type": _values("loss_type", "huber", "mean squared error"),
    "stack_size": _values("stack_size", 1, 2, 4),
    "critic": _values("critic", "camera", "state"),
    "neural_network": _values(
        "neural_network", "COMPACT_CONVOLUTIONAL_NETWORK", "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
    ),
}
"""The values of each knob that are drawn, by how the picture calls them."""


@dataclass(frozen=True)
class Curve:
    """How one training went.

    Attributes:
        steps: Steps driven by the end of each iteration.
        progress: Mean progress of the training episodes of each iteration, percent.
        evaluated: Steps driven by each evaluation.
        evaluation: Mean progress of each evaluation, percent.
        cpu_s: Processor time of driving and learning by the end of each iteration, seconds.
    """

    steps: list[int]
    progress: list[float]
    evaluated: list[int]
    evaluation: list[float]
    cpu_s: list[float]

    def until(self, steps: int) -> "Curve":
        """What a shorter training would have been."""
        last = int(np.searchsorted(self.steps, steps)) + 1
        tried = int(np.searchsorted(self.evaluated, self.steps[:last][-1], side="right"))
        return Curve(
            self.steps[:last],
            self.progress[:last],
            self.evaluated[:tried],
            self.evaluation[:tried],
            self.cpu_s[:last],
        )

    def at(self, steps: Floats) -> Floats:
        """Progress of training at some numbers of steps, on straight lines between iterations."""
        return np.interp(steps, self.steps, self.progress)

    def evaluation_at(self, steps: Floats) -> Floats:
        """Progress of evaluations, likewise."""
        return np.interp(steps, self.evaluated, self.evaluation)


def main() -> None:
    """Train what is missing, and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--knob", nargs="+", choices=KNOBS, default=list(KNOBS))
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--curves", type=Path, help="folder to keep the curves in")
    parser.add_argument("--into", type=Path, default=Path("docs/pictures"))
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    flush_denormals()
    options.into.mkdir(parents=True, exist_ok=True)
    result: dict[str, dict[str, dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.curves or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        # Seed by seed, so that an interrupted sweep has something to say about every knob.
        for seed in range(1, options.seeds + 1):
            for knob in options.knob:
                for change in KNOBS[knob].values():
                    train_once(folder, change, seed, options.steps)
        for knob in options.knob:
            curves = {
                name: [
                    train_once(folder, change, seed, options.steps)
                    for seed in range(1, options.seeds + 1)
                ]
                for name, change in KNOBS[knob].items()
            }
            picture = options.into / f"knob-{knob.replace('_', '-')}.png"
            draw(knob, curves, options.steps, picture)
            result[knob] = {name: figures(found, options.steps) for name, found in curves.items()}
            say(f"{picture}: {picture.stat().st_size / 1024:.0f} kB")
    print(json.dumps(result) if options.json else table(result))


def train_once(folder: Path, change: Change, seed: int, steps: int) -> Curve:
    """The curve of a training, from its file where there is one.

    Args:
        folder: Where curves are kept.
        change: What differs from the shipped files; values that do not differ count as none.
        seed: Of the training.
        steps: Steps to drive.
    """
    work = work_with(change)
    shape = [work.parameters.model_dump(mode="json"), work.spec.network, seed]
    name = hashlib.sha256(json.dumps(shape, sort_keys=True).encode()).hexdigest()[:16]
    path = folder / f"{name}.json"
    if path.exists():
        kept = Curve(**json.loads(path.read_text())["curve"])
        if kept.steps[-1] >= steps:
            return kept.until(steps)
    curve = train(work, seed, steps)
    found = {"change": dict(change), "seed": seed, "curve": asdict(curve)}
    path.write_text(json.dumps(found))
    last = figures([curve], steps)
    say(f"{dict(change)} seed {seed}: " + ", ".join(f"{k} {v:.1f}" for k, v in last.items()))
    return curve


def work_with(change: Change) -> Work:
    """The shipped files with a few values changed.

    Raises:
        SettingsError: A value is out of range.
    """
    shipped = Work.load(
        {"DR_TORCH_PRECISION": "fp32"},
        change.get("neural_network", "COMPACT_CONVOLUTIONAL_NETWORK"),
        threads=1,
    )
    written = json.loads(shipped.files["hyperparameters.json"])
    written |= {key: value for key, value in change.items() if key != "neural_network"}
    parameters = Hyperparameters.from_bytes(json.dumps(written).encode())
    metadata = ModelMetadata.from_bytes(shipped.files["model_metadata.json"])
    return replace(shipped, parameters=parameters, spec=policy_spec(metadata, parameters))


def train(work: Work, seed: int, steps: int) -> Curve:
    """Drive and learn until so many steps are driven, then evaluate."""
    parameters = work.parameters
    torch.manual_seed(seed)
    ppo = PPO(ActorCritic(work.spec), work.config, work.compute)
    simulation = work.simulation(CARS)
    driver = Driver(simulation, [Racer(ppo.model, work.actions)], seed)
    curve = Curve([], [], [], [], [])
    cpu_s, before = 0.0, 0
    while before < steps:
        iteration = len(curve.steps)
        began_s = time.process_time()
        first = iteration * parameters.num_episodes_between_training
        numbers = range(first, first + parameters.num_episodes_between_training)
        driven: list[Driven] = []
        ppo.model.eval()
        driver.drive(
            [Plan(number, "training", number * ADVANCE % 1.0) for number in numbers],
            driven.append,
            epsilon=blind_share(parameters, before),
        )
        rollout = rollout_of(driven)
        ppo.update(rollout, seed + SEED_STRIDE * iteration, steps_before=before)
        cpu_s += time.process_time() - began_s
        after = before + rollout.steps
        curve.steps.append(after)
        curve.progress.append(mean_progress(driven))
        curve.cpu_s.append(cpu_s)
        if after // TRIALS_EVERY > before // TRIALS_EVERY:
            trials: list[Driven] = []
            ppo.model.eval()
            driver.drive([Plan(n, "evaluation", n / TRIALS) for n in range(TRIALS)], trials.append)
            curve.evaluated.append(after)
            curve.evaluation.append(mean_progress(trials))
        before = after
    simulation.close()
    return curve


def mean_progress(episodes: Sequence[Driven]) -> float:
    """Percent of the lap."""
    return float(np.mean([episode.progress for episode in episodes]))


def blind_share(parameters: Hyperparameters, before: int) -> Callable[[int], float] | None:
    """The share of blind actions by the steps of an iteration, as simulation workers choose it."""
    if parameters.exploration_type != "e-greedy":
        return None

    def share(driven: int) -> float:
        done = min(1.0, (before + driven) / parameters.epsilon_steps)
        return 1.0 + (parameters.e_greedy_value - 1.0) * done

    return share


def figures(curves: Sequence[Curve], steps: int) -> dict[str, float]:
    """Means over the seeds; see the top of this file."""
    grid = np.arange(GRID_STEPS, steps + 1, GRID_STEPS, dtype=np.float64)
    heights = np.mean([curve.at(grid) for curve in curves], axis=0)
    return {
        "mean_progress": float(heights.mean()),
        "last_progress": float(heights[grid > 0.8 * steps].mean()),
        "mean_evaluation": float(np.mean([np.mean(curve.evaluation) for curve in curves])),
        "last_evaluation": float(np.mean([curve.evaluation[-1] for curve in curves])),
        "cpu_s": float(np.mean([curve.cpu_s[-1] for curve in curves])),
    }


def draw(knob: str, curves: Mapping[str, Sequence[Curve]], steps: int, path: Path) -> None:
    """Progress over steps, a colour for each value of a knob.

    Args:
        knob: Its name.
        curves: By value, one for each seed.
        steps: Where the picture ends.
        path: The picture, 480 x 300 pixels.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from PIL import Image

    grid = np.arange(0, steps + 1, GRID_STEPS, dtype=np.float64)
    figure, axes = plt.subplots(figsize=(4.8, 3.0), layout="constrained")
    shipped = {key: work_with({}).parameters.model_dump().get(key) for key in (knob,)}
    for number, (name, found) in enumerate(curves.items()):
        color = f"C{number}"
        for curve in found:
            axes.plot(curve.steps, curve.progress, color=color, linewidth=0.7, alpha=0.45)
        mean = np.mean([curve.at(grid) for curve in found], axis=0)
        drawn = grid >= max(curve.steps[0] for curve in found)
        mark = " (shipped)" if KNOBS[knob][name].get(knob) == shipped[knob] else ""
        axes.plot(grid[drawn], mean[drawn], color=color, linewidth=2.2, label=name + mark)
        tried = np.arange(TRIALS_EVERY, steps + 1, TRIALS_EVERY, dtype=np.float64)
        trials = np.mean([curve.evaluation_at(tried) for curve in found], axis=0)
        axes.plot(tried, trials, color=color, linestyle=":", marker="o", markersize=3)
    axes.set(xlim=(0, steps), ylim=(0, 101), title=knob)
    axes.set(xlabel="steps driven", ylabel="mean progress, %")
    axes.grid(visible=True, alpha=0.3)
    axes.legend(fontsize=8, loc="upper left")
    figure.savefig(path, dpi=100)
    plt.close(figure)
    with Image.open(path) as opened:
        small = opened.convert("RGB").quantize(64, method=Image.Quantize.MAXCOVERAGE)
    small.save(path, optimize=True)


def table(result: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
    """All figures, one line for each value of each knob."""
    lines = []
    for knob, values in result.items():
        for name, numbers in values.items():
            shown = ", ".join(f"{key} {value:.1f}" for key, value in numbers.items())
            lines.append(f"{knob} {name}: {shown}")
    return "\n".join(lines)


def say(text: str) -> None:
    """Tell the person who waits; stdout is for the result."""
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
