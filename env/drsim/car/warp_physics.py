"""Steps many cars with MuJoCo Warp, on a CUDA GPU. Needs the packages of the extra `gpu`."""

import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from drsim.arrays import Floats, Ints
from drsim.car.conditions import Variation

F = TypeVar("F", bound=Callable[..., Any])

wp.set_module_options({"enable_backward": False})
# Warp would print its version and every module it compiles.
wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)

MOST_CONTACTS = 8
"""Each of four wheels is a capsule with two ends."""

_MODULES = ("smooth", "forward", "constraint", "passive", "derivative")
"""Those that take longest to compile."""

_VARIED = (
    "pair_friction",
    "body_mass",
    "body_inertia",
    "body_subtreemass",
    "body_invweight0",
    "dof_invweight0",
    "actuator_delay",
    "actuator_forcerange",
)
_STATE = ("time", "qpos", "qvel", "act", "qacc_warmstart", "history")
"""In the order of the kernels' arguments."""


class WarpError(Exception):
    """MuJoCo Warp cannot run here. The message is part of a sentence."""


class WarpPhysics:
    """Physics of n cars in CUDA graphs, with numbers of 32 bits.

    On a GPU the same controls give the same motion up to rounding, unless it is `deterministic`.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_cars: int,
        *,
        device: str | None = None,
        deterministic: bool = False,
    ) -> None:
        """Compile what is not in Warp's cache.

        `device` is a name of Warp's, such as `cpu`.

        Raises:
            WarpError: There is no such device, or MuJoCo Warp refuses the model or fails.
        """
        self._orders = {
            "model": model,
            "num_cars": num_cars,
            "device": device,
            "deterministic": deterministic,
        }
        self.model = model
        try:
            self._device = _device(device)
            self.device_name = self._device.name if self._device.is_cuda else "the processor"
            with wp.ScopedDevice(self._device):
                self._build(model, num_cars, deterministic)
        except WarpError:
            raise
        except Exception as error:  # Warp raises plain ones, too
            text = " ".join(str(error).split())
            raise WarpError(
                f"MuJoCo Warp {mjw.__version__} failed: {type(error).__name__}: {text:.200}"
            ) from error

    def __getstate__(self) -> dict[str, Any]:
        return {
            "orders": self._orders,
            "varied": {name: values.copy() for name, values in self._varied.items()},
            "state": {name: getattr(self._data, name).numpy() for name in _STATE},
            "request": self._request.copy(),
            "qpos": self.qpos.copy(),
            "qvel": self.qvel.copy(),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        # The type is ignored because a subclass could take other arguments; there is none.
        self.__init__(**state["orders"])  # type: ignore[misc]
        self._varied = state["varied"]
        self._varied_changed = True
        for name, values in state["state"].items():
            getattr(self._data, name).assign(values)
        self._request[:] = state["request"]
        self.qpos[:], self.qvel[:] = state["qpos"], state["qvel"]

    def vary(self, cars: Ints, variation: Variation) -> None:
        v, model, varied = variation, self.model, self._varied
        mass = v.mass[:, None]
        varied["pair_friction"][cars] = model.pair_friction * v.friction[:, None, None]
        varied["body_mass"][cars] = model.body_mass * mass
        varied["body_inertia"][cars] = model.body_inertia * mass[:, None]
        # What MuJoCo's set_const finds, as mass and inertia of all parts have one factor.
        varied["body_subtreemass"][cars] = model.body_subtreemass * mass
        varied["body_invweight0"][cars] = model.body_invweight0 / mass[:, None]
        varied["dof_invweight0"][cars] = model.dof_invweight0 / mass
        varied["actuator_delay"][cars] = model.actuator_delay + v.latency_s[:, None]
        torque = np.repeat(model.actuator_forcerange[None], len(cars), axis=0)
        torque[:, 2:] *= v.battery[:, None, None]  # the first two motors steer
        varied["actuator_forcerange"][cars] = torque
        self._varied_changed = True

    def place(self, cars: Ints, qpos: Floats) -> None:
        """The GPU is told in the next step."""
        self._placed[cars] = 1.0
        self._new_qpos[cars] = qpos
        # As the GPU has it.
        self.qpos[cars] = self._new_qpos[cars]
        self.qvel[cars] = 0.0

    def step(self, ctrl: Floats, cars: Ints | None, substeps: int) -> None:
        self._ctrl[:] = ctrl
        self._moving[:] = 1.0 if cars is None else 0.0
        if cars is not None:
            self._moving[cars] = 1.0
        with wp.ScopedDevice(self._device):
            if self._varied_changed:
                for name, values in self._varied.items():
                    getattr(self._model, name).assign(values.astype(np.float32))
                self._varied_changed = False
            wp.copy(self._request_there, self._request_here)
            if self._device.is_cuda:
                wp.capture_launch(self._graph(substeps))
            else:
                self._launch(substeps)
            wp.copy(self._motion_here, self._motion_there)
            wp.synchronize_stream()
        self._placed[:] = 0.0
        nq = self.model.nq
        self.qpos[:], self.qvel[:] = self._motion[:, :nq], self._motion[:, nq:]

    def _build(self, model: mujoco.MjModel, num_cars: int, deterministic: bool) -> None:
        on_gpu = self._device.is_cuda
        self._model = mjw.put_model(model)
        self._model.opt.deterministic = deterministic
        # A car that slides at full lock reaches the limit now and then, also in MuJoCo.
        self._model.opt.warn_overflow &= ~int(mjw.OverflowType.LS_ITERATIONS)
        # Each contact of a friction pyramid has two rows for each direction but the first.
        rows = MOST_CONTACTS * 2 * (int(model.pair_dim.max()) - 1)
        self._data = mjw.make_data(model, nworld=num_cars, nconmax=MOST_CONTACTS, njmax=rows)
        self._varied = {
            name: np.repeat(getattr(model, name)[None], num_cars, axis=0) for name in _VARIED
        }
        for name, values in self._varied.items():
            dtype = getattr(self._model, name).dtype
            setattr(self._model, name, wp.array(values.astype(np.float32), dtype=dtype))
        self._varied_changed = False
        self._rest_history = wp.array(mujoco.MjData(model).history, dtype=float)

        self.qpos: Floats = np.zeros((num_cars, model.nq))
        self.qvel: Floats = np.zeros((num_cars, model.nv))
        columns = model.nu + 2 + model.nq
        self._request_there = wp.zeros((num_cars, columns), dtype=float)
        self._request_here = wp.zeros((num_cars, columns), dtype=float, device="cpu", pinned=on_gpu)
        self._request = self._request_here.numpy()
        self._ctrl = self._request[:, : model.nu]
        self._moving, self._placed = self._request[:, model.nu], self._request[:, model.nu + 1]
        self._new_qpos = self._request[:, model.nu + 2 :]
        motion = (num_cars, model.nq + model.nv)
        self._motion_there = wp.zeros(motion, dtype=float)
        self._motion_here = wp.zeros(motion, dtype=float, device="cpu", pinned=on_gpu)
        self._motion = self._motion_here.numpy()
        size = sum(array.size for array in self._state) // num_cars
        self._kept = wp.zeros((num_cars, size), dtype=float)

        self._graphs: dict[int, Any] = {}
        if on_gpu:
            modules = [wp.get_module(f"mujoco_warp._src.{name}") for name in _MODULES]
            wp.force_load(self._device, modules=modules, max_workers=os.cpu_count())
        self._launch(1)  # compiles the rest, and fails here if it does
        if on_gpu:
            self._graph(1)
        self.place(np.arange(num_cars), np.repeat(model.qpos0[None], num_cars, axis=0))

    @property
    def _state(self) -> list[Any]:
        return [getattr(self._data, name) for name in _STATE]

    def _graph(self, substeps: int) -> Any:
        if substeps not in self._graphs:
            with wp.ScopedCapture() as capture:
                self._launch(substeps)
            self._graphs[substeps] = capture.graph
        return self._graphs[substeps]

    def _launch(self, substeps: int) -> None:
        num_cars = len(self._request)
        inputs = [self._request_there, self._rest_history]
        wp.launch(_begin, num_cars, inputs, [self._data.ctrl, *self._state, self._kept])
        for _ in range(substeps):
            mjw.step(self._model, self._data)
        inputs = [self._request_there, self._data.ctrl.shape[1], self._kept]
        wp.launch(_end, num_cars, inputs, [*self._state, self._motion_there])


def _device(name: str | None) -> Any:
    wp.init()
    if name is not None:
        return wp.get_device(name)
    if not wp.is_cuda_available():
        raise WarpError(f"Warp {wp.__version__} finds no CUDA GPU")
    return wp.get_cuda_device()


_kernel = cast(Callable[[F], F], wp.kernel)


@_kernel
def _begin(
    request: wp.array2d[float],
    rest_history: wp.array[float],
    ctrl: wp.array2d[float],
    time: wp.array[float],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    act: wp.array2d[float],
    qacc_warmstart: wp.array2d[float],
    history: wp.array2d[float],
    kept: wp.array2d[float],
) -> None:
    car = wp.tid()
    nu = ctrl.shape[1]
    for i in range(nu):
        ctrl[car, i] = request[car, i]
    if request[car, nu + 1] != 0.0:
        time[car] = 0.0
        for i in range(qpos.shape[1]):
            qpos[car, i] = request[car, nu + 2 + i]
        for i in range(qvel.shape[1]):
            qvel[car, i] = 0.0
            qacc_warmstart[car, i] = 0.0
        for i in range(act.shape[1]):
            act[car, i] = 0.0
        for i in range(history.shape[1]):
            history[car, i] = rest_history[i]
    nq, nv, na = qpos.shape[1], qvel.shape[1], act.shape[1]
    kept[car, 0] = time[car]
    for i in range(nq):
        kept[car, 1 + i] = qpos[car, i]
    for i in range(nv):
        kept[car, 1 + nq + i] = qvel[car, i]
        kept[car, 1 + nq + nv + i] = qacc_warmstart[car, i]
    for i in range(na):
        kept[car, 1 + nq + 2 * nv + i] = act[car, i]
    for i in range(history.shape[1]):
        kept[car, 1 + nq + 2 * nv + na + i] = history[car, i]


@_kernel
def _end(
    request: wp.array2d[float],
    nu: int,
    kept: wp.array2d[float],
    time: wp.array[float],
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    act: wp.array2d[float],
    qacc_warmstart: wp.array2d[float],
    history: wp.array2d[float],
    motion: wp.array2d[float],
) -> None:
    car = wp.tid()
    nq, nv, na = qpos.shape[1], qvel.shape[1], act.shape[1]
    if request[car, nu] == 0.0:
        time[car] = kept[car, 0]
        for i in range(nq):
            qpos[car, i] = kept[car, 1 + i]
        for i in range(nv):
            qvel[car, i] = kept[car, 1 + nq + i]
            qacc_warmstart[car, i] = kept[car, 1 + nq + nv + i]
        for i in range(na):
            act[car, i] = kept[car, 1 + nq + 2 * nv + i]
        for i in range(history.shape[1]):
            history[car, i] = kept[car, 1 + nq + 2 * nv + na + i]
    for i in range(nq):
        motion[car, i] = qpos[car, i]
    for i in range(nv):
        motion[car, nq + i] = qvel[car, i]
