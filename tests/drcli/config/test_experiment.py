"""Which experiment counts, and which cannot."""

import pytest


@pytest.mark.parametrize("name", ["../x", "a/b", ".hidden", "x" * 101])
def test_an_experiment_that_cannot_be_a_folder_is_not_offered_to_be_made(folder, name):
    refusal = folder.refusal("", flags={"DR_EXPERIMENT_NAME": name})

    assert "is not a plain folder name." in str(refusal)
    assert refusal.remedy == "Name a folder in experiments/, or drop the name."


def test_an_experiment_that_is_missing_can_be_made(folder):
    refusal = folder.refusal("", flags={"DR_EXPERIMENT_NAME": "first"})

    assert refusal.remedy == "Write it with `dr init --experiment first`, or drop the name."


def test_an_experiment_that_does_not_exist_is_refused(folder):
    folder.write("experiments/first/run.env", "")

    refusal = folder.refusal("", flags={"DR_EXPERIMENT_NAME": "frist"})

    assert str(refusal) == (
        f"flag: DR_EXPERIMENT_NAME=frist has no experiments/frist/run.env in {folder.path}."
    )
    assert refusal.remedy == "Did you mean first? Write one of first."
