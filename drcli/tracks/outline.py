"""The lines of a track, as maps draw them."""

from typing import Any

import numpy as np

from drsim.track.track import Track

_DIGITS = 3


def outline(track: Track) -> dict[str, Any]:
    """Lines as lists of [x, y], in metres with millimetres."""
    lines = {"center": track.center, "inner": track.inner, "outer": track.outer}
    return {
        "name": track.name,
        "closed": track.closed,
        "length_m": track.length_m,
        **{name: np.round(line, _DIGITS).tolist() for name, line in lines.items()},
    }
