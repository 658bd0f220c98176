"""Names of worlds, which may end in a driving direction."""

_CLOCKWISE = {"_cw": True, "_ccw": False}
"""Source: the reference simulator."""


def split_direction(world: str) -> tuple[str, bool | None]:
    """A name without ending, and whether it asks for clockwise."""
    name, underscore, ending = world.rpartition("_")
    clockwise = _CLOCKWISE.get(underscore + ending)
    return (world, None) if clockwise is None else (name, clockwise)
