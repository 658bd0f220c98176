"""The ground picture of a track: where its paint lies, and how large it gets."""

from dataclasses import replace

import numpy as np
import pytest

from drsim.sensing.scene import Scene, build_scene
from drsim.track.appearance import Look, Paint, look_of
from drsim.track.track import Track

FLAT = Look(
    road=Paint(50.0),
    line=Paint(200.0),
    dash=Paint(140.0),
    kerb=Paint(170.0),
    field=Paint(100.0),
    chequer=Paint(20.0),
)


def square_track(half_m: float = 2.0, per_side: int = 16) -> Track:
    """A square road 1 m wide around the origin, counter-clockwise from its corner at -x, -y."""
    steps = np.arange(per_side) / per_side * 2.0 * half_m - half_m
    side = np.stack([steps, np.full(per_side, -half_m)], axis=1)
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    loop = [side @ np.linalg.matrix_power(turn, k) for k in range(4)]
    center = np.concatenate([*loop, side[:1]])
    return Track(
        name="square",
        center=center,
        inner=center * (half_m - 0.5) / half_m,
        outer=center * (half_m + 0.5) / half_m,
        closed=True,
    )


def grey_at(scene: Scene, x_m: float, y_m: float) -> int:
    """Grey of the texel that holds a point of the ground."""
    column = int((x_m - scene.x_m) / scene.texel_m)
    row = int((y_m - scene.y_m) / scene.texel_m)
    return int(scene.level(0)[row, column])


@pytest.fixture(scope="module")
def flat_scene() -> Scene:
    return build_scene(square_track(), FLAT)


@pytest.mark.parametrize(
    ("x_m", "grey"),
    [
        *[(0.5, 100), (1.49, 100), (1.51, 200), (1.57, 200), (1.59, 50)],
        *[(2.41, 50), (2.43, 200), (2.49, 200), (2.51, 100), (3.2, 100)],
    ],
)
def test_white_lies_on_the_road_side_of_both_borders(flat_scene, x_m, grey):
    seen = grey_at(flat_scene, x_m, 0.3)

    assert seen == grey


@pytest.mark.parametrize(
    ("x_m", "grey"),
    [
        *[(1.35, 100), (1.37, 170), (1.42, 170), (1.44, 200), (1.49, 200), (1.51, 50)],
        *[(2.49, 50), (2.51, 200), (2.56, 200), (2.58, 170), (2.63, 170), (2.65, 100)],
    ],
)
def test_white_and_kerb_lie_beyond_the_borders_in_the_outside_family(x_m, grey):
    look = replace(FLAT, border_side="out", border_width_m=0.07, kerb_width_m=0.07)

    scene = build_scene(square_track(), look)

    assert grey_at(scene, x_m, 0.3) == grey


def test_dashes_follow_the_arc_length_of_the_centre_line(flat_scene):
    # The second side starts 4 m along the line, at x = 2, y = -2, and runs towards greater y.
    along_m = np.array([5.0, 5.05, 5.1, 5.15])
    expected = [140 if (s - 0.0508) % 0.1016 < 0.0508 else 50 for s in along_m]

    seen = [grey_at(flat_scene, 2.0, s - 6.0) for s in along_m]

    assert seen == expected


def test_start_line_crosses_the_road_between_the_white_lines_at_waypoint_0():
    track = square_track()
    rolled = Track(
        "square",
        *(np.roll(line[:-1], -8, axis=0)[[*range(64), 0]] for line in _lines(track)),
        closed=True,
    )

    scene = build_scene(rolled, FLAT)

    y_m = np.linspace(-2.42, -1.58, 60)
    seen = [grey_at(scene, 0.01, y) for y in y_m]
    assert {20, 200} == set(seen) & {20, 200}
    assert 50 not in seen
    assert grey_at(scene, 0.05, -1.8) == 50


def test_a_world_looks_the_same_driven_the_other_way():
    track = square_track()

    forward, backward = build_scene(track), build_scene(track.reversed())

    np.testing.assert_array_equal(forward.level(0), backward.level(0))


def test_grain_is_the_same_in_every_build_and_another_in_another_world():
    track = square_track()
    other = replace(track, name="another")

    scenes = [build_scene(track), build_scene(track), build_scene(other)]

    np.testing.assert_array_equal(scenes[0].texels, scenes[1].texels)
    assert (scenes[0].level(0) != scenes[2].level(0)).mean() > 0.3
    road = scenes[0].level(0)[350:400, 1000:1100]
    assert road.std() > 1.0


def test_a_field_of_23_by_15_metres_stays_below_60_megabytes():
    corners = np.array([[-11.5, -7.5], [11.5, -7.5], [11.5, 7.5], [-11.5, 7.5], [-11.5, -7.5]])
    track = Track("large", corners * 0.97, corners * 0.94, corners, closed=True)

    scene = build_scene(track, FLAT)

    pairs = scene.texels.base
    assert isinstance(pairs, np.ndarray)
    assert pairs.nbytes < 60e6
    assert scene.texel_m < 0.005


def test_walls_stand_around_the_outer_border_with_the_margin_of_the_world():
    common = build_scene(square_track())
    reinvent = build_scene(replace(square_track(), name="reinvent_base"))

    np.testing.assert_allclose(common.walls_m, np.array([-1, 1, -1, 1]) * (2.5 + 0.762), rtol=1e-6)
    np.testing.assert_allclose(reinvent.walls_m, np.array([-1, 1, -1, 1]) * 3.414, rtol=1e-6)


def test_small_copies_keep_the_mean_of_the_ground(flat_scene):
    means = [flat_scene.level(index).mean() for index in range(len(flat_scene.levels))]

    assert np.ptp(means) < 1.0


def test_an_open_track_has_a_road_and_two_lines():
    x_m = np.linspace(0.0, 5.0, 21)
    ends = [np.stack([x_m, np.full(21, y)], axis=1) for y in (0.0, 0.3, -0.3)]
    track = Track("straight", *ends, closed=False)

    scene = build_scene(track, FLAT)

    assert [grey_at(scene, 2.5, y) for y in (0.15, 0.29, 0.31, -0.29)] == [50, 200, 100, 200]
    assert grey_at(scene, 5.1, 0.29) == 100


def test_lines_outside_the_road_of_an_open_track_end_squarely():
    x_m = np.linspace(0.0, 5.0, 21)
    ends = [np.stack([x_m, np.full(21, y)], axis=1) for y in (0.0, 0.3, -0.3)]
    track = Track("straight", *ends, closed=False)

    scene = build_scene(track, replace(FLAT, border_side="out"))

    assert [grey_at(scene, x, 0.33) for x in (-0.04, 0.1, 4.9, 5.04)] == [100, 200, 200, 100]


@pytest.mark.parametrize(
    ("world", "side", "width_m"),
    [
        ("reinvent_base", "in", 0.0762),
        ("2022_april_pro_cw", "in", 0.0762),
        ("caecer_gp", "in", 0.10),
        ("caecer_loop", "out", 0.0762),
        ("Straight_track", "out", 0.1525),
        ("Monaco", "out", 0.076),
        ("a world of my own", "in", 0.0762),
    ],
)
def test_a_world_has_the_border_line_of_its_family(world, side, width_m):
    look = look_of(world)

    assert (look.border_side, look.border_width_m) == (side, width_m)


@pytest.mark.parametrize(
    ("paint", "low", "high"), [("road", 52, 55), ("line", 211, 222), ("dash", 138, 146)]
)
def test_reinvent_base_has_the_greys_measured_on_reference_frames(paint, low, high):
    grey = getattr(look_of("reinvent_base"), paint).grey

    assert low <= grey <= high


def _lines(track: Track) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return track.center, track.inner, track.outer
