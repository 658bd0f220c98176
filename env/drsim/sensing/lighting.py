"""Domain randomisation: lights and colours that are drawn for each episode.

All cars share the grey picture of the ground, and see it through palettes.
"""

import numpy as np

from drsim.arrays import Bytes, Floats
from drsim.sensing.camera import Light
from drsim.sensing.cuboids import TO_SUN
from drsim.track.appearance import AMBIENT, LUMA, SUN, Look, Paint

_USUAL_SUN = np.array([1.0, 1.0, 0.8])
"""Source: the reference simulator's worlds, as for the lamp."""

_LAMP_HEIGHT_M = 15.0
_USUAL_LAMP = 0.225 / (0.4 + 0.01 * _LAMP_HEIGHT_M)
"""Power over attenuation, on the ground below."""

_SUN_ON_GROUND, _LAMP_ON_GROUND = SUN * TO_SUN[2] - 0.1, 0.1
"""Assumed: no frame shows either alone."""

_ROAD, _LINE = (15.0, 110.0), (185.0, 255.0)
"""In each colour a line outshines its road."""

_HUE = 0.25
_GRAIN_ROOM = 3.0
_LEAST_GAP = 1.5


class Lighting:
    def __init__(self, num_cars: int, look: Look, *, textures: bool = False) -> None:
        """Begin with the usual light; `textures` draws colours of the ground too."""
        self._look = look
        self._paints = _paints(look)
        self._textures = textures
        self._light = Light(
            palettes=np.tile(np.arange(256, dtype=np.uint8), (num_cars, 1)),
            wall_greys=np.tile(np.array(look.walls.greys, np.float32), (num_cars, 1)),
            sky_greys=np.full(num_cars, look.sky_grey, np.float32),
            ambient=np.full((num_cars, 3), AMBIENT, np.float32),
            sun=np.full((num_cars, 3), SUN, np.float32),
        )

    def of(self, cars: slice) -> Light:
        """A live view."""
        return Light._make(part[cars] for part in self._light)

    def draw(self, car: int, random: np.random.Generator) -> None:
        """As in the reference: colours of sun and lamp and the lamp's attenuations."""
        sun, lamp, attenuation = random.random((3, 3))
        sun = sun / _USUAL_SUN
        loss = attenuation @ (1.0, _LAMP_HEIGHT_M, _LAMP_HEIGHT_M**2)
        lamp = np.minimum(lamp / loss / _USUAL_LAMP, 1.0)
        lit = AMBIENT + _SUN_ON_GROUND * sun + _LAMP_ON_GROUND * lamp
        factor = lit / (AMBIENT + _SUN_ON_GROUND + _LAMP_ON_GROUND)
        colors = np.array([paint.rgb for paint in self._paints])
        if self._textures:
            colors = _other_colors(self._paints, self._look, random)
        greys = np.minimum(colors * factor, 255.0) @ LUMA
        self._light.palettes[car] = _palette(self._paints, greys)
        walls = self._look.walls
        if walls.height_m > 0.0:
            tint = np.array(walls.tint) * LUMA
            self._light.wall_greys[car] = tint @ factor / tint.sum() * np.array(walls.greys)
        self._light.sun[car] = SUN * sun


def _paints(look: Look) -> list[Paint]:
    paints = [look.road, look.line, look.dash, look.field, look.chequer]
    if look.kerb_width_m > 0.0:
        paints += [look.kerb, look.kerb_light or look.kerb]
    different: list[Paint] = []
    for paint in sorted(paints, key=lambda paint: (paint.grey, -paint.grain)):
        grain = different[-1].grain + paint.grain if different else 0.0
        if not different or paint.grey - different[-1].grey > max(1.0, _LEAST_GAP * grain):
            different.append(paint)
    return different


def _other_colors(paints: list[Paint], look: Look, random: np.random.Generator) -> Floats:
    """Their order of brightness stays: greys between two materials would otherwise show a third."""
    road = random.uniform(*_ROAD) * random.uniform(1.0 - _HUE, 1.0 + _HUE, 3)
    line = random.uniform(*_LINE) * random.uniform(1.0 - 0.5 * _HUE, 1.0, 3)
    olds = np.array([paint.grey for paint in paints])
    hue = random.uniform(-_HUE, _HUE, (len(paints), 3))
    share = np.sort(random.random(len(paints)))[:, None]
    between = road + np.clip(share + 0.5 * hue, 0.1, 0.9) * (line - road)
    darker = road * np.clip(share, 0.3, 0.9)
    colors = np.where(olds[:, None] < look.road.grey, darker, between)
    colors[olds >= look.line.grey - 1.0] = line
    colors[np.abs(olds - look.road.grey) <= 1.0] = road
    return colors


def _palette(paints: list[Paint], greys: Floats) -> Bytes:
    olds = [paint.grey for paint in paints]
    contrasts = [new / max(old, 1.0) for old, new in zip(olds, greys, strict=True)]
    anchors, values = [0.0, olds[0]], [0.0, greys[0]]
    for i in range(1, len(paints)):
        # Around each grey, as far as its grain goes, contrast changes as brightness does.
        below, above = (max(_GRAIN_ROOM * paint.grain, 0.5) for paint in paints[i - 1 : i + 1])
        room = min(0.9 * (olds[i] - olds[i - 1]) / (below + above), 1.0)
        anchors += [olds[i - 1] + room * below, olds[i] - room * above, olds[i]]
        values += [
            greys[i - 1] + room * below * contrasts[i - 1],
            greys[i] - room * above * contrasts[i],
            greys[i],
        ]
    anchors.append(256.0)
    values.append(256.0 * contrasts[-1])
    palette = np.interp(np.arange(256), anchors, values)
    whole: Bytes = np.clip(np.round(palette), 0, 255).astype(np.uint8)
    return whole
