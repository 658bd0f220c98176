"""Chooses what moves the cars: MuJoCo on threads, or MuJoCo Warp on a GPU."""

import importlib.util
from typing import Any, Literal, Protocol

import mujoco
import numpy as np
from mujoco.batch import Batch

from drsim.arrays import Floats, Ints
from drsim.car.conditions import Variation

# Steps many cars with MuJoCo's thread pool.


_VARIED = (
    "pair_friction",
    "body_mass",
    "body_inertia",
    "actuator_delay",
    "actuator_forcerange",
)


class MujocoPhysics:
    """Physics of n cars on processor threads, bit-identical whatever their number."""

    def __init__(self, model: mujoco.MjModel, num_cars: int, num_threads: int) -> None:
        self.model = model
        self._varied = False
        self._build(num_cars, num_threads)

    def __getstate__(self) -> dict[str, Any]:
        """MuJoCo's own batch cannot be copied."""
        arrays = {name: self._batch.expanded(name) for name in _VARIED}
        return {
            "model": self.model,
            "varied": self._varied,
            "num_threads": self._batch.nthread,
            "state": self._batch.state.copy(),
            "arrays": {n: values.copy() for n, values in arrays.items() if values is not None},
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.model, self._varied = state["model"], state["varied"]
        self._build(len(state["state"]), state["num_threads"])
        for name, values in state["arrays"].items():
            self._batch.expand(name)[:] = values
        if state["arrays"]:
            self._batch.set_const()
        self._batch.state[:] = state["state"]

    def _build(self, num_cars: int, num_threads: int) -> None:
        self._batch = Batch(self.model, nsim=num_cars, nthread=num_threads)
        self.qpos: Floats = self._batch.bind("qpos")
        self.qvel: Floats = self._batch.bind("qvel")
        self._ctrl: Floats = self._batch.bind("ctrl")
        self._batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        self._reset_state: Floats = self._batch.state[0].copy()

    def vary(self, cars: Ints, variation: Variation) -> None:
        self._varied = True
        v, batch, model = variation, self._batch, self.model
        torque = np.repeat(model.actuator_forcerange[None], len(cars), axis=0)
        torque[:, 2:] *= v.battery[:, None, None]  # the first two motors steer
        for name, factor, usual, values in (
            ("pair_friction", v.friction, 1.0, model.pair_friction * v.friction[:, None, None]),
            ("body_mass", v.mass, 1.0, model.body_mass * v.mass[:, None]),
            ("body_inertia", v.mass, 1.0, model.body_inertia * v.mass[:, None, None]),
            ("actuator_delay", v.latency_s, 0.0, model.actuator_delay + v.latency_s[:, None]),
            ("actuator_forcerange", v.battery, 1.0, torque),
        ):
            if (factor != usual).any() or batch.expanded(name) is not None:
                batch.expand(name)[cars] = values
        if batch.expanded("body_mass") is not None:
            batch.set_const(cars)

    def place(self, cars: Ints, qpos: Floats) -> None:
        if not self._varied:
            self._batch.state[cars] = self._reset_state
        else:  # a car's own latency is part of its state; ten times as slow
            self._batch.reset(ids=cars, stage=mujoco.mjtStage.mjSTAGE_NONE)
        self.qpos[cars] = qpos

    def state(self) -> Floats:
        return np.asarray(self._batch.state.copy())

    def set_state(self, state: Floats) -> None:
        self._batch.state[:] = state

    def step(self, ctrl: Floats, cars: Ints | None, substeps: int) -> None:
        self._ctrl[:] = ctrl
        self._batch.step(ids=cars, nstep=substeps)


PhysicsChoice = Literal["auto", "mujoco", "warp", "warp-on-cpu"]
"""The last is for tests: many times slower than MuJoCo."""


class Physics(Protocol):
    """What moves n cars of one model; `place` and `step` refresh `qpos` and `qvel`."""

    model: mujoco.MjModel
    qpos: Floats
    """MuJoCo's positions. Shape (n, nq)."""
    qvel: Floats
    """MuJoCo's velocities. Shape (n, nv)."""

    def vary(self, cars: Ints, variation: Variation) -> None:
        """Change cars; `variation` is theirs. Shape (k,)."""

    def place(self, cars: Ints, qpos: Floats) -> None:
        """Put cars at rest, with no request under way; `qpos` of shape (k, nq)."""

    def step(self, ctrl: Floats, cars: Ints | None, substeps: int) -> None:
        """Move some cars, or all, for some physics steps; `ctrl` is that of all, (n, nu)."""


def choose_physics(
    wanted: PhysicsChoice,
    model: mujoco.MjModel,
    num_cars: int,
    num_threads: int,
) -> tuple[Physics, str]:
    """What is wanted, or MuJoCo where Warp cannot run, and a note for a log.

    All cars stand at the origin. The note has neither capital nor full stop.
    """
    if wanted == "mujoco":
        why = "as asked for"
    elif wanted == "auto":
        # On an NVIDIA H200, Warp is faster from about 30 cars for each thread on, but compiling it
        # takes most of a minute, and rewards and policy limited the steps/s before motion did.
        why = "as auto chooses"
    else:
        missing = [n for n in ("warp", "mujoco_warp") if importlib.util.find_spec(n) is None]
        if missing:
            why = f"because MuJoCo Warp is not installed (no module {missing[0]})"
        else:
            from drsim.car.warp_physics import WarpError, WarpPhysics

            try:
                device = "cpu" if wanted == "warp-on-cpu" else None
                warp = WarpPhysics(model, num_cars, device=device)
                return warp, f"MuJoCo Warp on {warp.device_name}"
            except WarpError as error:
                why = f"because {error}"
    threads = f"{num_threads} thread" + "s" * (num_threads != 1)
    return MujocoPhysics(model, num_cars, num_threads), f"MuJoCo on {threads}, {why}"
