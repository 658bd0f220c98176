"""Speed of MuJoCo and MuJoCo Warp moving cars, and how far apart they bring them.

    python scripts/bench physics [--cars 1 16 64 256 1024 4096] [--device NAME] [--json]
    python scripts/bench physics --check [--device NAME] [--recordings FOLDER]

A control step is 1/15 s of one car. All cars get new random actions in every step, and every car is
put back to its start once in 75 steps, as episodes do. Times include the copies to and from the
GPU. Besides this and `env` it needs numpy, numba, mujoco, gymnasium, warp and mujoco_warp. With
--json the last line of stdout is one object with

    processor, threads, device   what MuJoCo and Warp ran on; device is null where Warp cannot run
    warp_build_s                 time until Warp was ready: compiled, or read from its cache
    steps                        for each number of cars: control steps/s of all cars together by
                                 `mujoco`, `warp` and `warp_deterministic`, null where left out
    parity                       of --check: how far both bring the cars apart in a second
    fidelity                     of --check --recordings: medians of both against a recorded car

--check exits with 1 where they are further apart than the limits of tests/drsim/car.
"""

import argparse
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drsim.car.car import CarBatch, car_model
from drsim.car.physics import MujocoPhysics, Physics

LEAST, MOST = (-30.0, 0.5), (30.0, 4.0)
"""Random actions: degrees and m/s."""

EPISODE_STEPS = 75
SUBSTEPS = 7

FURTHEST_M, FURTHEST_DEG = 0.005, 0.1
"""Limits of --check after a second, of each car."""

FIDELITY_SHARE = 0.1
"""How far Warp's errors against recorded cars may differ from MuJoCo's."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cars", type=int, nargs="+", default=[1, 16, 64, 256, 1024, 4096])
    parser.add_argument("--threads", type=int, default=_cores(), help="threads of MuJoCo")
    parser.add_argument("--seconds", type=float, default=2.0, help="least time of a measurement")
    parser.add_argument("--device", help="Warp's name of a device, such as cpu; default: a GPU")
    parser.add_argument("--deterministic", action="store_true", help="measure this mode of it, too")
    parser.add_argument("--check", action="store_true", help="compare motion instead of speed")
    parser.add_argument("--recordings", type=Path, help="folder of simtraces, for --check")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()

    figures: dict[str, Any] = {"processor": _processor(), "threads": options.threads}
    figures |= {"device": None, "warp_build_s": None}
    began_s = time.perf_counter()
    warp = _warp(1, options.device)
    if warp is not None:
        figures["device"] = warp.device_name
        figures["warp_build_s"] = round(time.perf_counter() - began_s, 1)
        _say(f"Warp on {warp.device_name} was ready after {figures['warp_build_s']} s")
    _say(f"MuJoCo on {options.threads} threads of {figures['processor']}")
    passed = True
    if options.check:
        passed = _check(options, figures)
    else:
        figures["steps"] = {n: _speeds(n, options, figures["device"]) for n in options.cars}
    if options.json:
        print(json.dumps(figures), flush=True)
    sys.exit(0 if passed else 1)


def _speeds(num_cars: int, options: argparse.Namespace, device: str | None) -> dict[str, Any]:
    """Control steps/s of all cars together by each engine; null where it cannot run."""
    engines: dict[str, Physics | None] = {
        "mujoco": MujocoPhysics(car_model(), num_cars, options.threads),
        "warp": _warp(num_cars, options.device) if device else None,
    }
    if options.deterministic and device:
        engines["warp_deterministic"] = _warp(num_cars, options.device, deterministic=True)
    found: dict[str, Any] = {}
    for name, engine in engines.items():
        found[name] = None if engine is None else round(_speed(engine, options.seconds), 1)
        shown = "-" if engine is None else f"{found[name]:,.0f}"
        _say(f"{num_cars:5} cars  {name:20} {shown:>12} control steps/s")
    return found


def _speed(engine: Physics, least_s: float) -> float:
    """Control steps/s of all cars together: the median of rounds after one that warms up."""
    num_cars, at_start = len(engine.qpos), engine.qpos.copy()
    random = np.random.default_rng(0)
    requests = random.uniform(LEAST, MOST, (EPISODE_STEPS, num_cars, 2))
    ctrl = np.repeat(requests, [2, 4], axis=2)
    ctrl[:, :, :2] = np.radians(ctrl[:, :, :2])
    ctrl[:, :, 2:] /= 0.035
    due = np.arange(num_cars) % EPISODE_STEPS
    rates: list[float] = []
    measured_s = 0.0
    step = 0
    engine.step(ctrl[0], None, SUBSTEPS)  # compiles
    while measured_s < least_s or len(rates) < 4:
        began_s = time.perf_counter()
        steps = 0
        while steps < 5 or time.perf_counter() - began_s < least_s / 8:
            cars = np.flatnonzero(due == step % EPISODE_STEPS)
            if len(cars):
                engine.place(cars, at_start[cars])
            engine.step(ctrl[step % EPISODE_STEPS], None, SUBSTEPS)
            step += 1
            steps += 1
        took_s = time.perf_counter() - began_s
        measured_s += took_s
        rates.append(num_cars * steps / took_s)
    return statistics.median(rates[1:])


def _check(options: argparse.Namespace, figures: dict[str, Any]) -> bool:
    """Compare motion of both; whether it is within the limits."""
    if figures["device"] is None:
        return False
    apart = figures["parity"] = parity(16, _choice(options.device))
    _say("  ".join(f"{name} {value:.6f}" for name, value in apart.items()))
    passed = apart["furthest_m"] < FURTHEST_M and apart["furthest_deg"] < FURTHEST_DEG
    if options.recordings is not None:
        from drsim.fidelity.motion import compare_motion
        from drsim.fidelity.recordings import RecordingError, load_recordings

        try:
            drives = load_recordings(options.recordings).drives
        except RecordingError as error:
            sys.exit(str(error))
        figures["fidelity"] = {}
        for physics in ("mujoco", _choice(options.device)):
            windows = compare_motion(drives, physics=physics)
            errors = {
                "median_m": float(np.median(windows.position_m)),
                "median_yaw_deg": float(np.median(windows.yaw_deg)),
                "windows": len(windows.position_m),
            }
            figures["fidelity"][physics] = errors
            _say(f"{physics:12} {errors}")
        usual, ours = figures["fidelity"].values()
        for name in ("median_m", "median_yaw_deg"):
            passed &= abs(ours[name] - usual[name]) <= FIDELITY_SHARE * usual[name]
    return passed


def parity(num_cars: int, physics: Any, steps: int = 15) -> dict[str, float]:
    """How far apart the same actions bring cars by MuJoCo and by `physics`, of `num_cars` cars.

    Half of them get new random actions in every step, half keep one, sliding where it is fast.
    """
    random = np.random.default_rng(0)
    poses = random.uniform([-20.0, -20.0, -3.0], [20.0, 20.0, 3.0], (num_cars, 3))
    cars = [CarBatch(num_cars, 1), CarBatch(num_cars, 1, physics=physics)]
    for each in cars:
        each.place(np.arange(num_cars), poses)
    action = random.uniform(LEAST, MOST, (num_cars, 2))
    for _ in range(steps):
        action[::2] = random.uniform(LEAST, MOST, (len(action[::2]), 2))
        for each in cars:
            each.drive(*action.T)
    usual, ours = cars
    apart_m = np.hypot(*(usual.front_xy - ours.front_xy).T)
    turned_rad = (usual.yaw_rad - ours.yaw_rad + np.pi) % (2 * np.pi) - np.pi
    apart_deg = np.abs(np.degrees(turned_rad))
    return {
        "median_m": float(np.median(apart_m)),
        "furthest_m": float(apart_m.max()),
        "median_deg": float(np.median(apart_deg)),
        "furthest_deg": float(apart_deg.max()),
    }


def _warp(num_cars: int, device: str | None, *, deterministic: bool = False) -> Any:
    """MuJoCo Warp; None, after a sentence on stderr, where it cannot run."""
    try:
        from drsim.car.warp_physics import WarpError, WarpPhysics
    except ImportError as error:
        _say(f"MuJoCo Warp is not measured: {error}")
        return None
    try:
        return WarpPhysics(car_model(), num_cars, device=device, deterministic=deterministic)
    except WarpError as error:
        _say(f"MuJoCo Warp is not measured: {error}")
        return None


def _choice(device: str | None) -> Any:
    return "warp-on-cpu" if device == "cpu" else "warp"


def _cores() -> int:
    usable = getattr(os, "sched_getaffinity", None)
    return len(usable(0)) if usable is not None else os.cpu_count() or 1


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines: Sequence[str] = info.read_text("utf-8").splitlines() if info.exists() else ()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
