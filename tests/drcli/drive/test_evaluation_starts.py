"""Where fresh laps of an evaluation start."""

from dataclasses import replace

import numpy as np
import pytest

from drcli.drive.evaluator import ANGLE_DEG, OFFSET_SHARE, fresh_starts
from drsim.episode.placing import start_pose
from drsim.track.worlds import load_track


@pytest.fixture(scope="module")
def track():
    return load_track("reinvent_base")


def test_there_is_one_start_in_each_part_of_the_lap_near_the_centre_line(track):
    starts = fresh_starts(track, 40, 7)

    assert [start.number for start in starts] == list(range(40))
    assert [int(40 * start.start_fraction) for start in starts] == list(range(40))
    widths = np.linalg.norm(track.inner - track.outer, axis=1)
    offsets = np.abs([start.offset_m for start in starts])
    assert offsets.max() <= OFFSET_SHARE * widths.max() * 1.05
    assert np.abs([start.angle_deg for start in starts]).max() <= ANGLE_DEG
    assert offsets.mean() > 0.02
    assert all(start_pose(track, s.start_fraction, s.offset_m, s.angle_deg).on_road for s in starts)


def test_the_seed_decides_about_the_starts(track):
    assert fresh_starts(track, 10, 1) == fresh_starts(track, 10, 1)
    assert not set(fresh_starts(track, 10, 1)) & set(fresh_starts(track, 10, 2))


def test_laps_of_an_open_track_begin_at_its_beginning(track):
    starts = fresh_starts(replace(track, closed=False), 5, 0)

    assert {start.start_fraction for start in starts} == {0.0}
    assert len({start.offset_m for start in starts}) == 5
