"""V-16: what a model is refused for is told before it is trained."""

import json

import pytest

COMPACT = {"neural_network": "COMPACT_CONVOLUTIONAL_NETWORK"}


def metadata(folder, **changes):
    file = folder.path / "custom_files" / "model_metadata.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **changes}))


def told(dr, capsys, place):
    code = dr("validate", "--json", "--for", place)
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    found = [each for each in report["errors"] + report["warnings"] if each["rule"] == "V-16"]
    assert (code == 3) == any(each["severity"] == "error" for each in found)
    return report["goes_to"], found


@pytest.mark.parametrize(
    ("place", "name"),
    [
        ("droa", "DeepRacer on AWS"),
        ("car", "the physical car"),
        ("drfc", "DeepRacer-for-Cloud"),
    ],
)
def test_a_usual_model_can_go_everywhere(folder, dr, capsys, place, name):
    goes_to, found = told(dr, capsys, place)

    assert goes_to == f"The trained model can go to {name}."
    assert not [each for each in found if each["severity"] == "error"]


@pytest.mark.parametrize(
    ("spoil", "refusing", "words"),
    [
        (lambda f: metadata(f, **COMPACT), {"droa", "drfc"}, "has no such network"),
        (lambda f: f.hyperparameters(stack_size=2), {"droa", "car", "drfc"}, "stack_size=2"),
        (
            lambda f: metadata(
                f,
                sensor=["FRONT_FACING_CAMERA", "DISCRETIZED_SECTOR_LIDAR"],
                lidar_config={"num_sectors": 8, "num_values_per_sector": 8},
            ),
            {"car"},
            "which the car does not know",
        ),
        (
            lambda f: f.reward("import os\n\n\ndef reward_function(params):\n    return 1.0\n"),
            {"droa"},
            "imports os",
        ),
        (
            lambda f: f.settings(DR_RACE_TYPE="OBJECT_AVOIDANCE", DR_OA_NUMBER_OF_OBSTACLES=8),
            {"droa"},
            "NUMBER_OF_OBSTACLES=8 is not from 1 to 6",
        ),
    ],
)
def test_each_place_refuses_what_it_has_not(folder, dr, capsys, spoil, refusing, words):
    spoil(folder)

    for place in ("droa", "car", "drfc"):
        goes_to, found = told(dr, capsys, place)

        errors = [each for each in found if each["severity"] == "error"]
        assert bool(errors) == (place in refusing), place
        assert bool(goes_to) != bool(errors)
        if errors:
            assert words in " ".join(each["message"] for each in errors)
            assert all(each["remedy"] and each["where"] for each in errors)


@pytest.mark.parametrize(
    ("changes", "place", "words"),
    [
        ({"DR_WORLD_NAME": "zoo-3"}, "droa", "is not a track of DeepRacer on AWS"),
        ({"DR_WORLD_NAME": "zoo-3"}, "drfc", "is not a track of DeepRacer-for-Cloud"),
        ({"DR_LOCAL_S3_MODEL_PREFIX": "team/model"}, "droa", "cannot be its name there"),
    ],
)
def test_what_can_be_changed_later_is_a_warning(folder, dr, capsys, changes, place, words):
    folder.settings(**changes)

    _, found = told(dr, capsys, place)

    assert words in " ".join(each["message"] for each in found)
    assert {each["severity"] for each in found} == {"warning"}


def test_wrong_files_are_corrected_first(folder, dr, capsys):
    folder.hyperparameters(lr=2)

    dr("validate", "--for", "droa")

    assert "What DeepRacer on AWS takes is checked once the files" in capsys.readouterr().out
