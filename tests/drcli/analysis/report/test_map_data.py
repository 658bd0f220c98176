"""The numbers of the map."""

from dataclasses import replace

import numpy as np
import pytest

from drcli.analysis.report import map_section as map_data_module
from drcli.analysis.report.lap_choice import LapChoice, choose_laps
from drcli.analysis.report.map_section import ground_cells, map_data


@pytest.mark.parametrize("count", [0, 1, 500])
@pytest.mark.parametrize("shift_m", [-1e5, -0.05, 0.0, 1e5])
def test_positions_are_put_into_squares_of_the_ground(count, shift_m):
    xy = np.random.default_rng(1).uniform(-3.0, 3.0, (count, 2)) + np.array([shift_m, -shift_m])

    cells, cell = ground_cells(xy, 0.5)

    np.testing.assert_array_equal(cells[cell], np.floor(xy / 0.5))
    assert cells.tolist() == sorted(map(list, {tuple(place) for place in cells.tolist()}))


def test_a_map_without_a_lap_that_can_be_played_still_shows_the_steps(run):
    drawn = map_data(replace(run, evaluations=()), LapChoice((), (), (), 1))

    assert drawn["laps"]["status"] == drawn["laps"]["progress"] == []
    assert drawn["steps"]["reward"] == []
    assert len(drawn["cells"]["periods"]) == 6


def test_of_very_many_ends_those_of_the_laps_are_kept(run, monkeypatch):
    monkeypatch.setattr(map_data_module, "_MOST_ENDS", 20)
    laps = choose_laps(run.episodes, 200)
    everything = map_data(run, laps)["ends"]["id"]

    assert set(laps.ids) <= set(everything)
    assert 20 <= len(everything) <= 20 + len(laps.ids) < len(run.episodes)
