"""Tables and files of made trainings, in the reference's formats."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drcli.analysis.run import Run
from drcli.model.files.action_space import ActionSpace
from synthetic_plans import Plan


@dataclass(frozen=True)
class SyntheticRun:
    """A run that was made: `steps` has the columns of a trace, `records` those of metrics."""

    plan: Plan
    steps: pd.DataFrame
    episodes: pd.DataFrame
    records: tuple[list[dict[str, Any]], ...]

    def as_run(self) -> Run:
        """The tables that a reader would make of the files."""
        plan = self.plan
        steps = self.steps
        episodes = self.episodes
        space = (
            ActionSpace(plan.actions)
            if not plan.continuous
            else ActionSpace((), plan.low, plan.high)
        )
        return Run(
            name=f"synthetic-{plan.seed}",
            origin="made",
            layout="drfc" if plan.workers == 1 else "drfc-workers",
            world=None,
            track=None,
            hyperparameters=self.hyperparameters,
            actions=space,
            steps=steps,
            episodes=episodes,
            iterations=iteration_table(episodes, self.records),
            learner=pd.DataFrame(index=pd.Index([], name="iteration")),
            evaluations=(),
            problems=(),
            parent=None,
        )

    @property
    def hyperparameters(self) -> dict[str, Any]:
        base = {
            "batch_size": 64,
            "beta_entropy": 0.01,
            "discount_factor": 0.95,
            "e_greedy_value": 0.05,
            "epsilon_steps": 10000,
            "exploration_type": "categorical",
            "loss_type": "huber",
            "lr": 0.0003,
            "num_epochs": 3,
            "stack_size": 1,
            "term_cond_avg_score": 100000.0,
            "term_cond_max_episodes": 100000,
        }
        return {**base, "num_episodes_between_training": self.plan.episodes, **self.plan.hyper}

    def write(self, folder: Path) -> None:
        """Write the files of a DeepRacer-for-Cloud model."""
        plan = self.plan
        (folder / "ip").mkdir(parents=True)
        (folder / "model").mkdir()
        (folder / "metrics").mkdir()
        (folder / "ip/hyperparameters.json").write_text(json.dumps(self.hyperparameters))
        actions: Any = [
            {"steering_angle": a, "speed": v, "index": n} for n, (a, v) in enumerate(plan.actions)
        ]
        if plan.low is not None and plan.high is not None:
            names = ("steering_angle", "speed")
            actions = {
                name: {"low": low, "high": high}
                for name, low, high in zip(names, plan.low, plan.high, strict=True)
            }
        metadata = {
            "action_space": actions,
            "sensor": ["FRONT_FACING_CAMERA"],
            "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
            "version": "4",
            "training_algorithm": "clipped_ppo",
            "action_space_type": "continuous" if plan.continuous else "discrete",
        }
        (folder / "model/model_metadata.json").write_text(json.dumps(metadata))
        for worker, records in enumerate(self.records):
            suffix = f"_{worker}" if worker else ""
            name = f"TrainingMetrics{suffix}.json"
            (folder / "metrics" / name).write_text(json.dumps({"metrics": records}))
        for (worker, number), rows in self.steps.groupby(["worker", "iteration"]):
            place = folder if plan.workers == 1 else folder / str(worker)
            place = place / "training-simtrace"
            place.mkdir(parents=True, exist_ok=True)
            _trace(rows, plan).to_csv(place / f"{number}-iteration.csv", index=False)


CSV_NAMES = {
    "episode": "episode",
    "steps": "steps",
    "x": "X",
    "y": "Y",
    "yaw": "yaw",
    "steering_angle": "steer",
    "speed": "throttle",
    "action": "action",
    "reward": "reward",
    "done": "done",
    "on_track": "all_wheels_on_track",
    "progress": "progress",
    "closest_waypoint": "closest_waypoint",
    "track_len": "track_len",
    "tstamp": "tstamp",
    "episode_status": "episode_status",
    "pause_duration": "pause_duration",
    "obstacle_crash_counter": "obstacle_crash_counter",
    "wall_clock": "wall_clock",
}


def _trace(rows: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    table = rows.rename(columns=CSV_NAMES).assign(obstacle_crash_counter=0)
    if plan.continuous:
        pairs = zip(table["steer"], table["throttle"], strict=True)
        table["action"] = [f"[{steer} {speed}]" for steer, speed in pairs]
    table["steps"] = table["steps"].astype(float)
    return table[list(CSV_NAMES.values())[: plan.columns]]


def metrics_records(
    plan: Plan, table: pd.DataFrame, evaluated: np.ndarray | None
) -> tuple[list[dict[str, Any]], ...]:
    """What the metrics files of the workers hold."""
    names = ["iteration", "episode", "time", "reward", "progress"]
    found: list[list[dict[str, Any]]] = []
    for worker in range(plan.workers):
        records: list[dict[str, Any]] = []
        rows = table.loc[table["worker"] == worker, names].to_numpy()
        clock, trial = 1000, 0
        for n, (iteration, episode, seconds, reward, percent) in enumerate(rows):
            trial += 1
            number = int(episode) + 1
            records.append(_record(clock, seconds, reward, number, trial, "training", percent))
            clock = records[-1]["metric_time"] + 70
            if n + 1 < len(rows) and rows[n + 1][0] == iteration:
                continue
            trial = 0
            trials = [] if evaluated is None or worker else evaluated[int(iteration)]
            for place, done in enumerate(trials, start=1):
                time_s = done / 100 * plan.length_m / 1.4
                records.append(
                    _record(clock, time_s, 0.8 * done, number, place, "evaluation", done)
                )
                clock = records[-1]["metric_time"] + 70
        found.append(records)
    return tuple(found)


def _record(
    start: int, seconds: float, reward: float, episode: int, trial: int, phase: str, percent: float
) -> dict[str, Any]:
    taken = int(1000 * seconds) + 66
    return {
        "reward_score": round(reward),
        "metric_time": start + taken,
        "start_time": start,
        "elapsed_time_in_milliseconds": taken,
        "episode": episode,
        "trial": trial,
        "phase": phase,
        "completion_percentage": int(percent),
        "episode_status": "Lap complete" if percent >= 100 else "Off track",
    }


def episode_table(steps: pd.DataFrame) -> pd.DataFrame:
    """The table of episodes, as `Run.episodes` describes it."""
    gap = steps["tstamp"].diff().where(steps["episode_status"] != "prepare", 0.0)
    way = np.hypot(steps["x"].diff(), steps["y"].diff()).where(
        steps["episode_status"] != "prepare", 0.0
    )
    groups = steps.assign(gap=gap, way=way).groupby("unique_episode")
    table = groups.agg(
        iteration=("iteration", "first"),
        worker=("worker", "first"),
        episode=("episode", "first"),
        steps=("steps", "size"),
        start_at=("closest_waypoint", "first"),
        progress=("progress", "max"),
        time=("gap", "sum"),
        dist=("way", "sum"),
        reward=("reward", "sum"),
        speed=("speed", "mean"),
        status=("episode_status", "last"),
    )
    table["complete"] = table["progress"] == 100.0
    names = ["1st", "2nd", "3rd", "4th", "5th"]
    table["quintile"] = [names[5 * n // len(table)] for n in range(len(table))]
    return table


def iteration_table(
    episodes: pd.DataFrame, records: tuple[list[dict[str, Any]], ...]
) -> pd.DataFrame:
    """The table of iterations, as `Run.iterations` describes it."""
    laps = episodes["time"].where(episodes["complete"])
    groups = episodes.assign(lap=laps).groupby("iteration")
    table = groups.agg(
        episodes=("reward", "size"),
        steps=("steps", "sum"),
        mean_reward=("reward", "mean"),
        median_reward=("reward", "median"),
        std_reward=("reward", lambda rewards: rewards.std(ddof=0)),
        best_reward=("reward", "max"),
        mean_progress=("progress", "mean"),
        complete_laps=("complete", "sum"),
        best_lap_s=("lap", "min"),
        mean_lap_s=("lap", "mean"),
    )
    trials = max(record["trial"] for record in records[0] if record["phase"] == "training")
    evaluated = pd.DataFrame(
        [
            {"iteration": (r["episode"] - 1) // trials, "progress": r["completion_percentage"]}
            for r in records[0]
            if r["phase"] == "evaluation"
        ],
        columns=["iteration", "progress"],
    )
    means = evaluated.groupby("iteration")["progress"]
    table["eval_mean_reward"] = np.nan
    table["eval_mean_progress"] = means.mean().astype(float).reindex(table.index)
    table["eval_laps"] = means.apply(lambda p: (p >= 100).sum()).astype(float).reindex(table.index)
    table["eval_best_lap_s"] = table["second_clean"] = np.nan
    table["wall_s"] = np.nan
    return table
