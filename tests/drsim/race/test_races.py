"""Whole episodes with others on the track: crashes, waits, and what is seen of whom."""

import numpy as np
import pytest

from drsim.car.conditions import Realism
from drsim.episode.episode_rules import EpisodeRules, Status, StepResult
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.race.race import BotRules, ObstacleRules, Race
from drsim.sensing.scene import build_scene
from drsim.sensing.sensors import Sensors
from drsim.track.track import Track
from simulations import simulations

AHEAD_M = 0.5
NOSE_M = 0.14
"""Results tell of the point so far ahead of a car's origin."""

WHEELBASE_M = 0.164


def ring(half_width_m: float = 0.5) -> Track:
    """A circular road, driven counter-clockwise; about 12.6 m long."""
    turn = np.linspace(0.0, 2 * np.pi, 90)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    around[-1] = around[0]
    center, inner, outer = (r * around for r in (2.0, 2.0 - half_width_m, 2.0 + half_width_m))
    return Track("ring", center, inner, outer, closed=True)


RING = ring()
LENGTH_M = RING.length_m


@pytest.fixture(scope="module")
def simulate():
    """Build simulations of the ring that share its scene."""
    with simulations(RING) as simulate:
        yield simulate


def box_at(*places: tuple[float, float], **rules) -> Race:
    """Boxes at distances in metres, on lanes as in the settings."""
    positions = tuple((at_m / LENGTH_M, lane) for at_m, lane in places)
    return Race(obstacles=ObstacleRules(positions=positions, **rules))


def one_bot(speed_mps: float = 0.3, **rules) -> Race:
    """A bot on the inner lane, 2 m after waypoint 0, and another one at the end of the lap."""
    return Race(bots=BotRules(count=2, min_gap_m=2.0, speed_mps=speed_mps, **rules))


def begin(simulation: Simulation, start_m: float = 0.0, **options) -> StepResult:
    everybody = np.arange(simulation.num_cars)
    return simulation.reset(everybody, np.full(simulation.num_cars, start_m / LENGTH_M), **options)


def steered(row: StepResult, lane: str = "center", track: Track = RING) -> np.ndarray:
    """Steering of a driver who aims at a point of a lane ahead of each car."""
    yaw_rad = np.radians(row.yaw_deg)
    nose = np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=1) * NOSE_M
    here = np.stack([row.x, row.y], axis=1) - nose
    goal = track.pose_at(track.locate(here).distance_m + AHEAD_M, lane)[:, :2] - here
    bearing_rad = np.arctan2(goal[:, 1], goal[:, 0]) - yaw_rad
    curvature = 2 * np.sin(bearing_rad) / np.hypot(*goal.T)
    return np.degrees(np.arctan(WHEELBASE_M * curvature))


def drive(simulation, row, steps, speed_mps=1.2, lane="center", track=RING):
    """Drive all cars along a lane until no episode runs, so many steps at most; yield every row."""
    running = np.ones(simulation.num_cars, np.bool_)
    speeds = np.broadcast_to(speed_mps, simulation.num_cars).astype(np.float64)
    for _ in range(steps):
        row = simulation.step(steered(row, lane, track), speeds)
        yield row
        running &= ~row.done
        if not running.any():
            return


def statuses(rows, car: int = 0) -> list[Status]:
    return [Status(int(row.status[car])) for row in rows]


@pytest.mark.parametrize("reverse", [False, True])
def test_driving_into_a_box_ends_a_training_episode(simulate, reverse) -> None:
    told = []
    simulation = simulate(
        reward_function=lambda params: told.append(params) or 0.25, race=box_at((3.0, 1))
    )
    row = begin(simulation, reverse=reverse)

    rows = list(drive(simulation, row, 60, track=RING.reversed() if reverse else RING))

    assert statuses(rows)[-1] is Status.CRASHED
    assert set(statuses(rows)[:-1]) == {Status.IN_PROGRESS}
    assert rows[-1].terminated[0]
    assert rows[-1].reward[0] == 0.25
    assert [params["is_crashed"] for params in told] == [False] * (len(rows) - 1) + [True]
    assert told[-1]["closest_objects"] == [0, 0]
    assert told[-1]["is_reversed"] is reverse
    # Half of both rectangles' lengths, less the nose that is located, and one step.
    gap_m = 3.0 - told[-1]["projection_distance"]
    assert 0.15 < gap_m < 0.412 - 0.14 + 0.01


def test_passing_a_box_on_the_other_lane_is_no_crash(simulate) -> None:
    simulation = simulate(race=box_at((3.0, 1)))

    rows = list(drive(simulation, begin(simulation), 60, lane="outer"))

    assert set(statuses(rows)) == {Status.IN_PROGRESS}
    assert rows[-1].progress[0] > 100 * 4.0 / LENGTH_M


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("start_m", [0.0, 8.0])
def test_an_evaluated_car_goes_on_a_metre_behind_the_box_on_the_other_lane(
    simulate, start_m, reverse
) -> None:
    told = []
    rules = EpisodeRules.evaluation(max_resets=5, collision_penalty_s=1.0)
    simulation = simulate(
        reward_function=lambda params: told.append(params) or 1.0,
        race=box_at(((start_m + 3.0) % LENGTH_M, 1)),
        rules=rules,
    )
    track = RING.reversed() if reverse else RING
    crashing = list(drive(simulation, begin(simulation, start_m, reverse=reverse), 55, track=track))
    crash = statuses(crashing).index(Status.CRASHED)

    waiting = crashing[crash + 1 : crash + 16]
    going_on = list(drive(simulation, crashing[-1], 400, lane="outer", track=track))

    assert not crashing[crash].done[0]
    assert crashing[crash].pause_s[0] == 1.0
    assert told[crash]["is_crashed"] is True
    assert told[crash + 1]["is_crashed"] is False
    assert set(statuses(waiting)) == {Status.PAUSE}
    assert statuses(crashing)[crash + 16] is Status.IN_PROGRESS
    where = track.locate(np.array([[waiting[0].x[0], waiting[0].y[0]]]))
    assert where.distance_m[0] == pytest.approx((start_m + 2.14) % LENGTH_M, abs=0.03)
    assert where.from_center_m[0] == pytest.approx(0.25, abs=0.02)
    assert waiting[0].progress[0] == pytest.approx(100 * 2.14 / LENGTH_M, abs=0.3)
    assert statuses(going_on)[-1] is Status.LAP_COMPLETE
    assert (going_on[-1].crashes[0], going_on[-1].resets[0]) == (1, 1)


def test_crashes_beyond_the_allowance_end_an_evaluation(simulate) -> None:
    rules = EpisodeRules.evaluation(max_resets=2, collision_penalty_s=0.2)
    simulation = simulate(race=box_at((2.0, 1)), rules=rules)

    rows = list(drive(simulation, begin(simulation), 300))

    assert statuses(rows).count(Status.CRASHED) == 3
    assert rows[-1].terminated[0]
    assert (rows[-1].crashes[0], rows[-1].resets[0]) == (3, 2)


def test_after_a_crash_into_a_bot_the_car_waits_where_it_is_and_the_bot_drives_on(simulate) -> None:
    rules = EpisodeRules.evaluation(max_resets=3, collision_penalty_s=2.0)
    simulation = simulate(race=one_bot(speed_mps=0.5), rules=rules)
    for crash in drive(simulation, begin(simulation, 0.5), 60, 1.5, lane="inner"):
        if crash.status[0] == Status.CRASHED:
            break
    bot_m = float(simulation.traffic.distance_m[0, 0])

    waiting, frames = [], []
    for row in drive(simulation, crash, 30, 1.5, lane="inner"):
        waiting.append(row)
        frames.append(simulation.observations[0].copy())
    on = list(drive(simulation, row, 3, 0.5, lane="inner"))

    assert crash.status[0] == Status.CRASHED
    assert not crash.done[0]
    assert set(statuses(waiting)) == {Status.PAUSE}
    assert len({(row.x[0], row.y[0]) for row in waiting}) == 1
    assert (row.x[0], row.y[0]) == pytest.approx((crash.x[0], crash.y[0]), abs=0.005)
    # Along the centre line, whose corners shift a place beside it by up to 2 cm.
    assert simulation.traffic.distance_m[0, 0] - bot_m == pytest.approx(33 * 0.5 / 15, abs=0.04)
    assert (frames[-1] != frames[0]).any(), "who waits sees the bot drive away"
    assert set(statuses(on)) == {Status.IN_PROGRESS}


def test_a_slow_car_that_a_bot_runs_into_goes_on(simulate) -> None:
    simulation = simulate(race=one_bot(speed_mps=1.0, penalty_s=1.0))
    first = begin(simulation, 3.1)
    rows, at_m = [], []

    for row in drive(simulation, first, 40, 0.3, lane="inner"):
        rows.append(row)
        at_m.append(simulation.traffic.distance_m[0].copy())

    stands = np.diff(at_m, axis=0) % LENGTH_M < 1e-6
    hit = int(stands[:, 0].argmax())
    assert set(statuses(rows)) == {Status.IN_PROGRESS}
    assert rows[-1].crashes[0] == 0
    assert hit > 0
    assert stands[hit : hit + 15].all(), "all bots wait for a second"
    assert not stands[[hit - 1, hit + 15]].any()


STANDING_BOT = Race(bots=BotRules(count=1, min_gap_m=2.0, speed_mps=0.0))
"""On the inner lane, 2 m after waypoint 0."""


def test_a_bot_ahead_is_seen_and_measured(simulate) -> None:
    sensors = Sensors(("FRONT_FACING_CAMERA", "LIDAR"), lidar_forward=True)
    alone, following = (simulate(sensors=sensors, race=race) for race in (Race(), STANDING_BOT))

    for simulation in (alone, following):
        begin(simulation, 0.98)

    _, columns = np.nonzero(alone.observations[0] != following.observations[0])
    assert 50 < len(columns) < 4000
    assert columns.mean() < 80, "it stands on the left lane of a road that bends to the left"
    assert (alone.scans == 1.0).all()
    # From the scanner to the rear of the bot's cabin, 0.11 m behind its middle.
    yaw_rad = RING.pose_at(np.array([0.98]))[0, 2]
    scanner = RING.pose_at(np.array([0.98]))[0, :2] + 0.029 * np.array(
        [np.cos(yaw_rad), np.sin(yaw_rad)]
    )
    away_m = np.hypot(*(following.traffic.xy[0, 0] - scanner))
    assert following.scans.min() == pytest.approx(away_m - 0.11, abs=0.02)


def test_the_lidar_of_the_reference_measures_what_the_camera_cannot_see(simulate) -> None:
    sensors = Sensors(("FRONT_FACING_CAMERA", "LIDAR"))
    alone, followed = (simulate(sensors=sensors, race=race) for race in (Race(), STANDING_BOT))

    for simulation in (alone, followed):
        begin(simulation, 3.02)

    np.testing.assert_array_equal(alone.observations, followed.observations)
    met = np.flatnonzero(followed.scans[0] < 1.0)
    # Rays go from the left round by the rear; 31 and 32 look straight back. It is to their left.
    assert len(met) > 0
    assert set(met) <= set(range(20, 32))
    assert (alone.scans == 1.0).all()


def racing(simulate, **options) -> Simulation:
    return simulate(2, race=Race(racers=2), **options)


def test_of_two_racers_the_one_behind_is_penalised(simulate) -> None:
    told = []
    simulation = racing(
        simulate, reward_function=lambda params: told.append(params["is_crashed"]) or 1.0
    )
    row = begin(simulation)

    rows = list(drive(simulation, row, 60, [0.4, 1.6]))

    crash = statuses(rows, 1).index(Status.CRASHED)
    assert rows[crash].done.tolist() == [False, True]
    assert statuses(rows, 0)[crash] is Status.IN_PROGRESS
    assert told.count(True) == 1
    assert len(rows) == 60
    assert set(statuses(rows, 0)) == {Status.IN_PROGRESS}
    assert set(statuses(rows, 1)[crash + 1 :]) == {Status.PARK}
    assert rows[-1].crashes.tolist() == [0, 1]


@pytest.mark.parametrize("reverse", [False, True])
def test_a_racer_that_is_done_is_parked_beside_the_road_while_the_other_goes_on(
    simulate, reverse
) -> None:
    track = RING.reversed() if reverse else RING
    simulation = racing(simulate, rules=EpisodeRules.evaluation())
    row = begin(simulation, reverse=reverse)

    rows = list(drive(simulation, row, 400, [2.0, 0.9], track=track))

    first = statuses(rows, 0).index(Status.LAP_COMPLETE)
    last = statuses(rows, 1).index(Status.LAP_COMPLETE)
    assert first < last == len(rows) - 1
    assert rows[first].progress[0] == 100.0
    assert set(statuses(rows, 0)[first + 1 :]) == {Status.PARK}
    parked = np.array([[r.x[0], r.y[0]] for r in rows[first + 1 :]])
    np.testing.assert_array_equal(parked, parked[:1].repeat(len(parked), axis=0))
    assert np.hypot(*parked[0]) > 2.4 + 0.15
    assert rows[-1].crashes.tolist() == [0, 0]


def test_racers_see_and_measure_each_other(simulate) -> None:
    sensors = Sensors(("FRONT_FACING_CAMERA", "SECTOR_LIDAR"), lidar_forward=True)
    alone, following = (racing(simulate, sensors=sensors) for _ in range(2))

    alone.reset(np.array([1]), np.array([0.1]))
    begin(following, 0.1 * LENGTH_M)

    seen = alone.observations[1] != following.observations[1]
    assert seen.sum() > 50
    assert np.nonzero(seen)[1].mean() > 80, "the first one starts ahead on the right"
    assert alone.scans[1].sum() == 0
    on = list(drive(following, begin(following), 8, [0.1, 1.0], lane="center"))
    assert len(on) == 8
    assert following.scans[1].sum() > 0


def test_racers_that_drive_towards_each_other_both_crash(simulate) -> None:
    simulation = racing(simulate)
    row = simulation.reset(np.arange(2), np.array([0.0, 0.8]), reverse=np.array([False, True]))
    tracks = [RING, RING.reversed()]

    for _ in range(60):
        steering = [steered(row, track=track)[k] for k, track in enumerate(tracks)]
        row = simulation.step(np.array(steering), np.ones(2))
        if row.done.any():
            break

    assert row.status.tolist() == [Status.CRASHED, Status.CRASHED]


RACES = {
    "time trial": Race(),
    "boxes": Race(obstacles=ObstacleRules(count=4, randomize=True)),
    "parked cars": box_at((2.0, 1), (5.0, -1), (9.0, 1), kind="bot_car"),
    "bots": Race(bots=BotRules(count=3, speed_mps=0.6, randomize=True, lane_change=True)),
    "racers": Race(racers=2),
}
EXTRAS = Realism(
    image_noise=4.0,
    brightness=0.2,
    blur_px=0.6,
    camera_angle_deg=2.0,
    camera_shift_m=0.005,
    latency_s=0.03,
    latency_jitter_s=0.04,
    friction=0.2,
    mass=0.2,
)
STEPS = 50


def record(simulation: Simulation, steps: int, again=(), watched=slice(None)) -> list[np.ndarray]:
    """All that some cars see and get on a drive with noisy steering.

    Cars begin anew in pairs when one of a pair is done, and those of `again` before every step.
    """
    noise_deg = np.random.default_rng(5).normal(0.0, 12.0, (steps, simulation.num_cars))
    starts = np.repeat(np.linspace(0.0, 0.7, simulation.num_cars // 2), 2)
    row = simulation.reset(np.arange(simulation.num_cars), starts)
    kept = [simulation.frames[watched].copy(), simulation.scans[watched].copy()]
    for noise in noise_deg:
        if len(again):
            simulation.reset(np.array(again), np.full(len(again), 0.3))
        row = simulation.step(steered(row) + noise, np.full(simulation.num_cars, 1.3))
        seen = (simulation.frames, simulation.scans, row.reward, row.x, row.status)
        kept += [values[watched].copy() for values in seen]
        over = np.flatnonzero(row.done.reshape(-1, 2).any(axis=1).repeat(2))
        simulation.reset(over, starts[over])
    return kept


@pytest.mark.nightly
@pytest.mark.parametrize("race", RACES.values(), ids=RACES)
def test_a_drive_is_the_same_bit_by_bit_beside_other_cars_and_on_more_threads(
    simulate, race
) -> None:
    alone, *beside = (
        beside_others(
            simulate(
                num_cars,
                race=race,
                num_threads=num_threads,
                sensors=Sensors(("STEREO_CAMERAS", "LIDAR")),
                realism=EXTRAS,
                randomize="textures",
            ),
            race.racers,
        )
        for num_cars, num_threads in ((race.racers, 1), (4, 1), (20, 2))
    )

    for others in beside:
        for own, same in zip(alone, others, strict=True):
            np.testing.assert_array_equal(own, same)


def beside_others(simulation: Simulation, racers: int, steps: int = 24) -> list[np.ndarray]:
    """All that the cars of the last track see and get, while others drive and begin anew."""
    everybody = np.arange(simulation.num_cars)
    own, others = everybody[-racers:], everybody[:-racers]
    random, noise = np.random.default_rng(len(others)), np.random.default_rng(5)
    wild = random.uniform([-30.0, 0.5], [30.0, 4.0], (steps, len(others), 2))
    seeds = np.append(random.integers(9, 99, len(others)), [3] * racers).astype(np.uint64)
    row = simulation.reset(everybody, seeds % 10 / 10, seeds=seeds)
    kept = []
    for step, actions in enumerate(wild):
        steering_deg = steered(row)[own] + noise.normal(0.0, 12.0, racers)
        mine = np.column_stack([steering_deg, np.full(racers, 1.3)])
        row = simulation.step(*np.concatenate([actions, mine]).T)
        values = [value for name, value in vars(row).items() if name != "reward_time_s"]
        seen = simulation.frames, simulation.scans, simulation.privileged(everybody)
        kept += [value[own].copy() for value in (*seen, *values)]
        if step % 6 == 5:
            cars = everybody if step > steps // 2 else others
            simulation.reset(cars, seeds[cars] % 7 / 7, seeds=seeds[cars])
    return kept


@pytest.mark.parametrize("extras", [{"randomize": "lights"}, {"realism": EXTRAS}, {}])
def test_another_seed_is_another_episode(simulate, extras) -> None:
    race = RACES["boxes"]

    first, same, other = (
        record(simulate(2, race=race, seed=seed, **extras), 1) for seed in (3, 3, 4)
    )

    np.testing.assert_array_equal(first[0], same[0])
    assert (first[0] != other[0]).any()


@pytest.mark.parametrize("name", ["time trial", "boxes", "bots"])
def test_a_new_episode_of_one_car_disturbs_no_other(simulate, name) -> None:
    options = {
        "race": RACES[name],
        "randomize": "lights",
        "realism": EXTRAS,
        "sensors": Sensors(("FRONT_FACING_CAMERA", "LIDAR")),
    }
    others = np.array([0, 1, 3])

    calm = record(simulate(4, **options), 10, watched=others)
    disturbed = record(simulate(4, **options), 10, again=[2], watched=others)

    for one, two in zip(calm, disturbed, strict=True):
        np.testing.assert_array_equal(one, two)


WIDE = ring(half_width_m=1.0)
"""Cars can turn round on it."""


@pytest.fixture(scope="module")
def wide_scene():
    return build_scene(WIDE)


def circle(step: int, row: StepResult) -> np.ndarray:
    return np.full(len(row.x), 30.0)


def straight_on(step: int, row: StepResult) -> np.ndarray:
    return np.zeros(len(row.x))


def turn_round(step: int, row: StepResult) -> np.ndarray:
    return circle(step, row) if step < 15 else steered(row, track=WIDE.reversed())


@pytest.mark.nightly
@pytest.mark.parametrize("race", RACES.values(), ids=RACES)
@pytest.mark.parametrize(
    ("steering", "speed_mps", "end"),
    [
        (circle, 1.4, Status.IMMOBILIZED),
        (straight_on, 0.0, Status.IMMOBILIZED),
        (turn_round, 1.0, Status.REVERSED),
    ],
    ids=["circling", "crawling", "turned round"],
)
def test_no_car_drives_for_ever(wide_scene, race, steering, speed_mps, end) -> None:
    simulation = Simulation(
        WIDE,
        num_cars=2,
        reward_function=centre_line_reward,
        rules=EpisodeRules(max_steps=150),
        scene=wide_scene,
        race=race,
        num_threads=1,
    )
    row = begin(simulation, 1.0)
    ends = {}

    for step in range(150):
        row = simulation.step(steering(step, row), np.full(2, speed_mps))
        ends |= {int(car): Status(int(row.status[car])) for car in np.flatnonzero(row.done)}
    simulation.close()

    assert ends.keys() == {0, 1}
    if race == Race():
        assert set(ends.values()) == {end}
