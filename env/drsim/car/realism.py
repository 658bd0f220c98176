"""Sim-to-real extras: noise, delays and other differences of real cars, drawn for each episode.

Everything is off by default. The same seed disturbs an episode in the same way.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Floats, Ints, Seeds, Singles
from drsim.jit import kernel

Frames = NDArray[np.uint8]

_WIDEST_BLUR = 12
"""Most pixels on either side that a blur reaches."""


@dataclass(frozen=True)
class Realism:
    """How far an episode may differ from the nominal car and camera; 0 switches a part off.

    Attributes:
        image_noise: Standard deviation of the noise in every pixel of every frame, greys.
        brightness: Greys are multiplied by 1 +- up to this share, once per episode.
        blur_px: Frames are blurred with a Gaussian of up to this standard deviation, pixels.
        camera_angle_deg: The lens is turned about each of its axes by up to +- this angle.
        camera_shift_m: The lens is moved along each of its axes by up to +- this length.
        latency_s: Every action acts this much later.
        latency_jitter_s: And later still by up to this much, drawn once per episode.
        friction: Grip of the wheels is multiplied by 1 +- up to this share.
        mass: Mass and inertia are multiplied by 1 +- up to this share.
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

    def __post_init__(self) -> None:
        """Raise ValueError for a value that is negative, not finite, or takes all light or grip."""
        for name, value in vars(self).items():
            if not 0.0 <= value < np.inf:
                raise ValueError(f"{name} is {value}; it must be 0 or more.")
        for name in ("brightness", "friction", "mass"):
            if getattr(self, name) >= 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be less than 1.")

    @property
    def spoils_frames(self) -> bool:
        """Frames are changed after they were rendered."""
        return self.image_noise > 0 or self.brightness > 0 or self.blur_px > 0

    @property
    def moves_camera(self) -> bool:
        """The lens is not exactly where it should be."""
        return self.camera_angle_deg > 0 or self.camera_shift_m > 0

    @property
    def changes_car(self) -> bool:
        """Cars drive differently from the calibrated one."""
        return self.friction > 0 or self.mass > 0 or self.longest_latency_s > 0

    @property
    def longest_latency_s(self) -> float:
        """Longest delay of an action, seconds."""
        return self.latency_s + self.latency_jitter_s


class Disturbances:
    """The random differences of the running episodes of n cars.

    Attributes:
        friction: Factor on the grip of the wheels. Shape (n,).
        mass: Factor on mass and inertia. Shape (n,).
        latency_s: How much later actions act, seconds. Shape (n,).
    """

    def __init__(self, num_cars: int, realism: Realism) -> None:
        """Begin with nominal cars and cameras."""
        self.realism = realism
        self.friction: Floats = np.ones(num_cars)
        self.mass: Floats = np.ones(num_cars)
        self.latency_s: Floats = np.zeros(num_cars)
        self._brightness: Floats = np.ones(num_cars)
        self._blur_px: Floats = np.zeros(num_cars)
        self._turn: Floats = np.tile(np.eye(3), (num_cars, 1, 1))
        self._shift_m: Floats = np.zeros((num_cars, 3))
        self._noise_key: Seeds = np.zeros(num_cars, np.uint64)

    def draw(self, car: int, random: np.random.Generator) -> None:
        """Draw for a new episode of a car; the same count of random numbers each time."""
        r = self.realism
        either_way = random.uniform(-1.0, 1.0, 9)
        upwards = random.random(2)
        self.friction[car] = 1.0 + r.friction * either_way[0]
        self.mass[car] = 1.0 + r.mass * either_way[1]
        self._brightness[car] = 1.0 + r.brightness * either_way[2]
        self._turn[car] = _rotation(np.radians(r.camera_angle_deg) * either_way[3:6])
        self._shift_m[car] = r.camera_shift_m * either_way[6:9]
        self.latency_s[car] = r.latency_s + r.latency_jitter_s * upwards[0]
        self._blur_px[car] = r.blur_px * upwards[1]
        self._noise_key[car] = random.integers(2**64, dtype=np.uint64)

    def lenses(self, lens_pos: Floats, lens_mat: Floats) -> tuple[Floats, Floats]:
        """Where the lenses of all cars are, given where they should be; as in `CarBatch`."""
        if not self.realism.moves_camera:
            return lens_pos, lens_mat
        shifted = lens_pos + np.einsum("nij,nj->ni", lens_mat, self._shift_m)
        return shifted, lens_mat @ self._turn

    def next_frames(self, cars: Ints) -> None:
        """Give the next frames of cars new noise. Shape (k,)."""
        self._noise_key[cars] += np.uint64(1)

    def spoil(self, frames: Frames, cars: slice) -> None:
        """Blur, brighten and add noise to frames of some cars in place, without the GIL.

        `frames` are those of all cars. Shape (n, eyes, rows, columns).
        """
        _spoil(
            frames[cars],
            self._brightness[cars],
            self._blur_px[cars],
            self.realism.image_noise,
            self._noise_key[cars],
        )


def _rotation(angles_rad: Floats) -> Floats:
    """Rotation by roll, pitch and yaw about forward, left and up. Shape (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles_rad), np.sin(angles_rad)
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    rotation: Floats = yaw @ pitch @ roll
    return rotation


@kernel
def _spoil(
    frames: Frames,
    brightness: Floats,
    blur_px: Floats,
    noise: float,
    noise_key: Seeds,
) -> None:
    cars, eyes, rows, columns = frames.shape
    picture = np.empty((rows, columns), np.float32)
    for car in range(cars):
        for eye in range(eyes):
            frame = frames[car, eye]
            for row in range(rows):
                for column in range(columns):
                    picture[row, column] = frame[row, column] * brightness[car]
            if blur_px[car] > 0.05:
                _blur(picture, blur_px[car])
            state = noise_key[car] * np.uint64(2) + np.uint64(eye)
            for row in range(rows):
                for column in range(columns):
                    grey = picture[row, column]
                    if noise > 0:
                        state += np.uint64(0x9E3779B97F4A7C15)
                        grey += noise * _normal(state)
                    frame[row, column] = np.uint8(min(max(grey + 0.5, 0.0), 255.0))


@kernel
def _normal(state: int) -> float:
    """A nearly normal number of variance 1: eight bytes of a hash (SplitMix64) summed."""
    mixed = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed ^= mixed >> np.uint64(31)
    total = np.int64(0)
    for byte in range(8):
        total += np.int64((mixed >> np.uint64(8 * byte)) & np.uint64(255))
    return (total - 1020.0) / 209.02153  # mean and deviation of eight even bytes


@kernel
def _blur(picture: Singles, sigma_px: float) -> None:
    """Gaussian blur, rows first, then columns; the edge is repeated outwards."""
    rows, columns = picture.shape
    reach = min(max(int(3.0 * sigma_px + 0.5), 1), _WIDEST_BLUR)
    weights = np.empty(2 * reach + 1, np.float32)
    for k in range(-reach, reach + 1):
        weights[k + reach] = math.exp(-0.5 * (k / sigma_px) ** 2)
    weights /= weights.sum()
    line = np.empty(max(rows, columns), np.float32)
    for row in range(rows):
        line[:columns] = picture[row]
        for column in range(columns):
            total = np.float32(0.0)
            for k in range(-reach, reach + 1):
                total += weights[k + reach] * line[min(max(column + k, 0), columns - 1)]
            picture[row, column] = total
    for column in range(columns):
        line[:rows] = picture[:, column]
        for row in range(rows):
            total = np.float32(0.0)
            for k in range(-reach, reach + 1):
                total += weights[k + reach] * line[min(max(row + k, 0), rows - 1)]
            picture[row, column] = total
