"""What the learning curve says about the health of a training."""

from collections.abc import Sequence

from drcli.store.history import IterationRecord
from drcli.store.keys import CheckpointName

_SMOOTH = 3
"""Iterations over which completion is averaged: single ones vary by chance."""

_PEAK = 40.0
"""Mean completion, percent, from which on there is something to lose."""

_FALL = 0.6
"""Share of its best at which completion counts as collapsed."""


def collapse(records: Sequence[IterationRecord], best: str | None) -> str | None:
    """Whether the policy has become far worse than it was, as one sentence; None if not.

    Args:
        records: The iterations so far, oldest first.
        best: Name of the best checkpoint.
    """
    progress = [record.mean_progress for record in records]
    means = [
        sum(progress[end - _SMOOTH : end]) / _SMOOTH for end in range(_SMOOTH, len(progress) + 1)
    ]
    if not means or max(means) < _PEAK or means[-1] > _FALL * max(means):
        return None
    name = CheckpointName.parse(best or "")
    where = "" if name is None else f"; best is {name.number}"
    return f"completion fell from {max(means):.0f} % to {means[-1]:.0f} %{where}"
