"""The evaluation worker: drives laps with one checkpoint of a finished or running training.

Run by `dr-evaluate` as `python -m drcli.worker.evaluate CHECKPOINT STAMP`. It reads the model and
writes a trace and metrics of its own; it never changes the model.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import torch
from safetensors.torch import load as load_tensors

from drcli.hyperparameters import Hyperparameters
from drcli.job import Job
from drcli.learn.policy import ActorCritic
from drcli.model_metadata import ModelMetadata
from drcli.store import keys
from drcli.store.checkpoints import CheckpointStore
from drcli.store.connect import open_bucket
from drcli.worker import announce, process
from drcli.worker.driving import Driven, Driver, Plan
from drcli.worker.learning import policy_spec
from drcli.worker.process import Lifeline
from drcli.worker.trace import STATUS_LABELS, Episode, csv_text, log_lines, schedule
from drcli.worker.world import actions_of, load_reward, load_world
from drsim.episode import EpisodeRules
from drsim.reward import centre_line_reward
from drsim.simulation import Simulation

MAX_LAP_S = 600.0
"""Simulated time after which an evaluation gives up a lap."""

COUNTED = {
    "crashed": "crash",
    "immobilized": "immobilized",
    "off_track": "off_track",
    "reversed": "reversed",
}
"""Violations that evaluation metrics count: the words of the trace, and those of the metrics."""


def evaluate(job: Job, lifeline: Lifeline, checkpoint: str, stamp: str) -> list[Episode]:
    """Drive the trials that the settings ask for, and put trace and metrics into the bucket.

    Args:
        job: Settings and folder.
        lifeline: Says when to give up.
        checkpoint: Name of the checkpoint.
        stamp: Fourteen digits that name this evaluation.

    Returns:
        One episode a trial; the laps of a continuous race are trials.
    """
    s = job.settings
    bucket = open_bucket(s, job.directory)
    metadata = ModelMetadata.from_bytes(
        bucket.get(keys.model_metadata(s.model_prefix)), "model_metadata.json"
    )
    parameters = Hyperparameters.from_bytes(
        bucket.get(keys.hyperparameters(s.model_prefix)), "hyperparameters.json"
    )
    print(announce.start_lines(s, metadata, parameters, "EVALUATION"))
    threads = os.cpu_count() or 1
    torch.set_num_threads(threads)
    model = ActorCritic(policy_spec(metadata)).eval()
    loaded = CheckpointStore(bucket, s.model_prefix).load(checkpoint)
    model.load_state_dict(load_tensors(loaded.tensors))

    track = load_world(s, job.directory)
    if s.eval_reverse_direction:
        track = track.reversed()
    reward = (
        load_reward(bucket, s.model_prefix, job.folder)
        if s.eval_debug_reward
        else centre_line_reward
    )
    trials = s.eval_number_of_trials
    continuous = s.eval_is_continuous
    rules = EpisodeRules.evaluation(
        laps=trials if continuous else 1,
        max_resets=s.eval_max_resets,
        off_track_penalty_s=s.eval_off_track_penalty,
        collision_penalty_s=s.eval_collision_penalty,
        max_steps=int(MAX_LAP_S * 15) * (trials if continuous else 1),
    )
    simulation = Simulation(
        track,
        num_cars=1 if continuous else trials,
        reward_function=reward,
        rules=rules,
        num_threads=threads,
        seed=job.seed,
    )
    driver = Driver(simulation, actions_of(metadata), model, job.seed)
    driven: list[Driven] = []
    begin = time.time()
    plans = [Plan(trial, "evaluation", 0.0) for trial in range(1 if continuous else trials)]
    driver.drive(plans, driven.append, lifeline.should_stop)
    driven.sort(key=lambda episode: episode.number)
    episodes: list[Episode] = laps_of(driven[0]) if continuous else [*driven]
    if not continuous:
        schedule(episodes, 0.0)
    wall_clock = (begin, time.time())
    for episode in episodes:
        print(log_lines(episode, track.length_m, wall_clock[1]))
    bucket.put(
        keys.evaluation_trace(s.model_prefix, stamp),
        csv_text(episodes, track.length_m, wall_clock).encode(),
    )
    metrics = {"metrics": [record(e, e.number + 1) for e in episodes]}
    bucket.put(keys.evaluation_metrics(s.metrics_prefix, stamp), json.dumps(metrics).encode())
    (job.folder / "evaluation.json").write_text(json.dumps(metrics), "utf-8")
    return episodes


def laps_of(race: Episode) -> list[Episode]:
    """Cut a continuous race into laps: each is an episode of the trace, numbered from 0."""
    laps = [Episode(0, race.phase, clock_s=race.clock_s)]
    for row in race.rows:
        if laps[-1].rows and laps[-1].rows[-1].progress >= 100.0:
            begin_s = laps[-1].rows[-1].time_s
            laps.append(Episode(len(laps), race.phase, clock_s=race.clock_s, begin_s=begin_s))
        laps[-1].rows.append(row)
    return laps


def record(episode: Episode, trial: int) -> dict[str, Any]:
    """One entry of an evaluation's metrics file.

    Args:
        episode: A trial, or a lap of a continuous race.
        trial: Its number, from 1.
    """
    start_ms = round((episode.clock_s + episode.begin_s) * 1000)
    elapsed_ms = round(episode.duration_s * 1000)
    counts = {
        f"{name}_count": sum(row.status == status for row in episode.rows)
        for status, name in COUNTED.items()
    }
    completed = episode.rows[-1].progress >= 100.0
    # The violation that ended a trial for good put nobody back.
    ended_by_violation = episode.rows[-1].done and not completed
    return {
        "completion_percentage": min(100, max(0, int(episode.progress))),
        "metric_time": start_ms + elapsed_ms,
        "start_time": start_ms,
        "elapsed_time_in_milliseconds": elapsed_ms,
        "episode_status": STATUS_LABELS["lap_complete" if completed else episode.status],
        **counts,
        "reset_count": sum(counts.values()) - ended_by_violation,
        "trial": trial,
    }


def main(checkpoint: str, stamp: str) -> Callable[[Job, Lifeline], None]:
    """The evaluation, to be run as a process."""

    def loop(job: Job, lifeline: Lifeline) -> None:
        evaluate(job, lifeline, checkpoint, stamp)

    return loop


if __name__ == "__main__":
    process.run("evaluation", main(sys.argv[1], sys.argv[2]))
