"""The numbers of a car: what it may be asked for, and the calibrated parameters of its motion."""

import math
from dataclasses import dataclass

MAX_STEERING_DEG = 30.0
MIN_SPEED_MPS = 0.1
MAX_SPEED_MPS = 4.0
"""Requests are clipped to these before they reach the motors. Source: the reference simulator."""

MOST_LOCK_DEG = 60.0
"""Greatest angle that wheels of a car of one's own can be said to turn to."""

_MAY_BE_ZERO = ("steering_lag_s", "steering_delay_s", "speed_delay_s", "speed_lag_s")
_MAY_BE_NEGATIVE = ("steering_trim_deg",)


@dataclass(frozen=True)
class CarParameters:
    """The calibrated numbers of the car; masses and geometry are in car.xml.

    The defaults were found by replaying recorded actions of the reference simulator (release 6,
    continuous actions), every other episode, and comparing where the car ended one second later. On
    the other half of the episodes the median is 0.081 m and 3.9 degrees, after 1.55 m driven.
    """

    steering_lag_s: float = 0.1255
    """Time constant with which the wheels follow a requested angle."""
    steering_delay_s: float = 0.0095
    """Time before a steering request begins to act; never less than one physics step."""
    speed_delay_s: float = 0.0095
    """Time before a speed request begins to act; never less than one physics step."""
    speed_lag_s: float = 0.0
    """Time constant with which the motors follow a requested speed; 0 lets them follow at once."""
    wheel_damping: float = 0.0505
    """Wheel motor torque per speed error, N m s/rad. All four wheels are held at one speed, so in a
    turn this compliance, with the grip, decides how far the car understeers."""
    wheel_torque: float = 1.79
    """Largest torque of a wheel motor, N m."""
    friction: float = 0.9
    """Grip of the wheels across their plane (the reference names 0.5, its engine's mixing is
    unknown)."""
    traction: float = 3.33
    """Grip along it. The recorded car reaches 1.4 m/s in two steps, so its wheels hardly spin."""
    twist_friction_m: float = 0.0151
    """Grip of a wheel against turning on the spot, metres: torque over load."""
    tyre_time_s: float = 0.042
    """Time constant with which a tyre pushed into the floor comes back out, and in which it stops a
    slide; at least twice the physics step."""
    tyre_impedance: float = 0.479
    """How far a tyre gets its way against the load, 0 .. 1: small is soft. Together with the time
    it decides how deep a standing car sinks in (2.4 mm, which car.xml makes up for) and how far
    wheels creep under load."""
    speed_scale: float = 0.998
    """Factor on requested wheel speeds."""
    max_wheel_rad_s: float = 100.0
    """Ceiling of the wheel joints: 4 m/s asks for 114 rad/s, so about 3.6 m/s is the fastest."""
    substeps: int = 7
    """Physics steps in one control step, 9.5 ms each. With 20, errors are 2 mm smaller."""
    steering_left_deg: float = MAX_STEERING_DEG
    """Where the wheels of this car stand when the greatest angle to the left is requested; smaller
    requests are scaled with it."""
    steering_right_deg: float = MAX_STEERING_DEG
    """The same to the right."""
    steering_trim_deg: float = 0.0
    """Where the wheels stand when they should stand straight, left positive."""
    battery: float = 1.0
    """Motor strength: factor on the wheel speed that a request reaches, and on the torque."""
    max_speed_mps: float = MAX_SPEED_MPS
    """Requests for a higher speed count as requests for this one."""

    def __post_init__(self) -> None:
        """Raise ValueError for a number that no car can have."""
        for name, value in vars(self).items():
            if name in _MAY_BE_NEGATIVE:
                continue
            if not 0.0 <= value < math.inf or (value == 0.0 and name not in _MAY_BE_ZERO):
                least = "0 or more" if name in _MAY_BE_ZERO else "more than 0"
                raise ValueError(f"{name} is {value}; it must be {least}.")
        for name in ("steering_left_deg", "steering_right_deg", "steering_trim_deg"):
            value = getattr(self, name)
            if not abs(value) <= MOST_LOCK_DEG:
                raise ValueError(f"{name} is {value}; it must be at most {MOST_LOCK_DEG:g}.")
        if self.max_speed_mps <= MIN_SPEED_MPS:
            raise ValueError(
                f"max_speed_mps is {self.max_speed_mps}; it must be more than {MIN_SPEED_MPS}, the "
                "least speed of a car."
            )
        if self.tyre_impedance >= 1.0:
            raise ValueError(f"tyre_impedance is {self.tyre_impedance}; it must be less than 1.")
        if self.substeps != int(self.substeps):
            raise ValueError(f"substeps is {self.substeps}; it must be a whole number.")
