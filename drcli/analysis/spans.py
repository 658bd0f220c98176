"""Runs of equal numbers in sorted columns."""

from typing import Any

import numpy as np

Numbers = np.ndarray[tuple[int, ...], np.dtype[Any]]


def spans(values: Numbers) -> tuple[Numbers, Numbers]:
    """Places of the first and of the last of each run of equal values. Shapes (n,), (n,)."""
    if not len(values):
        empty = np.zeros(0, np.int64)
        return empty, empty
    ends = np.flatnonzero(np.diff(values) != 0)
    return np.concatenate([[0], ends + 1]), np.concatenate([ends, [len(values) - 1]])
