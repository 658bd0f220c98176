"""What scripts/bench/fit_car.py finds, and what it refuses."""

import importlib
import sys
from dataclasses import fields, replace
from types import ModuleType

import numpy as np
import pytest

from car_bags import record
from drsim.car.car import CONTROL_HZ, CarBatch
from drsim.car.car_parameters import CarParameters
from drsim.fidelity.recordings import Recording


@pytest.fixture
def bench() -> ModuleType:
    return importlib.import_module("fit_car")


def drive(parameters: CarParameters, episode: int, rows: int = 45) -> Recording:
    """A drive of a car with random requests, from rest."""
    random = np.random.default_rng(episode)
    car = CarBatch(1, 1, parameters)
    actions = random.uniform([-25.0, 1.0], [25.0, 2.0], (rows, 2))
    poses = []
    for steering_deg, speed_mps in actions:
        poses.append([*car.front_xy[0], car.yaw_rad[0]])
        car.drive(np.array([steering_deg]), np.array([speed_mps]))
    ends_s = (np.arange(rows) + 1.0) / CONTROL_HZ
    unknown = np.full(rows, np.nan)
    return Recording(
        episode=episode,
        poses=np.array(poses),
        actions=actions,
        starts_s=ends_s - 1.0 / CONTROL_HZ,
        ends_s=ends_s,
        held=False,
        from_rest=True,
        progress=unknown,
        waypoint=np.full(rows, -1),
        wheels_on=np.full(rows, -1),
        track_length_m=float("nan"),
    )


def test_a_steering_lag_is_found_again_and_the_rest_is_kept(bench):
    recorded = replace(CarParameters(), steering_lag_s=0.2)
    kept = {name: getattr(recorded, name) for name in bench.RANGES if name != "steering_lag_s"}
    drives = [drive(recorded, episode) for episode in range(4)]

    found, evaluations = bench.fit(drives, CarParameters(), kept, minutes=0.03, seed=0)

    assert evaluations > 5
    assert found.steering_lag_s == pytest.approx(0.2, abs=0.01)
    others = [f.name for f in fields(found) if f.name != "steering_lag_s"]
    assert all(getattr(found, name) == getattr(recorded, name) for name in others)


def test_the_delays_of_a_recorded_car_are_kept(bench, tmp_path):
    bag = record(tmp_path / "a", [40.0] * 20, status=[(45.0, 60.0)])
    slow = record(tmp_path / "b", [400.0] * 20)

    assert bench.delays([]) == {}
    assert bench.delays([bag]) == {"steering_delay_s": 0.045, "speed_delay_s": 0.045}
    assert set(bench.delays([slow]).values()) == {0.2}  # the longest that is searched


def test_even_episodes_are_searched_with_and_odd_ones_held_out(bench):
    drives = [drive(CarParameters(), episode, rows=20) for episode in range(4)]
    drives.append(drive(CarParameters(), 6, rows=8))

    some, even, odd = bench.halves(drives)

    assert [each.episode for each in some] == [0, 2]  # short drives are left out
    assert [each.episode for each in even] == [0, 2, 6]
    assert [each.episode for each in odd] == [1, 3]


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["nowhere"], "The folder nowhere does not exist"),
        (["nowhere", "--bag", "nowhere"], "nowhere holds no recording of a car"),
        (["nowhere", "--keep", "grip=1"], "--keep grip=1 must be a name and a number"),
        (["nowhere", "--keep", "friction"], "--keep friction must be a name and a number"),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_a_sentence(
    bench, monkeypatch, capsys, given, sentence
):
    monkeypatch.setattr(sys, "argv", ["fit_car", *given])

    assert bench.main() == 3

    printed = capsys.readouterr()
    assert sentence in printed.err
    assert not printed.out


def test_a_search_begins_at_the_parameters_that_it_is_given(bench):
    start = CarParameters()
    search = bench.Search([drive(start, 0)], start, tuple(bench.RANGES), 0.0, start)

    back = search.parameters(search.point(start))

    # Delays act as at least one physics step; the logarithm of no lag is not a number.
    begun = {name: max(getattr(start, name), low) for name, (low, _) in bench.RANGES.items()}
    assert {name: getattr(back, name) for name in begun} == pytest.approx(begun)
