"""Trainings as files, made by the writers of our workers, without driving."""

import json
import math
from dataclasses import replace
from pathlib import Path

from drcli.model import keys
from drcli.records.episode_metrics import EpisodeMetrics, encode_metrics
from drcli.records.trace import Episode, Phase, Row, csv_text
from drsim.track.worlds import load_track

WORLD = "reinvent_base"
ACTIONS = [{"steering_angle": angle, "speed": 1.5} for angle in (-20.0, 0.0, 20.0)]
RANGES = {"steering_angle": {"low": -30, "high": 30}, "speed": {"low": 1, "high": 3}}
TRACK = load_track(WORLD)
STEP_S = 1 / 15


def episode(
    number: int,
    steps: int = 8,
    *,
    progress: float = 20.0,
    reward: float = 1.0,
    continuous: bool = False,
    phase: Phase = "training",
) -> Episode:
    """A drive along the centre line from a start of its own, evenly, up to some progress."""
    start = (7 * number) % (len(TRACK.center) - 1)
    driven = Episode(number, phase, clock_s=100.0 * number, track_length_m=TRACK.length_m)
    complete = progress >= 100.0
    for step in range(steps):
        part = step / (steps - 1)
        waypoint = (start + round(part * progress / 100 * 118)) % (len(TRACK.center) - 1)
        x, y = (float(value) for value in TRACK.center[waypoint])
        action = step % len(ACTIONS)
        angle = ACTIONS[action]["steering_angle"]
        last = step == steps - 1
        status = "prepare" if step == 0 else "in_progress"
        if last:
            status = "lap_complete" if complete else "off_track"
        driven.rows.append(
            Row(
                steps=step + 1,
                x=x,
                y=y,
                yaw_deg=0.0,
                steering_deg=angle,
                speed_mps=1.5,
                action=f"[{angle} 1.5]" if continuous else str(action),
                reward=reward if step else 0.0,
                done=last,
                all_wheels_on_track=not last,
                progress=100.0 if last and complete else 0.5 + part * (progress - 0.5),
                closest_waypoint=waypoint,
                status=status,
                pause_s=0.0,
                time_s=(step + 1) * STEP_S,
                reward_ms=0.004 if step else 0.0,
            )
        )
    return driven


def with_reset(driven: Episode, at: int, pause_steps: int = 75) -> Episode:
    """The same drive, but the car leaves the track in a row and waits there as a penalty."""
    rows = driven.rows
    left = replace(rows[at], status="off_track", pause_s=pause_steps * STEP_S)
    waits = [
        replace(
            left,
            status="pause",
            reward=0.0,
            steps=left.steps + n,
            pause_s=(pause_steps - n) * STEP_S,
            time_s=left.time_s + n * STEP_S,
        )
        for n in range(1, pause_steps + 1)
    ]
    later = [
        replace(row, steps=row.steps + pause_steps, time_s=row.time_s + pause_steps * STEP_S)
        for row in rows[at + 1 :]
    ]
    driven.rows = [*rows[:at], left, *waits, *later]
    return driven


def trace(episodes: list[Episode], began_s: float = 1.7e9) -> bytes:
    """A simtrace file."""
    return csv_text(episodes, (began_s, began_s + 10.0)).encode()


def write_model(
    folder: Path,
    *,
    iterations: int = 5,
    episodes: int = 4,
    workers: int = 1,
    continuous: bool = False,
    evaluations: int = 1,
    reward: float = 1.0,
    laps_from: int | None = None,
) -> Path:
    """A model whose cars come further from iteration to iteration.

    Args:
        folder: Where it goes.
        iterations: Their number; 0 for a model that was only evaluated.
        episodes: Of each worker in an iteration.
        workers: Simulation workers.
        continuous: Whether the actions are ranges.
        evaluations: Stand-alone evaluations of two trials each.
        reward: Of a step.
        laps_from: From this iteration on, all episodes are complete laps.
    """
    metadata = {
        "action_space": RANGES if continuous else ACTIONS,
        "action_space_type": "continuous" if continuous else "discrete",
        "sensor": ["FRONT_FACING_CAMERA"],
        "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
        "training_algorithm": "clipped_ppo",
        "version": "5",
    }
    parameters = {"num_episodes_between_training": episodes * workers, "discount_factor": 0.99}
    put(folder, "model/model_metadata.json", json.dumps(metadata).encode())
    put(folder, "ip/hyperparameters.json", json.dumps(parameters).encode())
    put(folder, "reward_function.py", b"def reward_function(params):\n    return 1.0\n")
    put(folder, "training_params.yaml", f"WORLD_NAME: {WORLD}\n".encode())
    records: list[list[EpisodeMetrics]] = [[] for _ in range(workers)]
    for iteration in range(iterations):
        lap = laps_from is not None and iteration >= laps_from
        for worker in range(workers):
            driven = [
                episode(
                    iteration * episodes + k,
                    8 + k,
                    progress=100.0 if lap else 10.0 + 5.0 * iteration + k,
                    reward=reward * (1 + iteration),
                    continuous=continuous,
                )
                for k in range(episodes)
            ]
            key = keys.training_trace("", iteration, worker=worker, workers=workers)
            put(folder, key.lstrip("/"), trace(driven, 1.7e9 + 20.0 * iteration))
            for k, each in enumerate(driven, 1):
                records[worker].append(
                    EpisodeMetrics.of(
                        each, iteration=iteration, episode=iteration * episodes + k, trial=k
                    )
                )
            if worker == 0:
                number = (iteration + 1) * episodes
                tested = episode(number, progress=30.0, phase="evaluation")
                records[0].append(
                    EpisodeMetrics.of(tested, iteration=iteration, episode=number, trial=episodes)
                )
    for worker in range(workers if iterations else 0):
        key = keys.training_metrics("metrics", worker)
        put(folder, key, encode_metrics(records[worker], "progress"))
    for number in range(evaluations):
        trials = [
            episode(k, 10, progress=100.0 if k else 40.0, phase="evaluation") for k in range(2)
        ]
        key = keys.evaluation_trace("", f"2026010203040{number}").lstrip("/")
        put(folder, key, trace(trials))
    return folder


def put(folder: Path, name: str, data: bytes) -> None:
    """Write a file and its folders."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def mean_reward(iteration: int, episodes: int = 4, reward: float = 1.0) -> float:
    """Mean reward of an episode in an iteration of `write_model`."""
    steps = math.fsum(7 + k for k in range(episodes)) / episodes
    return reward * (1 + iteration) * steps
