"""Chooses what moves the cars: MuJoCo on threads, or MuJoCo Warp on a GPU."""

import importlib.util
from typing import Literal, NamedTuple, Protocol

import mujoco

from drsim.arrays import Floats, Ints
from drsim.car.mujoco_physics import MujocoPhysics
from drsim.car.variation import Variation

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


class ChosenPhysics(NamedTuple):
    """What moves the cars, and a `note` for a log, without capital and full stop."""

    engine: Physics
    note: str


def choose_physics(
    wanted: PhysicsChoice,
    model: mujoco.MjModel,
    num_cars: int,
    num_threads: int,
) -> ChosenPhysics:
    """What is wanted, or MuJoCo where Warp cannot run; all cars stand at the origin."""
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
                return ChosenPhysics(warp, f"MuJoCo Warp on {warp.device_name}")
            except WarpError as error:
                why = f"because {error}"
    threads = f"{num_threads} thread" + "s" * (num_threads != 1)
    mujoco_physics = MujocoPhysics(model, num_cars, num_threads)
    return ChosenPhysics(mujoco_physics, f"MuJoCo on {threads}, {why}")
