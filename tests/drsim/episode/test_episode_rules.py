"""Episode rules on numbers: what ends an episode, what is forgiven, and in which order."""

import numpy as np
import pytest

from drsim.episode.episode_rules import EpisodeRules, Episodes, Observed, Status

DRIVEN = np.array([True])


def begun(rules: EpisodeRules | None = None, start: float = 0.0) -> Episodes:
    episodes = Episodes(1, rules or EpisodeRules())
    episodes.begin(np.array([0]), np.array([start]), np.array([(start + 0.008) % 1]))
    return episodes


def judge(
    episodes: Episodes,
    fraction: float,
    moved_m: float = 0.1,
    off_track: bool = False,
    crashed: bool = False,
):
    return episodes.judge(
        Observed(
            driven=DRIVEN,
            fraction=np.array([fraction]),
            moved_m=np.array([moved_m]),
            off_track=np.array([off_track]),
            crashed=np.array([crashed]),
        )
    )


def drive_lap(episodes: Episodes, start: float = 0.0):
    for part in np.arange(0.05, 1.0, 0.05):
        judge(episodes, (start + part) % 1)
    return judge(episodes, (start + 0.001) % 1)


def test_an_episode_begins_with_step_one_and_the_progress_of_the_point_ahead():
    episodes = begun(start=0.995)

    assert episodes.state.steps[0] == 1
    assert episodes.state.progress[0] == pytest.approx(0.8)
    assert not episodes.state.over[0]


def test_leaving_the_track_ends_a_training_episode():
    episodes = begun()

    verdict = judge(episodes, 0.01, off_track=True)

    assert verdict.status[0] == Status.OFF_TRACK
    assert verdict.terminated[0]
    assert not verdict.truncated[0]
    assert episodes.state.over[0]


@pytest.mark.parametrize("start", [0.0, 0.35])
def test_a_lap_ends_a_training_episode_at_exactly_one_hundred(start):
    episodes = begun(start=start)

    verdict = drive_lap(episodes, start)

    assert verdict.status[0] == Status.LAP_COMPLETE
    assert verdict.terminated[0]
    assert episodes.state.progress[0] == 100.0
    assert episodes.state.laps[0] == 1


def test_standing_still_for_fifteen_steps_ends_the_episode_and_not_for_fourteen():
    episodes = begun()

    early = [judge(episodes, 0.01, moved_m=0.0003).status[0] for _ in range(14)]
    verdict = judge(episodes, 0.01, moved_m=0.0003)

    assert set(early) == {Status.IN_PROGRESS}
    assert verdict.status[0] == Status.IMMOBILIZED
    assert verdict.terminated[0]


def test_one_moving_step_restarts_the_patience():
    episodes = begun()

    for moved_m in [0.0] * 14 + [0.0004] + [0.0] * 14:
        verdict = judge(episodes, 0.01, moved_m=moved_m)

    assert verdict.status[0] == Status.IN_PROGRESS


def test_falling_progress_for_fifteen_steps_counts_as_reversed():
    episodes = begun()
    judge(episodes, 0.5)

    statuses = [judge(episodes, 0.5 - 0.01 * k).status[0] for k in range(1, 16)]

    assert statuses == [Status.IN_PROGRESS] * 14 + [Status.REVERSED]


def test_leaving_the_track_takes_precedence_over_driving_backwards():
    episodes = begun()
    judge(episodes, 0.5)
    for k in range(1, 15):
        judge(episodes, 0.5 - 0.01 * k)

    verdict = judge(episodes, 0.3, off_track=True)

    assert verdict.status[0] == Status.OFF_TRACK


def test_the_step_limit_truncates_and_is_called_immobilized():
    episodes = begun(EpisodeRules(max_steps=4))

    verdicts = [judge(episodes, 0.01 * k) for k in (1, 2, 3)]

    assert [v.truncated[0] for v in verdicts] == [False, False, True]
    assert not verdicts[-1].terminated[0]
    assert verdicts[-1].status[0] == Status.IMMOBILIZED
    assert episodes.state.steps[0] == 4


def test_a_lap_in_the_last_allowed_step_terminates_instead():
    episodes = begun(EpisodeRules(max_steps=21))

    verdict = drive_lap(episodes)

    assert episodes.state.steps[0] == 21
    assert verdict.terminated[0]
    assert not verdict.truncated[0]


def test_forgiven_violations_cost_their_penalty_until_the_allowance_is_used():
    episodes = begun(EpisodeRules.evaluation(max_resets=2, off_track_penalty_s=2.0))

    pauses = []
    for _ in range(2):
        verdict = judge(episodes, 0.3, off_track=True)
        pauses.append((bool(verdict.put_back[0]), int(episodes.state.pause_steps[0])))
        episodes.state.pause_steps[0] = 0
    last = judge(episodes, 0.3, off_track=True)

    assert pauses == [(True, 30), (True, 30)]
    assert last.terminated[0]
    assert not last.put_back[0]
    assert episodes.state.resets[0] == 2


def test_waiting_counts_steps_and_lap_time_down_to_zero():
    episodes = begun(EpisodeRules.evaluation(max_resets=2, off_track_penalty_s=0.2))
    judge(episodes, 0.3, off_track=True)

    for _ in range(3):
        episodes.wait(DRIVEN)

    assert episodes.state.pause_steps[0] == 0
    assert episodes.state.steps[0] == 5
    assert episodes.state.lap_steps[0] == 4


def test_patience_restarts_after_a_forgiven_violation():
    episodes = begun(EpisodeRules.evaluation(max_resets=1))
    for _ in range(15):
        verdict = judge(episodes, 0.01, moved_m=0.0)
    after = judge(episodes, 0.01, moved_m=0.0)

    assert verdict.put_back[0]
    assert after.status[0] == Status.IN_PROGRESS


def test_a_continuous_race_counts_laps_and_restarts_progress():
    episodes = begun(EpisodeRules.evaluation(laps=2))

    first = drive_lap(episodes)
    laps = int(episodes.state.laps[0])
    lap_steps = int(episodes.state.lap_steps[0])
    second = judge(episodes, 0.01)
    fresh = (float(episodes.state.progress[0]), int(episodes.state.lap_steps[0]))
    last = drive_lap(episodes)

    assert laps == 1
    assert first.status[0] == Status.IN_PROGRESS
    assert lap_steps == 20
    assert second.status[0] == Status.IN_PROGRESS
    assert fresh == (pytest.approx(1.0), 1)
    assert last.status[0] == Status.LAP_COMPLETE
    assert episodes.state.laps[0] == 2


def test_cars_are_judged_each_by_its_own_counters():
    episodes = Episodes(3, EpisodeRules())
    episodes.begin(np.array([0, 1]), np.zeros(2), np.full(2, 0.01))
    driven = np.array([True, True, False])

    verdict = episodes.judge(
        Observed(
            driven=driven,
            fraction=np.full(3, 0.02),
            moved_m=np.full(3, 0.1),
            off_track=np.array([False, True, True]),
            crashed=np.zeros(3, bool),
        )
    )

    assert verdict.terminated.tolist() == [False, True, False]
    assert episodes.state.over.tolist() == [False, True, True]
    assert episodes.state.steps.tolist() == [2, 2, 0]


def test_statuses_carry_the_words_of_traces():
    assert [status.label for status in Status] == [
        "in_progress",
        "prepare",
        "pause",
        "park",
        "lap_complete",
        "crashed",
        "off_track",
        "immobilized",
        "time_up",
        "reversed",
        "discarded",
    ]


def test_a_car_put_back_across_the_finish_line_finishes_its_lap_by_driving_only():
    episodes = Episodes(1, EpisodeRules.evaluation(laps=2, max_resets=5))
    car = np.array([0])
    episodes.begin(car, np.array([0.0]), np.array([0.01]))
    episodes.state.progress[:] = 99.9

    episodes.put_back(car, np.array([0.002]))
    shown = float(episodes.state.progress[0])
    judge(episodes, 0.003)

    assert shown < 100.0
    assert episodes.state.laps.tolist() == [1]


def test_a_crash_is_named_before_leaving_the_track_and_a_lap_before_both():
    crashed = begun()
    finished = begun()
    for part in np.arange(0.05, 1.0, 0.05):
        judge(finished, part)

    assert judge(crashed, 0.01, off_track=True, crashed=True).status[0] == Status.CRASHED
    assert judge(finished, 0.001, off_track=True, crashed=True).status[0] == Status.LAP_COMPLETE
    assert (crashed.state.crashes[0], finished.state.crashes[0]) == (1, 0)


def test_a_forgiven_crash_costs_the_collision_penalty_and_is_counted():
    episodes = begun(EpisodeRules.evaluation(max_resets=2, collision_penalty_s=3.0))

    verdict = judge(episodes, 0.01, crashed=True)

    assert verdict.put_back[0]
    assert not verdict.terminated[0]
    assert episodes.state.pause_steps[0] == 45
    assert (episodes.state.resets[0], episodes.state.crashes[0]) == (1, 1)


def test_a_lap_that_takes_too_long_ends_the_race_with_its_time_up():
    episodes = begun(EpisodeRules(laps=2, max_resets=9, max_lap_steps=25))
    drive_lap(episodes)  # 20 steps: the time of each lap counts for itself

    verdicts = [judge(episodes, 0.02 * step + 0.001) for step in range(1, 26)]

    assert {int(verdict.status[0]) for verdict in verdicts[:-1]} == {Status.IN_PROGRESS}
    assert verdicts[-1].status[0] == Status.TIME_UP
    assert (verdicts[-1].truncated[0], verdicts[-1].terminated[0]) == (True, False)
    assert episodes.state.over[0]


def test_the_time_of_all_laps_ends_the_race_with_its_time_up_too():
    episodes = begun(EpisodeRules(laps=2, max_resets=9, max_steps=30, max_lap_steps=25))
    drive_lap(episodes)

    verdicts = [judge(episodes, 0.02 * step + 0.001) for step in range(1, 10)]

    assert not any(verdict.truncated[0] for verdict in verdicts[:-1])
    assert verdicts[-1].truncated[0]
    assert verdicts[-1].status[0] == Status.TIME_UP


def test_waiting_for_a_penalty_counts_as_time_of_the_lap():
    rules = EpisodeRules(max_resets=9, off_track_penalty_s=1.0, max_lap_steps=17)
    episodes = begun(rules)
    judge(episodes, 0.01, off_track=True)
    for _ in range(15):
        episodes.wait(DRIVEN)

    verdict = judge(episodes, 0.02)

    assert verdict.status[0] == Status.TIME_UP
