"""The tracks of our own design: sound roads, told truly, that a car can drive."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely

import drsim
from drsim.car.car import CONTROL_HZ
from drsim.track.track import Track
from drsim.track.worlds import ClosedSpline, describe, load_track

DEFINITIONS = [
    file
    for file in sorted((Path(drsim.__file__).parent / "track" / "definitions").glob("*.json"))
    if '"control_points_m"' in file.read_text(encoding="utf-8")
]
OWN = [file.stem for file in DEFINITIONS]

DESIGNED = [name for name in OWN if name != "reinvent_base"]
"""Those whose route was not given: `reinvent_base` has its width and waypoints from elsewhere."""


def definition_of(world: str) -> dict:
    (file,) = (file for file in DEFINITIONS if file.stem == world)
    return json.loads(file.read_text(encoding="utf-8"))


def road_of(track: Track) -> shapely.Polygon:
    return shapely.Polygon(track.outer, [track.inner])


def test_there_are_six_worlds_of_every_difficulty():
    infos = [describe(name) for name in OWN]

    assert len(infos) == 6
    assert {info.difficulty for info in infos} == {"easy", "medium", "hard"}
    assert all(info.about.endswith(".") and len(info.about) < 100 for info in infos)
    assert {info.direction for info in infos} == {"clockwise", "counterclockwise"}


@pytest.mark.parametrize("world", OWN)
def test_the_borders_neither_cross_themselves_nor_each_other(world):
    track = load_track(world)

    assert shapely.LinearRing(track.inner).is_simple
    assert shapely.LinearRing(track.outer).is_simple
    assert road_of(track).is_valid
    assert shapely.Polygon(track.outer).contains(shapely.Polygon(track.inner))
    assert track.on_road(track.center).all()


@pytest.mark.parametrize("world", OWN)
def test_stretches_of_road_keep_30_cm_apart(world):
    track = load_track(world)
    ring = shapely.LinearRing(track.center)
    area_m2 = road_of(track).area
    half_gap_m = 0.15

    grown = road_of(track).buffer(half_gap_m)
    meant_m2 = area_m2 + half_gap_m * (
        shapely.LinearRing(track.inner).length + shapely.LinearRing(track.outer).length
    )

    assert len(grown.interiors) == 1  # a second hole: two stretches have met
    assert grown.area == pytest.approx(meant_m2, rel=0.02)
    assert grown.contains(ring)


@pytest.mark.parametrize("world", DESIGNED)
def test_no_bend_is_tighter_than_60_cm_nor_than_half_the_road(world):
    definition = definition_of(world)
    spline = ClosedSpline(np.array(definition["control_points_m"]))
    step_m = 0.01

    _, direction = spline.at(np.arange(0, spline.length_m, step_m))

    yaw_rad = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
    tightest_m = step_m / np.abs(np.diff(yaw_rad)).max()
    assert tightest_m > max(0.6, definition["width_m"] / 2)


@pytest.mark.parametrize("world", DESIGNED)
def test_width_and_waypoints_are_as_designed(world):
    track, info = load_track(world), describe(world)
    step_m = np.hypot(*np.diff(track.center, axis=0).T)

    assert info.width_m.greatest <= definition_of(world)["width_m"] + 1e-9
    assert info.width_m.least == pytest.approx(definition_of(world)["width_m"], abs=0.01)
    assert step_m.min() > 0.15
    assert step_m.max() < 0.3
    assert step_m.max() / step_m.min() < 1.05


def test_lengths_run_from_14_to_56_m():
    lengths_m = {name: round(load_track(name).length_m) for name in OWN}

    assert lengths_m == {
        "bean": 14,
        "paddle": 20,
        "reinvent_base": 18,
        "willow": 28,
        "foundry": 45,
        "switchback": 56,
    }


def test_a_car_that_follows_the_centre_line_completes_a_lap_of_every_track(follow):
    tracks = [load_track(name) for name in OWN]
    longest_m = max(track.length_m for track in tracks)

    drive = follow(tracks, speed_mps=1.2, steps=int(longest_m / 1.2 * CONTROL_HZ))

    assert not drive.off_road.any()
    assert (drive.progress_m >= [track.length_m for track in tracks]).all()
