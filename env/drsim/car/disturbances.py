"""The conditions of running episodes, and what they do to frames."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drsim.arrays import Bools, Floats, Ints, Seeds, Singles
from drsim.car.conditions import NOMINAL, Conditions
from drsim.jit import kernel

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


Frames = NDArray[np.uint8]

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

    def lenses(self, lens_pos: Floats, lens_mat: Floats) -> tuple[Floats, Floats]:
        """From nominal lenses to real ones."""
        if not self._moved.any():
            return lens_pos, lens_mat
        shifted = lens_pos + np.einsum("nij,nj->ni", lens_mat, self._shift_m)
        return shifted, lens_mat @ self._turn

    def next_frames(self, cars: Ints) -> None:
        self._noise_key[cars] += np.uint64(1)

    def spoils(self, cars: Ints) -> bool:
        return bool(self._spoilt[cars].any())

    def spoil(self, frames: Frames, cars: slice) -> None:
        """Blur, brighten and add noise to frames of some cars in place, without the GIL.

        `frames`: of all. Shape (n, eyes, rows, columns).
        """
        if not self._spoilt[cars].any():
            return
        _spoil(
            frames[cars],
            self._brightness[cars],
            self._blur_px[cars],
            self._image_noise[cars],
            self._noise_key[cars],
        )


def _rotation(angles_rad: Floats) -> Floats:
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
    noise: Floats,
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
            if blur_px[car] > _LEAST_BLUR_PX:
                _blur(picture, blur_px[car])
            state = noise_key[car] * np.uint64(2) + np.uint64(eye)
            for row in range(rows):
                for column in range(columns):
                    grey = picture[row, column]
                    if noise[car] > 0:
                        state += np.uint64(0x9E3779B97F4A7C15)
                        grey += noise[car] * _normal(state)
                    frame[row, column] = np.uint8(min(max(grey + 0.5, 0.0), 255.0))


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
