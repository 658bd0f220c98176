"""Fits the car to recorded drives, so that it ends where the recorded car did.

    python scripts/bench fit_car FOLDER [--start SET] [--keep friction=0.6] [--bag BAG]
        [--minutes 5] [--json]

FOLDER holds simtrace CSV files. A Nelder-Mead search varies the parameters of the car, from those
of a named set on, and compares motion as `python -m drsim.replay` does, in the even episodes. The
odd ones are only measured, before and after. What is minimised is the sum of the median errors of
position and heading and a third of the error that nine of ten windows stay below, each as a share
of its value at the start. Parameters are refused with which a drive becomes unstable, and those
with which a standing car carries its camera much higher or lower than at the start.

BAG is a recording (ROS bag) of a physical car, or a folder with some. It has no poses, so it cannot
be FOLDER, but it tells how long after its picture an action acts: steering and speed get that as
their delay, which is then kept.

The last lines are the errors and the `CarParameters`; with --json the last line is one object
`{"parameters", "evaluations", "even", "odd", "odd_at_start"}`.
"""

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from machine import print_json
from scipy.optimize import minimize

from drcli.base.errors import DrError
from drcli.outside.car.car_latency import recorded_latency
from drsim.arrays import Floats
from drsim.car.car import CONTROL_HZ, CarBatch
from drsim.car.car_parameters import CAR_SETS, DEFAULT_CAR, CarParameters
from drsim.fidelity.motion import compare_motion
from drsim.fidelity.recordings import Recording, RecordingError, load_recordings
from drsim.replay import EXIT_SETTINGS, Fidelity, summary

SHORTEST_ROWS = 15
"""Shorter drives hardly have a window of 1 s, but cost as much as longer ones."""

MOST_DRIVES = 160
"""Of the even episodes, spread over the recording: a second or less for one evaluation."""

STEP_S = 1.0 / CONTROL_HZ / CarParameters().substeps

RANGES = {
    "steering_lag_s": (0.02, 1.0),
    "steering_delay_s": (STEP_S, 0.2),
    "speed_delay_s": (STEP_S, 0.2),
    "speed_lag_s": (0.005, 1.0),
    "wheel_damping": (0.003, 0.5),
    "wheel_torque": (0.1, 5.0),
    "friction": (0.1, 2.0),
    "traction": (0.2, 12.0),
    "twist_friction_m": (0.0005, 0.1),
    "tyre_time_s": (2.1 * STEP_S, 0.1),
    "tyre_impedance": (0.05, 0.95),
    "speed_scale": (0.8, 1.2),
}
"""What is searched, within which limits."""

HEIGHT_M = 0.0015
"""By so much the camera may be higher or lower without a penalty."""

FIRST_STEP, NEXT_STEP = 0.25, 0.7
"""Size of the first simplex, as a share of each parameter, and that of each later one relative to
the one before."""

SIMPLEX_EVALUATIONS = 400


@dataclass
class Search:
    """The best parameters so far, and what is needed to judge others."""

    drives: Sequence[Recording]
    start: CarParameters
    names: tuple[str, ...]
    end: float
    best: CarParameters
    best_loss: float = np.inf
    evaluations: int = 0
    unstable: int = 0

    def __post_init__(self) -> None:
        """Judge the start, which others are compared with."""
        self._at_start = _errors(self.drives, self.start)
        self._height_m = _camera_height_m(self.start)

    def loss(self, point: Floats) -> float:
        """How bad parameters are, given as logarithms. Shape (p,)."""
        if time.monotonic() > self.end:
            raise TimeoutError
        parameters = self.parameters(point)
        self.unstable = 0
        shares = _errors(self.drives, parameters) / self._at_start
        beyond_m = abs(_camera_height_m(parameters) - self._height_m) - HEIGHT_M
        loss = float(shares @ (1.0, 1.0, 1 / 3)) + max(0.0, beyond_m / 0.001)
        loss = np.inf if self.unstable or not np.isfinite(loss) else loss
        self.evaluations += 1
        if loss < self.best_loss:
            self.best, self.best_loss = parameters, loss
            _note(f"evaluation {self.evaluations}: loss {loss:.4f}")
        # An infinite corner would make the simplex stop.
        return min(loss, 1e6)

    def parameters(self, point: Floats) -> CarParameters:
        """The parameters at a point, within their ranges."""
        pairs = zip(self.names, np.exp(point), strict=True)
        values = {name: float(np.clip(value, *RANGES[name])) for name, value in pairs}
        return replace(self.start, **values)

    def point(self, parameters: CarParameters) -> Floats:
        """The point of parameters."""
        values = [max(getattr(parameters, name), RANGES[name][0]) for name in self.names]
        return np.log(values)


def fit(
    drives: Sequence[Recording],
    start: CarParameters,
    kept: Mapping[str, float],
    *,
    minutes: float,
    seed: int,
) -> tuple[CarParameters, int]:
    """The parameters that follow the drives best, to four digits, and how many were tried."""
    start = replace(start, **kept)
    names = tuple(name for name in RANGES if name not in kept)
    search = Search(drives, start, names, time.monotonic() + 60.0 * minutes, start)
    mujoco.set_mju_user_warning(lambda _: _count(search))
    random = np.random.default_rng(seed)
    size = FIRST_STEP
    try:
        while True:
            centre = search.point(search.best)
            # The speed is known to a few percent.
            sizes = np.array([size * (0.1 if name == "speed_scale" else 1.0) for name in names])
            corners = centre + np.diag(sizes * random.choice([-1.0, 1.0], len(names)))
            minimize(
                search.loss,
                centre,
                method="Nelder-Mead",
                options={
                    "initial_simplex": np.vstack([centre, corners]),
                    "adaptive": True,
                    "maxfev": SIMPLEX_EVALUATIONS,
                    "xatol": 1e-3,
                    "fatol": 1e-4,
                },
            )
            size *= NEXT_STEP
    except TimeoutError:
        pass
    finally:
        mujoco.set_mju_user_warning(None)
    rounded = {name: float(f"{getattr(search.best, name):.4g}") for name in names}
    return replace(search.best, **rounded), search.evaluations


def _count(search: Search) -> None:
    """Note a warning of the physics: numbers that are not finite."""
    search.unstable += 1


def _errors(drives: Sequence[Recording], parameters: CarParameters) -> Floats:
    """Median metres and degrees, and the metres that nine of ten windows stay below. Shape (3,)."""
    found = summary(compare_motion(drives, parameters))
    return np.array([found[name] for name in ("median_m", "median_yaw_deg", "p90_m")])


def _camera_height_m(parameters: CarParameters) -> float:
    return float(CarBatch(1, 1, parameters).lens_pos[0, 2])


def halves(drives: Sequence[Recording]) -> tuple[list[Recording], list[Recording], list[Recording]]:
    """Drives to search with, all of the even episodes, and all of the odd ones."""
    even = [drive for drive in drives if drive.episode % 2 == 0]
    odd = [drive for drive in drives if drive.episode % 2 == 1]
    long = [drive for drive in even if len(drive.poses) >= SHORTEST_ROWS]
    return long[:: max(1, -(-len(long) // MOST_DRIVES))], even, odd


def _kept(texts: Sequence[str]) -> dict[str, float]:
    kept = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            kept[name] = float(value)
            if name not in RANGES:
                raise ValueError
        except ValueError:
            raise RecordingError(
                f"--keep {text} must be a name and a number, as in friction=0.6. Names: "
                f"{', '.join(RANGES)}."
            ) from None
    return kept


def delays(bags: Sequence[Path]) -> dict[str, float]:
    """What recordings of a physical car say of its delays, within what is searched."""
    if not bags:
        return {}
    found_s = recorded_latency(bags).typical_ms / 1000.0
    names = ("steering_delay_s", "speed_delay_s")
    return {name: float(np.clip(found_s, *RANGES[name])) for name in names}


def main() -> int:
    """Fit and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder with *-iteration.csv files")
    parser.add_argument("--start", choices=CAR_SETS, default=DEFAULT_CAR, help="where to begin")
    parser.add_argument(
        "--keep", action="append", default=[], metavar="NAME=VALUE", help="do not vary this one"
    )
    parser.add_argument(
        "--bag", type=Path, action="append", default=[], help="recording of a physical car"
    )
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    try:
        kept = {**delays(options.bag), **_kept(options.keep)}
        some, even, odd = halves(load_recordings(options.folder).drives)
        start = CAR_SETS[options.start].parameters
        for half in (some, odd):
            if not len(compare_motion(half).driven_m):
                raise RecordingError(
                    f"{options.folder} has too few drives of 1 s: even and odd episodes need some."
                )
        found, evaluations = fit(some, start, kept, minutes=options.minutes, seed=options.seed)
    except (RecordingError, ValueError, DrError) as error:
        _note(str(error))
        return EXIT_SETTINGS
    report = {
        "even": summary(compare_motion(even, found)),
        "odd": summary(compare_motion(odd, found)),
        "odd_at_start": summary(compare_motion(odd, start)),
    }
    if options.json:
        result: dict[str, Any] = {"parameters": asdict(found), "evaluations": evaluations}
        print_json(result | report)
        return 0
    for name, each in report.items():
        print(f"{name:13} {_text(each)}")
    changed = [f for f in fields(found) if getattr(found, f.name) != f.default]
    print(f"CarParameters({', '.join(f'{f.name}={getattr(found, f.name)}' for f in changed)})")
    return 0


def _text(found: Fidelity) -> str:
    return (
        f"{found['median_m']:.3f} m, {found['median_yaw_deg']:.1f} degrees, 9 of 10 within "
        f"{found['p90_m']:.3f} m"
    )


def _note(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
