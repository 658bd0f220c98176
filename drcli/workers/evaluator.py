"""The evaluation worker: drives laps with one checkpoint of a finished or running training.

Run by `dr-evaluate` as `python -m drcli.workers.evaluator STAMP CHECKPOINT [OPPONENT]`, where the
opponent is the checkpoint of the second model of a HEAD_TO_MODEL race. It reads the models and
writes traces and metrics of its own; it never changes a model.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from safetensors.torch import load as load_tensors

from drcli.base import signal_guard
from drcli.base.errors import SettingsError
from drcli.base.log import plain
from drcli.config.settings import EvaluationConfig, RunConfig
from drcli.exchange.evaluation_metrics import (
    REPORT_FILE,
    TrialMetrics,
    encode_metrics_file,
    encode_report,
)
from drcli.exchange.job import Job
from drcli.exchange.trace import Episode, csv_text, log_lines, schedule
from drcli.modelfiles.network_shape import Design
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.store.checkpoints import CheckpointStore
from drcli.store.connect import open_bucket
from drcli.workers import reference_log, worker_process
from drcli.workers.build_learner import build_policy
from drcli.workers.build_race import (
    actions_of,
    build_simulation,
    load_reward,
    load_world,
    sensors_of_model,
)
from drcli.workers.cores import cores
from drcli.workers.driving import Driven, Driver, Pilot, Plan
from drcli.workers.worker_process import Lifeline
from drsim.car.car import CONTROL_HZ
from drsim.episode.episode import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.track.worlds import directed

MAX_LAP_S = 600.0
"""Simulated time after which an evaluation gives up a lap."""


@dataclass(frozen=True)
class Entry:
    """One racer of an evaluation: which checkpoint drives, and where its results go.

    Attributes:
        prefix: Its model in the bucket.
        checkpoint: Name of the checkpoint.
        trace: Key of its trace.
        metrics: Key of its metrics.
    """

    prefix: str
    checkpoint: str
    trace: str
    metrics: str


def entries(config: RunConfig, stamp: str, checkpoints: Sequence[str]) -> list[Entry]:
    """The racers: the model itself, and the opponent where a second checkpoint is named.

    Args:
        config: Of the evaluation.
        stamp: Fourteen digits that name it.
        checkpoints: One for each racer.
    """
    model, s = config.model, config.evaluation
    own = Entry(
        model.prefix,
        checkpoints[0],
        keys.evaluation_trace(model.prefix, stamp),
        keys.evaluation_metrics(model.metrics_prefix, stamp),
    )
    return [own] + [
        Entry(
            s.eval_opp_s3_model_prefix,
            checkpoint,
            keys.opponent_trace(s.eval_opp_s3_model_prefix),
            keys.opponent_metrics(s.eval_opp_s3_metrics_prefix, stamp),
        )
        for checkpoint in checkpoints[1:]
    ]


def evaluate(job: Job, lifeline: Lifeline, racers: Sequence[Entry]) -> list[list[Episode]]:
    """Drive the trials that the settings ask for, and put traces and metrics into the bucket.

    Args:
        job: Settings and folder.
        lifeline: Says when to give up.
        racers: Who drives, at most two.

    Returns:
        For each racer one episode a trial; the laps of a continuous race are trials.
    """
    s, race = job.config.evaluation, job.config.race()
    bucket = open_bucket(job.config.storage, hurried=lifeline.should_stop)
    threads = cores()
    torch.set_num_threads(1)
    designs = [Design.of_model(bucket, racer.prefix) for racer in racers]
    pilots = [
        _pilot(bucket, racer, design, job.config)
        for racer, design in zip(racers, designs, strict=True)
    ]
    if len({sensors_of_model(design.metadata) for design in designs}) > 1:
        raise SettingsError(
            f"{racers[0].prefix} and {racers[1].prefix} have different sensors and cannot race "
            "each other.",
            remedy="Choose an opponent with the same sensors in DR_EVAL_OPP_S3_MODEL_PREFIX.",
        )
    track = directed(load_world(race), reverse=s.eval_reverse_direction)
    races = 1 if s.eval_is_continuous else s.eval_number_of_trials
    reward = (
        load_reward(bucket, job.config.model.prefix, job.folder, races * len(pilots))
        if s.eval_debug_reward
        else centre_line_reward
    )
    simulation = build_simulation(
        race,
        "evaluation",
        designs[0].metadata,
        track,
        num_cars=races * len(pilots),
        reward=reward,
        rules=_rules(s),
        num_threads=threads,
        seed=job.seed,
    )
    driven: list[Driven] = []
    begin = time.time()
    plans = [
        Plan(trial, "evaluation", 0.0, racer=racer)
        for trial in range(races)
        for racer in range(len(pilots))
    ]
    Driver(simulation, pilots, job.seed).drive(plans, driven.append, lifeline.should_stop)
    driven.sort(key=lambda episode: episode.number)
    wall_clock = (begin, time.time())
    results: list[list[Episode]] = []
    for number, racer in enumerate(racers):
        own = [episode for episode in driven if episode.racer == number]
        episodes: list[Episode] = laps_of(own[0]) if s.eval_is_continuous else [*own]
        if not s.eval_is_continuous:
            schedule(episodes, 0.0)
        _publish(bucket, racer, episodes, track.length_m, wall_clock)
        results.append(episodes)
    report = encode_report([[TrialMetrics.of(e) for e in episodes] for episodes in results])
    (job.folder / REPORT_FILE).write_bytes(report)
    return results


def _pilot(bucket: Bucket, racer: Entry, design: Design, config: RunConfig) -> Pilot:
    """The policy of a racer, with its weights."""
    metadata, parameters = design.metadata, design.parameters
    prefix, race = config.model.prefix, config.race()
    plain.info(reference_log.start_lines(prefix, race, metadata, parameters, "EVALUATION"))
    model = build_policy(metadata, parameters)
    loaded = CheckpointStore(bucket, racer.prefix).load(racer.checkpoint)
    model.load_state_dict(load_tensors(loaded.tensors))
    return Pilot(model, actions_of(metadata))


def _rules(s: EvaluationConfig) -> EpisodeRules:
    laps = s.eval_number_of_trials if s.eval_is_continuous else 1
    return EpisodeRules.evaluation(
        laps=laps,
        max_resets=s.eval_max_resets,
        off_track_penalty_s=s.eval_off_track_penalty,
        collision_penalty_s=s.eval_collision_penalty,
        max_steps=int(MAX_LAP_S * CONTROL_HZ) * laps,
    )


def _publish(
    bucket: Bucket,
    racer: Entry,
    episodes: list[Episode],
    length_m: float,
    wall_clock: tuple[float, float],
) -> None:
    lines = (log_lines(episode, length_m, wall_clock[1]) for episode in episodes)
    plain.info("\n".join([reference_log.OWN_LINE, *lines]))
    bucket.put(racer.trace, csv_text(episodes, length_m, wall_clock).encode())
    bucket.put(racer.metrics, encode_metrics_file([TrialMetrics.of(e) for e in episodes]))


def laps_of(race: Episode) -> list[Episode]:
    """Cut a continuous race into laps: each is an episode of the trace, numbered from 0."""
    laps = [Episode(0, race.phase, clock_s=race.clock_s)]
    for row in race.rows:
        if laps[-1].rows and laps[-1].rows[-1].progress >= 100.0:
            begin_s = laps[-1].rows[-1].time_s
            laps.append(Episode(len(laps), race.phase, clock_s=race.clock_s, begin_s=begin_s))
        laps[-1].rows.append(row)
    return laps


def main(stamp: str, checkpoints: Sequence[str]) -> Callable[[Job, Lifeline], None]:
    """The evaluation, to be run as a process."""

    def loop(job: Job, lifeline: Lifeline) -> None:
        signal_guard.install()
        evaluate(job, lifeline, entries(job.config, stamp, checkpoints))

    return loop


if __name__ == "__main__":
    worker_process.run("evaluation", main(sys.argv[1], sys.argv[2:]))
