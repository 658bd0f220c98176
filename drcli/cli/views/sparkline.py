"""Curves one line high, made of block characters."""

from collections.abc import Sequence
from itertools import pairwise
from typing import TypeVar

T = TypeVar("T")

BLOCKS = "▁▂▃▄▅▆▇█"

NONE, SOME, ALL = "·", "◦", "●"


def curve(values: Sequence[float], width: int, *, top: float | None = None) -> str:
    """Numbers as heights, averaged down to `width` characters.

    From zero, or the least value if that is negative, to `top`, by default the greatest.
    """
    if not values:
        return ""
    means = [sum(part) / len(part) for part in _parts(values, width)]
    low = min(0.0, *means)
    span = (max(means) if top is None else top) - low
    if span <= 0:
        return BLOCKS[0] * len(means)
    last = len(BLOCKS) - 1
    heights = (round((mean - low) / span * last) for mean in means)
    return "".join(BLOCKS[max(0, min(last, height))] for height in heights)


def marks(completed: Sequence[float | None], width: int) -> str:
    """Marks of evaluations below a curve; the best of several is shown."""
    return "".join(_mark(part) for part in _parts(completed, width))


def _mark(completed: Sequence[float | None]) -> str:
    best = max((share for share in completed if share is not None), default=None)
    if best is None:
        return " "
    if best == 0:
        return NONE
    return ALL if best == 1 else SOME


def _parts(values: Sequence[T], width: int) -> list[Sequence[T]]:
    count = min(len(values), width)
    edges = [round(i * len(values) / count) for i in range(count + 1)] if count else []
    return [values[start:end] for start, end in pairwise(edges)]
