"""Domain randomisation: lights and colours that are drawn for each episode.

All cars share the grey picture of the ground, and see it through palettes.
"""

import math
from collections.abc import Sequence

import numpy as np

from drsim.arrays import Bytes, Floats, Ints, LensParts, Single, Singles
from drsim.jit import kernel
from drsim.sensing.cuboids import TO_SUN
from drsim.sensing.scene import Light, Scene
from drsim.track.appearance import AMBIENT, LUMA, SUN, Look, Paint, look_through

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
    def __init__(
        self,
        num_cars: int,
        looks: Sequence[Look],
        *,
        textures: bool = False,
        weights: Sequence[float] = LUMA,
    ) -> None:
        """Begin with the usual light of the first; `textures` draws colours of the ground too.

        `weights` of red, green and blue make the greys. With `textures` they are painted over the
        usual picture of the ground, without over the picture with these weights.
        """
        painted = (
            looks
            if textures or weights is LUMA
            else [look_through(each, weights) for each in looks]
        )
        self._looks = [(look, _paints(seen)) for look, seen in zip(looks, painted, strict=True)]
        self._weights = np.array(weights)
        look = looks[0]
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

    def draw(self, car: int, random: np.random.Generator, world: int = 0) -> None:
        """As in the reference: colours of sun and lamp and the lamp's attenuations."""
        look, paints = self._looks[world]
        sun, lamp, attenuation = random.random((3, 3))
        sun = sun / _USUAL_SUN
        loss = attenuation @ (1.0, _LAMP_HEIGHT_M, _LAMP_HEIGHT_M**2)
        lamp = np.minimum(lamp / loss / _USUAL_LAMP, 1.0)
        lit = AMBIENT + _SUN_ON_GROUND * sun + _LAMP_ON_GROUND * lamp
        factor = lit / (AMBIENT + _SUN_ON_GROUND + _LAMP_ON_GROUND)
        colors = np.array([paint.rgb for paint in paints])
        if self._textures:
            colors = _other_colors(paints, look, random)
        greys = np.minimum(colors * factor, 255.0) @ self._weights
        self._light.palettes[car] = _palette(paints, greys)
        self._light.sky_greys[car] = look.sky_grey
        walls = look.walls
        self._light.wall_greys[car] = walls.greys
        if walls.height_m > 0.0:
            tint = np.array(walls.tint)
            shade = tint * self._weights @ factor / (tint * LUMA).sum()
            self._light.wall_greys[car] = shade * np.array(walls.greys)
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
    return np.asarray(np.clip(np.round(palette), 0, 255).astype(np.uint8))


_GAP_M = 2.2
_MARGIN_M = 2.5
_MOST_LAMPS = 96
_HEIGHTS_M = (2.6, 4.2)
_BEHIND_WALL_M = 0.5
_OVER_WALL_M = (0.3, 1.1)
"""Behind a wall, and above it."""

_ROUGHNESS = 0.04
"""Slope of the floor's unevenness, radians."""

_LAMP_SIZE_M = 0.25
_MIRRORED = 1500.0
"""Greys in a perfect mirror. Numbers here were chosen by eye, to look like a varnished floor."""

_STRAIGHT_ON = 0.04
_REACH = 3.0


class Lamps:
    def __init__(self, scene: Scene, num_cars: int) -> None:
        self._walls_m = scene.walls_m
        self._wall_height_m = scene.wall_height_m
        self._counts, self._gap_m = _lattice(scene.walls_m)
        self._lamps_m: Floats = np.zeros((num_cars, math.prod(self._counts), 3))
        self._floodlight_m: Floats = np.zeros((num_cars, 3))
        self._glare: Floats = np.zeros(num_cars)
        self._reflections: Floats = np.zeros(num_cars)

    def begin(self, car: int, *, glare: float, reflections: float, pattern: int) -> None:
        """Strengths are 0 .. 1."""
        self._glare[car] = glare
        self._reflections[car] = reflections
        if glare > 0.0 or reflections > 0.0:
            random = np.random.Generator(np.random.Philox(key=pattern))
            self._floodlight_m[car] = self._floodlight(*random.random(2))
            self._lamps_m[car] = self._hanging(*random.random(3))

    def lit(self, cars: slice | Ints) -> bool:
        return bool((self._glare[cars] > 0.0).any() or (self._reflections[cars] > 0.0).any())

    def reflect(self, cars: slice, frames: Bytes, lenses: LensParts) -> None:
        """Add what the floor mirrors, without the GIL."""
        if (self._reflections[cars] > 0.0).any():
            room = self._walls_m, _ROUGHNESS, _MIRRORED
            _reflect(frames, lenses, self._reflections[cars], self._lamps_m[cars], room)

    def shine(self, cars: slice, frames: Bytes, lenses: LensParts) -> None:
        """Add the glare, without the GIL."""
        if (self._glare[cars] > 0.0).any():
            _shine(frames, lenses, self._glare[cars], self._floodlight_m[cars])

    def _floodlight(self, around: float, above: float) -> tuple[float, float, float]:
        low_x, high_x, low_y, high_y = self._walls_m.tolist()
        angle = 2.0 * math.pi * around
        half_x = 0.5 * (high_x - low_x) + _BEHIND_WALL_M
        half_y = 0.5 * (high_y - low_y) + _BEHIND_WALL_M
        cos, sin = math.cos(angle), math.sin(angle)
        out_m = 1.0 / max(abs(cos) / half_x, abs(sin) / half_y)
        low_m, high_m = _OVER_WALL_M
        return (
            0.5 * (low_x + high_x) + out_m * cos,
            0.5 * (low_y + high_y) + out_m * sin,
            max(self._wall_height_m, 1.0) + low_m + (high_m - low_m) * above,
        )

    def _hanging(self, along_x: float, along_y: float, height: float) -> Floats:
        low_m, high_m = _HEIGHTS_M
        x = self._walls_m[0] - _MARGIN_M + self._gap_m * (np.arange(self._counts[0]) + along_x)
        y = self._walls_m[2] - _MARGIN_M + self._gap_m * (np.arange(self._counts[1]) + along_y)
        places: Floats = np.stack(np.broadcast_arrays(x[:, None], y), axis=-1).reshape(-1, 2)
        return np.insert(places, 2, low_m + (high_m - low_m) * height, axis=1)


def _lattice(walls_m: Singles) -> tuple[tuple[int, int], float]:
    size_x = float(walls_m[1] - walls_m[0]) + 2.0 * _MARGIN_M
    size_y = float(walls_m[3] - walls_m[2]) + 2.0 * _MARGIN_M
    gap_m = max(_GAP_M, math.sqrt(size_x * size_y / _MOST_LAMPS))
    return (max(int(size_x / gap_m), 1), max(int(size_y / gap_m), 1)), gap_m


@kernel
def _reflect(
    frames: Bytes,
    lenses: LensParts,
    strengths: Floats,
    lamps_m: Floats,
    room: tuple[Singles, float, float],
) -> None:
    pos, mat, focal_px, _ = lenses
    walls_m, roughness, mirrored = room
    for car in range(len(frames)):
        if strengths[car] == 0.0 or not math.isfinite(pos[car].sum() + mat[car].sum()):
            continue
        for lamp in range(lamps_m.shape[1]):
            x = lamps_m[car, lamp, 0] - pos[car, 0]
            y = lamps_m[car, lamp, 1] - pos[car, 1]
            z = -lamps_m[car, lamp, 2] - pos[car, 2]
            ahead, left, up = _in_lens(mat[car], x, y, z)
            if ahead < 0.3:
                continue
            away_m = math.sqrt(x * x + y * y + z * z)
            fall = -z / away_m
            size = 0.5 * _LAMP_SIZE_M / away_m
            wide_px = focal_px * math.hypot(2.0 * roughness * fall, size)
            high_px = focal_px * math.hypot(2.0 * roughness, size)
            share = _STRAIGHT_ON + (1.0 - _STRAIGHT_ON) * (1.0 - fall) ** 5
            center = -focal_px * left / ahead, -focal_px * up / ahead
            _add_image(
                frames[car],
                (pos[car], mat[car], focal_px),
                center,
                (wide_px, high_px),
                strengths[car] * mirrored * share,
                walls_m,
            )


@kernel
def _in_lens(axes: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (
        x * axes[0, 0] + y * axes[1, 0] + z * axes[2, 0],
        x * axes[0, 1] + y * axes[1, 1] + z * axes[2, 1],
        x * axes[0, 2] + y * axes[1, 2] + z * axes[2, 2],
    )


@kernel
def _add_image(
    frame: Bytes,
    lens: tuple[Floats, Floats, float],
    center: tuple[float, float],
    size_px: tuple[float, float],
    grey: float,
    walls_m: Singles,
) -> None:
    pos, axes, focal_px = lens
    wide_px, high_px = size_px
    rows, columns = frame.shape
    column, row = center[0] + 0.5 * columns, center[1] + 0.5 * rows
    first = max(math.ceil(row - 0.5 - _REACH * high_px), 0)
    last = min(math.floor(row - 0.5 + _REACH * high_px), rows - 1)
    begin = max(math.ceil(column - 0.5 - _REACH * wide_px), 0)
    end = min(math.floor(column - 0.5 + _REACH * wide_px), columns - 1)
    for r in range(first, last + 1):
        up = (0.5 * rows - r - 0.5) / focal_px
        down = ((r + 0.5 - row) / high_px) ** 2
        for c in range(begin, end + 1):
            # Nearly a Gaussian, but it ends: (1 - q / 9)^4.5 has the same width as exp(-q / 2).
            q = (down + ((c + 0.5 - column) / wide_px) ** 2) / (_REACH * _REACH)
            if q >= 1.0:
                continue
            left = (0.5 * columns - c - 0.5) / focal_px
            z = axes[2, 0] + left * axes[2, 1] + up * axes[2, 2]
            if z > -1e-3:
                continue
            far = -pos[2] / z
            x = pos[0] + far * (axes[0, 0] + left * axes[0, 1] + up * axes[0, 2])
            y = pos[1] + far * (axes[1, 0] + left * axes[1, 1] + up * axes[1, 2])
            if x < walls_m[0] or x > walls_m[1] or y < walls_m[2] or y > walls_m[3]:
                continue
            light = grey * (1.0 - q) ** 4 * math.sqrt(1.0 - q)
            frame[r, c] = np.uint8(min(frame[r, c] + light, 255.0))


@kernel
def _shine(frames: Bytes, lenses: LensParts, strengths: Floats, lamps_m: Floats) -> None:
    """Exposure is shorter, because the camera measures the whole picture."""
    pos, mat, focal_px, _ = lenses
    rows, columns = frames.shape[1], frames.shape[2]
    light = np.empty(columns, np.float32)
    for car in range(len(frames)):
        if strengths[car] == 0.0 or not math.isfinite(pos[car].sum() + mat[car].sum()):
            continue
        x, y, z = lamps_m[car] - pos[car]
        ahead, left, up = _in_lens(mat[car], x, y, z)
        away_m = math.sqrt(x * x + y * y + z * z)
        seen = min(max((ahead / max(away_m, 1e-6) - 0.3) / 0.5, 0.0), 1.0)
        if seen == 0.0:
            continue
        power = strengths[car] * seen * seen * (3.0 - 2.0 * seen)
        column = 0.5 * columns - focal_px * left / ahead
        row = 0.5 * rows - focal_px * up / ahead
        outside_px = math.hypot(max(-column, column - columns, 0.0), max(-row, row - rows, 0.0))
        measured = power / (1.0 + outside_px / 25.0)
        gain = Single(1.0 - 0.35 * measured)
        haze = Single(28.0 * power + 0.5)
        for r in range(rows):
            _light_of_row(
                light,
                Single(r + 0.5 - row),
                Single(0.5 - column),
                Single(power),
                Single(5.0 + 4.0 * strengths[car]),
            )
            frame_row = frames[car, r]
            for c in range(columns):
                grey = gain * Single(np.int32(frame_row[c])) + light[c] + haze
                frame_row[c] = np.uint8(np.int32(min(grey, Single(255.0))))
        _ghost(frames[car], columns - column, rows - row, 14.0 * power)


@kernel
def _light_of_row(
    light: Singles, down: Single, first: Single, power: Single, radius_px: Single
) -> None:
    """Without exponentials and tests, so that it becomes vector instructions."""
    one = Single(1.0)
    core, halo, ray = Single(380.0) * power, Single(90.0) * power, Single(75.0) * power
    per_core = one / (radius_px * radius_px)
    per_halo = one / Single(42.0 * 42.0)
    per_thin, per_long = one / Single(2.2 * 2.2), one / Single(34.0 * 34.0)
    cos, sin = Single(0.8387), Single(0.5446)  # rays lie 33 degrees from the horizontal
    for c in range(len(light)):
        right = first + Single(np.int32(c))
        square = right * right + down * down
        near = one + square * per_core
        along, across = cos * right + sin * down, cos * down - sin * right
        other_along, other_across = cos * right - sin * down, cos * down + sin * right
        rays = np.divide(
            ray, (one + across * across * per_thin) * (one + along * along * per_long)
        ) + np.divide(
            Single(0.6) * ray,
            (one + other_across * other_across * per_thin)
            * (one + other_along * other_along * per_long),
        )
        light[c] = np.divide(core, near * near) + np.divide(halo, one + square * per_halo) + rays


@kernel
def _ghost(frame: Bytes, column: float, row: float, grey: float) -> None:
    rows, columns = frame.shape
    reach = 13.0
    for r in range(max(math.ceil(row - reach), 0), min(math.floor(row + reach) + 1, rows)):
        for c in range(
            max(math.ceil(column - reach), 0), min(math.floor(column + reach) + 1, columns)
        ):
            away_px = math.hypot(c + 0.5 - column, r + 0.5 - row)
            share = min(max(0.25 * (reach - away_px), 0.0), 1.0)
            frame[r, c] = np.uint8(min(frame[r, c] + grey * share, 255.0))
