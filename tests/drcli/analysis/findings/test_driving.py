"""What is measured of the driving, on drives that are written out."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from drcli.analysis.findings.action_use import action_use
from drcli.analysis.findings.driven_steps import (
    DrivenSteps,
    discount_horizon,
    driven_steps,
    episode_ends,
)
from drcli.analysis.findings.evidence import learner_health
from drcli.analysis.findings.reward_rate import RewardRate, reward_function_time, reward_rate
from drcli.analysis.findings.steering import snaking, steering_balance, wheels_off
from drcli.learn.algorithms import ALGORITHMS
from drcli.model.files.action_space import ActionSpace
from drsim.track.track import Track

STEPS = 400


def told(**columns: object) -> DrivenSteps:
    """Steps of which only these columns are known."""
    names = ("iteration", "x", "y", "steering_angle", "speed", "action", "reward", "progress")
    unknown = dict.fromkeys((*names, "closest_waypoint", "tstamp", "track_len"), np.nan)
    fixed = {"on_track": True, "episode_status": "in_progress"}
    return driven_steps(pd.DataFrame({**unknown, **fixed, **columns}))


def drive(**columns: object) -> DrivenSteps:
    """Two episodes of a car that goes round a circle of 2 m, counter-clockwise, twice."""
    number = np.arange(STEPS)
    angle = 2 * np.pi * (number % 200) / 200
    base = {
        "unique_episode": number // 200,
        "iteration": 0,
        "x": 2 * np.cos(angle),
        "y": 2 * np.sin(angle),
        "steering_angle": 0.0,
        "speed": 1.0,
        "action": 0,
        "reward": 1.0,
        "on_track": True,
        "progress": (number % 200) / 1.99,
        "closest_waypoint": (number % 200) // 4,
        "tstamp": number / 15,
        "episode_status": "in_progress",
        "track_len": 4 * np.pi,
    }
    return driven_steps(pd.DataFrame({**base, **columns}))


def test_steps_in_which_the_car_stands_are_left_out():
    status = ["prepare", *["in_progress"] * 99, *["pause"] * 100, *["in_progress"] * 200]

    assert len(drive(episode_status=status)) == 299


def test_the_steering_that_a_circle_needs_is_known_from_the_path():
    balance = steering_balance(drive(steering_angle=20.0), None)

    assert balance.left == 1.0
    assert balance.side == "left"
    assert balance.needed_deg == pytest.approx(np.degrees(np.arctan(0.5 * 0.217 * 1.091)), abs=0.3)
    assert balance.surplus_deg == pytest.approx(20.0 - balance.needed_deg)


def circle(*, reverse: bool) -> Track:
    """The circle that `drive` goes round, a waypoint each 0.25 m."""
    angle = 2 * np.pi * np.arange(51) / 50 * (-1 if reverse else 1)
    line = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Track("circle", 2.0 * line, 1.7 * line, 2.3 * line, closed=True)


@pytest.mark.parametrize("renumbered", [True, False])
def test_a_track_that_is_driven_backwards_bends_to_the_other_side(renumbered):
    """The first episode goes round as the track is numbered, the second one against that."""
    number = np.arange(STEPS)
    against = number >= STEPS // 2
    angle = 2 * np.pi * (number % 200) / 200 * np.where(against, -1, 1)
    place = (number % 200) // 4
    waypoint = np.where(against & (not renumbered), -place % 50, place)
    driven = drive(x=2 * np.cos(angle), y=2 * np.sin(angle), closest_waypoint=waypoint)
    forward = steering_balance(driven.where(~against), circle(reverse=False))

    backward = steering_balance(driven.where(against), circle(reverse=False))
    both = steering_balance(driven, circle(reverse=False))

    assert forward.needed_deg == pytest.approx(6.8, abs=0.3)
    assert backward.needed_deg == pytest.approx(-forward.needed_deg, abs=0.1)
    assert both.needed_deg == pytest.approx(0.0, abs=0.1)
    assert (both.needed_left, both.needed_right) == (0.5, 0.5)


def test_an_action_with_a_twentieth_of_the_next_rarer_one_is_dead():
    """Fifteen of 7,408 steps: chance alone may make it twelve or eighteen."""

    def dead(*counts: int) -> tuple[int, ...]:
        number = np.repeat(np.arange(len(counts)), counts)
        zeros = np.zeros(len(number))
        steps = told(unique_episode=zeros, action=number, steering_angle=zeros, speed=zeros)
        return action_use(steps, steps, None).dead

    assert dead(560, 965, 979, 3048, 1841, 15) == (5,)
    assert dead(200, 965, 979, 3408, 1841, 15) == ()
    assert dead(560, 965, 979, 3048, 1806, 50) == ()


def test_a_bend_that_is_cut_in_every_lap_is_told_from_wheels_off_here_and_there():
    """Laps of 20 steps, the later ones of a training; two steps of each are off the track."""
    number = np.arange(STEPS)
    lap = {"unique_episode": number // 20, "progress": (number % 20) / 0.19}
    lap["closest_waypoint"] = number % 20
    late = (number >= 80) & (number < 380)
    always = wheels_off(drive(on_track=number % 20 >= 2, **lap).where(late))
    anywhere = wheels_off(drive(on_track=number % 11 > 0, **lap).where(late))

    assert always.lap_places_share == pytest.approx(0.1)
    assert anywhere.lap_places_share == 0.0
    assert always.complete_share == 1.0


def test_a_swing_is_found_with_its_period_and_size():
    wave = 20.0 * np.sin(2 * np.pi * np.arange(STEPS) / 8 + 0.1)
    found = snaking(drive(steering_angle=wave))

    assert found.regularity == pytest.approx(2.0, abs=0.1)
    assert found.period_s == pytest.approx(8 / 15)
    assert found.amplitude_deg == pytest.approx(20.0, rel=0.1)


def test_chance_is_no_swing():
    angles = np.random.default_rng(1).choice([-30.0, 0.0, 30.0], STEPS)

    assert snaking(drive(steering_angle=angles)).regularity < 0.3


def test_an_action_is_dead_only_if_the_others_are_used():
    space = ActionSpace(((-30.0, 1.0), (0.0, 1.0), (30.0, 1.0), (15.0, 1.0)))
    alike = drive(action=np.arange(STEPS) % 3)
    sharp = drive(action=np.where(np.arange(STEPS) % 100 == 0, 1, 0))

    assert action_use(alike, alike, space).dead == (3,)
    assert action_use(sharp, sharp, space).dead == ()


def test_a_damaged_number_of_an_action_is_not_counted():
    number = np.arange(STEPS) % 3
    number[5] = 10**15  # a table of that size would fill the memory
    steps = drive(action=number)

    found = action_use(steps, steps, None)

    assert len(found.actions) == 3
    assert found.steps == STEPS - 1


def test_actions_vary_if_they_differ_at_the_same_place():
    tenth = (np.arange(STEPS) % 200) // 20
    by_place = drive(action=tenth // 5, closest_waypoint=tenth)
    by_chance = drive(action=np.random.default_rng(2).integers(0, 2, STEPS), closest_waypoint=tenth)
    space = ActionSpace(((-30.0, 1.0), (30.0, 1.0)))

    assert action_use(by_place, by_place, space).variety < 0.2
    assert action_use(by_chance, by_chance, space).variety > 0.8


def test_wheels_off_at_the_end_of_an_episode_are_no_cutting():
    crash = np.arange(STEPS) % 200 >= 192
    bend = (np.arange(STEPS) % 200 >= 50) & (np.arange(STEPS) % 200 < 100)
    short = {"progress": (np.arange(STEPS) % 200) / 2.5}

    assert wheels_off(drive(on_track=~crash, **short)).share == 0.0
    found = wheels_off(drive(on_track=~bend, **short))
    assert found.share == pytest.approx(100 / 376)
    assert found.places_share > 0.9


def test_a_share_of_few_episodes_is_as_sure_as_they_are_alike():
    """Eight episodes of 50 steps, the first of which is a complete lap."""
    number = np.arange(STEPS)
    first = number < 50
    driven = {
        "unique_episode": number // 50,
        "progress": np.where(first, (number % 50) / 0.49, 25.0 + (number % 50)),
    }
    alike, one = (
        wheels_off(drive(on_track=number % 3 > 0, **driven)),
        wheels_off(drive(on_track=~first, **driven)),
    )

    assert alike.share == pytest.approx(0.33, abs=0.02)
    assert alike.sure_share == pytest.approx(alike.share, abs=0.02)
    assert one.share > 0.1
    assert one.sure_share == 0.0
    assert one.lap_share == 1.0
    assert one.sure_lap_share == 0.0


def test_ends_are_counted_where_they_are():
    ends = episode_ends(drive(progress=(np.arange(STEPS) % 200) / 3))

    assert ends.episodes == 2
    assert ends.complete == 0
    assert ends.parts[-1].ends == 2
    assert ends.parts[-1].share == 1.0


def test_a_place_on_the_border_of_two_parts_is_not_cut_in_half():
    """Twenty episodes from waypoint 0 that end on either side of waypoint 50 of 100."""
    number = np.arange(STEPS)
    reached = 48 + (number // 20) % 4
    lap = np.where(number < 20, number * 5 + 4, (number % 20 + 1) * reached // 20)
    ends = episode_ends(
        drive(unique_episode=number // 20, closest_waypoint=lap, progress=1.0 * lap)
    )

    assert max(part.ends for part in ends.parts) < 0.6 * ends.episodes
    assert ends.densest.ends == ends.episodes - 1
    assert ends.densest.passes == ends.episodes


def test_the_horizon_is_told_in_steps_seconds_and_metres():
    horizon = discount_horizon({"discount_factor": 0.95}, 18.0, 1.5)

    assert horizon.steps == pytest.approx(20)
    assert horizon.seconds == pytest.approx(20 / 15)
    assert horizon.metres == pytest.approx(2.0)
    assert horizon.lap_share == pytest.approx(1 / 9)
    assert discount_horizon({"discount_factor": "high"}, 18.0, 1.5) is None
    assert discount_horizon({"discount_factor": 1}, 18.0, None).steps == float("inf")


def test_the_entropy_rises_only_if_it_does_for_long():
    falls, rises = np.linspace(1.6, 0.6, 30), np.linspace(0.6, 1.1, 20)

    def since(values: np.ndarray, *, sac: bool = False) -> int | None:
        return learner_health(
            pd.DataFrame({"entropy": values}), ALGORITHMS["sac" if sac else "clipped_ppo"]
        ).rising_since

    both = np.concatenate([falls, rises])
    assert since(falls) is None
    assert since(both) >= 8
    assert since(both, sac=True) is None


def test_the_time_of_the_reward_function_is_unknown_unless_the_trace_has_it():
    steps = pd.DataFrame({"reward": [1.0, 2.0], "episode_status": "in_progress"})

    assert reward_function_time(steps) is None
    assert reward_function_time(steps.assign(reward_ms=[1.0, 3.0])).p50_ms == 2.0


def test_the_time_of_the_reward_function_counts_calls_only():
    status = ["prepare", "in_progress", "pause", "in_progress", "off_track", "park"]
    steps = pd.DataFrame({"episode_status": status})
    quick = steps.assign(reward_ms=[0.0, 0.0, 0.0, 0.002, 0.004, 0.0])
    old = steps.assign(reward_ms=[np.nan] * 6)
    damaged = steps.assign(reward_ms=["0.0", "x", "0.0", "-1", "2.5", "0.0"])

    found = reward_function_time(quick)
    assert (found.calls, found.p50_ms) == (3, 0.002)
    assert found.total_s == pytest.approx(6e-6)
    assert reward_function_time(old) is None
    assert reward_function_time(damaged).calls == 1


def test_a_reward_that_is_paid_at_slow_places_only_does_not_pay_for_slowness():
    """Each tenth waypoint pays, and there the car is slow; how slow, does not matter."""
    laps, number = 80, np.arange(80 * 200)
    place = number % 200
    paid = place % 10 == 5
    chance = 0.1 * np.random.default_rng(5).standard_normal(len(number))
    steps = told(
        unique_episode=number // 200,
        iteration=number // 200 * 8 // laps,
        closest_waypoint=place,
        speed=np.where(paid, 1.0, 2.0) + chance,
        reward=10.0 * paid,
        progress=place / 1.99,
    )

    rate = reward_rate(steps, steps, pd.DataFrame(), None)

    assert rate.step_power == pytest.approx(0.0, abs=0.2)
    assert not rate.slow_steps_pay


@pytest.mark.parametrize(("lap_power", "pays"), [(1.5, True), (0.1, False), (None, True)])
def test_slow_steps_pay_only_if_laps_do_not_show_the_opposite(lap_power, pays):
    unknown = dict.fromkeys(RewardRate.__dataclass_fields__)
    rate = RewardRate(**{**unknown, "step_power": -0.5, "step_t": -9.0, "complete": True})

    assert replace(rate, lap_power=lap_power, lap_t=lap_power and 9.0).slow_steps_pay == pays


@pytest.mark.parametrize(("t", "pays"), [(3.0, None), (5.0, "slow")])
def test_slow_laps_earn_more_only_as_surely_as_the_advice_asks(t, pays):
    unknown = dict.fromkeys(RewardRate.__dataclass_fields__)

    assert RewardRate(**{**unknown, "lap_power": 0.5, "lap_t": t}).pays == pays


@pytest.mark.parametrize(("power", "t", "pays"), [(1.9, 4.1, False), (1.9, 20.0, True)])
def test_slowness_pays_only_if_it_surely_earns_more_than_each_step_alike(power, t, pays):
    unknown = dict.fromkeys(RewardRate.__dataclass_fields__)
    rate = RewardRate(**{**unknown, "complete": True, "lap_power": power, "lap_t": t})

    assert rate.slowness_pays == pays
    assert not replace(rate, complete=False).slowness_pays
