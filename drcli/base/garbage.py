"""How often Python searches for garbage.

In imports, that takes a sixth of a worker's start.
"""

import gc

_RARE = 50_000
"""Python's own number is about 700."""

_USUAL = gc.get_threshold()


def search_rarely() -> None:
    gc.set_threshold(_RARE)


def search_as_usual() -> None:
    gc.freeze()
    gc.set_threshold(*_USUAL)
