"""How often Python searches for garbage: for objects that refer to each other in a circle.

Imports make many objects and no garbage. By default, Python would search all of them again and
again, which takes a sixth of the time that a worker needs to start.
"""

import gc

_RARE = 50_000
"""New objects between two searches; Python's own number is about 700."""

_USUAL = gc.get_threshold()


def search_rarely() -> None:
    """Search rarely, for a program that imports or that ends soon."""
    gc.set_threshold(_RARE)


def search_as_usual() -> None:
    """Search as often as usual from now on, but not in the objects that exist already."""
    gc.freeze()
    gc.set_threshold(*_USUAL)
