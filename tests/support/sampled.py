"""A sample of all combinations for every commit, always the same; the rest is for the night."""

from collections.abc import Iterable
from itertools import product
from typing import Any

import pytest

ONE_IN = 4


def sampled(*axes: Iterable[Any]) -> list[Any]:
    """Parameters of a test: all combinations of values, three of four marked as nightly.

    Every value of an axis is in the sample, with another part of the other axis than its neighbour.
    """
    found = []
    for combination in product(*(list(enumerate(axis)) for axis in axes)):
        is_left_out = sum(index for index, _ in combination) % ONE_IN
        marks = [pytest.mark.nightly] if is_left_out else []
        found.append(pytest.param(*(value for _, value in combination), marks=marks))
    return found
