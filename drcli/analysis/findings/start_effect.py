"""Removes the effect of where episodes started from means of iterations."""

import math

import numpy as np

from drcli.analysis.run import Run
from drsim.arrays import Floats, Ints

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
    table, steps = run.episodes, run.steps
    nothing: list[Floats] = []
    if not len(table) or "start_at" not in table or "closest_waypoint" not in steps:
        return nothing
    at = np.asarray(table["start_at"], dtype=np.float64)
    places = np.asarray(steps["closest_waypoint"], dtype=np.float64)
    most = float(np.nanmax(places)) if np.isfinite(places).any() else 0.0
    if not np.isfinite(at).all() or most <= 0:
        return nothing
    found: list[Floats] = []
    sets = []
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
