"""A start says in one line what ends the training."""

from pathlib import Path

import pytest

from drcli.config.loading import load_settings
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.records.job import Job
from drcli.train.goals import ending


@pytest.fixture
def told(tmp_path):
    def tell(*lines: str, until_laps=None, max_minutes=None, lap_time_s=None, **parameters) -> str:
        (tmp_path / "run.env").write_text("\n".join(lines))
        (tmp_path / "system.env").write_text("")
        settings = load_settings(tmp_path, environ={})
        asked = {"until_laps": until_laps, "until_lap_time_s": lap_time_s}
        goals = {key: each for key, each in asked.items() if each is not None}
        job = Job(settings.run, "s", 1, max_minutes, Path(), 1, goals=goals)
        return ending(job, Hyperparameters(**parameters))

    return tell


def test_a_file_of_the_reference_ends_after_its_iterations_and_not_by_its_score(told):
    assert told(term_cond_max_episodes=1000, term_cond_avg_score=350) == (
        "Ends after 1,000 iterations (term_cond_max_episodes; it counts iterations), or with "
        "dr-stop-training."
    )


def test_everything_that_ends_a_training_is_in_the_line(told):
    text = told(
        "DR_TRAIN_MAX_ITERATIONS=50",
        "DR_TRAIN_MAX_MINUTES=30",
        "DR_TRAIN_STOP_MEAN_SCORE=400",
        "DR_TRAIN_STOP_PROGRESS=99",
        until_laps=3,
        max_minutes=30.0,
    )

    assert text == (
        "Ends once a checkpoint completes all its evaluation laps, at least 3, and then 38 of 40 "
        "laps from other starts are as good (--until-laps), or "
        "after 30 minutes (DR_TRAIN_MAX_MINUTES), or after 50 iterations "
        "(DR_TRAIN_MAX_ITERATIONS), or at a mean reward of 400 over 100 episodes "
        "(DR_TRAIN_STOP_MEAN_SCORE), or at 99 % of mean progress in 3 evaluations in a row, "
        "and on 40 laps from other starts (DR_TRAIN_STOP_PROGRESS), or with dr-stop-training."
    )


@pytest.mark.parametrize(("until_laps", "laps"), [(None, 5), (3, 3)])
def test_a_lap_time_is_told_with_its_number_of_laps(told, until_laps, laps):
    assert told(until_laps=until_laps, lap_time_s=8.0).startswith(
        f"Ends once each evaluation lap of a checkpoint, at least {laps}, takes 8 s or less, "
        "and then 38 of 40 laps from other starts are as good (--until-lap-time), or after"
    )


def test_a_limit_that_comes_later_than_another_is_left_out(told):
    text = told("DR_TRAIN_MAX_ITERATIONS=50", term_cond_max_episodes=20, max_minutes=2.5)

    assert text == (
        "Ends after 2.5 minutes (--max-minutes), or after 20 iterations "
        "(term_cond_max_episodes; it counts iterations), or with dr-stop-training."
    )
