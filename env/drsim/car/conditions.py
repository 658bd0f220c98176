"""The conditions in which one episode differs from the nominal car and camera."""

import math
import zlib
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, cast

import numpy as np

from drsim.arrays import Bools, Bytes, Floats, Ints, Seeds, Singles, Vector
from drsim.errors import require
from drsim.jit import kernel

_FACTORS = ("brightness", "friction", "mass", "battery", "steering_left", "steering_right")
_SHARES = ("glare", "reflections", "gray_overlay")
_NOT_NEGATIVE = ("image_noise", "blur_px", "latency_s")

MOST_TRIM_DEG = 20.0
MOST_FACTOR = 2.0


@dataclass(frozen=True)
class Conditions:
    """What an episode is driven under. The default is the nominal car in the usual light.

    `Realism` draws one for each episode; `Simulation.reset` takes a known one.

    Attributes:
        image_noise: Standard deviation in every pixel, greys.
        brightness: Factor on greys.
        blur_px: Standard deviation of a Gaussian.
        glare: Of a lamp that shines into the lens, 0 .. 1.
        reflections: Of lamps, by the floor, 0 .. 1.
        camera_turn_deg: Roll, pitch, yaw.
        camera_shift_m: Forward, left, up.
        latency_s: Actions act this much later.
        friction: Factor on grip.
        mass: Factor on mass and inertia.
        battery: Factor on speed reached and torque.
        steering_trim_deg: Further to the left than requested.
        steering_left: Factor on angles to the left.
        pattern: Fixes the noise of each pixel, and where lamps are.
        gray_overlay: Whether the car's software lays its gray gradient over the picture.
    """

    image_noise: float = 0.0
    brightness: float = 1.0
    blur_px: float = 0.0
    glare: float = 0.0
    reflections: float = 0.0
    camera_turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    latency_s: float = 0.0
    friction: float = 1.0
    mass: float = 1.0
    battery: float = 1.0
    steering_trim_deg: float = 0.0
    steering_left: float = 1.0
    steering_right: float = 1.0
    pattern: int = 0
    gray_overlay: bool = False

    def __post_init__(self) -> None:
        """Raise ValueError for a value that cannot be."""
        for name, value in vars(self).items():
            if name in _FACTORS:
                most = f"be more than 0 and at most {MOST_FACTOR:g}"
                require(0.0 < value <= MOST_FACTOR, name, value, most)
            elif name in _SHARES:
                require(0.0 <= value <= 1.0, name, value, "be 0 .. 1")
            elif name in _NOT_NEGATIVE:
                require(0.0 <= value < math.inf, name, value, "be 0 or more")
            elif name in ("camera_turn_deg", "camera_shift_m"):
                good = len(value) == 3 and all(math.isfinite(each) for each in value)
                require(good, name, value, "be three finite numbers")
        trim, pattern = self.steering_trim_deg, self.pattern
        most = f"be within {MOST_TRIM_DEG:g} degrees to either side"
        require(abs(trim) <= MOST_TRIM_DEG, "steering_trim_deg", trim, most)
        require(0 <= pattern < 2**64, "pattern", pattern, "be a whole number from 0 to 2**64 - 1")

    @property
    def changes_car(self) -> bool:
        return any(getattr(self, name) != getattr(NOMINAL, name) for name in _OF_CAR)

    def to_dict(self) -> dict[str, Any]:
        every = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: value for name, value in every.items() if value != getattr(NOMINAL, name)}


_OF_CAR = (
    "latency_s",
    "friction",
    "mass",
    "battery",
    "steering_trim_deg",
    "steering_left",
    "steering_right",
)

NOMINAL = Conditions()


_LESS_THAN_1 = ("brightness", "friction", "mass", "battery", "steering_lock")


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
        battery: Share of speed reached and torque.
        steering_lock: Share of the angle reached, drawn for each side.
        glare: Of a lamp that shines into the lens, 0 .. 1.
        reflections: Of lamps, by the floor, 0 .. 1.
        gray_overlay: Share of the episodes in which the car's gray gradient lies over the picture.
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
    gray_overlay: float = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError for a value that cannot be."""
        for name, value in vars(self).items():
            require(0.0 <= value < math.inf, name, value, "be 0 or more")
            require(name not in _LESS_THAN_1 or value < 1.0, name, value, "be less than 1")
            require(name not in _SHARES or value <= 1.0, name, value, "be at most 1")
        trim, most = self.steering_trim_deg, f"be at most {MOST_TRIM_DEG:g}"
        require(trim <= MOST_TRIM_DEG, "steering_trim_deg", trim, most)

    @property
    def longest_latency_s(self) -> float:
        return self.latency_s + self.latency_jitter_s

    def scaled(self, share: float) -> "Realism":
        """With narrower ranges; `latency_s` is not a range, every episode has all of it."""
        parts = {name: share * value for name, value in vars(self).items()}
        return replace(self, **parts | {"latency_s": self.latency_s})

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
            gray_overlay=0 < self.gray_overlay > streams.share("gray overlay", 1.0),
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

    def triple(self, name: str, most: float) -> Vector:
        if most == 0:
            return 0.0, 0.0, 0.0
        drawn: Floats = self._stream(name).uniform(-most, most, 3)
        return cast(Vector, tuple(drawn.tolist()))

    def pattern(self) -> int:
        return int(self._stream("pattern").integers(2**64, dtype=np.uint64))

    def _stream(self, name: str) -> np.random.Generator:
        # Lights and colours have the stream of the same key whose counter begins at 0; the highest
        # word of the counter keeps 2**192 numbers between any two streams.
        counter = np.array([0, 0, 0, zlib.crc32(name.encode())], np.uint64)
        return np.random.Generator(np.random.Philox(key=self._key, counter=counter))


# How cars of one batch differ from each other.


class Variation(NamedTuple):
    """How n cars differ from their parameters, as in `Conditions`; each of shape (n,)."""

    friction: Floats
    mass: Floats
    battery: Floats
    latency_s: Floats
    steering_trim_deg: Floats
    steering_left: Floats
    steering_right: Floats


def no_variation(num_cars: int) -> Variation:
    factors = [np.ones(num_cars) for _ in range(7)]
    return Variation(*factors)._replace(
        latency_s=np.zeros(num_cars), steering_trim_deg=np.zeros(num_cars)
    )


_WIDEST_BLUR = 12
_LEAST_BLUR_PX = 0.05


class Disturbances:
    def __init__(self, num_cars: int) -> None:
        self.variation = no_variation(num_cars)
        self._brightness: Floats = np.ones(num_cars)
        self._blur_px: Floats = np.zeros(num_cars)
        self._image_noise: Floats = np.zeros(num_cars)
        self._turn: Floats = np.tile(np.eye(3), (num_cars, 1, 1))
        self._shift_m: Floats = np.zeros((num_cars, 3))
        self._noise_key: Seeds = np.zeros(num_cars, np.uint64)
        self._spoilt: Bools = np.zeros(num_cars, np.bool_)
        self._overlaid: Bools = np.zeros(num_cars, np.bool_)
        self._moved: Bools = np.zeros(num_cars, np.bool_)

    def begin(self, car: int, conditions: Conditions) -> None:
        c = conditions
        for name, values in self.variation._asdict().items():
            values[car] = getattr(c, name)
        self._brightness[car] = c.brightness
        self._blur_px[car] = c.blur_px
        self._image_noise[car] = c.image_noise
        self._turn[car] = _rotation(np.radians(c.camera_turn_deg))
        self._shift_m[car] = c.camera_shift_m
        self._noise_key[car] = c.pattern
        self._moved[car] = (
            c.camera_turn_deg != NOMINAL.camera_turn_deg
            or c.camera_shift_m != NOMINAL.camera_shift_m
        )
        self._spoilt[car] = c.image_noise > 0 or c.brightness != 1.0 or c.blur_px > _LEAST_BLUR_PX
        self._overlaid[car] = c.gray_overlay

    def lenses(self, lens_pos: Floats, lens_mat: Floats) -> tuple[Floats, Floats]:
        """From nominal lenses to real ones."""
        if not self._moved.any():
            return lens_pos, lens_mat
        return lens_pos + np.einsum("nij,nj->ni", lens_mat, self._shift_m), lens_mat @ self._turn

    def next_frames(self, cars: Ints) -> None:
        self._noise_key[cars] += np.uint64(1)

    def spoils(self, cars: Ints) -> bool:
        return bool((self._spoilt[cars] | self._overlaid[cars]).any())

    def spoil(self, frames: Bytes, cars: slice, *, colors: bool = False) -> None:
        """Blur, brighten and add noise to frames of some cars in place, without the GIL.

        The overlay comes last, as on the car, whose camera knows nothing of it.

        `frames`: of all, eyes or colours, which have the same noise. Shape (n, eyes, rows,
        columns).
        """
        if self._spoilt[cars].any():
            _spoil(
                frames[cars],
                self._brightness[cars],
                self._blur_px[cars],
                self._image_noise[cars],
                self._noise_key[cars],
                0 if colors else 1,
            )
        if self._overlaid[cars].any():
            _overlay(frames[cars], self._overlaid[cars], _OVERLAID)


OVERLAY_GREY = 127.5
OVERLAY_FULL, OVERLAY_ENDS = 0.25, 0.5
"""The gray overlay hides the picture above the first of these shares of its height, and fades away
evenly down to the second. Measured from the picture that sensor_fusion_pkg of the car's community
software blends over its own (pull request 70, June 2026); our own gradient is within half a grey of
it. The car blends before it makes the picture small and grey, which changes a grey by one at most.
"""


def _overlaid_greys(rows: int) -> Bytes:
    """What becomes of each grey in the rows that the overlay reaches. Shape (r, 256)."""
    height = (np.arange(rows) + 0.5) / rows
    weight = np.clip((OVERLAY_ENDS - height) / (OVERLAY_ENDS - OVERLAY_FULL), 0.0, 1.0)
    weight = weight[weight > 0.0, None]
    greys = (1.0 - weight) * np.arange(256) + weight * OVERLAY_GREY
    return np.rint(greys).astype(np.uint8)


_OVERLAID = _overlaid_greys(120)


def draw_gray_overlay(frames: Bytes) -> None:
    """Lay the car's gray gradient over pictures in place. Shape (n, eyes, 120, columns)."""
    _overlay(frames, np.ones(len(frames), np.bool_), _OVERLAID)


def _rotation(angles_rad: Floats) -> Floats:
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles_rad), np.sin(angles_rad)
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return np.asarray(yaw @ pitch @ roll)


@kernel
def _spoil(
    frames: Bytes,
    brightness: Floats,
    blur_px: Floats,
    noise: Floats,
    noise_key: Seeds,
    next_noise: int,
) -> None:
    cars, eyes, rows, columns = frames.shape
    picture = np.empty((rows, columns), np.float32)
    for car in range(cars):
        for eye in range(eyes):
            frame = frames[car, eye]
            for row in range(rows):
                for column in range(columns):
                    picture[row, column] = frame[row, column] * brightness[car]
            if blur_px[car] > _LEAST_BLUR_PX:
                _blur(picture, blur_px[car])
            state = noise_key[car] * np.uint64(2) + np.uint64(eye * next_noise)
            for row in range(rows):
                for column in range(columns):
                    grey = picture[row, column]
                    if noise[car] > 0:
                        state += np.uint64(0x9E3779B97F4A7C15)
                        grey += noise[car] * _normal(state)
                    frame[row, column] = np.uint8(min(max(grey + 0.5, 0.0), 255.0))


@kernel
def _overlay(frames: Bytes, overlaid: Bools, greys: Bytes) -> None:
    for car in range(frames.shape[0]):
        if overlaid[car]:
            for eye in range(frames.shape[1]):
                for row in range(greys.shape[0]):
                    for column in range(frames.shape[3]):
                        frames[car, eye, row, column] = greys[row, frames[car, eye, row, column]]


@kernel
def _normal(state: int) -> float:
    """Nearly normal, of variance 1: eight bytes of a hash (SplitMix64) summed."""
    mixed = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed ^= mixed >> np.uint64(31)
    total = np.int64(0)
    for byte in range(8):
        total += np.int64((mixed >> np.uint64(8 * byte)) & np.uint64(255))
    return (total - 1020.0) / 209.02153  # mean and deviation of eight even bytes


@kernel
def _blur(picture: Singles, sigma_px: float) -> None:
    reach = min(max(int(3.0 * sigma_px + 0.5), 1), _WIDEST_BLUR)
    weights = np.empty(2 * reach + 1, np.float32)
    for k in range(-reach, reach + 1):
        weights[k + reach] = math.exp(-0.5 * (k / sigma_px) ** 2)
    weights /= weights.sum()
    _smear(picture, weights)
    _smear(picture.T, weights)


@kernel
def _smear(picture: Singles, weights: Singles) -> None:
    """Along each row."""
    rows, columns = picture.shape
    reach = len(weights) // 2
    line = np.empty(columns, np.float32)
    for row in range(rows):
        line[:] = picture[row]
        for column in range(columns):
            total = np.float32(0.0)
            for k in range(-reach, reach + 1):
                total += weights[k + reach] * line[min(max(column + k, 0), columns - 1)]
            picture[row, column] = total
