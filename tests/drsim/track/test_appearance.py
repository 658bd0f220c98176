"""What worlds look like: colours that agree with the greys, kerbs, fields without walls."""

from dataclasses import fields, replace

import numpy as np
import pytest

from drsim.arrays import Bytes
from drsim.sensing.ground import Grid, paint_ground
from drsim.track.appearance import LUMA, Look, Paint, Walls, look_of
from drsim.track.track import Track

WORLDS = [
    "reinvent_base",
    "reinvent_wood",
    "Virtual_May19_Train_track",
    "Monaco",
    "our own",
    "zoo-3",
]

KERBED = Look(
    road=Paint(50.0),
    line=Paint(200.0),
    dash=Paint(50.0),
    field=Paint(100.0),
    kerb=Paint(20.0),
    kerb_light=Paint(240.0),
    kerb_stripe_m=0.25,
    kerb_width_m=0.1,
    border_side="out",
    start_depth_m=0.0,
)


def square_track() -> Track:
    """A square road around the origin; its outer border lies 1.5 m away, its inner one 0.5 m."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    return Track("square", corners, corners * 0.5, corners * 1.5, closed=True)


def picture(look: Look, track: Track | None = None) -> Bytes:
    """The ground from -2 m to 2 m, a texel a centimetre."""
    return paint_ground(track or square_track(), look, Grid(-2.0, -2.0, 0.01, 400, 400))


def paints(look: Look) -> dict[str, Paint]:
    values = {field.name: getattr(look, field.name) for field in fields(look)}
    return {name: value for name, value in values.items() if isinstance(value, Paint)}


@pytest.mark.parametrize("world", WORLDS)
def test_every_paint_is_as_bright_as_its_colour(world):
    for name, paint in paints(look_of(world)).items():
        luma = sum(weight * value for weight, value in zip(LUMA, paint.rgb, strict=True))

        assert luma == pytest.approx(paint.grey, abs=0.3), name


def test_a_paint_without_hue_is_grey():
    assert Paint(25.0, 2.0).rgb == (25.0, 25.0, 25.0)


def test_the_walls_of_the_measured_world_have_the_hue_of_the_frames():
    walls = look_of("reinvent_base").walls

    seen = np.array(walls.tint) * walls.greys[1]

    assert seen == pytest.approx([14.1, 27.9, 31.5], abs=0.5)
    assert walls.greys[1] == 24.0


def test_tracks_of_our_own_look_like_most_worlds():
    assert look_of("a track of our own") == look_of("2022_march_pro")


@pytest.mark.parametrize("world", ["2022_april_open", "2022_october_pro", "2022_reinvent_champ_cw"])
def test_worlds_with_scenery_have_a_field_of_25_metres_without_walls(world):
    walls = look_of(world).walls

    assert walls.height_m == 0.0
    assert walls.around((-9.0, -7.0, 9.0, 7.0)) == (-12.5, 12.5, -12.5, 12.5)


@pytest.mark.parametrize("world", ["2022_april_open_cw", "2022_march_open", "arctic_pro"])
def test_other_worlds_have_walls(world):
    assert look_of(world).walls == Walls()


def test_a_road_beyond_the_field_makes_the_field_larger():
    walls = Walls(margin_m=1.0, field_half_m=12.5)

    assert walls.around((-14.0, -7.0, 3.0, 7.0)) == (-15.0, 12.5, -12.5, 12.5)


def test_walls_stand_the_margin_away_from_the_road():
    assert Walls(margin_m=0.5).around((1.0, 2.0, 3.0, 5.0)) == (0.5, 3.5, 1.5, 5.5)


def test_every_generated_circuit_looks_different_and_the_same_whichever_way_it_is_driven():
    looks = [look_of(f"zoo-{number}") for number in range(100)]

    assert looks == [look_of(f"zoo-{number}_cw") for number in range(100)]
    assert len({look.road.rgb for look in looks}) > 50
    assert {look.border_side for look in looks} == {"in", "out"}
    assert 10 < sum(look.walls.height_m == 0.0 for look in looks) < 45
    assert 1 < sum(look.border_width_m == 0.0 for look in looks) < 20
    assert 3 < sum(look.dash == look.road for look in looks) < 30


@pytest.mark.parametrize("number", range(100))
def test_the_road_of_a_generated_circuit_can_be_seen(number):
    look = look_of(f"zoo-{number}")

    edge = look.line if look.border_width_m > 0.0 else look.field

    assert edge.grey > look.road.grey + 45.0
    assert all(0.0 <= value <= 255.0 for paint in paints(look).values() for value in paint.rgb)
    assert all(0.0 <= grey <= 255.0 for grey in look.walls.greys)


def test_kerbs_alternate_dark_and_light_with_even_stripes():
    # Along the right border, beyond its white line: x = 1.5 + 0.0762 + 0.05.
    stripe = picture(KERBED)[60:340, 362]

    assert set(stripe.tolist()) >= {20, 240}
    assert stripe.mean() == pytest.approx(130.0, abs=15.0)
    edges = np.flatnonzero(np.diff((stripe > 130).astype(int)))
    np.testing.assert_allclose(np.diff(edges), 25.0, atol=1.0)


def test_kerb_stripes_lie_where_they_are_whichever_way_the_track_is_driven():
    forward, backward = picture(KERBED), picture(KERBED, square_track().reversed())

    np.testing.assert_array_equal(forward, backward)


def test_a_kerb_of_one_colour_has_no_stripes():
    flat = replace(KERBED, kerb_light=None)

    assert set(picture(flat)[60:340, 362].tolist()) == {20}


def test_worlds_with_kerbs_have_red_and_white_ones():
    look = look_of("Monaco")

    assert look.kerb_light is not None
    red, green, blue = look.kerb.rgb
    assert red > 5 * green
    assert red > 5 * blue
    mean = 0.5 * (look.kerb.grey + look.kerb_light.grey)
    assert mean == pytest.approx(152.0, abs=1.0)
