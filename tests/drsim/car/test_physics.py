"""Which engine moves the cars, and what the log says about it."""

import sys
from types import ModuleType

import mujoco
import numpy as np
import pytest

from drsim.car import physics
from drsim.car.car import CarBatch, car_model


class NoWarp(Exception):
    """As `WarpError`."""


def refuse(*_arguments: object, **_options: object) -> None:
    raise NoWarp("Warp 9 finds no CUDA GPU")


@pytest.fixture
def warp_without_gpu(monkeypatch):
    """MuJoCo Warp is installed, but cannot run."""
    module = ModuleType("drsim.car.warp_physics")
    module.WarpError, module.WarpPhysics = NoWarp, refuse  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "drsim.car.warp_physics", module)
    monkeypatch.setattr(physics.importlib.util, "find_spec", lambda _name: object())


def test_the_usual_physics_is_mujoco():
    assert CarBatch(1, 2).physics == "MuJoCo on 2 threads, as asked for"


def test_auto_takes_mujoco(warp_without_gpu):
    assert CarBatch(300, 1, physics="auto").physics == "MuJoCo on 1 thread, as auto chooses"


def test_without_a_gpu_mujoco_moves_the_cars_and_says_why(warp_without_gpu):
    cars = CarBatch(2, 1, physics="warp")

    cars.drive(np.zeros(2), np.ones(2))

    assert cars.physics == "MuJoCo on 1 thread, because Warp 9 finds no CUDA GPU"
    assert (cars.origin_xy[:, 0] > 0.01).all()


def test_without_the_package_mujoco_moves_the_cars_and_names_it(monkeypatch):
    monkeypatch.setattr(physics.importlib.util, "find_spec", lambda _name: None)

    cars = CarBatch(1, 1, physics="warp")

    assert "because MuJoCo Warp is not installed (no module warp)" in cars.physics


def test_of_a_heavier_car_the_weights_change_that_warp_is_told_of():
    # WarpPhysics.vary scales these by hand, on the strength of this.
    usual, heavy = car_model(), car_model()
    heavy.body_mass[:] *= 1.3
    heavy.body_inertia[:] *= 1.3

    mujoco.mj_setConst(heavy, mujoco.MjData(heavy))

    np.testing.assert_allclose(heavy.body_subtreemass, usual.body_subtreemass * 1.3)
    np.testing.assert_allclose(heavy.body_invweight0, usual.body_invweight0 / 1.3)
    np.testing.assert_allclose(heavy.dof_invweight0, usual.dof_invweight0 / 1.3)
    assert heavy.stat.meaninertia == usual.stat.meaninertia
