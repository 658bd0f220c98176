"""How often Python searches for garbage.

Imports make many objects and no garbage. Searching all of them again and again takes a sixth of a
worker's start.
"""

import gc

_RARE = 50_000
"""Python's own number is about 700."""

_USUAL = gc.get_threshold()


def search_rarely() -> None:
    """For a program that imports or that ends soon."""
    gc.set_threshold(_RARE)


def search_as_usual() -> None:
    """Leaves out objects that exist already."""
    gc.freeze()
    gc.set_threshold(*_USUAL)
