"""The file of a sweep: what it means, and what is said about mistakes in it."""

from pathlib import Path

import pytest

from drcli.base.errors import ProblemsError, SettingsError
from drcli.config.presets import model_file
from drcli.sweeps.sweep_file import Span, SweepFile, read_sweep_file
from drcli.sweeps.trials import trials_of


@pytest.fixture
def read(tmp_path: Path):
    def read(text: str, name: str = "sweep.yaml") -> SweepFile:
        path = tmp_path / name
        path.write_text(text)
        return read_sweep_file(path)

    return read


VARY = "vary:\n  hyperparameters:\n    lr: [1e-4, 3e-4]\nbudget: {minutes: 20}\n"


def test_the_shipped_example_is_in_order():
    found = read_sweep_file(model_file("sweep.yaml"))

    assert found.name == "first-sweep"
    assert len(trials_of(found)) == 4


def test_the_name_of_the_file_is_that_of_the_sweep(read):
    assert read(VARY, "My Rewards.yaml").name == "my-rewards"
    assert read("name: other\n" + VARY).name == "other"


def test_a_grid_has_every_combination_in_the_order_of_the_file(read):
    found = read(
        "name: a\nsettings: {DR_TRAIN_MIN_EVAL_TRIALS: 3}\nvary:\n"
        "  reward_function: [fast.py, rewards/safe.py]\n"
        "  hyperparameters: {lr: [1e-4, 0.001]}\n  seed: [7]\nbudget: {steps: 1000}\n"
    )

    trials = trials_of(found)

    assert [(t.name, t.reward_function, t.hyperparameters) for t in trials] == [
        ("a-01", "fast.py", {"lr": 0.0001}),
        ("a-02", "fast.py", {"lr": 0.001}),
        ("a-03", "rewards/safe.py", {"lr": 0.0001}),
        ("a-04", "rewards/safe.py", {"lr": 0.001}),
    ]
    assert trials[0].settings == {"DR_TRAIN_MIN_EVAL_TRIALS": "3", "DR_TRAIN_SEED": "7"}
    assert trials[2].text == "reward_function=safe, lr=0.001".replace("0.001", "0.0001")


def test_files_of_one_name_are_told_apart_by_their_folders(read):
    found = read("vary: {reward_function: [a/r.py, b/r.py]}\nbudget: {minutes: 1}\n")

    assert [t.varied for t in trials_of(found)] == [
        {"reward_function": "a/r.py"},
        {"reward_function": "b/r.py"},
    ]


RANDOM = """
search: random
trials: 12
seed: 5
vary:
  hyperparameters:
    lr: {min: 1e-5, max: 1e-3, log: true}
    batch_size: {min: 32, max: 128}
    discount_factor: [0.9, 0.99]
budget: {episodes: 500}
"""


def test_random_trainings_are_different_within_the_ranges_and_the_same_again(read):
    trials = trials_of(read(RANDOM))

    assert trials == trials_of(read(RANDOM))
    assert trials != trials_of(read(RANDOM.replace("seed: 5", "seed: 6")))
    chosen = [t.hyperparameters for t in trials]
    assert len({tuple(each.items()) for each in chosen}) == 12
    assert all(1e-5 <= each["lr"] <= 1e-3 for each in chosen)
    assert all(isinstance(each["batch_size"], int) for each in chosen)
    assert {each["discount_factor"] for each in chosen} == {0.9, 0.99}
    assert sum(each["lr"] < 1e-4 for each in chosen) in range(2, 11)  # half of them, by its log


def test_a_range_says_what_it_is(read):
    plan = read(RANDOM).plan

    assert plan.vary.hyperparameters["lr"] == Span(1e-5, 1e-3, log=True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "The file is empty."),
        ("- a\n", "instead of the key vary"),
        ("budget: {minutes: 1}\n", "vary is missing"),
        ("vary: {}\nbudget: {minutes: 1}\n", "vary has nothing that differs"),
        (VARY + "budgets: 3\n", "line 5: budgets is not a key of a sweep."),
        (VARY.replace("lr", "learning_rate"), "vary.hyperparameters.learning_rate is not a hyper"),
        (VARY.replace("lr: [1e-4, 3e-4]", "lr: []"), "is neither values nor a range"),
        (VARY.replace("[1e-4, 3e-4]", "{min: 1, max: 0}"), "is an empty range"),
        (VARY.replace("[1e-4, 3e-4]", "{min: 0, max: 1, log: true}"), "is an empty range"),
        (VARY.replace("[1e-4, 3e-4]", "{min: 0.1, max: 1}"), "search=grid trains all values"),
        (VARY.replace("minutes: 20", "minutes: 20, steps: 5"), "budget has minutes and steps"),
        (VARY.replace("minutes: 20", ""), "budget has no limit"),
        (VARY.replace("minutes: 20", "minutes: -1"), "budget.minutes=-1 is not above 0"),
        (VARY.replace("minutes: 20", "hours: 2"), "budget.hours is not a key of a sweep"),
        (VARY + "search: random\n", "does not say how many trainings"),
        (VARY + "trials: 5\n", "has no meaning for search=grid"),
        (VARY + "search: random\ntrials: 3\n", "has only about 2 different combinations"),
        (VARY + "search: bayes\n", 'search="bayes" is not a known word'),
        (VARY + "metric: speed\n", 'metric="speed" is not a known word'),
        (VARY + "name: My Sweep\n", "cannot be the name of a sweep"),
        (VARY + "early_stopping: {method: bands}\n", 'method="bands" is not a known word'),
        (VARY + "early_stopping: {reduction_factor: 1}\n", "is below 1.1"),
        (VARY + "settings: {DR_WORLD: x}\n", "Did you mean DR_WORLD_NAME?"),
        (VARY.replace("3e-4]", "1e-4]"), "vary.hyperparameters.lr has 0.0001 twice"),
        (VARY.replace("vary:", "vary:\n  seed: [1, 2, 1]"), "vary.seed has 1 twice"),
        (VARY + "settings: {DR_LAUNCHER: ray}\n", "a sweep sets DR_LAUNCHER itself"),
        (VARY + "settings: {DR_RUN_ID: 3}\n", "a sweep sets DR_RUN_ID itself"),
        (
            VARY.replace("vary:", "vary:\n  model_metadata: [a.json, b.json]")
            + "early_stopping: {method: population}\n",
            "which fit one model_metadata only",
        ),
        (VARY + "parallel: 0\n", "parallel=0 is below 1"),
        (VARY + "vary: 3\n", "occurs twice"),
        (
            "vary: {hyperparameters: {num_epochs: [1,2,3,4,5,6,7,8,9,10,11,12,13,14,15]}, "
            "seed: [1,2,3,4,5,6,7,8,9,10,11,12,13,14,15]}\nbudget: {minutes: 1}\n",
            "vary has 225 combinations; at most 200 are trained.",
        ),
    ],
)
def test_each_mistake_is_one_sentence_with_its_line(read, text, said):
    with pytest.raises(ProblemsError) as caught:
        trials_of(read(text))

    error = caught.value
    assert said in f"{error} {error.remedy}"
    assert "sweep.yaml" in str(error)
    assert error.remedy


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(SettingsError, match=r"none\.yaml cannot be read"):
        read_sweep_file(tmp_path / "none.yaml")
