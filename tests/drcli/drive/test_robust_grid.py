"""Which disturbances a robust evaluation drives."""

from drcli.drive.evaluate_many import UNSEEN, grid, unseen_races, with_patterns
from drsim.car.conditions import NOMINAL

ASKED = {
    "start",
    "direction",
    "light",
    "glare",
    "reflections",
    "noise",
    "latency",
    "grip",
    "battery",
    "steering trim",
}


def test_the_grid_begins_undisturbed_and_has_every_disturbance():
    """003-18 and 003-19."""
    cells = grid(0)

    assert (cells[0].axis, cells[0].conditions, cells[0].side) == ("none", NOMINAL, "centre")
    assert {cell.axis for cell in cells} >= ASKED
    assert len({(cell.axis, cell.level) for cell in cells}) == len(cells)


def test_every_level_disturbs_something():
    for cell in grid(0)[1:]:
        moved = cell.side != "centre" or cell.angle_deg or cell.other_way
        assert moved or cell.conditions != NOMINAL, cell.level


def test_the_seed_decides_what_is_drawn():
    once, again, other = (with_patterns(grid(seed), seed) for seed in (3, 3, 4))

    assert once == again
    assert [c for c in once if c.axis == "together"] != [c for c in other if c.axis == "together"]
    assert len({cell.conditions.pattern for cell in once}) == len(once)


def test_an_open_track_is_driven_in_one_direction():
    assert "direction" not in {cell.axis for cell in grid(0, closed=False)}


def test_tracks_that_the_model_was_not_trained_on_are_an_axis_of_their_own(racer):
    race = racer.settings().race
    given = race.replaced(train_worlds="bean", train_eval_world="willow, bean, zoo:3-4")
    crowded = race.replaced(race_type="OBJECT_AVOIDANCE", oa_number_of_obstacles=40)

    assert [race.world_name for race in unseen_races(given)] == ["willow", "zoo-3", "zoo-4"]
    assert [race.world_name for race in unseen_races(race)] == UNSEEN
    assert len(unseen_races(crowded)) < len(UNSEEN), "there is no room on the short ones"
    last = grid(0, unseen=["willow", "zoo-3"])[-1]
    assert (last.axis, last.level, last.track, last.conditions) == (
        "unseen tracks",
        "zoo-3",
        2,
        NOMINAL,
    )
