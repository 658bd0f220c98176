"""Names of worlds, which may end in a driving direction."""

_CLOCKWISE = {"_cw": True, "_ccw": False}
"""Endings of a world name that choose the driving direction. Source: the reference simulator."""


def split_direction(world: str) -> tuple[str, bool | None]:
    """A name without such an ending, and whether it asks for clockwise; None if it has none."""
    name, underscore, ending = world.rpartition("_")
    clockwise = _CLOCKWISE.get(underscore + ending)
    return (world, None) if clockwise is None else (name, clockwise)
