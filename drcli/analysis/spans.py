"""Runs of equal numbers in sorted columns."""

from typing import Any

import numpy as np

Numbers = np.ndarray[tuple[int, ...], np.dtype[Any]]


def spans(values: Numbers) -> tuple[Numbers, Numbers]:
    """First and last index of each run. Shapes (n,), (n,)."""
    if not len(values):
        empty = np.zeros(0, np.int64)
        return empty, empty
    ends = np.flatnonzero(np.diff(values) != 0)
    return np.concatenate([[0], ends + 1]), np.concatenate([ends, [len(values) - 1]])
