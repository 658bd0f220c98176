"""Drives a model under a grid of disturbances, many cars at a time."""

import math
import time
from collections import Counter
from collections.abc import Sequence
from statistics import fmean

import torch

from drcli.config.run_config import RunConfig
from drcli.exchange.job import Job
from drcli.exchange.robust_result import RobustCell, RobustResult
from drcli.exchange.trace import STATUS_LABELS
from drcli.store import keys
from drcli.store.bucket import Bucket
from drcli.workers.build_race import build_simulation, load_world, longest_episode
from drcli.workers.driven_episode import Driven, Plan
from drcli.workers.driving import Driver
from drcli.workers.evaluator import MOST_CARS, Entry, enter
from drcli.workers.live_moment import Onlooker
from drcli.workers.live_scene import facts_of
from drcli.workers.live_view import LiveShow
from drcli.workers.robust_grid import PLACES, Cell, grid, with_patterns
from drcli.workers.worker_process import Lifeline
from drsim.car.car import CONTROL_HZ
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.episode.start_poses import offset_of, start_pose
from drsim.track.track import Track
from drsim.track.worlds import directed


def evaluate_robustly(
    job: Job,
    lifeline: Lifeline,
    bucket: Bucket,
    entry: Entry,
    config: RunConfig,
    *,
    stamp: str,
    threads: int,
    live: LiveShow | None = None,
) -> RobustResult:
    cells = grid(job.seed, closed=load_world(config.race()).closed)
    if live is not None:
        live.about(None, entry.checkpoint, facts_of(config.race(), [entry.name]))
        lifeline.pulse.say(f"evaluates {entry.checkpoint} of {entry.name}", waits=False)
    began_s = time.monotonic()
    found = drive_cells(job, lifeline, bucket, entry, config, cells, threads=threads, onlooker=live)
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
    lifeline: Lifeline,
    bucket: Bucket,
    entry: Entry,
    config: RunConfig,
    cells: Sequence[Cell],
    *,
    threads: int,
    laps: int = 1,
    onlooker: Onlooker | None = None,
) -> list[RobustCell]:
    """Drive from every place on the lap, each to the first violation.

    Only traffic is that of the settings. Progress counts all `laps`.

    Raises:
        SettingsError: The model cannot be used.
        StopRequested: The process should stop.
    """
    torch.set_num_threads(1)
    racer, metadata = enter(bucket, entry, config)
    race = config.race().replaced(enable_domain_randomization=False, sim_extras_in="training")
    s = config.evaluation
    track = directed(load_world(race), reverse=s.eval_reverse_direction)
    cells = with_patterns(list(cells), job.seed)
    plans = [plan for number, cell in enumerate(cells) for plan in _plans(number, cell, track)]
    most_steps = min(
        longest_episode(track, racer.actions), math.ceil(s.eval_max_lap_seconds * CONTROL_HZ)
    )
    simulation = build_simulation(
        race,
        "evaluation",
        metadata,
        track,
        num_cars=min(len(plans), MOST_CARS),
        reward=centre_line_reward,
        rules=EpisodeRules(laps=laps, max_steps=most_steps * laps),
        num_threads=threads,
        seed=job.seed,
        longest_latency_s=max(cell.conditions.latency_s for cell in cells),
    )
    driven: list[Driven] = []
    try:
        driver = Driver(simulation, [racer], job.seed, onlooker=onlooker)
        driver.drive(plans, driven.append, lifeline.step_done)
    finally:
        simulation.close()
    driven.sort(key=lambda episode: episode.number)
    return [
        _summed_up(cell, driven[PLACES * number : PLACES * (number + 1)], laps)
        for number, cell in enumerate(cells)
    ]


def _plans(number: int, cell: Cell, track: Track) -> list[Plan]:
    """Those of the same place have the same seed in every cell."""
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
