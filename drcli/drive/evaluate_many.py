"""A worker that drives a share of many evaluations, one after another.

`python -m drcli.drive.evaluate_many SHARE SHARES`: each SHARES-th task from SHARE on. Files
in the job's folder say what came of them.
"""

import math
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean
from typing import Any

import numpy as np
import torch

from drcli.base.errors import DrError, ProblemsError
from drcli.base.files import save_record
from drcli.base.log import get_logger
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_bucket
from drcli.config.run_config import DriveConfig, RunConfig
from drcli.config.track_names import races_on, training_races
from drcli.drive.build_race import (
    build_simulation,
    load_race,
    load_world,
    longest_episode,
    realism_of,
)
from drcli.drive.driving import Driven, Driver, Plan
from drcli.drive.evaluator import MOST_CARS, Entry, enter, entries, evaluate
from drcli.live.live_scene import facts_of
from drcli.live.live_view import LiveShow, live_show
from drcli.live.step_snapshot import LiveObserver
from drcli.model import keys
from drcli.records.evaluation_task import (
    NOMINAL_AXIS,
    EvaluationTask,
    RobustCell,
    RobustResult,
    TaskOutcome,
)
from drcli.records.job import Job
from drcli.records.trace import STATUS_LABELS
from drcli.workers import worker_process
from drcli.workers.cores import usable_cores
from drcli.workers.reward_failures import reward_failure
from drcli.workers.worker_process import StopSignal
from drsim.car.car import CONTROL_HZ
from drsim.car.conditions import NOMINAL, Conditions
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.placing import Side, offset_of, start_pose
from drsim.episode.reward import centre_line_reward
from drsim.errors import RewardError
from drsim.track.track import Track
from drsim.track.worlds import directed

_logger = get_logger(__name__)

# The grid of a robust evaluation: disturbances, starts and tracks.


PLACES = 4
"""Starts of each level, spread evenly over the lap."""

COMBINATIONS = 4
UNSEEN = [f"zoo-{number}" for number in range(9000, 9006)]
"""Where DR_TRAIN_EVAL_WORLD names nothing: nobody trains on so many that these are among them."""

MOST_UNSEEN = 12


@dataclass(frozen=True)
class Cell:
    """One level of one disturbance (`axis`); angles are to the left.

    `track` is an index: 0 for that of the evaluation.
    """

    axis: str
    level: str
    conditions: Conditions = field(default=NOMINAL)
    side: Side = "centre"
    angle_deg: float = 0.0
    other_way: bool = False
    track: int = 0


def grid(seed: int, *, closed: bool = True, unseen: Sequence[str] = ()) -> list[Cell]:
    """All cells; the seed decides what is drawn for the axis `together`.

    An open track is driven in one direction only; `unseen` are names of further tracks.
    """
    cells = [
        Cell(NOMINAL_AXIS, "none"),
        Cell("start", "left", side="left"),
        Cell("start", "right", side="right"),
        Cell("start", "15 deg to the left", angle_deg=15.0),
        Cell("start", "15 deg to the right", angle_deg=-15.0),
        Cell("direction", "the other way", other_way=True),
        *_levels("light", "brightness", (0.35, 0.6, 1.4, 1.9), "x {:g}"),
        *_levels("glare", "glare", (0.5, 1.0), "{:g}"),
        *_levels("reflections", "reflections", (0.5, 1.0), "{:g}"),
        *_levels("noise", "image_noise", (10.0, 25.0, 50.0), "{:g} greys"),
        Cell("camera", "4 deg up", Conditions(camera_turn_deg=(0.0, -4.0, 0.0))),
        Cell("camera", "4 deg down", Conditions(camera_turn_deg=(0.0, 4.0, 0.0))),
        Cell("camera", "4 deg to the left", Conditions(camera_turn_deg=(0.0, 0.0, 4.0))),
        Cell("camera", "4 deg to the right", Conditions(camera_turn_deg=(0.0, 0.0, -4.0))),
        *_levels("latency", "latency_s", (0.03, 0.06, 0.1, 0.15), "{:g} s"),
        *_levels("grip", "friction", (0.4, 0.7, 1.4), "x {:g}"),
        *_levels("battery", "battery", (0.65, 0.85, 1.2), "x {:g}"),
        *_levels("steering trim", "steering_trim_deg", (-8.0, -4.0, 4.0, 8.0), "{:+g} deg"),
        Cell("steering lock", "left x 0.5", Conditions(steering_left=0.5)),
        Cell("steering lock", "right x 0.5", Conditions(steering_right=0.5)),
        *_together(seed),
        *(Cell("unseen tracks", name, track=k) for k, name in enumerate(unseen, start=1)),
    ]
    return [cell for cell in cells if closed or not cell.other_way]


def with_patterns(cells: list[Cell], seed: int) -> list[Cell]:
    """With noise and lamps fixed by the seed."""
    patterns = np.random.SeedSequence([seed, 1]).generate_state(len(cells), np.uint64)
    return [
        replace(cell, conditions=replace(cell.conditions, pattern=pattern))
        for cell, pattern in zip(cells, patterns.tolist(), strict=True)
    ]


def _levels(axis: str, name: str, values: tuple[float, ...], words: str) -> Iterator[Cell]:
    for value in values:
        changed: dict[str, Any] = {name: value}
        yield Cell(axis, words.format(value), replace(NOMINAL, **changed))


def _together(seed: int) -> Iterator[Cell]:
    """Mild, as a real car has them."""
    random = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, 0])))
    for number in range(COMBINATIONS):
        either, share = random.uniform(-1.0, 1.0, 7).tolist(), random.random(4).tolist()
        drawn = Conditions(
            brightness=1.0 + 0.25 * either[0],
            friction=1.0 + 0.2 * either[1],
            battery=1.0 + 0.12 * either[2],
            steering_trim_deg=2.5 * either[3],
            camera_turn_deg=tuple(1.5 * turn for turn in either[4:7]),
            image_noise=8.0 * share[0],
            glare=0.3 * share[1],
            reflections=0.3 * share[2],
            latency_s=0.08 * share[3],
        )
        yield Cell("together", f"draw {number + 1}", drawn)


# Drives a model under a grid of disturbances, many cars at a time.


def evaluate_robustly(
    job: Job,
    stop_signal: StopSignal,
    bucket: Bucket,
    entry: Entry,
    config: RunConfig,
    *,
    stamp: str,
    threads: int,
    live: LiveShow | None = None,
) -> RobustResult:
    unseen = unseen_races(config.race())
    names = [race.world_name for race in unseen]
    cells = grid(job.seed, closed=load_world(config.race()).closed, unseen=names)
    if live is not None:
        live.about(None, entry.checkpoint, facts_of(config.race(), [entry.name]))
        stop_signal.heartbeat.say(f"evaluates {entry.checkpoint} of {entry.name}", waits=False)
    began_s = time.monotonic()
    found = drive_cells(
        job, stop_signal, bucket, entry, config, cells, unseen, threads=threads, observer=live
    )
    result = RobustResult(
        prefix=entry.prefix,
        checkpoint=entry.checkpoint,
        world=config.race().world_name,
        seed=job.seed,
        cells=found,
        seconds=round(time.monotonic() - began_s, 3),
    )
    bucket.put(keys.robust_result(config.model.metrics_prefix, stamp), result.encode())
    return result


def drive_cells(
    job: Job,
    stop_signal: StopSignal,
    bucket: Bucket,
    entry: Entry,
    config: RunConfig,
    cells: Sequence[Cell],
    unseen: Sequence[DriveConfig] = (),
    *,
    threads: int,
    laps: int = 1,
    observer: LiveObserver | None = None,
) -> list[RobustCell]:
    """Drive from every place on the lap, each to the first violation.

    Only traffic is that of the settings. Progress counts all `laps`.

    Raises:
        SettingsError: The model cannot be used.
        StopRequested: The process should stop.
    """
    torch.set_num_threads(1)
    racer, metadata = enter(bucket, entry, config)
    race = config.race()
    if realism_of(race, "evaluation").gray_overlay == 1.0:  # of this car, so under every level
        cells = [
            replace(cell, conditions=replace(cell.conditions, gray_overlay=True)) for cell in cells
        ]
    race = race.replaced(enable_domain_randomization=False, sim_extras_in="training")
    s = config.evaluation
    track = directed(load_world(race), reverse=s.eval_reverse_direction)
    tracks = [track, *map(load_world, unseen)]
    cells = with_patterns(list(cells), job.seed)
    plans = [plan for number, cell in enumerate(cells) for plan in _plans(number, cell, tracks)]
    most_steps = min(
        max(longest_episode(each, racer.actions) for each in tracks),
        math.ceil(s.eval_max_lap_seconds * CONTROL_HZ),
    )
    simulation = build_simulation(
        race,
        "evaluation",
        metadata,
        tracks,
        num_cars=min(len(plans), MOST_CARS),
        reward=centre_line_reward,
        rules=EpisodeRules(laps=laps, max_steps=most_steps * laps),
        num_threads=threads,
        seed=job.seed,
        longest_latency_s=max(cell.conditions.latency_s for cell in cells),
    )
    try:
        driver = Driver(simulation, [racer], job.seed, observer=observer)
        driven = driver.driven(plans, stop_signal.step_done)
    finally:
        simulation.close()
    return [
        _summed_up(cell, driven[PLACES * number : PLACES * (number + 1)], laps)
        for number, cell in enumerate(cells)
    ]


def unseen_races(race: DriveConfig) -> list[DriveConfig]:
    """The race on tracks that the model was not trained on, where there is room for it."""
    trained = {each.world_name for each in training_races(race)}
    named = races_on(race, "DR_TRAIN_EVAL_WORLD")[:MOST_UNSEEN]
    found = []
    for each in named or [race.replaced(world_name=name) for name in UNSEEN]:
        try:
            load_race(each, load_world(each))
        except ProblemsError as error:
            _logger.warning("%s is left out: %s", each.world_name, error)
            continue
        if each.world_name not in trained:
            found.append(each)
    return found


def _plans(number: int, cell: Cell, tracks: Sequence[Track]) -> list[Plan]:
    """Those of the same place have the same seed in every cell."""
    track = tracks[cell.track]
    driven = track.reversed() if cell.other_way else track
    plans = []
    for place in range(PLACES):
        fraction = place / PLACES if track.closed else 0.0
        wanted_m = offset_of(driven, fraction, cell.side)
        plans.append(
            Plan(
                PLACES * number + place,
                "evaluation",
                fraction,
                reverse=cell.other_way,
                offset_m=start_pose(driven, fraction, wanted_m, cell.angle_deg).offset_m,
                angle_deg=cell.angle_deg,
                world=place,
                conditions=cell.conditions,
                track=cell.track,
            )
        )
    return plans


def _summed_up(cell: Cell, driven: Sequence[Driven], laps: int) -> RobustCell:
    complete = [episode for episode in driven if episode.completed]
    others = Counter(e.status for e in driven if not e.completed)
    return RobustCell(
        axis=cell.axis,
        level=cell.level,
        trials=len(driven),
        completed=len(complete),
        progress=round(fmean(_progress(episode, laps) for episode in driven), 3),
        lap_s=round(fmean(e.duration_s / laps for e in complete), 3) if complete else None,
        ended_by=STATUS_LABELS[others.most_common(1)[0][0]] if others else "",
    )


def _progress(episode: Driven, laps: int) -> float:
    if episode.completed:
        return 100.0
    whole = sum(row.progress >= 100.0 for row in episode.rows)
    last = episode.progress if episode.progress < 100.0 else 0.0
    return min(100.0, max(0.0, (100.0 * whole + last) / laps))


def drive_share(
    job: Job, stop_signal: StopSignal, share: int, shares: int, live: LiveShow | None = None
) -> None:
    threads = max(1, usable_cores(job.config.train) // shares)
    for task in job.tasks[share::shares]:
        _logger.info("Evaluates %s of %s on %s.", task.checkpoint, task.prefix, task.world)
        try:
            outcome = _driven(job, stop_signal, task, threads, live)
        except RewardError as error:
            outcome = _refused(reward_failure(error))
        except DrError as error:
            outcome = _refused(error)
        save_record(job.folder / task.outcome_file, outcome)


def config_of(config: RunConfig, task: EvaluationTask) -> RunConfig:
    race = config.race().replaced(world_name=task.world)
    model = replace(config.model, prefix=task.prefix, metrics_prefix=task.metrics_prefix)
    return replace(config, model=model, races=(race,))


def _driven(
    job: Job, stop_signal: StopSignal, task: EvaluationTask, threads: int, live: LiveShow | None
) -> TaskOutcome:
    config = config_of(job.config, task)
    [entry] = entries(config, task.stamp, [task.checkpoint], [task.source])
    if task.robust:
        bucket = open_bucket(config.storage, hurried=stop_signal.should_stop)
        robust = evaluate_robustly(
            job, stop_signal, bucket, entry, config, stamp=task.stamp, threads=threads, live=live
        )
        return TaskOutcome(robust=robust)
    found = evaluate(
        job,
        stop_signal,
        [entry],
        config=config,
        threads=threads,
        live=live,
        fresh_laps=task.fresh_laps,
    )
    return TaskOutcome(trials=found.racers[0], notes=found.notes)


def _refused(error: DrError) -> TaskOutcome:
    _logger.warning("%s %s", error, error.remedy)
    return TaskOutcome(reason=str(error), remedy=error.remedy, code=error.code)


def main(job: Job, stop_signal: StopSignal) -> None:
    share, shares = map(int, sys.argv[1:])
    name, models = f"evaluation-{share}", [job.config.model.prefix]
    with live_show(job, name, stop_signal.heartbeat, models) as live:
        drive_share(job, stop_signal, share, shares, live)


if __name__ == "__main__":
    worker_process.run("evaluation", main)
