"""What a world looks like: line widths, colours after lighting, walls and sky.

Greys are what the lens sees, 0..255, measured on frames of the reference simulator in one world.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from random import Random
from typing import Literal

from drsim.arrays import RGB
from drsim.track.zoo import number_of

# Names of worlds, which may end in a driving direction.


_CLOCKWISE = {"_cw": True, "_ccw": False}
"""Source: the reference simulator."""


def split_direction(world: str) -> tuple[str, bool | None]:
    """A name without ending, and whether it asks for clockwise."""
    name, underscore, ending = world.rpartition("_")
    clockwise = _CLOCKWISE.get(underscore + ending)
    return (world, None) if clockwise is None else (name, clockwise)


LUMA: RGB = (0.2989, 0.5870, 0.1140)
"""Source: the reference simulator's camera filter."""

_LIGHT = 1.115
"""Seen grey over texture grey. Measured on frames of the reference simulator, where materials
agree within 2 %; 121 of the 127 worlds share one sun and lamp.
"""

AMBIENT, SUN = 0.5, 0.7075
"""Of that light, on every side, and on one that faces the sun. Source: the reference simulator's
worlds; both together are `_LIGHT` on level ground. Assumed: no frame shows an object.
"""


@dataclass(frozen=True)
class Paint:
    """One painted material; 0..255."""

    grey: float
    grain: float = 0.0
    color: RGB | None = None

    @property
    def rgb(self) -> RGB:
        return self.color or (self.grey, self.grey, self.grey)


@dataclass(frozen=True)
class Walls:
    """The rectangle of walls around the field, or its edge.

    Attributes:
        margin_m: From the bounding box of the outer border.
        greys: At the least x, greatest x, least y, greatest y. Measured on three frames of the
            reference simulator in one world, assumed for all.
        tint: Over the grey. Source: the texture, 36, 70, 81; the frames agree within one grey.
        field_half_m: From the origin; None: to the margin.
    """

    margin_m: float = 0.762
    height_m: float = 1.0
    greys: tuple[float, float, float, float] = (13.0, 24.0, 1.0, 21.0)
    tint: RGB = (0.589, 1.146, 1.326)
    field_half_m: float | None = None

    def around(self, road: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        """Least x, greatest x, least y, greatest y of the field."""
        low_x, low_y, high_x, high_y = road
        half_m = -math.inf if self.field_half_m is None else self.field_half_m
        return (
            min(low_x - self.margin_m, -half_m),
            max(high_x + self.margin_m, half_m),
            min(low_y - self.margin_m, -half_m),
            max(high_y + self.margin_m, half_m),
        )


@dataclass(frozen=True)
class Look:
    """What a world's route does not say.

    Attributes:
        border_side: "in" when touching the white line is on track; "out" when off track.
        dash_pitch_m: From start to start.
        dash_start_m: From waypoint 0, to fit three frames of the reference simulator.
        start_depth_m: Of the chequered line; 0 for none.
        start_squares: Across the road and along it.
        line: Also of the light fields of the start line.
        kerb_stripe_m: Assumed.
        chequer: Of the dark fields.
    """

    border_side: Literal["in", "out"] = "in"
    border_width_m: float = 0.0762
    kerb_width_m: float = 0.0
    dash_width_m: float = 0.0254
    dash_length_m: float = 0.0508
    dash_pitch_m: float = 0.1016
    dash_start_m: float = 0.0508
    start_depth_m: float = 0.07
    start_squares: tuple[int, int] = (8, 2)
    road: Paint = Paint(71.0, 8.0)
    line: Paint = Paint(249.0, 9.0)
    dash: Paint = Paint(169.0)
    kerb: Paint = Paint(152.0)
    kerb_light: Paint | None = None
    kerb_stripe_m: float = 0.15
    field: Paint = Paint(137.0, 4.0)
    chequer: Paint = Paint(25.0)
    walls: Walls = Walls()
    sky_grey: float = 178.0


def look_through(look: Look, weights: Sequence[float]) -> Look:
    """The appearance in one colour: its greys are red, green and blue with these weights."""

    def seen(paint: Paint) -> Paint:
        grey = sum(weight * value for weight, value in zip(weights, paint.rgb, strict=True))
        return Paint(grey, paint.grain, paint.rgb)

    walls, light = look.walls, look.kerb_light
    tint = sum(weight * value for weight, value in zip(weights, walls.tint, strict=True))
    low_x, high_x, low_y, high_y = (tint * grey for grey in walls.greys)
    return replace(
        look,
        road=seen(look.road),
        line=seen(look.line),
        dash=seen(look.dash),
        kerb=seen(look.kerb),
        kerb_light=None if light is None else seen(light),
        field=seen(look.field),
        chequer=seen(look.chequer),
        walls=replace(walls, greys=(low_x, high_x, low_y, high_y)),
    )


def look_of(world: str) -> Look:
    """The appearance of a world; an unknown name gets the common set, a circuit one of its own.

    Source of widths and colours: the reference simulator. Assumed: start lines and sky.
    """
    name, _ = split_direction(world)
    if number_of(name) is not None:
        return _drawn(Random(f"look of {name}"))
    look = _COMMON
    if world in _WITHOUT_WALLS:
        look = replace(look, walls=_OPEN_FIELD)
    if name in _REINVENT_ROADS:
        look = replace(_REINVENT, road=_REINVENT_ROADS[name])
    if name == "Virtual_May19_Train_track":
        look = replace(
            look, road=_lit((76, 73, 70), _GRAIN), line=_lit((232, 232, 232), _LINE_GRAIN)
        )
    if name == "LGSWide":
        look = replace(look, walls=Walls(margin_m=9.1))
    if name == "caecer_gp":
        look = replace(look, border_width_m=0.10)
    if name in _LINE_OUTSIDE:
        width_m, kerb_m = _LINE_OUTSIDE[name]
        look = replace(look, border_side="out", border_width_m=width_m, kerb_width_m=kerb_m)
    return look


def _lit(rgb: RGB, grain: float = 0.0, light: float = _LIGHT) -> Paint:
    grey = sum(weight * value for weight, value in zip(LUMA, rgb, strict=True))
    red, green, blue = (min(255.0, light * value) for value in rgb)
    return Paint(min(255.0, light * grey), grain, (red, green, blue))


_GRAIN, _LINE_GRAIN, _FIELD_GRAIN = 5.0, 8.0, 3.0
"""Greys, so that frames deviate like the reference simulator's. Assumed for all worlds."""

_COMMON = Look(
    road=_lit((64, 63, 61), _GRAIN),
    line=_lit((223, 223, 222), _LINE_GRAIN),
    dash=_lit((225, 143, 0)),
    # The mean of red and white is 180, 118, 118, and white is that of the line.
    kerb=_lit((137, 13, 14)),
    kerb_light=_lit((223, 223, 222)),
    field=_lit((126, 133, 65), _FIELD_GRAIN),
)

_REINVENT = replace(
    _COMMON,
    line=_lit((194, 194, 190), _LINE_GRAIN),
    dash=_lit((194, 117, 0)),
    field=_lit((95, 136, 104), _FIELD_GRAIN),
    walls=Walls(margin_m=0.914),
)

_REINVENT_ROADS = {
    "reinvent_base": _lit((36, 49, 64), _GRAIN),
    "reinvent_carpet": _lit((50, 50, 50), _GRAIN),
    "reinvent_concrete": _lit((116, 110, 107), _GRAIN),
    "reinvent_wood": _lit((110, 71, 41), _GRAIN),
}

_LINE_OUTSIDE = {
    "Virtual_May19_Train_track": (0.0762, 0.0),
    "Oval_track": (0.0762, 0.0),
    "Bowtie_track": (0.0762, 0.0),
    "AWS_track": (0.0762, 0.0),
    "July_2020": (0.0762, 0.0),
    "caecer_loop": (0.0762, 0.0),
    "Spain_track": (0.0762, 0.0),
    "Spain_track_f1": (0.0762, 0.0),
    "Straight_track": (0.1525, 0.0),
    "China_track": (0.051, 0.07),
    "Mexico_track": (0.051, 0.07),
    "Tokyo_Training_track": (0.051, 0.07),
    "New_York_Track": (0.051, 0.07),
    "Canada_Training": (0.051, 0.07),
    "Monaco": (0.076, 0.07),
    "Monaco_building": (0.076, 0.07),
    "Singapore": (0.076, 0.07),
    "Singapore_building": (0.076, 0.07),
    "Singapore_f1": (0.076, 0.07),
    "Austin": (0.076, 0.07),
}
"""Width of line and kerb, metres. Source: the reference simulator's meshes."""

_WITHOUT_WALLS = {
    *(
        f"2022_{month}_{league}"
        for month in ("april", "may", "june", "july", "august", "september", "october")
        for league in ("open", "pro")
    ),
    "2022_reinvent_champ_cw",
    "2022_reinvent_champ_ccw",
}
"""With scenery; one-direction variants have walls. Source: the reference simulator."""

_USUAL_LINES: tuple[tuple[Literal["in", "out"], float, float], ...] = (
    *3 * (("in", 0.0762, 0.0),),
    *(
        ("out", width_m, kerb_m)
        for width_m, kerb_m in ((0.0762, 0.0), (0.051, 0.07), (0.076, 0.07))
    ),
)

_OPEN_FIELD = Walls(
    height_m=0.0, greys=4 * (_COMMON.sky_grey,), tint=(1.0, 1.0, 1.0), field_half_m=12.5
)
"""As in the reference simulator. The edge has the sky's grey because the camera blends along it."""


_ROADS: tuple[RGB, ...] = (
    *4 * ((64, 63, 61),),  # asphalt, as in most worlds
    (36, 49, 64),  # blueish vinyl
    (50, 50, 50),  # carpet
    (116, 110, 107),  # concrete
    (110, 71, 41),  # wood
    (28, 28, 30),  # black mat
    (92, 92, 98),  # worn asphalt
    (45, 70, 110),  # blue mat
    (105, 50, 45),  # clay
    (60, 80, 60),  # green mat
)
_FIELDS: tuple[RGB, ...] = (
    *2 * ((126, 133, 65),),  # meadow, as in most worlds
    *2 * ((95, 136, 104),),  # green mat
    (60, 95, 45),  # grass
    (190, 165, 110),  # sand
    (150, 105, 65),  # wood
    (170, 150, 120),  # beige carpet
    (50, 70, 120),  # blue carpet
    (120, 45, 45),  # red carpet
    (130, 128, 125),  # concrete
    (165, 168, 170),  # light tiles
    (212, 212, 208),  # white floor
    (35, 35, 38),  # black floor
)
_WHITE: RGB = (223, 223, 222)
_LINES: tuple[RGB, ...] = (*5 * (_WHITE,), (194, 194, 190), (225, 190, 40), (230, 215, 120))
_DASHES: tuple[RGB | None, ...] = (
    *4 * ((225, 143, 0),),
    *2 * ((225, 200, 60),),
    _WHITE,
    None,
)
_LEAST_CONTRAST = 45.0
"""Greys by which a line stands out from the road; the road from the field where there is none."""


_USUAL_SHARE = 0.4


def _drawn(random: Random) -> Look:
    """As one of the worlds above, or in materials of places where people set up a track."""
    if random.random() < _USUAL_SHARE:
        walls = _OPEN_FIELD if random.random() < 0.25 else Walls()
        side, width_m, kerb_m = random.choice(_USUAL_LINES)
        return replace(
            _COMMON, walls=walls, border_side=side, border_width_m=width_m, kerb_width_m=kerb_m
        )

    def between(low: float, high: float) -> float:
        return low + (high - low) * random.random()

    def one_of(colors: tuple[RGB, ...]) -> RGB:
        return colors[int(len(colors) * random.random())]

    light = _LIGHT * between(0.75, 1.2)

    def paint(color: RGB, grain: float = 0.0) -> Paint:
        red, green, blue = (min(value * between(0.85, 1.15), 255.0 / light) for value in color)
        return _lit((red, green, blue), grain, light)

    while True:
        road, line = paint(one_of(_ROADS), between(2, 9)), paint(one_of(_LINES), between(2, 9))
        field = paint(one_of(_FIELDS), between(2, 6))
        lined = random.random() < 0.92
        stands_out = (line if lined else field).grey - road.grey
        if stands_out > _LEAST_CONTRAST and abs(field.grey - road.grey) > 8.0:
            break
    pitch_m = between(0.1, 0.8)
    dash = _DASHES[int(len(_DASHES) * random.random())]
    kerbed = random.random() < 0.15
    return Look(
        border_side="out" if kerbed or random.random() < 0.15 else "in",
        border_width_m=between(0.04, 0.11) if lined else 0.0,
        kerb_width_m=0.07 if kerbed and lined else 0.0,
        dash_width_m=between(0.02, 0.05),
        dash_length_m=pitch_m * between(0.35, 0.75),
        dash_pitch_m=pitch_m,
        dash_start_m=0.0,
        start_depth_m=0.07 if random.random() < 0.6 else 0.0,
        road=road,
        line=line,
        dash=road if dash is None else paint(dash),
        kerb=paint((137, 13, 14)),
        kerb_light=paint(_WHITE),
        field=field,
        walls=_drawn_walls(random),
        sky_grey=between(90.0, 230.0),
    )


def _drawn_walls(random: Random) -> Walls:
    if random.random() < 0.25:
        return _OPEN_FIELD
    tint = [0.6 + 0.8 * random.random() for _ in LUMA]
    luma = sum(weight * part for weight, part in zip(LUMA, tint, strict=True))
    red, green, blue = (part / luma for part in tint)
    grey = 4.0 * (200.0 / 4.0) ** random.random()
    north, south, west, east = (grey * (0.6 + 0.6 * random.random()) for _ in range(4))
    return Walls(
        margin_m=0.4 + 1.6 * random.random() ** 2,
        height_m=0.4 + 1.6 * random.random(),
        greys=(north, south, west, east),
        tint=(red, green, blue),
    )
