"""Sim-to-real extras, each with a random stream of its own: changing one changes no other."""

import math
import zlib
from dataclasses import dataclass
from typing import cast

import numpy as np

from drsim.arrays import Floats
from drsim.car.conditions import MOST_TRIM_DEG, Conditions

_SHARES = ("brightness", "friction", "mass", "battery", "steering_lock")
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Realism:
    """How far an episode may differ from the nominal car and camera; 0 switches a part off.

    Drawn once per episode, both ways; shares are of factors 1 +-.

    Attributes:
        image_noise: Standard deviation in every pixel, greys.
        brightness: Share of greys.
        blur_px: Largest standard deviation of a Gaussian.
        camera_angle_deg: About each axis of the lens.
        camera_shift_m: Along each axis.
        latency_s: Every action acts this much later.
        latency_jitter_s: And later still by up to this much.
        friction: Share of grip.
        mass: Share.
        battery: Share of speed reached and torque.
        steering_lock: Share of the angle reached, drawn for each side.
        glare: Of a lamp that shines into the lens, 0 .. 1.
        reflections: Of lamps, by the floor, 0 .. 1.
    """

    image_noise: float = 0.0
    brightness: float = 0.0
    blur_px: float = 0.0
    camera_angle_deg: float = 0.0
    camera_shift_m: float = 0.0
    latency_s: float = 0.0
    latency_jitter_s: float = 0.0
    friction: float = 0.0
    mass: float = 0.0
    battery: float = 0.0
    steering_trim_deg: float = 0.0
    steering_lock: float = 0.0
    glare: float = 0.0
    reflections: float = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError for a value that cannot be."""
        for name, value in vars(self).items():
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} is {value}; it must be 0 or more.")
        for name in _SHARES:
            if getattr(self, name) >= 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be less than 1.")
        for name in ("glare", "reflections"):
            if getattr(self, name) > 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at most 1.")
        if self.steering_trim_deg > MOST_TRIM_DEG:
            raise ValueError(
                f"steering_trim_deg is {self.steering_trim_deg}; it must be at most "
                f"{MOST_TRIM_DEG:g}."
            )

    @property
    def longest_latency_s(self) -> float:
        return self.latency_s + self.latency_jitter_s

    def draw(self, seed: int, racer: int = 0) -> Conditions:
        """The conditions of the episode with this seed, 0 .. 2**64 - 1, for one of the racers."""
        streams = _Streams(seed, racer)
        return Conditions(
            image_noise=self.image_noise,
            brightness=streams.factor("brightness", self.brightness),
            blur_px=streams.share("blur", self.blur_px),
            glare=streams.share("glare", self.glare),
            reflections=streams.share("reflections", self.reflections),
            camera_turn_deg=streams.triple("camera angle", self.camera_angle_deg),
            camera_shift_m=streams.triple("camera shift", self.camera_shift_m),
            latency_s=self.latency_s + streams.share("latency", self.latency_jitter_s),
            friction=streams.factor("friction", self.friction),
            mass=streams.factor("mass", self.mass),
            battery=streams.factor("battery", self.battery),
            steering_trim_deg=streams.either_way("steering trim", self.steering_trim_deg),
            steering_left=streams.factor("steering left", self.steering_lock),
            steering_right=streams.factor("steering right", self.steering_lock),
            pattern=streams.pattern() if self._has_pattern else 0,
        )

    @property
    def _has_pattern(self) -> bool:
        return self.image_noise > 0 or self.glare > 0 or self.reflections > 0


class _Streams:
    def __init__(self, seed: int, racer: int) -> None:
        self._key = np.array([seed, racer], np.uint64)

    def share(self, name: str, most: float) -> float:
        return most * self._stream(name).random() if most > 0 else 0.0

    def either_way(self, name: str, most: float) -> float:
        return self._stream(name).uniform(-most, most) if most > 0 else 0.0

    def factor(self, name: str, share: float) -> float:
        return 1.0 + self.either_way(name, share)

    def triple(self, name: str, most: float) -> Triple:
        if most == 0:
            return 0.0, 0.0, 0.0
        drawn: Floats = self._stream(name).uniform(-most, most, 3)
        return cast(Triple, tuple(drawn.tolist()))

    def pattern(self) -> int:
        return int(self._stream("pattern").integers(2**64, dtype=np.uint64))

    def _stream(self, name: str) -> np.random.Generator:
        # Lights and colours have the stream of the same key whose counter begins at 0; the highest
        # word of the counter keeps 2**192 numbers between any two streams.
        counter = np.array([0, 0, 0, zlib.crc32(name.encode())], np.uint64)
        return np.random.Generator(np.random.Philox(key=self._key, counter=counter))
