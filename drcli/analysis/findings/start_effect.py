"""Takes out of the means of iterations what comes from where their episodes started."""

import math

import numpy as np

from drcli.analysis.run import Run
from drsim.arrays import Floats, Ints

WAVES = 4
"""Most waves around the lap that the effect of the start is made of. Where an iteration starts
along a part of the lap, shorter ones are flattened; where several workers start at the same place,
they are not. As many are taken as foretell best an iteration that is left out."""

LEAST_SPREAD = 0.05
"""Standard deviation of a wave over the iterations; with less, all start alike."""


def without_starts(run: Run, numbers: Ints, values: Floats) -> Floats:
    """Means of iterations without the part that follows from where their episodes started.

    Where each episode starts 5 % of the lap further, 8 episodes start along 40 % of it: one
    iteration has the bends, and the next one the straight. So their means jump to and fro however
    many steps a batch has.

    Args:
        run: The training.
        numbers: The iterations. Shape (n,).
        values: Their means. Shape (n,).

    Returns:
        The rest of a least-squares fit around the mean, as large as it would be by chance without
        the fit; `values` where all start alike or nothing is known. Shape (n,).
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
    """What a fit by waves and a line leaves of values, and its error for values left out.

    The sum of the squared errors of values that are left out of the fit one by one (PRESS) falls
    with a wave only as long as that says more than chance, however many waves there are.

    Args:
        values: The values. Shape (n,).
        waves: The waves. Shape (n, waves).

    Returns:
        The values without their mean and without what follows from the waves, shape (n,); and the
        mean squared error.
    """
    time = np.linspace(-1.0, 1.0, len(values))
    inputs = np.column_stack([np.ones(len(values)), time, waves])
    basis, triangle = np.linalg.qr(inputs)
    weights = np.linalg.lstsq(triangle, basis.T @ values, rcond=None)[0]
    used = np.minimum(np.sum(basis**2, axis=1), 1.0 - 1e-9)
    error = float(np.mean(((values - inputs @ weights) / (1.0 - used)) ** 2))
    rest = values - waves @ weights[2:]
    return np.asarray(rest - rest.mean()), error


def _waves(run: Run, numbers: Ints) -> list[Floats]:
    """Mean of sines and cosines of the starts of each iteration: of one wave, of two, ...

    Each has shape (n, columns), with those columns that vary.
    """
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
