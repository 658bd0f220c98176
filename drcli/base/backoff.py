"""Waiting for a condition, with growing pauses."""

import time
from collections.abc import Callable, Iterator

from drcli.base import notices

FIRST_DELAY_S = 0.05
LAST_DELAY_S = 1.0

FAST_GROWTH = 2.0
SLOW_GROWTH = 1.05
"""A twentieth of the time waited."""


def delays_s(
    first_s: float = FIRST_DELAY_S, last_s: float = LAST_DELAY_S, *, growth: float = FAST_GROWTH
) -> Iterator[float]:
    delay_s = first_s
    while True:
        yield delay_s
        delay_s = min(growth * delay_s, last_s)


def wait_until(
    condition: Callable[[], bool],
    *,
    patience_s: float,
    first_s: float = FIRST_DELAY_S,
    last_s: float = LAST_DELAY_S,
    growth: float = FAST_GROWTH,
    what: str = "",
    clock: Callable[[], float] = time.monotonic,
    pause: Callable[[float], None] = time.sleep,
) -> bool:
    """Whether the condition holds within `patience_s`; `what` is shown if that takes long.

    Tests replace `clock` and `pause`.
    """
    began_s = clock()
    for delay_s in delays_s(first_s, last_s, growth=growth):
        if condition():
            return True
        waited_s = clock() - began_s
        left_s = patience_s - waited_s
        if what and waited_s > notices.QUIET_S:
            notices.show(what)
            what = ""
        if left_s <= 0:
            return False
        pause(min(delay_s, left_s))
    raise AssertionError("delays_s never ends")
