"""Distance and speed compared with a table of an optimal line."""

import math

INSIDE = 0.25
"""How far the line leaves the middle towards the inside of a bend, as a share of the width."""

FASTEST_MPS, SLOWEST_MPS = 1.8, 1.0

_table = []


def _make_table(waypoints, track_width):
    """Rows of x, y and speed: the racing line that others compute beforehand and paste here."""
    points = waypoints[:-1] if waypoints[0] == waypoints[-1] else waypoints
    for index, (x, y) in enumerate(points):
        before, after = points[index - 3], points[(index + 3) % len(points)]
        one = math.atan2(y - before[1], x - before[0])
        other = math.atan2(after[1] - y, after[0] - x)
        bend = (other - one + math.pi) % (2 * math.pi) - math.pi
        share = max(-1.0, min(1.0, bend / 0.5))
        aside, along = INSIDE * share * track_width, (one + other) / 2
        if abs(other - one) > math.pi:
            along += math.pi
        speed = FASTEST_MPS - abs(share) * (FASTEST_MPS - SLOWEST_MPS)
        _table.append((x - aside * math.sin(along), y + aside * math.cos(along), speed))


def reward_function(params):
    """Pay for being near the line and for its speed, added up; nothing off the road."""
    if not _table:
        _make_table(params["waypoints"], params["track_width"])
    if params["is_offtrack"]:
        return 1e-3
    squares = [(x - params["x"]) ** 2 + (y - params["y"]) ** 2 for x, y, _ in _table]
    nearest = min(range(len(squares)), key=squares.__getitem__)
    distance = math.sqrt(squares[nearest])
    near = max(1e-3, 1.0 - distance / (params["track_width"] * 0.5))
    wrong_mps = abs(_table[nearest][2] - params["speed"])
    return 3.0 * near + 2.0 * max(0.0, 1.0 - wrong_mps**2)
