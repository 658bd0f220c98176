"""What entropy, KL divergence and losses say about the updates."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drcli.analysis.findings.learning_curve import rolling
from drcli.store.alarms import ENTROPY_NEAR, ENTROPY_RISE, ENTROPY_SINCE, ENTROPY_WINDOW
from drsim.arrays import Floats

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class LearnerHealth:
    """The updates of a training; None where nothing was recorded.

    Attributes:
        lowest_entropy: Nats; mean over five updates.
        spread: `last_entropy` as a share of that of equal probabilities.
        rising_since: Updates since it was lowest, if it rises as `dr-status` warns of.
        clip_fraction: Share of the steps whose probability ratio was clipped.
    """

    updates: int
    first_entropy: float | None
    last_entropy: float | None
    lowest_entropy: float | None
    spread: float | None
    rising_since: int | None
    median_kl: float | None
    last_value_loss: float | None
    clip_fraction: float | None


def learner_health(learner: "pd.DataFrame", *, sac: bool, actions: int = 0) -> LearnerHealth | None:
    """Judge the updates in `Run.learner`.

    SAC's temperature steers the entropy: then a rise is not a warning.
    """
    if not len(learner):
        return None
    entropy, kl = _known(learner, "entropy"), _known(learner, "kl")
    means = rolling(entropy, ENTROPY_WINDOW)[ENTROPY_WINDOW - 1 :]
    last = _mean(entropy[-ENTROPY_WINDOW:])
    return LearnerHealth(
        updates=len(learner),
        first_entropy=_mean(entropy[:ENTROPY_WINDOW]),
        last_entropy=last,
        lowest_entropy=float(means.min()) if len(means) else None,
        spread=None if last is None or actions < 2 else last / math.log(actions),
        rising_since=None if sac else _rising_since(means),
        median_kl=float(np.median(kl)) if len(kl) else None,
        last_value_loss=_mean(_known(learner, "value_loss")[-ENTROPY_WINDOW:]),
        clip_fraction=_mean(_known(learner, "clip_fraction")[-ENTROPY_WINDOW:]),
    )


def _rising_since(means: Floats) -> int | None:
    if len(means) <= ENTROPY_SINCE:
        return None
    low = int(np.flatnonzero(means <= means.min() + ENTROPY_NEAR)[-1])
    since = len(means) - 1 - low
    risen = since >= ENTROPY_SINCE and means[-1] >= means.min() + ENTROPY_RISE
    return since if risen else None


def _known(learner: "pd.DataFrame", name: str) -> Floats:
    if name not in learner:
        return np.empty(0)
    values = np.asarray(learner[name], dtype=np.float64)
    return values[np.isfinite(values)]


def _mean(values: Floats) -> float | None:
    return float(values.mean()) if len(values) else None
