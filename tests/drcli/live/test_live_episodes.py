"""Laps and rewards as the live view counts them, whether or not somebody watches."""

from dataclasses import replace

import pytest

from drcli.live.live_scene import REMEMBERED, Drive, LiveEpisodes
from drcli.live.step_snapshot import Rider
from drcli.records.trace import STEP_S, Episode, Row
from drsim.track.worlds import load_track

TRACK = load_track("reinvent_base")
DRIVE = Drive("oval", 3, "3_Step-9.ckpt")

ROW = Row(1, 0.0, 0.0, 0.0, 0.0, 1.0, "0", 0.0, False, True, 0.0, 0, "prepare", 0.0, STEP_S)


def rows_of(*progress: float, ends: bool = True) -> list[Row]:
    rows = [
        replace(
            ROW,
            steps=number + 1,
            progress=each,
            reward=float(number),
            time_s=(number + 1) * STEP_S,
            status="lap_complete" if each == 100.0 else "in_progress",
        )
        for number, each in enumerate(progress)
    ]
    if ends:
        rows[-1] = replace(rows[-1], done=True)
    return rows


def rider(rows: list[Row]) -> Rider:
    return Rider(0, 0, 7, "evaluation", TRACK, False, rows, len(rows))


@pytest.mark.parametrize("watched", [False, True])
def test_a_race_of_several_laps_is_told_lap_by_lap(watched):
    episodes = LiveEpisodes()
    progress = (0.0, 50.0, 100.0, 40.0, 100.0, 30.0)
    rows: list[Row] = []
    for row in rows_of(*progress):
        rows.append(row)
        if watched:
            assert episodes.follow(rider(rows), DRIVE) == sum(each.reward for each in rows)

    episodes.end(Episode(7, "evaluation", rows), 0, DRIVE)

    told = episodes.finished
    assert [each.lap for each in told] == [1, 2, 3]
    assert [each.serial for each in told] == [1, 2, 3]
    assert [each.progress for each in told] == [100.0, 100.0, 30.0]
    assert [each.time_s for each in told] == [0.2, 0.133, 0.067]
    assert [each.reward for each in told] == [3.0, 7.0, 5.0]
    assert [each.steps for each in told] == [2, 2, 1]


def test_an_episode_that_ended_is_told_once_if_a_late_viewer_looks_at_it():
    episodes = LiveEpisodes()
    rows = rows_of(0.0, 100.0)

    episodes.end(Episode(7, "evaluation", rows), 0, DRIVE)
    total = episodes.follow(rider(rows), DRIVE)

    assert total == 1.0
    assert len(episodes.finished) == 1


def test_what_was_watched_in_part_is_told_once_although_it_is_counted_later():
    episodes = LiveEpisodes()
    rows = rows_of(0.0, 100.0, 30.0)
    episodes.follow(rider(rows[:2]), DRIVE)
    watched = rows[:2]
    episodes.follow(rider(watched), DRIVE)
    watched.append(rows[2])
    episodes.end(Episode(7, "evaluation", watched), 0, DRIVE)

    episodes.forget()

    assert [each.lap for each in episodes.finished if each.reward == 2.0] == [2]


def test_only_the_newest_are_remembered_and_an_empty_episode_is_none():
    episodes = LiveEpisodes()
    for number in range(REMEMBERED + 5):
        episodes.end(Episode(number, "training", rows_of(0.0, 9.0)), 0, DRIVE)
    episodes.end(Episode(99, "training", []), 0, DRIVE)

    assert [each.episode for each in episodes.finished] == list(range(5, REMEMBERED + 5))


def test_the_reward_is_that_of_the_step_although_the_car_has_driven_on():
    episodes = LiveEpisodes()
    rows = rows_of(0.0, 1.0, 2.0, 3.0, ends=False)

    earlier = replace(rider(rows), steps=2)

    assert episodes.follow(earlier, DRIVE) == 1.0
    assert episodes.follow(rider(rows), DRIVE) == 6.0
