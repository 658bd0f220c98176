"""model_metadata.json: what is accepted, what is refused, and in which words."""

import contextlib
import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drcli.base.errors import SettingsError
from drcli.model.files.model_metadata import ModelMetadata

ROOT = Path(__file__).resolve().parents[4]
EXAMPLE = (ROOT / "defaults" / "model_metadata.json").read_bytes()

RANGES = {"steering_angle": {"low": -20, "high": 30.0}, "speed": {"low": 0.5, "high": 2}}
ACTIONS = [{"steering_angle": -10, "speed": 1}, {"steering_angle": 10, "speed": 2.5}]


def metadata(**values) -> ModelMetadata:
    return ModelMetadata.from_bytes(json.dumps({"action_space": ACTIONS, **values}).encode())


def test_the_example_of_the_project_is_accepted_and_can_be_trained():
    read = ModelMetadata.from_bytes(EXAMPLE)

    assert read.problems == ()
    assert read.action_space.num_actions == 7


def test_the_file_of_a_reference_run_is_accepted():
    path = ROOT.parent / "shared/reference-runs/drfc-time-trial/model/model_metadata.json"
    if not path.exists():
        pytest.skip("the reference runs are not beside this checkout")

    read = ModelMetadata.from_bytes(path.read_bytes())

    assert read.action_space.values[:2] == ((-30.0, 1.0), (-30.0, 2.0))
    assert read.action_space.num_actions == 14
    assert (read.version, read.problems) == ("4", ())


def test_discrete_actions_keep_their_order():
    space = metadata().action_space

    assert space.values == ((-10.0, 1.0), (10.0, 2.5))
    assert (space.continuous, space.num_actions, space.low) == (False, 2, None)


def test_continuous_actions_have_ranges():
    read = metadata(action_space=RANGES, action_space_type="Continuous")

    space = read.action_space
    assert (space.low, space.high) == ((-20.0, 0.5), (30.0, 2.0))
    assert (space.continuous, space.num_actions, space.values) == (True, 2, ())
    assert read.action_space_type == "continuous"


@pytest.mark.parametrize(
    ("values", "sensor", "version"),
    [
        ({}, ("observation",), "1.0"),
        ({"sensor": ["LEFT_CAMERA"]}, ("LEFT_CAMERA",), "2.0"),
        ({"sensor": ["STEREO_CAMERAS", "LIDAR"], "version": 3}, ("STEREO_CAMERAS", "LIDAR"), "3"),
    ],
)
def test_missing_keys_have_the_defaults_of_the_reference(values, sensor, version):
    read = metadata(**values)

    assert (read.sensor, read.version) == (sensor, version)
    assert read.training_algorithm == "clipped_ppo"
    assert read.neural_network == "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"


@pytest.mark.parametrize("version", [1, "2", 3.0, "4.0", "5", 6])
def test_a_version_may_be_text_or_number(version):
    assert float(metadata(version=version).version) == float(version)


def test_the_action_space_is_kept_as_written_for_logs():
    assert json.loads(metadata().action_space_json) == ACTIONS


@pytest.mark.parametrize(
    ("values", "sentence", "remedy"),
    [
        pytest.param(
            {"action_space": []},
            "action_space=[] is empty",
            'Write at least one, as in "action_space": [{"steering_angle": 15, "speed": 1.0}].',
            id="no-action",
        ),
        pytest.param(
            {"action_space": RANGES},
            "action_space is ranges, but action_space_type is discrete",
            'Write "action_space_type": "continuous", or discrete actions.',
            id="ranges-without-their-type",
        ),
        pytest.param(
            {"action_space_type": "continuous", "action_space": ACTIONS},
            "action_space is a list, but action_space_type is continuous",
            'Write "action_space_type": "discrete", or continuous actions.',
            id="list-as-ranges",
        ),
        pytest.param(
            {"action_space": [7]},
            "action_space[0]=7 is not an object with keys",
            'Write it between { }, as in {"steering_angle": 15, "speed": 1.0}.',
            id="number-as-action",
        ),
        pytest.param(
            {"action_space": [{"steering": 5, "speed": 1}]},
            "action_space[0].steering_angle is missing",
            'Rename "steering" to "steering_angle".',
            id="misspelt-steering",
        ),
        pytest.param(
            {"action_space": [{"steering_angle": 5, "speed": "1"}]},
            'action_space[0].speed="1" is not a number',
            'Write 1 without quotes, as in "speed": 1.0.',
            id="speed-in-quotes",
        ),
        pytest.param(
            {"action_space": [{"steering_angle": 5, "speed": 1e6}]},
            "action_space[0].speed=1000000.0 is above 1000",
            "Write 1000 or less",
            id="speed-beyond-reason",
        ),
        pytest.param(
            {
                "action_space_type": "continuous",
                "action_space": {**RANGES, "speed": {"low": 2, "high": 1}},
            },
            'action_space.speed={"low": 2, "high": 1} has a low that is not below its high',
            "Write a low below the high",
            id="low-above-high",
        ),
        pytest.param(
            {"action_space_type": "continuous", "action_space": {"speed": RANGES["speed"]}},
            "action_space.steering_angle is missing",
            'Add "steering_angle": {"low": -30, "high": 30}.',
            id="no-steering-range",
        ),
        pytest.param(
            {"action_space_type": "steps"},
            'action_space_type="steps" is not one of discrete, continuous',
            "Write one of these.",
            id="unknown-type",
        ),
        pytest.param(
            {"training_algorithm": "ppo"},
            'training_algorithm="ppo" is not one of clipped_ppo, sac',
            "Write one of these.",
            id="unknown-algorithm",
        ),
        pytest.param(
            {"training_algorithm": "sac"},
            'training_algorithm="sac" needs continuous actions',
            'Write "action_space_type": "continuous" with ranges',
            id="sac-with-a-list",
        ),
        pytest.param(
            {"neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALOW"},
            'neural_network="DEEP_CONVOLUTIONAL_NETWORK_SHALOW" is not one of '
            "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW, DEEP_CONVOLUTIONAL_NETWORK, "
            "DEEP_CONVOLUTIONAL_NETWORK_DEEP, COMPACT_CONVOLUTIONAL_NETWORK",
            "Did you mean DEEP_CONVOLUTIONAL_NETWORK_SHALLOW?",
            id="unknown-network",
        ),
        pytest.param(
            {"sensor": "FRONT_FACING_CAMERA"},
            'sensor="FRONT_FACING_CAMERA" is not a list of sensors',
            'Write "sensor": ["FRONT_FACING_CAMERA"].',
            id="sensor-without-list",
        ),
        pytest.param(
            {"sensor": ["FRONT_FACING_CAMRA"]},
            'sensor=["FRONT_FACING_CAMRA"] contains FRONT_FACING_CAMRA, which is not a known '
            "sensor",
            "Did you mean FRONT_FACING_CAMERA?",
            id="misspelt-sensor",
        ),
        pytest.param(
            {"sensor": ["LIDAR"]},
            'sensor=["LIDAR"] does not contain a camera',
            "Keep exactly one of",
            id="no-camera",
        ),
        pytest.param(
            {"sensor": ["observation", "LEFT_CAMERA"]},
            'sensor=["observation", "LEFT_CAMERA"] contains more than one camera',
            "Keep exactly one of",
            id="two-cameras",
        ),
        pytest.param(
            {"sensor": ["observation", "LIDAR", "SECTOR_LIDAR"]},
            'sensor=["observation", "LIDAR", "SECTOR_LIDAR"] contains more than one lidar',
            "Keep at most one of",
            id="two-lidars",
        ),
        pytest.param(
            {"version": 7},
            "version=7 is not a version from 1 to 6",
            'Write "version": "5".',
            id="unknown-version",
        ),
        pytest.param(
            {"version": "new"},
            'version="new" is not a version from 1 to 6',
            'Write "version": "5".',
            id="version-as-word",
        ),
        pytest.param(
            {"sensr": ["LIDAR"]},
            'sensr=["LIDAR"] is not a known key',
            "Did you mean sensor?",
            id="misspelt-key",
        ),
        pytest.param(
            {
                "sensor": ["observation", "DISCRETIZED_SECTOR_LIDAR"],
                "lidar_config": {"num_sectors": 7},
            },
            "lidar_config.num_sectors=7 is not a divisor of 64",
            "Write a divisor of 64, such as 8.",
            id="lidar-sectors",
        ),
    ],
)
def test_a_bad_value_is_named_with_file_line_key_value_and_remedy(values, sentence, remedy):
    with pytest.raises(SettingsError) as refusal:
        metadata(**values)

    assert str(refusal.value) == f"model_metadata.json line 1: {sentence}."
    assert remedy in refusal.value.remedy


def test_a_missing_action_space_is_refused():
    with pytest.raises(SettingsError) as refusal:
        ModelMetadata.from_bytes(b'{"version": "5"}')

    assert str(refusal.value) == "model_metadata.json: action_space is missing."


def test_a_value_deep_inside_is_named_with_its_own_line():
    first = b'{"steering_angle": 0, "speed": 1}'
    text = b'{"action_space": [\n' + first + b',\n{"steering_angle": 5,\n"speed": null}]}'

    with pytest.raises(SettingsError) as refusal:
        ModelMetadata.from_bytes(text, "m.json")

    assert str(refusal.value) == "m.json line 4: action_space[1].speed=null is not a number."


@pytest.mark.parametrize(
    ("values", "warning"),
    [
        ({"action_space": [ACTIONS[0], ACTIONS[0]]}, "action 1 repeats action 0."),
        (
            {"action_space": [{"steering_angle": 35, "speed": 1}]},
            "action_space[0].steering_angle=35 is more than the car can do (-30 to 30).",
        ),
        (
            {"action_space": [{"steering_angle": 3, "speed": 4.5}]},
            "action_space[0].speed=4.5 is more than the car can do (0.1 to 4).",
        ),
        (
            {"action_space": [{"steering_angle": 3, "speed": 0.05}]},
            "action_space[0].speed=0.05 is less than the car can do (0.1 to 4).",
        ),
        (
            {"action_space": [{"steering_angle": k / 10, "speed": 1} for k in range(31)]},
            "31 actions learn slowly.",
        ),
        (
            {"action_space": [{**ACTIONS[0], "colour": 1}]},
            "action_space[0].colour is not used.",
        ),
        ({"description": "mine"}, "description is not used."),
        (
            {"version": 1, "sensor": ["LEFT_CAMERA"]},
            "version 1 has one camera; its sensor list is ignored.",
        ),
    ],
)
def test_something_odd_is_used_with_a_warning(values, warning):
    said = [str(each) for each in metadata(**values).problems]
    assert said == [f"model_metadata.json line 1: {warning}"]


def test_sectors_of_a_lidar_are_read_and_missing_ones_have_the_reference_values():
    read = metadata(
        sensor=["FRONT_FACING_CAMERA", "DISCRETIZED_SECTOR_LIDAR"],
        lidar_config={"num_sectors": 4, "clipping_dist": 1.5},
    )

    assert (read.lidar.num_sectors, read.lidar.num_values_per_sector) == (4, 8)
    assert read.lidar.clipping_dist == 1.5


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_file_is_read_or_refused_and_nothing_else(data):
    at = data.draw(st.integers(0, len(EXAMPLE)))
    junk = data.draw(st.binary(max_size=4) | st.sampled_from([b'"', b"{", b"[", b"1e9", b"null,"]))
    text = EXAMPLE[:at] + junk + EXAMPLE[at + data.draw(st.integers(0, 20)) :]

    with contextlib.suppress(SettingsError):
        read = ModelMetadata.from_bytes(text)

        assert read.action_space.num_actions >= 1


@settings(max_examples=60)
@given(
    st.dictionaries(
        st.sampled_from(["action_space", "sensor", "version", "action_space_type", "lidar_config"]),
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(st.sampled_from(["speed", "steering_angle", "low"]), inner)
            ),
            max_leaves=6,
        ),
    )
)
def test_any_values_are_accepted_or_refused_and_nothing_else(values):
    with contextlib.suppress(SettingsError):
        read = metadata(**values)

        assert read.action_space.num_actions >= 1
