"""Domain randomisation: light and colours that each car's world draws anew."""

from typing import Any

import numpy as np
import pytest

from drsim.race.solids import SHAPES, Solids
from drsim.sensing.lighting import Lighting
from drsim.sensing.scene import Scene, build_scene, render
from drsim.track.appearance import AMBIENT, LUMA, SUN, Look, look_of
from drsim.track.worlds import load_track

WORLDS = ["reinvent_base", "reinvent_concrete", "Monaco", "2022_april_open", "Spain_track"]

UP = 0.9 / np.linalg.norm([0.5, 0.1, 0.9])
USUAL = [[1.0, 1.0, 0.8], [0.225] * 3, [0.4, 0.01, 0.0]]
"""Sun, lamp and attenuation as the reference's worlds have them."""


class Drawn:
    """A generator of random numbers that have been chosen."""

    def __init__(self, numbers: list[list[float]]) -> None:
        self._numbers = np.array(numbers)

    def random(self, shape: tuple[int, int]) -> np.ndarray:
        assert self._numbers.shape == shape
        return self._numbers


def light_of(look: Look, numbers: list[list[float]]) -> Any:
    """The light of one car that has drawn some numbers."""
    lighting = Lighting(1, [look])
    lighting.draw(0, Drawn(numbers))
    return lighting.of(slice(0, 1))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(load_track("reinvent_base"))


def views(lens_count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lenses on the road that look at a box, and what they see of it."""
    x, y, yaw = load_track("reinvent_base").pose_at(np.array([3.0]))[0]
    down = np.radians(13.6)
    ahead = np.array([np.cos(yaw) * np.cos(down), np.sin(yaw) * np.cos(down), -np.sin(down)])
    left = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    mat = np.stack([ahead, left, np.cross(ahead, left)], axis=1)
    solids = Solids(lens_count, [SHAPES["box_obstacle"]])
    xy = np.array([x, y]) + 0.9 * ahead[:2] + 0.3 * left[:2]
    everybody = np.arange(lens_count)
    solids.move(everybody, np.tile(xy, (lens_count, 1, 1)), np.full((lens_count, 1), yaw))
    pos = np.tile([x, y, 0.13], (lens_count, 1))
    return pos, np.tile(mat, (lens_count, 1, 1)), solids.boxes


@pytest.mark.parametrize("world", WORLDS)
def test_the_usual_numbers_give_the_usual_light(world):
    look = look_of(world)

    light = light_of(look, USUAL)

    np.testing.assert_allclose(light.palettes[0, :250].astype(int), np.arange(250), atol=1)
    np.testing.assert_allclose(light.wall_greys[0], look.walls.greys, rtol=1e-5)
    np.testing.assert_allclose(light.sun[0], SUN)


def test_a_car_that_has_drawn_nothing_sees_what_it_sees_without_randomisation(scene):
    pos, mat, boxes = views(2)
    plain, lit = (np.zeros((2, 120, 160), np.uint8) for _ in range(2))
    lighting = Lighting(2, [look_of("reinvent_base")], textures=True)

    render(scene, pos, mat, plain, boxes=boxes)
    render(scene, pos, mat, lit, boxes=boxes, light=lighting.of(slice(0, 2)))

    np.testing.assert_array_equal(lit, plain)


def test_without_sun_and_lamp_only_ambient_light_is_left():
    look = look_of("reinvent_base")

    light = light_of(look, [[0.0] * 3, [0.0] * 3, [1.0] * 3])

    part = AMBIENT / (AMBIENT + SUN * UP)
    for paint in (look.road, look.line, look.dash, look.field):
        assert light.palettes[0, round(paint.grey)] == pytest.approx(part * paint.grey, abs=1.5)
    np.testing.assert_allclose(light.wall_greys[0], part * np.array(look.walls.greys), rtol=1e-3)
    assert light.sky_greys[0] == look.sky_grey
    assert light.sun[0].tolist() == [0.0] * 3
    np.testing.assert_allclose(light.ambient[0], AMBIENT)


def test_red_light_favours_orange_dashes_over_a_green_field():
    look = look_of("reinvent_base")
    usual = AMBIENT + SUN * UP

    light = light_of(look, [[1.0, 0.0, 0.0], [0.0] * 3, [1.0] * 3])

    # The lamp is assumed to give 0.1 of the usual light, and is out here.
    factor = np.array([usual - 0.1, AMBIENT, AMBIENT]) / usual
    for paint in (look.dash, look.field):
        expected = np.dot(LUMA, factor * paint.rgb)
        assert light.palettes[0, round(paint.grey)] == pytest.approx(expected, abs=1.5)


def test_a_world_without_walls_keeps_the_sky_at_the_edge_of_its_field():
    light = light_of(look_of("2022_april_open"), [[0.0] * 3, [0.0] * 3, [1.0] * 3])

    assert light.wall_greys[0].tolist() == pytest.approx([178.0] * 4)


def test_boxes_stand_in_the_light_of_their_car(scene):
    pos, mat, boxes = views(2)
    mat[:, :, :2] *= -1.0  # turned round, to look at the side of the box that faces the sun
    for axis, name in enumerate(("x", "y")):
        boxes[name] = 2 * pos[:, axis, None] - boxes[name]
    lighting = Lighting(2, [look_of("reinvent_base")])
    lighting.draw(1, Drawn([[0.0] * 3, [0.0] * 3, [1.0] * 3]))
    out = np.zeros((2, 120, 160), np.uint8)

    render(scene, pos, mat, out, boxes=boxes, light=lighting.of(slice(0, 2)))

    grey = np.dot(LUMA, SHAPES["box_obstacle"].boxes[0].color)
    in_the_dark = out[1] == int(AMBIENT * grey)
    assert in_the_dark.sum() > 500
    in_the_sun = AMBIENT + SUN * np.dot([0.5, -0.1, 0.9], mat[0, :, 0] * [-1, -1, 0]) * UP / 0.9
    assert np.median(out[0][in_the_dark]) == pytest.approx(in_the_sun * grey, abs=4.0)


@pytest.mark.parametrize("textures", [False, True])
def test_the_same_seed_draws_the_same_world_and_another_seed_another(textures):
    lighting = Lighting(3, [look_of("Monaco")], textures=textures)

    for car, seed in enumerate((5, 5, 6)):
        lighting.draw(car, np.random.default_rng(seed))

    light = lighting.of(slice(0, 3))
    for part in (light.palettes, light.wall_greys, light.sun):
        np.testing.assert_array_equal(part[0], part[1])
        assert (part[0] != part[2]).any()


def test_drawing_for_one_car_leaves_the_others_in_their_light():
    lighting = Lighting(3, [look_of("Monaco")], textures=True)

    lighting.draw(1, np.random.default_rng(0))

    light = lighting.of(slice(0, 3))
    assert (light.palettes[0] == np.arange(256)).all()
    assert (light.palettes[1] != np.arange(256)).mean() > 0.9
    assert (light.palettes[2] == np.arange(256)).all()


@pytest.mark.parametrize("textures", [False, True])
@pytest.mark.parametrize("world", WORLDS)
def test_lines_can_be_told_from_the_road_in_every_draw(world, textures):
    look = look_of(world)
    lighting = Lighting(1, [look], textures=textures)
    random = np.random.default_rng(1)
    line, road = round(look.line.grey), round(look.road.grey)
    brighter = []

    for _ in range(300):
        lighting.draw(0, random)
        palette = lighting.of(slice(0, 1)).palettes[0].astype(int)
        brighter.append(palette[line] - palette[road])

    assert min(brighter) >= 25


@pytest.mark.parametrize("world", WORLDS)
def test_grain_is_not_blown_up_where_two_materials_are_nearly_as_bright(world):
    look = look_of(world)
    lighting = Lighting(1, [look], textures=True)
    random = np.random.default_rng(2)
    field, grain = look.field.grey, look.field.grain
    greys = np.arange(int(field - 2 * grain) + 1, int(field + 2 * grain) + 1)

    for _ in range(100):
        lighting.draw(0, random)
        palette = lighting.of(slice(0, 1)).palettes[0].astype(float)
        assert np.ptp(palette[greys]) <= np.ptp(greys) * 255.0 / field + 2.0


def test_textures_change_how_the_materials_compare():
    look = look_of("reinvent_base")
    lighting = Lighting(1, [look], textures=True)
    random = np.random.default_rng(3)
    shares = []

    for _ in range(50):
        lighting.draw(0, random)
        palette = lighting.of(slice(0, 1)).palettes[0].astype(float)
        shares.append(palette[round(look.road.grey)] / palette[round(look.line.grey)])

    assert min(shares) < 0.15
    assert max(shares) > 0.4
