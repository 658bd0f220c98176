"""training_params.yaml for DeepRacer on AWS."""

import pytest
import yaml

from drcli.model.files.params_yaml import (
    CLOCKWISE,
    COUNTER_CLOCKWISE,
    DROA_TRACKS,
    droa_parameters,
    read_parameters,
    split_world,
)


def written(text, route=None):
    return yaml.safe_load(droa_parameters(text.encode(), route))


def test_there_are_62_tracks_and_none_names_a_direction():
    assert len(DROA_TRACKS) == 62
    assert all(split_world(name) == (name, None) for name in DROA_TRACKS)


@pytest.mark.parametrize(
    ("lines", "route", "clockwise"),
    [
        ("WORLD_NAME: 'arctic_open_cw'", None, True),
        ("WORLD_NAME: 'arctic_open_ccw'", CLOCKWISE, False),
        ("WORLD_NAME: 'arctic_open_cw'\nREVERSE_DIR: 'True'", None, False),
        ("WORLD_NAME: 'arctic_open'", COUNTER_CLOCKWISE, False),
        ("WORLD_NAME: 'arctic_open'\nREVERSE_DIR: 'True'", COUNTER_CLOCKWISE, True),
        ("WORLD_NAME: arctic_open\nTRACK_DIRECTION_CLOCKWISE: 'True'", COUNTER_CLOCKWISE, True),
        ("WORLD_NAME: Monaco\nREVERSE_DIR: 'True'", None, True),  # only clockwise there
        ("WORLD_NAME: reinvent_base", CLOCKWISE, False),  # only counterclockwise there
    ],
)
def test_the_direction_comes_from_the_name_else_from_the_route(lines, route, clockwise):
    values = written(lines, route)

    assert values["TRACK_DIRECTION_CLOCKWISE"] is clockwise
    assert not values["WORLD_NAME"].endswith(("_cw", "_ccw"))


def test_a_direction_that_nobody_knows_is_not_invented():
    with pytest.raises(ValueError, match="in which direction"):
        written("WORLD_NAME: arctic_open")


def test_texts_become_values_where_the_importer_compares_types():
    values = written(
        "WORLD_NAME: 'reinvent_base'\nNUMBER_OF_OBSTACLES: '6'\nCHANGE_START_POSITION: 'True'\n"
        "RANDOMIZE_OBSTACLE_LOCATIONS: 'false'\nROUND_ROBIN_ADVANCE_DIST: '0.05'\n"
        "RACER_NAME: '12'\nCAR_NAME: 'yes'\nOBJECT_POSITIONS:\n- '0.2,1'\n"
    )

    assert values["NUMBER_OF_OBSTACLES"] == 6
    assert values["CHANGE_START_POSITION"] is True
    assert values["RANDOMIZE_OBSTACLE_LOCATIONS"] is False
    assert values["ROUND_ROBIN_ADVANCE_DIST"] == 0.05
    assert values["RACER_NAME"] == "12"
    assert values["CAR_NAME"] == "yes"
    assert values["OBJECT_POSITIONS"] == ["0.2,1"]


def test_only_true_and_false_are_truth_values():
    values = read_parameters(b"a: yes\nb: on\nc: True\nd: FALSE\ne: 'true'\n")

    assert values == {"a": "yes", "b": "on", "c": True, "d": False, "e": "true"}


@pytest.mark.parametrize(
    "data", [b"", b"[]", b"text", b"a: [", b"\xff", b"[" * 5000, b"? [a]\n: b"]
)
def test_something_else_is_refused(data):
    with pytest.raises(ValueError, match="it "):
        read_parameters(data)


def test_objects_of_python_are_not_made():
    with pytest.raises(ValueError, match="it is not YAML"):
        read_parameters(b"a: !!python/object/apply:os.system ['true']")
