"""Advice on the updates: batches, learning rate, entropy, discount."""

import math
from dataclasses import dataclass

import numpy as np

from drcli.analysis.findings.advice_item import Advice, rounded, train_on
from drcli.analysis.findings.driving_advice import REWARD_CHECK
from drcli.analysis.findings.evidence import Evidence, algorithm_of
from drcli.analysis.findings.learning_curve import LEAST_NOISE, UNDER, rise, slope, swings
from drcli.analysis.findings.verdict import NOT_LEARNING
from drcli.analysis.run import Run
from drsim.arrays import Floats, Ints

# Removes the effect of where episodes started from means of iterations.


WAVES = 4
"""As many are taken as foretell best an iteration that is left out."""

LEAST_SPREAD = 0.05


def without_starts(run: Run, numbers: Ints, values: Floats) -> Floats:
    """Means of iterations, shape (n,), without what follows from where their episodes started.

    Where each episode starts 5 % of the lap further, 8 episodes start along 40 % of it: one
    iteration has the bends, and the next one the straight. The rest of the fit is made as large as
    it would be by chance without it.
    """
    best, least = values, _left_out(values, np.empty((len(values), 0)))[1]
    for waves in _waves(run, numbers):
        free = len(values) - waves.shape[1]
        if free < len(values) // 2:
            break
        rest, error = _left_out(values, waves)
        if error < least:
            best, least = values.mean() + math.sqrt(len(values) / free) * rest, error
    return np.asarray(best)


def _left_out(values: Floats, waves: Floats) -> tuple[Floats, float]:
    """What a fit by waves, shape (n, waves), leaves, and its error (PRESS)."""
    time = np.linspace(-1.0, 1.0, len(values))
    inputs = np.column_stack([np.ones(len(values)), time, waves])
    basis, triangle = np.linalg.qr(inputs)
    weights = np.linalg.lstsq(triangle, basis.T @ values, rcond=None)[0]
    used = np.minimum(np.sum(basis**2, axis=1), 1.0 - 1e-9)
    error = float(np.mean(((values - inputs @ weights) / (1.0 - used)) ** 2))
    rest = values - waves @ weights[2:]
    return np.asarray(rest - rest.mean()), error


def _waves(run: Run, numbers: Ints) -> list[Floats]:
    """Mean sines and cosines of the starts. Shapes (n, columns)."""
    table, most = run.episodes, run.steps["closest_waypoint"].max()
    at = np.asarray(table["start_at"], dtype=np.float64)
    found: list[Floats] = []
    sets: list[Floats] = []
    if not len(table) or not np.isfinite(at).all() or not most > 0:
        return sets
    for wave in range(1, WAVES + 1):
        angle = 2.0 * math.pi * wave * at / (most + 1.0)
        for value in (np.sin(angle), np.cos(angle)):
            means = table.assign(wave=value).groupby("iteration")["wave"].mean().reindex(numbers)
            column = np.asarray(means, dtype=np.float64)
            if np.isfinite(column).all() and column.std() >= LEAST_SPREAD:
                found.append(column - column.mean())
        if found:
            sets.append(np.column_stack(found))
    return sets


USUAL_LR, USUAL_BATCH, USUAL_EPISODES = 0.0003, 64, 20

JUMP = 0.4
"""Share of the reward, beyond chance; `dr-status` warns of such jumps."""


SMALL_JUMP, TINY_JUMP = 0.3, 0.22

JUMP_SIGMAS, JUMP_SPREAD = 2.0, 0.9
"""The standard error of a mean of n jumps is the second times the mean, divided by sqrt(n):
neighbours share a value.
"""


TURNS = 0.5
"""Unrelated values have two of three."""


JUMP_WINDOW, JUMP_LEAST = 40, 8

SMALL_BATCH, SMALL_EPISODES = 32, 10

TINY_BATCH, TINY_EPISODES = 16, 5

BY_CHANCE = 1.6
"""Times those that the spread of the episodes makes: larger jumps come from the updates."""


EVEN = 0.97
"""A training that learned nothing had 1.00 after 20 iterations; those that learn had 0.95 after 5,
and 0.78 after 8 or 0.88 after 12. The recorded training of the reference has 0.88 after 27.
"""


LOW_LR = 1e-5

HIGH_BETA, USUAL_BETA = 0.03, 0.01


def unstable(evidence: Evidence) -> Advice | None:
    if evidence.fall is not None or algorithm_of(evidence.run).replay:
        return None  # with a replay buffer, an iteration may be a single episode
    curve = evidence.curve
    count = min(JUMP_WINDOW, 2 * len(curve) // 3)
    if count < JUMP_LEAST or not np.isfinite(curve.reward[-count:]).all():
        return None
    newest = curve.iteration[-count:]
    measured = tuple(
        _jumps(what, without_starts(evidence.run, newest, values[-count:]), error[-count:])
        for what, values, error in (
            ("reward", curve.reward, curve.reward_error),
            ("progress", curve.progress, curve.progress_error),
        )
    )
    to_and_fro = [found for found in measured if found.turns >= TURNS]
    if not to_and_fro:
        return None
    jumps = max(to_and_fro, key=lambda found: (found.beyond, found.size))
    batch = evidence.number("batch_size")
    wanted = evidence.number("num_episodes_between_training")
    episodes = float(np.median(curve.episodes[-count:])) if wanted is None else wanted
    small = episodes <= SMALL_EPISODES or (batch is not None and batch <= SMALL_BATCH)
    tiny = episodes <= TINY_EPISODES or (batch is not None and batch <= TINY_BATCH)
    large = jumps.beyond >= (TINY_JUMP if tiny else SMALL_JUMP if small else JUMP)
    chance_alone = episodes <= TINY_EPISODES and jumps.size >= JUMP
    if not (large or chance_alone):
        return None
    numbers = {"jump": jumps.size, "turns": jumps.turns, "episodes": episodes}
    chance = ""
    if jumps.chance is not None:
        numbers["chance"] = jumps.chance
        chance = f"; by chance alone it would jump by {100 * jumps.chance:.0f} %"
    if batch is not None:
        numbers["batch_size"] = batch
    seen = (
        f"From one iteration to the next, the mean {jumps.what} jumps by "
        f"{100 * jumps.size:.0f} %, and {100 * jumps.turns:.0f} % of the jumps turn back{chance}. "
    )
    few = episodes <= SMALL_EPISODES and not (batch is not None and batch <= TINY_BATCH)
    if small or (jumps.chance is not None and jumps.size <= BY_CHANCE * jumps.chance):
        by_batch = batch is not None and batch <= SMALL_BATCH and not few
        return _larger_batch(seen, numbers, episodes, batch, by_batch=by_batch)
    if _outgrown(curve.progress, count):
        return None
    lr = evidence.number("lr")
    return Advice(
        "learning-rate-too-high",
        "The reward zigzags",
        f"{seen}So the updates are too large.",
        numbers if lr is None else {**numbers, "lr": lr},
        "lr",
        train_on(f"lr={lower_lr(evidence)}"),
    )


def _outgrown(progress: Floats, count: int) -> bool:
    """Progress surely rises by more than it jumps: such large updates still help."""
    newest = progress[-count:]
    trend = slope(newest, LEAST_NOISE)
    return trend.rises and trend.gain > float(np.mean(np.abs(np.diff(newest))))


def _larger_batch(
    seen: str, numbers: dict[str, float], episodes: float, batch: float | None, *, by_batch: bool
) -> Advice:
    if by_batch and batch is not None:
        better = max(USUAL_BATCH, 2 * int(batch))
        cause = f"Each change of the weights is a mean over only {batch:.0f} steps (batch_size)."
        setting, change = "batch_size", f"batch_size={better}"
    else:
        better = max(USUAL_EPISODES, 2 * int(episodes))
        cause = f"An iteration has only {episodes:.0f} episodes (num_episodes_between_training)" + (
            f", and a batch {batch:.0f} steps (batch_size)." if batch is not None else "."
        )
        setting = "num_episodes_between_training"
        change = f"num_episodes_between_training={better}"
    return Advice(
        "batch-too-small",
        "The batch is too small for the noise",
        f"{seen}{cause} Chance decides what is learned.",
        numbers,
        setting,
        train_on(change),
    )


@dataclass(frozen=True)
class _Jumps:
    """Jumps of a mean, as shares of it, with those that chance makes."""

    what: str
    size: float
    turns: float
    chance: float | None
    beyond: float


def _jumps(what: str, values: Floats, error: Floats) -> _Jumps:
    """From means and standard errors (NaN for one episode), shapes (n,)."""
    size, turns = swings(values)
    mean = float(np.mean(np.abs(values)))
    if not np.isfinite(error).any() or mean <= 0:
        return _Jumps(what, size, turns, None, 0.0)
    chance = 1.128 * float(np.sqrt(np.nanmean(error**2))) / mean  # E|a - b| is 1.128 sigma
    surely = chance * (1.0 + JUMP_SIGMAS * JUMP_SPREAD / math.sqrt(len(values)))
    beyond = math.sqrt(size**2 - chance**2) if size > surely else 0.0
    return _Jumps(what, size, turns, chance, beyond)


def entropy_rises(evidence: Evidence) -> Advice | None:
    learner = evidence.learner
    if learner is None or learner.rising_since is None:
        return None
    low, now = learner.lowest_entropy, learner.last_entropy
    assert low is not None
    assert now is not None
    beta = evidence.number("beta_entropy")
    change = f"beta_entropy={rounded(beta / 3.0)}" if beta else f"lr={lower_lr(evidence)}"
    return Advice(
        "entropy-rises",
        "The policy becomes less sure",
        f"Its entropy rose from {low:.2f} to {now:.2f} nats in the last {learner.rising_since} "
        "iterations. It should fall while a car learns.",
        {"lowest": low, "now": now, "iterations": learner.rising_since},
        change.partition("=")[0],
        train_on(change),
    )


def even_probabilities(evidence: Evidence) -> Advice | None:
    spread, curve = evidence.spread, evidence.curve
    if spread is None or spread < EVEN or evidence.fall is not None:
        return None
    if len(curve) < NOT_LEARNING or evidence.level >= UNDER or rise(curve) is not None:
        return None  # a new policy is like that, and one that gains needs no advice
    numbers = {"spread": spread, "iterations": float(len(curve)), "progress": evidence.level}
    seen = (
        f"After {len(curve)} iterations, all actions are still nearly equally likely (the spread "
        f"is {100 * spread:.0f} % of that of equal probabilities), and mean progress is "
        f"{evidence.level:.0f} % of the lap. "
    )
    lr, beta = evidence.number("lr"), evidence.number("beta_entropy")
    if lr is not None and lr <= LOW_LR:
        why = f"A learning rate of {lr:g} hardly changes the weights."
        setting, command = "lr", train_on(f"lr={rounded(USUAL_LR)}")
        numbers["lr"] = lr
    elif beta is not None and beta > HIGH_BETA:
        why = f"A beta_entropy of {beta:g} pays it for that."
        setting, command = "beta_entropy", train_on(f"beta_entropy={rounded(USUAL_BETA)}")
        numbers["beta_entropy"] = beta
    else:
        why = "Check that the reward tells good actions from bad ones."
        setting, command = "reward_function.py", REWARD_CHECK
    return Advice(
        "even-probabilities",
        "The policy prefers no action",
        seen + why,
        numbers,
        setting,
        command,
    )


def short_horizon(evidence: Evidence) -> Advice | None:
    horizon = evidence.horizon
    if horizon is None or horizon.steps > 7.5 or evidence.level >= 90.0:
        return None
    way = "" if horizon.metres is None else f" or {horizon.metres:.1f} m"
    return Advice(
        "short-horizon",
        "The car plans only a moment ahead",
        f"A discount_factor of {horizon.discount:g} plans about {horizon.steps:.0f} steps ahead: "
        f"{horizon.seconds:.1f} s{way}. A car cannot see a crash coming that late.",
        {"discount_factor": horizon.discount, "steps": horizon.steps, "seconds": horizon.seconds},
        "discount_factor",
        train_on("discount_factor=0.95"),
    )


def lower_lr(evidence: Evidence) -> str:
    lr = evidence.number("lr") or USUAL_LR
    return rounded(lr / 3.0) if math.isfinite(lr) and lr > 0 else rounded(USUAL_LR / 3.0)
