"""The evaluation worker, which never changes a model.

`python -m drcli.drive.evaluator STAMP CHECKPOINT [OPPONENT]`. The job says whether files
drive instead.
"""

import math
import os
import sys
import time
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import cast

import numpy as np
import torch

from drcli.base.errors import SettingsError
from drcli.base.log import plain, traces
from drcli.base.report import counted
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_bucket
from drcli.config.run_config import EvaluationConfig, RunConfig
from drcli.config.value_types import START_SIDES
from drcli.convert.build_network import build_policy, load_weights
from drcli.convert.policy_file import read_policy_file
from drcli.convert.runtimes import policy_of_file, policy_of_model
from drcli.convert.stored_checkpoint import driving_graph, load_checkpoint
from drcli.drive import reference_log
from drcli.drive.build_race import (
    actions_of,
    build_simulation,
    load_reward,
    load_world,
    longest_episode,
    sensors_of_model,
)
from drcli.drive.driving import Driven, Driver, Plan, Racer, log_trial
from drcli.learn.policy import Policy
from drcli.live.live_scene import facts_of
from drcli.live.live_view import LiveShow, live_show
from drcli.metrics.figure_events import trial_points
from drcli.metrics.open_sinks import sender_of_episodes
from drcli.model import keys
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.model_metadata import ModelMetadata
from drcli.model.files.network_shape import Design
from drcli.model.model_store import ModelStore
from drcli.records.episode_metrics import (
    REPORT_FILE,
    EvaluationTrials,
    TrialMetrics,
    encode_metrics_file,
)
from drcli.records.evaluation_task import PolicySource, RaceRecording, RecordedObjects
from drcli.records.job import Job
from drcli.records.trace import Episode, csv_text, log_lines, schedule
from drcli.workers import worker_process
from drcli.workers.cores import usable_cores
from drcli.workers.reward_failures import RewardFailures
from drcli.workers.worker_process import StopSignal
from drsim.car.car import CONTROL_HZ
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.placing import Side, offset_of, start_pose
from drsim.episode.reward import centre_line_reward
from drsim.race.solids import Shape
from drsim.track.track import Track
from drsim.track.worlds import directed

# What an evaluation leaves beside its trace, so that it can be filmed later.


_DIGITS = 4


def recording_of_race(
    config: RunConfig,
    model: str,
    shapes: Sequence[Shape],
    driven: Sequence[Driven],
    episodes: Sequence[Episode],
) -> RaceRecording:
    race = config.race()
    objects = [poses for drive in driven for poses in drive.objects]
    rows = sum(len(drive.rows) for drive in driven)
    recorded = []
    if shapes and len(objects) == rows:
        begin = 0
        for episode in episodes:
            end = begin + len(episode.rows)
            recorded.append(RecordedObjects(episode.number, _poses(objects[begin:end])))
            begin = end
    return RaceRecording(
        world=race.world_name,
        reverse=config.evaluation.eval_reverse_direction,
        race_type=race.race_type,
        model=model,
        checkpoint="",
        racer=race.racer_name,
        color=race.car_color,
        shapes=[shape.name for shape in shapes] if recorded else [],
        episodes=recorded,
        off_track_penalty_s=config.evaluation.eval_off_track_penalty,
        collision_penalty_s=config.evaluation.eval_collision_penalty,
    )


def _poses(objects: Sequence[np.ndarray]) -> list[list[list[float]]]:
    """Only the first row if nothing moved."""
    poses = np.round(np.stack(objects), _DIGITS)
    if (poses == poses[0]).all():
        poses = poses[:1]
    rows: list[list[list[float]]] = poses.tolist()
    return rows


# Fresh starts of evaluation laps, each a little off the ideal start.
#
# A deterministic policy drives each lap from the same start alike. The spread is that of a car
# set down by hand.


OFFSET_SHARE = 0.1
ANGLE_DEG = 3.0


def fresh_starts(track: Track, count: int, seed: int) -> list[Plan]:
    """Plans in the order of the lap, drawn from the seed.

    One start lies in each of `count` equal parts; on an open track all are at its beginning.
    """
    # A name of its own among the random numbers of a seed.
    random = np.random.default_rng([seed, 0x5747])
    parts, sides, turns = random.random((3, count))
    plans = []
    for number in range(count):
        fraction = float((number + parts[number]) / count) if track.closed else 0.0
        most_m = OFFSET_SHARE * _width_m(track, fraction)
        angle_deg = float(ANGLE_DEG * (2.0 * turns[number] - 1.0))
        wanted_m = float(most_m * (2.0 * sides[number] - 1.0))
        pose = start_pose(track, fraction, wanted_m, angle_deg)
        plans.append(
            Plan(number, "evaluation", fraction, offset_m=pose.offset_m, angle_deg=angle_deg)
        )
    return plans


def _width_m(track: Track, fraction: float) -> float:
    distance_m = np.array([fraction * track.length_m])
    # The lanes lie midway between the centre line and the borders.
    inner, outer = (track.pose_at(distance_m, lane)[0] for lane in ("inner", "outer"))
    return 2.0 * float(np.hypot(*(outer - inner)[:2]))


OPPONENT_COLOR = "Orange"
"""Source: the reference."""

MOST_CARS = 64
"""More do not make a step faster."""

FRESH_SEEDS = 1 << 32
"""Added to the seed: no training chose a checkpoint by laps from these starts."""

MOST_ENGINE_THREADS = 2
"""Without PyTorch, more do not help a few pictures at a time."""


@dataclass(frozen=True)
class Entry:
    """A model that drives, with keys of its trace and metrics; `source` may be a file."""

    prefix: str
    checkpoint: str
    trace: str
    metrics: str
    source: PolicySource = field(default_factory=PolicySource)

    @property
    def recording(self) -> str:
        return keys.recording_of(self.trace)

    @property
    def name(self) -> str:
        return self.prefix if self.source.file is None else str(self.source.file)


def entries(
    config: RunConfig,
    stamp: str,
    checkpoints: Sequence[str],
    sources: Sequence[PolicySource] = (),
) -> list[Entry]:
    sources = sources or [PolicySource()] * len(checkpoints)
    model, s = config.model, config.evaluation
    own = Entry(
        model.prefix,
        checkpoints[0],
        keys.evaluation_trace(model.prefix, stamp),
        keys.evaluation_metrics(model.metrics_prefix, stamp),
        sources[0],
    )
    if len(checkpoints) == 1:
        return [own]
    opponent = Entry(
        s.eval_opp_s3_model_prefix,
        checkpoints[1],
        keys.opponent_trace(s.eval_opp_s3_model_prefix),
        keys.opponent_metrics(s.eval_opp_s3_metrics_prefix, stamp),
        sources[1],
    )
    return [own, opponent]


def evaluate(
    job: Job,
    stop_signal: StopSignal,
    entered: Sequence[Entry],
    *,
    config: RunConfig | None = None,
    threads: int | None = None,
    live: LiveShow | None = None,
    fresh_laps: int = 0,
) -> EvaluationTrials:
    """Drive the trials, and put traces and metrics into the bucket.

    There is one episode for each trial and racer; the laps of a continuous race are trials.
    `fresh_laps` replace the trials; each ends at its first violation.

    Raises:
        SettingsError: A model cannot be used, or the two cannot race each other.
        StopRequested: The process should stop.
    """
    config = config or job.config
    s, race = config.evaluation, config.race()
    bucket = open_bucket(config.storage, hurried=stop_signal.should_stop)
    torch.set_num_threads(1)
    entrants = [enter(bucket, entry, config) for entry in entered]
    racers = [racer for racer, _ in entrants]
    if len({sensors_of_model(metadata) for _, metadata in entrants}) > 1:
        raise SettingsError(
            f"{entered[0].name} and {entered[1].name} have different sensors and cannot race "
            "each other.",
            remedy="Choose an opponent with the same sensors in DR_EVAL_OPP_S3_MODEL_PREFIX or "
            "with --opp-model.",
        )
    track = directed(load_world(race), reverse=s.eval_reverse_direction)
    most_steps = math.ceil(s.eval_max_minutes * 60 * CONTROL_HZ) or sys.maxsize
    lap_steps = min(math.ceil(s.eval_max_lap_seconds * CONTROL_HZ), most_steps)
    continuous = s.eval_is_continuous and not fresh_laps
    laps = s.eval_number_of_trials if continuous else 1
    notes: list[str] = []
    if fresh_laps:
        starts = fresh_starts(track, fresh_laps, FRESH_SEEDS + job.seed)
        # A car that gets nowhere must not keep the others waiting.
        lap_steps = min(lap_steps, longest_episode(track, racers[0].actions))
    else:
        start, notes = start_of(s, track)
        races = 1 if continuous else s.eval_number_of_trials
        starts = [replace(start, number=trial) for trial in range(races)]
    plans = [replace(plan, racer=racer) for plan in starts for racer in range(len(racers))]
    num_cars = min(len(plans), MOST_CARS) if fresh_laps else len(plans)
    reward = (
        load_reward(
            ModelStore(bucket, config.model.prefix), job.folder / f"reward-{os.getpid()}", num_cars
        )
        if s.eval_debug_reward
        else centre_line_reward
    )
    simulation = build_simulation(
        race,
        "evaluation",
        entrants[0][1],
        track,
        num_cars=num_cars,
        reward=reward,
        rules=EpisodeRules.evaluation(
            laps=laps,
            max_resets=0 if fresh_laps else s.eval_max_resets,
            off_track_penalty_s=s.eval_off_track_penalty,
            collision_penalty_s=s.eval_collision_penalty,
            max_steps=min(lap_steps * laps + 1, most_steps),
            max_lap_steps=lap_steps,
        ),
        num_threads=threads or usable_cores(job.config.train),
        seed=job.seed,
        on_reward_error=RewardFailures(job.config.train).handle,
    )
    if live is not None:
        names = [entry.name for entry in entered]
        live.about(None, entered[0].checkpoint, facts_of(race, names, OPPONENT_COLOR))
        stop_signal.heartbeat.say(f"evaluates {entered[0].checkpoint} of {names[0]}", waits=False)
    begin, began_s = time.time(), time.monotonic()
    try:
        driver = Driver(simulation, racers, job.seed, keeps_objects=True, observer=live)
        driven = driver.driven(plans, stop_signal.step_done)
        shapes = [] if simulation.traffic is None else list(simulation.traffic.shapes)
    finally:
        simulation.close()
    wall_clock = (begin, begin + time.monotonic() - began_s)
    trials: list[list[TrialMetrics]] = []
    colors = race.car_color, OPPONENT_COLOR if len(entered) > 1 else ""
    by_racer = [[each for each in driven if each.racer == racer] for racer in range(len(entered))]
    kept = len(starts)
    if not (continuous or fresh_laps):
        lengths = [max(len(each.rows) for each in trial) for trial in zip(*by_racer, strict=True)]
        kept = trials_in_time(lengths, most_steps)
    if late := len(starts) - kept:
        minutes = f"DR_EVAL_MAX_MINUTES={s.eval_max_minutes:g}"
        notes.append(f"{counted(late, 'trial')} left out, which would end after {minutes}.")
    for racer, entry in enumerate(entered):
        own = by_racer[racer][:kept]
        episodes: list[Episode] = laps_of(own[0]) if continuous else [*own]
        if not continuous:
            schedule(episodes, 0.0)
        # Only the first lap of a continuous race has a start.
        begun = {plan.number: plan for plan in starts}
        trials.append([_recorded(episode, begun.get(episode.number)) for episode in episodes])
        lines = (log_lines(episode, wall_clock[1]) for episode in episodes)
        traces.info("\n".join([reference_log.OWN_LINE, *lines]))
        for episode in episodes:
            log_trial(episode, entry.name)
        bucket.put(entry.trace, csv_text(episodes, wall_clock).encode())
        bucket.put(entry.metrics, encode_metrics_file(trials[-1]))
        recording = replace(
            recording_of_race(config, entry.name, shapes, own, episodes),
            checkpoint=entry.checkpoint if entry.source.file is None else "",
            racer=(race.racer_name, s.eval_opp_racer_name)[racer],
            color=colors[racer],
            other_color=colors[1 - racer],
        )
        bucket.put(entry.recording, recording.encode())
        figures = sender_of_episodes(config.figures, entry.name)
        figures.send(*trial_points(trials[-1], wall_clock))
        figures.close()  # may wait for a slow tool, so it comes last
    return EvaluationTrials(trials, notes)


def trials_in_time(lengths: Sequence[int], most_steps: int) -> int:
    """How many trials end in time when they are driven one after the other; `lengths` in steps.

    The first one always counts: it was cut off at that time.
    """
    return max(1, bisect_right([*accumulate(lengths)], most_steps))


def _recorded(episode: Episode, plan: Plan | None) -> TrialMetrics:
    record = TrialMetrics.of(episode)
    if plan is None:
        return record
    return replace(  # to the last digit, so that it can be driven again
        record,
        start_position=plan.start_fraction,
        start_offset_m=plan.offset_m,
        start_angle_deg=plan.angle_deg,
    )


def start_of(s: EvaluationConfig, track: Track) -> tuple[Plan, list[str]]:
    """The start that the settings ask for, and what is different about it."""
    fraction, word = s.eval_start_position, s.eval_start_offset
    by_word = word in START_SIDES
    wanted_m = offset_of(track, fraction, cast(Side, word)) if by_word else float(word)
    pose = start_pose(track, fraction, wanted_m, s.eval_start_angle)
    notes = []
    if pose.offset_m != wanted_m:
        notes.append(
            f"A start {wanted_m:.2f} m to the left of the centre line (DR_EVAL_START_OFFSET={word})"
            f" would stand off {track.name}; the car starts {pose.offset_m:.2f} m to the left."
        )
    plan = Plan(0, "evaluation", fraction, offset_m=pose.offset_m, angle_deg=s.eval_start_angle)
    return plan, notes


def enter(bucket: Bucket, entry: Entry, config: RunConfig) -> tuple[Racer, ModelMetadata]:
    """The policy of an entry in its engine.

    Raises:
        SettingsError: It cannot be used, or its file has changed since it was checked.
        NotAvailable: Its engine is not installed here.
    """
    store, source = ModelStore(bucket, entry.prefix), entry.source
    threads, runtime = min(MOST_ENGINE_THREADS, usable_cores(config.train)), source.runtime
    policy: Policy
    if source.file is None:
        file = driving_graph(store, entry.checkpoint)
        runtime = None if file is not None and runtime == "torch" else runtime
    else:
        file = read_policy_file(source.file, source.metadata)
        if source.sha256 not in ("", file.sha256):
            raise SettingsError(
                f"{source.file} has changed while its evaluation started.",
                remedy="Wait until it is completely written, then run `dr-evaluate` again.",
            )
    if file is not None:
        metadata = file.metadata
        _say_start(config, metadata, Hyperparameters.from_bytes(b"{}"))
        policy = policy_of_file(file, runtime, threads)
    else:
        checkpoint = load_checkpoint(store, entry.checkpoint)
        design = Design.of_record(store, checkpoint.record)
        metadata = design.metadata
        _say_start(config, metadata, design.parameters)
        model = build_policy(metadata, design.parameters)
        load_weights(model, checkpoint.tensors, checkpoint.record.name)
        origin = f"{checkpoint.record.name} of {entry.prefix}"
        policy = policy_of_model(model, metadata, runtime or "torch", origin, threads)
    return Racer(policy, actions_of(metadata)), metadata


def _say_start(config: RunConfig, metadata: ModelMetadata, parameters: Hyperparameters) -> None:
    prefix, race = config.model.prefix, config.race()
    plain.info(reference_log.start_lines(prefix, race, metadata, parameters, "EVALUATION"))


def laps_of(race: Episode) -> list[Episode]:
    """Cut a continuous race into laps, the episodes of its trace."""
    first = Episode(0, race.phase, clock_s=race.clock_s, track_length_m=race.track_length_m)
    laps = [first]
    for row in race.rows:
        if laps[-1].rows and laps[-1].rows[-1].progress >= 100.0:
            begin_s = laps[-1].rows[-1].time_s
            laps.append(replace(first, number=len(laps), rows=[], begin_s=begin_s))
        laps[-1].rows.append(row)
    return laps


def main(job: Job, stop_signal: StopSignal) -> None:
    stamp, *checkpoints = sys.argv[1:]
    entered = entries(job.config, stamp, checkpoints, job.sources)
    with live_show(job, "evaluation", stop_signal.heartbeat, [entered[0].name]) as live:
        found = evaluate(job, stop_signal, entered, live=live)
    (job.folder / REPORT_FILE).write_bytes(found.encode())


if __name__ == "__main__":
    worker_process.run("evaluation", main)
