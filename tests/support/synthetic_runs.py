"""Makes the steps of a training that was never driven, from its plan."""

import math

import numpy as np
import pandas as pd

from synthetic_files import SyntheticRun, episode_table, metrics_records
from synthetic_plans import Plan, learning

STEP_S = 1 / 15


def centre_line(plan: Plan) -> np.ndarray:
    """Centre line of the track, a row a waypoint, in driving order. Shape (waypoints + 1, 2)."""
    rng = np.random.default_rng(plan.seed + 7)
    angle = np.linspace(0, 2 * np.pi, 2000)
    radius = np.ones_like(angle)
    if plan.shape == "oval":
        radius = 1 + 0.35 * np.cos(2 * angle)
    elif plan.shape == "blob":
        for wave in (2, 3, 4, 5):
            radius += rng.uniform(0.08, 0.2) * np.cos(wave * angle + rng.uniform(0, 6))
    line = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    if plan.clockwise:
        line = line[::-1]
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    line *= plan.length_m / along[-1]
    at = np.linspace(0, 1, plan.waypoints + 1) * along[-1]
    scaled = np.stack([np.interp(at, along, line[:, n]) for n in (0, 1)], axis=1)
    scaled[-1] = scaled[0]
    return scaled


def make(plan: Plan) -> SyntheticRun:
    """Make the run of a plan."""
    rng = np.random.default_rng(plan.seed + 3)
    level = (plan.level or learning)(plan, rng)
    number = np.repeat(np.arange(plan.iterations), plan.episodes)
    progress = _progress_of(level[number], rng)
    steps = _steps(plan, number, progress, rng)
    evaluated = None
    if plan.evaluations:
        mean = (
            plan.evaluation_level(plan, level, rng)
            if plan.evaluation_level
            else level + plan.lead * np.minimum(1.0, level / 50.0)
        )
        repeated = np.repeat(np.clip(mean, 2, 99.5), plan.evaluations)
        evaluated = _progress_of(repeated, rng).reshape(plan.iterations, plan.evaluations)
    table = episode_table(steps)
    return SyntheticRun(plan, steps, table, metrics_records(plan, table, evaluated))


def _progress_of(mean: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Progress of episodes that fail anywhere alike, with these means; 100 is a complete lap."""
    scales = np.geomspace(1.0, 20000.0, 400)
    means = scales * (1 - np.exp(-100.0 / scales))
    drawn = rng.exponential(np.interp(mean, means, scales))
    return np.asarray(np.clip(np.where(drawn >= 100.0, 100.0, drawn + 1.0), 1.5, 100.0))


def _steps(
    plan: Plan, number: np.ndarray, progress: np.ndarray, rng: np.random.Generator
) -> pd.DataFrame:
    line = centre_line(plan)
    part = number / max(1, plan.iterations - 1)
    if plan.low is not None and plan.high is not None:
        pace = np.full(len(number), (plan.low[1] + plan.high[1]) / 2)
    else:
        pace = np.full(len(number), float(np.mean([v for _, v in plan.actions])))
    count = np.maximum(4, np.ceil(progress / 100 * plan.length_m / (0.95 * pace * STEP_S)))
    count = (count * (1 + plan.slowing * 0.15 * part)).astype(int) + 1  # and the prepare row
    episode = np.repeat(np.arange(len(number)), count)
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    k = np.arange(len(episode)) - first[episode]
    if plan.start == "fixed":
        start = np.zeros(len(number))
    elif plan.start == "spread":
        start = (np.arange(len(number)) * 0.05) % 1.0
    else:
        start = rng.random(len(number))
    done = k / (count[episode] - 1)
    percent = 0.5 + (progress[episode] - 0.5) * done
    percent[k == count[episode] - 1] = progress
    where = (start[episode] + percent / 100) % 1.0
    need = _need_deg(line, plan)[(where * plan.waypoints).astype(int) % plan.waypoints]
    random = (plan.early_random + (plan.late_random - plan.early_random) * part)[episode]
    steer, speed, action = _act(plan, need, random, part[episode], k, episode, rng)
    offset = (
        _smooth(rng.standard_normal(len(k)), 12) * 0.12
        + 0.05 * rng.standard_normal(len(number))[episode]
    )
    point = where * plan.waypoints
    low = point.astype(int) % plan.waypoints
    share = (point - point.astype(int))[:, None]
    ahead = line[low + 1] - line[low]
    tangent = ahead / np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    xy = line[low] + share * ahead + offset[:, None] * np.stack([-tangent[:, 1], tangent[:, 0]], 1)
    yaw = np.degrees(np.arctan2(tangent[:, 1], tangent[:, 0])) + rng.normal(0, 6, len(k))
    on_track = rng.random(len(k)) >= plan.off
    if plan.cut:
        bends = np.abs(need) >= np.quantile(np.abs(need), 1 - plan.cut)
        on_track &= ~(bends & (rng.random(len(k)) < 0.85))
    end = k == count[episode] - 1
    complete = progress[episode] >= 100
    status = np.where(end, np.where(complete, "lap_complete", "off_track"), "in_progress")
    status[k == 0] = "prepare"
    on_track[end & ~complete] = False
    on_track[k == 0] = True
    reward = _reward(plan, speed, offset, percent, k, on_track, rng)
    reward[k == 0] = 0.0
    tick = STEP_S * (1 + 0.03 * rng.standard_normal(len(k)).clip(-3, 3))
    worker = np.arange(len(number)) % plan.workers
    order = np.lexsort((np.arange(len(number)), worker, number))
    rank = np.empty(len(order), dtype=int)
    rank[order] = np.arange(len(order))
    own = np.arange(len(number)) // plan.workers
    frame = pd.DataFrame(
        {
            "episode": own[episode],
            "steps": k + 1.0,
            "x": xy[:, 0],
            "y": xy[:, 1],
            "yaw": (yaw + 180) % 360 - 180,
            "steering_angle": steer,
            "speed": speed,
            "action": action,
            "reward": reward,
            "done": end,
            "on_track": on_track,
            "progress": percent,
            "closest_waypoint": np.rint(point).astype(int) % plan.waypoints,
            "track_len": plan.length_m,
            "tstamp": 10 + np.cumsum(tick),
            "episode_status": status,
            "pause_duration": 0.0,
            "wall_clock": 1.76e9 + np.cumsum(tick) * 1.3 + number[episode] * 20,
            "iteration": number[episode],
            "worker": worker[episode],
            "unique_episode": rank[episode],
        }
    )
    return frame.sort_values(["unique_episode", "steps"], ignore_index=True)


def _act(
    plan: Plan,
    need: np.ndarray,
    random: np.ndarray,
    part: np.ndarray,
    k: np.ndarray,
    episode: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steering, speed and number of the action of each step."""
    size = len(k)
    most = max(abs(a) for a, _ in plan.actions) if plan.actions else plan.high[0]
    if plan.style == "driver":
        options = need + _smooth(rng.standard_normal(size), 3) * 5 + rng.normal(0, 4, size)
        dice = rng.random(size) < random
    else:
        options = rng.normal(0, most / 2.2, size)
        dice = rng.random(size) < 0.6
    options = np.where(dice, rng.uniform(-most * 1.15, most * 1.15, size), options)
    if plan.swing is not None:
        size_deg, period = plan.swing
        phase = rng.random(int(episode.max()) + 1)[episode]
        beat = np.sign(np.sin(2 * np.pi * (k / period + phase) + 1e-6))
        options = 0.4 * options + np.minimum(size_deg, most) * beat
    if plan.side:
        keep = rng.random(size) < rng.uniform(0.94, 1.0)
        options = np.where(keep, plan.side * np.abs(options), options)
    if plan.low is not None and plan.high is not None:
        haste = rng.normal(0.5 + 0.1 * part, 0.28 * (0.4 + random), size).clip(0, 1)
        haste = haste * (1 - 0.12 * plan.slowing * part)
        speed = plan.low[1] + (plan.high[1] - plan.low[1]) * haste
        return np.clip(options, plan.low[0], plan.high[0]), speed, np.full(size, -1)
    pairs = np.array(plan.actions)
    alive = np.array([n for n in range(len(pairs)) if n not in plan.dead])
    angles = np.unique(pairs[:, 0])
    width = max(4.0, float(np.median(np.diff(angles))) * 0.6) if len(angles) > 1 else 10.0
    score = -(((pairs[None, alive, 0] - options[:, None]) / width) ** 2)
    haste = (pairs[alive, 1] - pairs[:, 1].mean()) / max(0.1, np.ptp(pairs[:, 1]))
    score += haste[None, :] * (0.4 * part - plan.slowing * 1.3 * part)[:, None]
    weight = np.exp(score - score.max(axis=1, keepdims=True)) + 0.01
    total = np.cumsum(weight, axis=1)
    drawn = (rng.random(size)[:, None] * total[:, -1:] > total).sum(axis=1)
    action = alive[np.minimum(drawn, len(alive) - 1)]
    if plan.only is not None:
        action = np.where(rng.random(size) < plan.only[1], plan.only[0], action)
    return pairs[action, 0], pairs[action, 1], action


def _reward(
    plan: Plan,
    speed: np.ndarray,
    offset: np.ndarray,
    percent: np.ndarray,
    k: np.ndarray,
    on_track: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    distance = np.abs(offset) / 0.5
    centre = np.maximum(1e-3, 1 - distance**2)
    gained = np.diff(percent, prepend=0.0)
    gained[k == 0] = 0.0
    fast = speed / speed.max()
    found: dict[str, np.ndarray] = {
        "centre": centre,
        "bands": np.where(distance < 0.2, 1.0, np.where(distance < 0.5, 0.5, 0.1)),
        "progress": 2.0 * gained,
        "speed": fast * centre,
        "squared": fast**2,
        "constant": np.ones(len(k)),
        "mixed": centre + 0.5 * fast + gained,
        "inverse": centre / fast,
        "brake": 0.2 + 2.0 * (1.05 - fast),
    }
    reward = np.where(on_track, found[plan.reward], 0.3 * found[plan.reward])
    return np.asarray(reward * (1 + 0.05 * rng.standard_normal(len(k))))


def _need_deg(line: np.ndarray, plan: Plan) -> np.ndarray:
    """Steering that the track needs at each waypoint, degrees."""
    ahead = np.diff(line, axis=0)
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    turn = np.diff(heading, append=heading[0] + 2 * np.pi * (-1 if plan.clockwise else 1))
    curvature = turn / np.hypot(*ahead.T)
    wide = np.convolve(np.tile(curvature, 3), np.ones(3) / 3, "same")[len(turn) : 2 * len(turn)]
    return np.degrees(np.arctan(wide * 0.25))


def _smooth(values: np.ndarray, width: int) -> np.ndarray:
    return np.convolve(values, np.ones(width) / math.sqrt(width), "same")[: len(values)]
