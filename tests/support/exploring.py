"""How long the fuzz tests look: a few examples in the suite, many minutes on request."""

import os
import secrets
import time
from collections.abc import Callable
from typing import Any

from hypothesis import Phase, given, seed, settings
from hypothesis import strategies as st

MINUTES = "DRCLI_FUZZ_MINUTES"
"""Variable with the time of the long form, for all tests together."""

_BATCH = 5
"""Examples between two looks at the clock."""

_PHASES = (Phase.generate,)
"""To make an example of a slow command smaller takes minutes, and they are small."""


def long_minutes() -> float:
    """How long the long form looks; 0 for the short form."""
    return float(os.environ.get(MINUTES) or 0)


def explore(
    examples: st.SearchStrategy[Any], check: Callable[[Any], None], *, few: int, share: float
) -> None:
    """Check examples: always the same few, or in the long form new ones for a share of the time.

    Args:
        examples: Where they come from.
        check: Raises AssertionError for one that shows a fault.
        few: Number of examples of the short form.
        share: Part of the time of the long form.
    """
    if not long_minutes():
        _look(examples, check, settings(max_examples=few, database=None))
        return
    until_s = time.monotonic() + 60.0 * long_minutes() * share
    while True:
        chosen = secrets.randbits(48)
        print(f"seed {chosen}", flush=True)
        batch = settings(max_examples=_BATCH, database=None, derandomize=False, phases=_PHASES)
        _look(examples, check, batch, chosen)
        if time.monotonic() > until_s:
            return


def _look(
    examples: st.SearchStrategy[Any],
    check: Callable[[Any], None],
    how: settings,
    chosen: int | None = None,
) -> None:
    def told(example: Any) -> None:
        try:
            check(example)
        except AssertionError as fault:
            if long_minutes():
                print(f"\n{fault}\n", flush=True)  # the end of all tests is far away
            raise

    test: Any = given(examples)(told)
    test = how(test)
    if chosen is not None:
        test = seed(chosen)(test)
    test()
