"""Domain randomisation of what cameras see: lights and colours that each episode draws anew.

The picture of the ground is shared by all cars and holds greys. A car with another light looks at
it through a palette: the greys of the painted materials become what they are in that light, and
those between them, which belong to grain and to the edges of paint, become something in between.
"""

import numpy as np
from numpy.typing import NDArray

from drsim.camera import Light
from drsim.look import AMBIENT, LUMA, SUN, Look, Paint

Floats = NDArray[np.float64]

_LAMP = 0.1
"""Part of the lamp in the usual light on the ground. Assumed: the reference's worlds hold it 15 m
above the ground at a fifth of the sun's power."""

_LAMP_HEIGHT_M = 15.0
_USUAL_LAMP = 0.225 / (0.4 + 0.01 * _LAMP_HEIGHT_M)
"""Power of that lamp at the ground, over its attenuation."""

_ROAD, _LINE, _FIELD = (15.0, 110.0), (185.0, 255.0), (20.0, 200.0)
"""Brightness that drawn textures can have: a line is always much brighter than its road."""

_HUE = 0.25
"""Share by which each channel of road and line may differ from their brightness."""


class Lighting:
    """The light in each car's world."""

    def __init__(self, num_cars: int, look: Look, *, textures: bool = False) -> None:
        """Begin with the usual light.

        Args:
            num_cars: How many cars.
            look: The world in the usual light.
            textures: Draw the colours of road, lines and field too.
        """
        self._look = look
        self._textures = textures
        self._light = Light(
            palettes=np.tile(np.arange(256, dtype=np.uint8), (num_cars, 1)),
            wall_greys=np.tile(np.array(look.walls.greys, np.float32), (num_cars, 1)),
            sky_greys=np.full(num_cars, look.sky_grey, np.float32),
            ambient=np.full((num_cars, 3), AMBIENT, np.float32),
            sun=np.full((num_cars, 3), SUN, np.float32),
        )

    def of(self, cars: slice) -> Light:
        """The light of some cars."""
        whole = self._light
        return Light(
            palettes=whole.palettes[cars],
            wall_greys=whole.wall_greys[cars],
            sky_greys=whole.sky_greys[cars],
            ambient=whole.ambient[cars],
            sun=whole.sun[cars],
        )

    def draw(self, car: int, random: np.random.Generator) -> None:
        """Draw the light of a new episode of a car.

        As in the reference, sun and lamp get a colour whose three channels are anything from dark
        to full, and the lamp falls off anyhow; the ambient light and the sky stay.

        Args:
            car: Which car.
            random: Where the numbers come from.
        """
        sun, lamp, attenuation = random.random((3, 3))
        distance = np.array([1.0, _LAMP_HEIGHT_M, _LAMP_HEIGHT_M**2])
        lamp = np.minimum(lamp / (attenuation @ distance) / _USUAL_LAMP, 1.0)
        usual = AMBIENT + SUN * _UP + _LAMP
        factor = (AMBIENT + SUN * _UP * sun + _LAMP * lamp) / usual
        paints = self._paints(random)
        olds = np.array([old.grey for old, _ in paints])
        news = np.array([np.dot(LUMA, new * factor) for _, new in paints])
        self._light.palettes[car] = _palette(olds, news, float(factor.mean()))
        self._light.wall_greys[car] = np.array(self._look.walls.greys)
        if self._look.walls.height_m > 0:
            self._light.wall_greys[car] *= factor.mean()
        self._light.sun[car] = SUN * sun

    def _paints(self, random: np.random.Generator) -> list[tuple[Paint, Floats]]:
        """Each material as it is painted, and its colour in this episode in the usual light."""
        look = self._look
        drawn = {
            "road": random.uniform(*_ROAD) * random.uniform(1 - _HUE, 1 + _HUE, 3),
            "line": random.uniform(*_LINE) * random.uniform(1 - _HUE / 2, 1.0, 3),
            "dash": random.uniform(*_FIELD, 3),
            "field": random.uniform(*_FIELD, 3),
        }
        materials = ["road", "line", "dash", "field", "chequer"]
        if look.kerb_width_m > 0:
            materials += ["kerb"] + ["kerb_light"] * (look.kerb_light is not None)
        paints = []
        for name in materials:
            paint: Paint = getattr(look, name)
            color = drawn[name] if self._textures and name in drawn else np.array(paint.rgb)
            paints.append((paint, color))
        return paints


_UP = 0.8693
"""Cosine of the angle between the sun and level ground."""


def _palette(olds: Floats, news: Floats, beyond: float) -> NDArray[np.uint8]:
    """What becomes of the greys 0..255 when some of them become others. Shape (256,)."""
    order = np.argsort(olds, kind="stable")
    first = np.concatenate([[True], np.diff(olds[order]) > 1.0])
    olds, news = olds[order][first], news[order][first]
    shades = np.arange(256)
    palette = np.interp(shades, olds, news)
    # Grain darker than the darkest paint and lighter than the lightest keeps its contrast.
    palette[shades < olds[0]] += (shades[shades < olds[0]] - olds[0]) * beyond
    palette[shades > olds[-1]] += (shades[shades > olds[-1]] - olds[-1]) * beyond
    return np.clip(np.round(palette), 0, 255).astype(np.uint8)
