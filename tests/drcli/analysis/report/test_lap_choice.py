"""Which laps of a training are in the report."""

import numpy as np
import pandas as pd
import pytest

from drcli.analysis.report.lap_choice import choose_laps


def episodes(iterations: int, per_iteration: int = 10, steps: int = 100) -> pd.DataFrame:
    """A training that gets better; the last episode of each iteration is its best one."""
    count = iterations * per_iteration
    number = np.arange(count)
    place = number % per_iteration
    late = number // per_iteration / iterations
    complete = (place == per_iteration - 1) & (late >= 0.5)
    return pd.DataFrame(
        {
            "iteration": number // per_iteration,
            "episode": number,
            "steps": steps,
            "progress": np.where(complete, 100.0, 5.0 + 5.0 * place + 20.0 * late),
            "time": 20.0 - 5.0 * late,
            "complete": complete,
        },
        index=pd.Index(number, name="unique_episode"),
    )


def test_a_short_training_is_there_as_a_whole():
    table = episodes(5)

    chosen = choose_laps(table)

    assert list(chosen.ids) == list(table.index)
    assert chosen.every == 1


def test_fastest_are_full_laps_and_worst_are_of_the_last_fifth():
    table = episodes(20)

    chosen = choose_laps(table)

    assert chosen.fastest == (199, 189, 179, 169, 159)
    assert all(number >= 160 for number in chosen.worst)
    assert chosen.worst[0] == 160


def test_without_full_laps_the_furthest_are_the_best():
    table = episodes(3).assign(complete=False)

    chosen = choose_laps(table)

    assert table.progress[list(chosen.fastest)].min() >= table.progress.sort_values().iloc[-5]


@pytest.mark.parametrize("budget", [60_000, 20_000])
def test_a_long_training_keeps_best_and_worst_of_each_iteration(budget):
    table = episodes(200, steps=200)

    chosen = choose_laps(table, budget)

    kept = table.loc[list(chosen.ids)]
    assert kept.steps.sum() / chosen.every <= 1.05 * budget
    assert kept.iteration.nunique() == 200
    assert set(range(9, 2000, 10)) <= set(chosen.ids)  # the best
    assert set(range(0, 2000, 10)) <= set(chosen.ids)  # the worst
    assert {*chosen.fastest, *chosen.worst} <= set(chosen.ids)
    assert list(chosen.ids) == sorted(chosen.ids)


def test_a_very_long_training_skips_iterations_but_never_the_newest():
    table = episodes(3000, per_iteration=2, steps=200)

    chosen = choose_laps(table, 20_000)

    kept = table.loc[list(chosen.ids)]
    assert kept.steps.sum() / chosen.every <= 1.1 * 20_000
    assert kept.iteration.max() == 2999


def test_nothing_is_chosen_of_nothing():
    chosen = choose_laps(episodes(0))

    assert (chosen.ids, chosen.fastest, chosen.worst) == ((), (), ())
