"""Trainings side by side, and what is more than chance."""

import json

import numpy as np
import pytest

from drcli.analysis.compare_runs import compare_means, compare_runs
from drcli.analysis.read_run import read_runs
from drcli.base.errors import SettingsError
from simtraces import put, write_model


def groups(seed, mean, count=8, spread=3.0):
    """Values of iterations whose means differ among each other, as those of trainings do."""
    random = np.random.default_rng(seed)
    return [random.normal(random.normal(mean, spread), 10.0, 20) for _ in range(count)]


def test_equal_trainings_rarely_differ_by_more_than_chance():
    found = [compare_means(groups(seed, 50.0), groups(seed + 1000, 50.0)) for seed in range(20)]

    assert sum(each.beyond_chance for each in found) <= 3


@pytest.mark.parametrize("change", [15.0, -15.0])
def test_a_large_difference_is_more_than_chance(change):
    found = compare_means(groups(1, 50.0), groups(2, 50.0 + change))

    assert found.beyond_chance
    assert found.low < found.difference < found.high
    assert found.difference == pytest.approx(change, abs=6.0)


def test_few_iterations_tell_nothing():
    assert compare_means(groups(1, 50.0, count=2), groups(2, 90.0)) is None


def test_two_trainings_stand_side_by_side(read, tmp_path):
    slow = write_model(tmp_path / "slow", iterations=8)
    fast = write_model(tmp_path / "fast", iterations=8, laps_from=1)
    put(fast, "ip/hyperparameters.json", b'{"lr": 0.001}')

    found = compare_runs([read(slow), read(fast)])

    assert [run.model for run in found.runs] == ["slow", "fast"]
    assert [run.complete_laps for run in found.runs] == [0, 28]
    assert [(run.evaluated_clean, run.evaluated_laps) for run in found.runs] == [(1, 2), (1, 2)]
    assert [run.evaluated_resets for run in found.runs] == [0, 0]
    rows = {name: cells for name, *cells in found.numbers()}
    assert rows["clean laps"] == ["0", "28"]
    assert rows["of them clean"] == ["1", "1"]
    [pair] = found.pairs
    assert pair.progress["beyond_chance"]
    assert "fast drives further" in pair.sentence
    assert pair.reward is not None  # the reward functions are equal
    assert '+  "lr": 0.001' in pair.files["hyperparameters.json"].splitlines()
    assert found.at_equal["steps"]["progress"][1] > found.at_equal["steps"]["progress"][0]
    goals = found.runs[1].goals
    assert [goal["iteration"] is not None for goal in goals] == [True, True, True]


def test_rewards_of_different_functions_are_not_compared(read, tmp_path):
    first, second = (write_model(tmp_path / name) for name in "ab")
    put(second, "reward_function.py", b"def reward_function(params):\n    return 2.0\n")

    [pair] = compare_runs([read(first), read(second)]).pairs

    assert pair.reward is None
    assert "reward_function.py" in pair.files


def test_json_in_another_form_is_no_difference(read, tmp_path):
    first, second = (write_model(tmp_path / name) for name in "ab")
    path = second / "ip" / "hyperparameters.json"
    values = dict(reversed(json.loads(path.read_text()).items()))
    path.write_text(json.dumps(values, indent=4))

    [pair] = compare_runs([read(first), read(second)]).pairs

    assert pair.files == {}
    assert pair.same_reward


def test_models_of_one_name_are_called_by_their_places(read, tmp_path):
    folders = [write_model(tmp_path / place / "model") for place in "ab"]

    found = compare_runs([read(folder) for folder in folders])

    assert [run.model for run in found.runs] == list(map(str, folders))
    assert found.pairs[0].model == str(folders[1])


def test_one_model_twice_is_refused(settings, libraries, tmp_path):
    model = write_model(tmp_path / "model", iterations=1)
    (tmp_path / "other").symlink_to(model)

    for names, sentence in (
        ((model, model), "model is named twice"),
        ((model, tmp_path / "other"), "model and .*other are the same model"),
    ):
        with pytest.raises(SettingsError, match=f"{sentence} .*nothing to compare"):
            read_runs(settings, list(map(str, names)))
