"""Many MuJoCo cars that turn steering and speed requests into poses."""

import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from drsim.arrays import Bools, Floats, Ints
from drsim.car.car_parameters import MAX_SPEED_MPS, MAX_STEERING_DEG, MIN_SPEED_MPS, CarParameters
from drsim.car.conditions import Variation, no_variation
from drsim.car.physics import MujocoPhysics, PhysicsChoice, choose_physics
from drsim.jit import kernel


@dataclass(frozen=True)
class CameraModel:
    """A front camera. Source of the defaults: the reference simulator.

    Attributes:
        mount_m: In the car's base frame: forward, left, up.
        pitch_rad: Nose down. The car rests 1.39 degrees nose up, so a resting lens looks 13.6
            degrees down.
        field_of_view_rad: Horizontal.
    """

    mount_m: tuple[float, float, float] = (0.145294, 0.0, 0.130326)
    pitch_rad: float = 0.2618
    field_of_view_rad: float = 1.13
    columns: int = 160
    rows: int = 120

    @property
    def focal_px(self) -> float:
        return 0.5 * self.columns / math.tan(0.5 * self.field_of_view_rad)


FRONT = CameraModel()
EYES_APART_M = 0.06
"""Source: the reference simulator."""


CONTROL_HZ = 15
"""Decisions per simulated second: one per camera frame of the reference simulator."""

MODEL_FILE = Path(__file__).parent / "car.xml"

COMMAND_RADIUS_M = 0.035
"""Turns requests into wheel turns. Wheels measure 0.036 m, so a car is 2.9 % faster than asked.
Source: the reference simulator.
"""

WHEEL_RADIUS_M = 0.036
"""Source: the reference simulator."""

REFERENCE_POINT_AHEAD_M = 0.14
"""Where track quantities are measured, ahead of the origin."""

# Places in the frame of base_link, metres. Source: the reference simulator's car description.
_REAR_X, _REAR_Y, _REAR_Z = -0.081663, 0.08105, 0.038999
_FRONT_X, _FRONT_Y, _FRONT_Z = 0.082311, 0.079601, 0.035008

WHEELS_M = np.array(
    [
        [_REAR_X, _REAR_Y, _REAR_Z],
        [_REAR_X, -_REAR_Y, _REAR_Z],
        [_FRONT_X, _FRONT_Y, _FRONT_Z],
        [_FRONT_X, -_FRONT_Y, _FRONT_Z],
    ]
)
"""Forward, left, up of the origin: rear left, rear right, front left, front right."""

WHEELBASE_M = _FRONT_X - _REAR_X
REAR_AXLE_BEHIND_M = REFERENCE_POINT_AHEAD_M - _REAR_X
_SETTLE_STEPS = 30


def car_model(
    parameters: CarParameters | None = None, *, longest_latency_s: float = 0.0
) -> mujoco.MjModel:
    """One car on an endless floor: car.xml with the given parameters."""
    p = parameters or CarParameters()
    spec = mujoco.MjSpec.from_file(str(MODEL_FILE))
    step_s = 1.0 / CONTROL_HZ / p.substeps
    spec.option.timestep = step_s
    for actuator in spec.actuators:
        steers = actuator.name.startswith("steer_")
        # The engine reads a request before it stores it, so no delay is shorter than one step.
        actuator.delay = max(p.steering_delay_s if steers else p.speed_delay_s, step_s)
        actuator.nsample = math.ceil((actuator.delay + longest_latency_s) / step_s) + 2
        if steers:
            actuator.dynprm[0] = p.steering_lag_s
        else:
            actuator.gainprm[0] = p.wheel_damping
            actuator.biasprm[2] = -p.wheel_damping
            torque = p.wheel_torque * p.battery
            actuator.forcerange[:] = -torque, torque
            if p.speed_lag_s > 0.0:
                actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
                actuator.dynprm[0] = p.speed_lag_s
    for pair in spec.pairs:
        pair.friction[:3] = p.friction, p.traction, p.twist_friction_m
        pair.solref[:] = p.tyre_time_s, 1.0
        pair.solimp[:2] = p.tyre_impedance
    return spec.compile()


def motor_commands(
    steering_deg: Floats,
    speed_mps: Floats,
    parameters: CarParameters,
    variation: Variation | None = None,
) -> tuple[Floats, Floats]:
    """Steering in radians and wheel speeds in rad/s for the motors, from clipped requests."""
    p = parameters
    # Not np.clip, which takes three times as long for a few cars.
    angle_deg = np.minimum(np.maximum(steering_deg, -MAX_STEERING_DEG), MAX_STEERING_DEG)
    speed_mps = np.minimum(
        np.maximum(speed_mps, MIN_SPEED_MPS), min(p.max_speed_mps, MAX_SPEED_MPS)
    )
    wheel_rad_s = np.minimum(speed_mps / COMMAND_RADIUS_M * p.speed_scale, p.max_wheel_rad_s)
    wheel_rad_s = wheel_rad_s * p.battery
    left, right = p.steering_left_deg / MAX_STEERING_DEG, p.steering_right_deg / MAX_STEERING_DEG
    if variation is not None:
        v = variation
        wheel_rad_s = wheel_rad_s * v.battery
        factors = np.where(angle_deg > 0.0, left * v.steering_left, right * v.steering_right)
        angle_deg = angle_deg * factors + (p.steering_trim_deg + v.steering_trim_deg)
    elif (left, right, p.steering_trim_deg) != (1.0, 1.0, 0.0):
        angle_deg = angle_deg * np.where(angle_deg > 0.0, left, right) + p.steering_trim_deg
    return np.radians(angle_deg), wheel_rad_s


class CarBatch:
    """Independent cars, stepped together: by MuJoCo on threads, or by MuJoCo Warp on a GPU.

    With MuJoCo the same actions give bit-identical motion on one machine. `place` and `drive`
    refresh the attributes.

    Attributes:
        physics: What steps them and why, for a log.
        origin_xy: Car origins (base_link), metres. Shape (n, 2).
        front_xy: The points 0.14 m ahead of them. Shape (n, 2).
        yaw_rad: Counter-clockwise from world x. Shape (n,).
        wheel_xy: In the order of `WHEELS_M`. Shape (n, 4, 2).
        lens_pos: Metres. Shape (n, 3).
        lens_mat: Columns forward, left, up. Shape (n, 3, 3).
        speed: Of the origin, m/s. Shape (n,).
    """

    def __init__(
        self,
        num_cars: int,
        num_threads: int,
        parameters: CarParameters | None = None,
        *,
        longest_latency_s: float = 0.0,
        physics: PhysicsChoice = "mujoco",
    ) -> None:
        """Build cars that stand at the world's origin.

        Args:
            num_cars: How many.
            num_threads: The caller's included.
            parameters: Default: the calibrated ones.
            longest_latency_s: The largest that `vary` will get.
            physics: Where MuJoCo Warp cannot run, MuJoCo does.
        """
        self._variation: Variation | None = None
        self._parameters = parameters or CarParameters()
        self._longest_latency_s = longest_latency_s
        model = car_model(self._parameters, longest_latency_s=longest_latency_s)
        self._physics, self.physics = choose_physics(physics, model, num_cars, num_threads)
        self._ctrl: Floats = np.zeros((num_cars, model.nu))
        self._rest_height_m, self._rest_pitch_rad = _rest_pose(model)

        self.origin_xy: Floats = np.zeros((num_cars, 2))
        self.front_xy: Floats = np.zeros((num_cars, 2))
        self.yaw_rad: Floats = np.zeros(num_cars)
        self.wheel_xy: Floats = np.zeros((num_cars, 4, 2))
        self.lens_pos: Floats = np.zeros((num_cars, 3))
        self.lens_mat: Floats = np.zeros((num_cars, 3, 3))
        self.speed: Floats = np.zeros(num_cars)
        self._motion = (
            self.origin_xy,
            self.front_xy,
            self.yaw_rad,
            self.wheel_xy,
            self.lens_pos,
            self.lens_mat,
            self.speed,
        )
        self.place(np.arange(num_cars), np.zeros((num_cars, 3)))

    def vary(self, cars: Ints, variation: Variation) -> None:
        """Change cars from their parameters until the next call for them, before `place`.

        Raises:
            ValueError: A latency is longer than `longest_latency_s`.
        """
        v = Variation(*(values[cars] for values in variation))
        longest_s = float(v.latency_s.max(initial=0.0))
        if longest_s > self._longest_latency_s + 1e-9:
            raise ValueError(
                f"A latency of {longest_s:g} s is longer than longest_latency_s, "
                f"{self._longest_latency_s:g} s, for which these cars were built."
            )
        if self._variation is None:
            self._variation = no_variation(len(self.speed))
        for mine, values in zip(self._variation, v, strict=True):
            mine[cars] = values
        self._physics.vary(cars, v)

    def place(self, cars: Ints, poses: Floats) -> None:
        """Put cars on the ground: at rest, wheels straight, no request under way.

        `poses` are x and y of the origins in metres and yaws in radians. Shape (k, 3).
        """
        if not len(cars):
            return
        half_yaw, half_pitch = poses[:, 2] / 2, self._rest_pitch_rad / 2
        qpos = np.zeros((len(cars), self._physics.qpos.shape[1]))
        qpos[:, :2] = poses[:, :2]
        qpos[:, 2] = self._rest_height_m
        qpos[:, 3] = np.cos(half_yaw) * np.cos(half_pitch)
        qpos[:, 4] = -np.sin(half_yaw) * np.sin(half_pitch)
        qpos[:, 5] = np.cos(half_yaw) * np.sin(half_pitch)
        qpos[:, 6] = np.sin(half_yaw) * np.cos(half_pitch)
        self._physics.place(cars, qpos)
        self._refresh()

    def drive(self, steering_deg: Floats, speed_mps: Floats, moving: Bools | None = None) -> None:
        """Let the cars, or those that are `moving`, move for one control step, 1/15 s.

        Left is positive; requests are clipped to +-30 degrees and 0.1 .. 4 m/s: a car cannot stop.
        Shape (n,).
        """
        steering_rad, wheel_rad_s = motor_commands(
            steering_deg, speed_mps, self._parameters, self._variation
        )
        self._ctrl[:, :2] = steering_rad[:, None]
        self._ctrl[:, 2:] = wheel_rad_s[:, None]
        ids = None if moving is None or moving.all() else np.flatnonzero(moving)
        if ids is None or len(ids):
            self._physics.step(self._ctrl, ids, self._parameters.substeps)
        self._refresh()

    def state(self) -> Floats:
        """All that motion depends on, with MuJoCo only."""
        return self._mujoco().state()

    def set_state(self, state: Floats) -> None:
        """Go on from rows of `state`."""
        self._mujoco().set_state(state)
        self._refresh()

    def _mujoco(self) -> MujocoPhysics:
        if not isinstance(self._physics, MujocoPhysics):
            raise TypeError(f"States can only be read of MuJoCo's cars, not of {self.physics}.")
        return self._physics

    @property
    def wheels(self) -> Floats:
        """The front wheels' angle (radians, left) and metres rolled. Shape (n, 2)."""
        model = self._physics.model
        steers, rolls = (
            [model.joint(f"{joint}_{side}").qposadr[0] for side in ("left", "right")]
            for joint in ("steer", "front")
        )
        turned_rad, rolled_rad = self._physics.qpos[:, steers], self._physics.qpos[:, rolls]
        return np.column_stack([turned_rad.mean(axis=1), WHEEL_RADIUS_M * rolled_rad.mean(axis=1)])

    @property
    def velocity(self) -> Floats:
        """Forward and left, m/s, and yaw rate, rad/s. Shape (n, 3)."""
        x, y = self._physics.qvel[:, :2].T
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.column_stack([cos * x + sin * y, cos * y - sin * x, self._physics.qvel[:, 5]])

    def _refresh(self) -> None:
        # Poses come from the state itself: the engine's own derived fields are one substep old.
        _poses_of(
            self._physics.qpos, self._physics.qvel, FRONT.mount_m, FRONT.pitch_rad, self._motion
        )


def _rest_pose(model: mujoco.MjModel) -> tuple[float, float]:
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(_SETTLE_STEPS / CONTROL_HZ / model.opt.timestep))
    return float(data.qpos[2]), 2.0 * math.atan2(float(data.qpos[5]), float(data.qpos[3]))


@kernel
def _poses_of(
    qpos: Floats,
    qvel: Floats,
    mount_m: tuple[float, float, float],
    pitch_rad: float,
    motion: tuple[Floats, ...],
) -> None:
    origin_xy, front_xy, yaw_rad, wheel_xy, lens_pos, lens_mat, speed = motion
    forward_m, _, up_m = mount_m
    cos_pitch, sin_pitch = math.cos(pitch_rad), math.sin(pitch_rad)
    for i in range(qpos.shape[0]):
        at = (qpos[i, 0], qpos[i, 1], qpos[i, 2])
        w, a, b, c = qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6]
        # Columns of the car's rotation matrix.
        forward = (1 - 2 * (b * b + c * c), 2 * (a * b + w * c), 2 * (a * c - w * b))
        left = (2 * (a * b - w * c), 1 - 2 * (a * a + c * c), 2 * (b * c + w * a))
        up = (2 * (a * c + w * b), 2 * (b * c - w * a), 1 - 2 * (a * a + b * b))
        for k in range(2):
            origin_xy[i, k] = at[k]
            # The body's own x axis, pitch and all, as the reference rotates that point.
            front_xy[i, k] = at[k] + forward[k] * REFERENCE_POINT_AHEAD_M
            for wheel in range(4):
                wx, wy, wz = WHEELS_M[wheel, 0], WHEELS_M[wheel, 1], WHEELS_M[wheel, 2]
                wheel_xy[i, wheel, k] = at[k] + forward[k] * wx + left[k] * wy + up[k] * wz
        yaw_rad[i] = math.atan2(forward[1], forward[0])
        for k in range(3):
            lens_pos[i, k] = at[k] + forward[k] * forward_m + up[k] * up_m
            lens_mat[i, k, 0] = forward[k] * cos_pitch - up[k] * sin_pitch
            lens_mat[i, k, 1] = left[k]
            lens_mat[i, k, 2] = forward[k] * sin_pitch + up[k] * cos_pitch
        speed[i] = math.hypot(qvel[i, 0], qvel[i, 1])
