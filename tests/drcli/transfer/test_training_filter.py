"""Which trainings fulfil a condition."""

from datetime import UTC, datetime

import pytest

from drcli.base.errors import SettingsError
from drcli.transfer.training_list import began, entry_of, in_state, of_model, values_of, where
from past_trainings import training

VALUES = values_of(training(1), entry_of(training(1), exists=True))
NOW = datetime(2026, 11, 20, 12, tzinfo=UTC)


@pytest.mark.parametrize(
    ("text", "fits"),
    [
        ("lr=0.001", True),
        ("LR = 1e-3", True),
        ("lr<0.001", False),
        ("lr<=0.001", True),
        ("batch_size>32", True),
        ("batch_size>=65", False),
        ("best_lap_s<15.5", True),
        ("world=reinvent*", True),
        ("world=REINVENT_BASE", True),
        ("world!=reinvent_base", False),
        ("DR_RACE_TYPE=TIME_TRIAL", True),
        ("DR_WORLD_NAME=reinvent_base", True),
        ("dr_world_name=other", False),
        ("DR_ENABLE_DOMAIN_RANDOMIZATION=False", True),
        ("usd<100", False),
        ("usd!=3", True),
        ("description=", False),
        ("seed=1", True),
    ],
)
def test_a_comparison_holds_or_not(text, fits):
    assert where(text, [*VALUES])(VALUES) == fits


@pytest.mark.parametrize(
    ("text", "message", "remedy"),
    [
        ("lr", "--where lr is no comparison", "lr<0.001"),
        ("", "is no comparison", "lr<0.001"),
        ("learn_rate<1", "no training has a value learn_rate", "hyperparameter"),
        ("batchsize=64", "no training has a value batchsize", "Did you mean batch_size?"),
    ],
)
def test_what_is_no_comparison_is_refused(text, message, remedy):
    with pytest.raises(SettingsError, match=message) as error:
        where(text, [*VALUES])

    assert remedy in error.value.remedy


@pytest.mark.parametrize(
    ("pattern", "fits"),
    [("team", True), ("team/*", True), ("model", True), ("mod*", False), ("other", False)],
)
def test_a_model_fits_a_pattern(pattern, fits):
    assert of_model(pattern)(VALUES) == fits


@pytest.mark.parametrize(
    ("text", "fits"),
    [
        ("2026-11-19", True),
        ("2026-11-19T11:06", True),
        ("2026-11-19T12:00+00:30", False),
        ("2026-11-20", False),
        ("25h", True),
        ("24h", False),
        ("2d", True),
        ("1w", True),
    ],
)
def test_a_time_is_a_date_or_an_age(text, fits):
    assert began("--since", text, NOW, after=True)(VALUES) == fits
    assert began("--until", text, NOW, after=False)(VALUES) != fits


def test_a_training_whose_time_is_unknown_is_neither_before_nor_after():
    values = {"began_at": ""}

    assert not began("--since", "2020-01-01", NOW, after=True)(values)
    assert not began("--until", "2030-01-01", NOW, after=False)(values)


@pytest.mark.parametrize("text", ["yesterday", "2026-13-01", "7", "999999w", ""])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(SettingsError, match="neither a date nor an age"):
        began("--since", text, NOW, after=True)


def test_states_are_words():
    assert in_state("failed, Finished")(VALUES)
    assert not in_state("lost")(VALUES)
    with pytest.raises(SettingsError, match="--state done is no state"):
        in_state("done")
