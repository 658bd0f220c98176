"""What the driver hands to the learner: every sensor, every step once, cuts with their rest."""

import logging
from dataclasses import replace

import numpy as np
import pytest
import torch

from drcli.drive import driving
from drcli.drive.driving import Driven, Driver, Plan, Racer, rollout_of
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.compute import driving_format
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.learn.encoders import compute_in
from drcli.learn.policy import Observation, Policy, PolicySpec
from drcli.learn.sac_networks import SACAgent
from drcli.records.trace import STEP_S
from drsim.car.actions import ContinuousActions, DiscreteActions
from drsim.car.car import CONTROL_HZ
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.episode.teacher_features import PRIVILEGED_DIMS
from drsim.race.race import ObstacleRules, Race
from drsim.sensing.sensors import Sensors
from drsim.track.worlds import load_track

COMPACT = "COMPACT_CONVOLUTIONAL_NETWORK"
STRAIGHT = DiscreteActions(((0.0, 1.0), (20.0, 1.0), (-20.0, 1.0)))


def drive(
    spec: PolicySpec,
    *,
    sensors: Sensors | None = None,
    max_steps: int = 12,
    episodes: int = 3,
    epsilon=None,
    seed: int = 5,
) -> list[Driven]:
    """Episodes on two cars with an untrained policy."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    actions = ContinuousActions((-30.0, 30.0), (0.5, 1.0)) if spec.continuous else STRAIGHT
    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=2,
        reward_function=centre_line_reward,
        rules=EpisodeRules(max_steps=max_steps),
        num_threads=1,
        sensors=sensors,
    )
    driven: list[Driven] = []
    plans = [Plan(number, "training", 0.2 * number) for number in range(episodes)]
    Driver(simulation, [Racer(fresh(spec), actions)], seed).drive(
        plans, driven.append, epsilon=epsilon
    )
    simulation.close()
    return sorted(driven, key=lambda episode: episode.number)


def test_every_sensor_is_recorded_once_a_step():
    sensors = Sensors(("STEREO_CAMERAS", "SECTOR_LIDAR"))
    spec = PolicySpec(3, network=COMPACT, eyes=2, stack=3, scan_dims=8, state_dims=PRIVILEGED_DIMS)

    episode = drive(spec, sensors=sensors)[0]

    assert len(episode.samples) == episode.steps
    frames, scans, states, *_ = zip(*episode.samples, strict=True)
    assert {frame.shape for frame in frames} == {(2, 120, 160)}
    assert {scan.shape for scan in scans} == {(8,)}
    assert {state.shape for state in states} == {(PRIVILEGED_DIMS,)}


def test_rows_tell_how_long_the_reward_function_took():
    [episode] = drive(PolicySpec(3, network=COMPACT), episodes=1)
    prepare, *driven = [row.reward_ms for row in episode.rows]

    assert prepare == 0.0
    assert all(0.0 < took_ms < 1000.0 for took_ms in driven)


def test_a_cut_episode_comes_with_what_the_critic_still_expected():
    episodes = drive(PolicySpec(3, network=COMPACT), max_steps=6)

    assert [episode.cut for episode in episodes] == [True] * 3
    assert all(episode.last_value != 0.0 for episode in episodes)


def test_an_episode_that_ends_by_its_rules_has_nothing_left():
    spec = PolicySpec(2, continuous=True, network=COMPACT)

    episodes = drive(spec, max_steps=400)

    assert not any(episode.cut for episode in episodes)
    assert [episode.last_value for episode in episodes] == [0.0] * 3


DEEP = "DEEP_CONVOLUTIONAL_NETWORK"
SHALLOW, DEEPEST = f"{DEEP}_SHALLOW", f"{DEEP}_DEEP"
POLICIES = {
    "discrete": (PolicySpec(3, network=COMPACT), "fp32"),
    "one action, bf16": (PolicySpec(1, network=COMPACT), "bf16"),
    "many actions": (PolicySpec(21, network=SHALLOW), "bf16"),
    "continuous": (PolicySpec(2, continuous=True, network=SHALLOW), "fp32"),
    "stack and lidar": (PolicySpec(3, network=COMPACT, stack=3, scan_dims=8), "bf16"),
    "two cameras": (PolicySpec(3, network=COMPACT, eyes=2, state_dims=PRIVILEGED_DIMS), "fp32"),
    "deep": (PolicySpec(3, network=DEEP), "fp32"),
    "deep, bf16": (PolicySpec(16, network=DEEP, scan_dims=64), "bf16"),
    "deepest": (PolicySpec(3, network=DEEPEST), "fp32"),
    "deepest, bf16": (PolicySpec(3, network=DEEPEST, eyes=2), "bf16"),
    "SAC": (PolicySpec(2, continuous=True, network=COMPACT), "fp32"),
    "SAC, bf16": (PolicySpec(2, True, SHALLOW, state_dims=PRIVILEGED_DIMS), "bf16"),
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", POLICIES)
def test_an_episode_is_the_same_bit_by_bit_beside_any_number_of_cars(name):
    """A lap depends on its start and its seed; so do trainings, whatever the clock lets run."""
    spec, number_format = POLICIES[name]
    policy = fresh(spec, SACAgent if name.startswith("SAC") else ActorCritic)
    compute_in(policy, driving_format(number_format))

    alone, *beside = (beside_others(policy, *batch) for batch in ((1, 1), (3, 1), (8, 2), (20, 2)))

    assert alone["steps"] > 3
    for other in beside:
        for column, values in alone.items():
            np.testing.assert_array_equal(values, other[column], err_msg=column)


def beside_others(policy: Policy, cars: int, threads: int) -> dict[str, object]:
    """All of an episode that begins while others, which soon end, drive in the cars before it."""
    torch.set_num_threads(1)
    spec = policy.spec
    eyes = "STEREO_CAMERAS" if spec.eyes == 2 else "FRONT_FACING_CAMERA"
    lidar = {0: (), 8: ("SECTOR_LIDAR",), 64: ("LIDAR",)}[spec.scan_dims]
    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=cars,
        reward_function=centre_line_reward,
        rules=EpisodeRules(max_steps=7),
        num_threads=threads,
        sensors=Sensors((eyes, *lidar)),
    )
    actions = ContinuousActions((-30.0, 30.0), (0.5, 4.0)) if spec.continuous else STRAIGHT
    if not spec.continuous:
        turns = np.linspace(-25.0, 25.0, spec.num_actions).tolist()
        actions = DiscreteActions(tuple((turn, 1.0) for turn in turns))
    plans = [
        Plan(9 + n, ("training", "evaluation")[n % 2], 0.07 * n, offset_m=0.5, angle_deg=70.0)
        for n in range(cars - 1)
    ]
    plans.append(Plan(0, "training", 0.3))
    plans += [Plan(90 + n, "evaluation", 0.07 * n) for n in range(cars - 1)]
    driven: list[Driven] = []
    driver = Driver(simulation, [Racer(DataParallelPolicy(policy, threads), actions)], seed=5)
    driver.drive(plans, driven.append)
    simulation.close()
    [own] = [episode for episode in driven if episode.number == 0]
    assert cars == 1 or min(episode.steps for episode in driven) < own.steps
    rows = [replace(row, reward_ms=0.0) for row in own.rows]
    return {"rows": rows, "steps": own.steps, **vars(rollout_of([own]))}


Network = ActorCritic | SACAgent


def fresh(spec: PolicySpec, kind: type[Network] = ActorCritic) -> Network:
    """An untrained policy, whose critic expects something."""
    torch.manual_seed(0)
    policy = kind(spec).eval()
    policy.returns.scale.fill_(1.0)
    with torch.no_grad():
        for parameter in policy.parameters():
            if parameter.dim() == 1:
                parameter += 0.02 * torch.randn_like(parameter)
    return policy


def test_blind_actions_follow_the_schedule_of_the_steps_driven():
    asked: list[int] = []

    def epsilon(driven: int) -> float:
        asked.append(driven)
        return 0.0

    episodes = drive(PolicySpec(3, network=COMPACT), max_steps=6, epsilon=epsilon)

    total = sum(episode.steps for episode in episodes)
    assert asked[0] == 0
    assert asked == sorted(asked)
    assert 0 < asked[-1] < total


def test_without_blind_actions_the_likeliest_are_taken_whatever_the_dice():
    spec = PolicySpec(3, network=COMPACT)

    one = drive(spec, max_steps=6, epsilon=lambda _: 0.0, seed=5)
    other = drive(spec, max_steps=6, epsilon=lambda _: 0.0, seed=6)

    assert rollout_of(one).actions.tolist() == rollout_of(other).actions.tolist()


@pytest.mark.parametrize("stack", [1, 4])
def test_what_was_seen_can_be_put_together_again_from_single_frames(stack):
    """The learner stacks frames itself; it must see what the policy saw."""
    spec = PolicySpec(3, network=COMPACT, stack=stack)
    episode = drive(spec, episodes=1)[0]
    model = fresh(spec)
    rollout = rollout_of([episode])
    frames = rollout.frames
    rows = np.arange(len(frames))[:, None] - np.minimum(
        np.arange(stack - 1, -1, -1), np.arange(len(frames))[:, None]
    )

    with torch.inference_mode():
        nothing = torch.empty((len(frames), 0))
        together = torch.from_numpy(frames[rows]).flatten(1, 2)
        value = model(Observation(together, nothing, nothing)).value

    np.testing.assert_allclose(value.numpy(), rollout.values, rtol=1e-4, atol=1e-5)


def test_a_step_of_a_trace_is_one_of_the_simulation():
    assert STEP_S == 1.0 / CONTROL_HZ


def test_a_car_whose_physics_fails_ends_its_episode_and_is_named(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)  # the physics engine writes its own log there
    monkeypatch.setattr(driving, "_logger", logging.getLogger("driving"))
    step = Simulation.step
    steps = 0

    def failing_step(self, steering_deg, speed_mps):
        nonlocal steps
        steps += 1
        if steps == 4:
            self._cars._physics.qpos[1, 0] = np.nan
        return step(self, steering_deg, speed_mps)

    monkeypatch.setattr(Simulation, "step", failing_step)

    with caplog.at_level("WARNING", "driving"):
        driven = drive(PolicySpec(3, network=COMPACT))

    assert [episode.number for episode in driven] == [0, 1, 2]
    assert (driven[1].status, driven[1].steps) == ("off_track", 4)
    assert driven[0].steps > 4
    [record] = caplog.records
    assert record.getMessage().startswith("The physics of training episode 1 failed at step 5")


def test_objects_around_the_car_are_kept_for_those_who_show_them():
    torch.manual_seed(0)
    torch.set_num_threads(1)
    simulation = Simulation(
        load_track("reinvent_base"),
        num_cars=1,
        reward_function=centre_line_reward,
        rules=EpisodeRules(max_steps=4),
        num_threads=1,
        race=Race(obstacles=ObstacleRules(count=2)),
    )
    racers = [Racer(fresh(PolicySpec(3, network=COMPACT)), STRAIGHT)]
    driven: list[Driven] = []

    for keeps in (True, False):
        driver = Driver(simulation, racers, 5, keeps_objects=keeps)
        driver.drive([Plan(0, "evaluation", 0.5)], driven.append)
    simulation.close()

    kept, without = driven
    assert [poses.shape for poses in kept.objects] == [(2, 3)] * len(kept.rows)
    assert without.objects == []
