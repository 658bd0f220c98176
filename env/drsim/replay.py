"""How faithful the car is: `python -m drsim.replay FOLDER --world NAME [--car NAME|all]`.

FOLDER holds simtrace CSV files of the reference simulator, whose poses and track columns are
compared.
"""

import argparse
import json
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drsim.car.car_parameters import CAR_SETS, DEFAULT_CAR
from drsim.errors import TrackError
from drsim.fidelity.motion import Agreement, Windows, compare_motion, compare_track_columns
from drsim.fidelity.recordings import Recording, RecordingError, load_recordings
from drsim.track.worlds import load_track

EXIT_SETTINGS = 3
"""The input cannot be used."""

_SHORTEST_S, _LONGEST_S = 0.1, 60.0

_REMAINDERS = {"all": (0, 1), "even": (0,), "odd": (1,)}
_ALL_CARS = "all"


Fidelity = dict[str, float]
"""Errors a horizon ahead by name; nine of ten windows are within `p90_m`."""


def summary(windows: Windows) -> Fidelity:
    return {
        "median_m": float(np.median(windows.position_m)),
        "p90_m": float(np.percentile(windows.position_m, 90)),
        "median_yaw_deg": float(np.median(windows.yaw_deg)),
        "windows": len(windows.position_m),
        "bicycle_median_m": float(np.median(windows.bicycle_position_m)),
        "bicycle_median_yaw_deg": float(np.median(windows.bicycle_yaw_deg)),
        "driven_median_m": float(np.median(windows.driven_m)),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write; the exit code is 3 after a sentence on stderr."""
    options = _parser().parse_args(arguments)
    try:
        reports, agreement = _measure(options)
    except RecordingError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_SETTINGS
    if options.json:
        text = json.dumps(_as_json(options, reports, agreement))
    else:
        text = _as_text(options, reports, agreement)
    sys.stdout.write(f"{text}\n")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m drsim.replay",
        description="Drive the recorded actions of the reference simulator with our car, from each "
        "recorded pose, and tell how far it ends from the recorded car.",
    )
    parser.add_argument(
        "folder", type=Path, help="folder with *-iteration.csv files, also in folders below it"
    )
    parser.add_argument(
        "--world", required=True, metavar="NAME", help="world that was driven, or its route file"
    )
    parser.add_argument(
        "--horizon", type=float, default=1.0, metavar="S", help="seconds ahead (default 1)"
    )
    parser.add_argument(
        "--episodes",
        choices=list(_REMAINDERS),
        default="all",
        help="which episodes, by number: calibrate on one half, report the other",
    )
    parser.add_argument(
        "--tracks-dir",
        type=Path,
        default=os.environ.get("DR_TRACKS_DIR") or None,
        metavar="DIR",
        help="folder with route files (default: DR_TRACKS_DIR)",
    )
    parser.add_argument(
        "--car",
        choices=[*CAR_SETS, _ALL_CARS],
        help=f"set of car parameters, or all of them (default {DEFAULT_CAR})",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _measure(options: argparse.Namespace) -> tuple[dict[str, Fidelity], Agreement | None]:
    if not _SHORTEST_S <= options.horizon <= _LONGEST_S:
        raise RecordingError(
            f"--horizon is {options.horizon:g}; it must be {_SHORTEST_S:g} to {_LONGEST_S:g} s."
        )
    recordings = load_recordings(options.folder)
    if recordings.left_out:
        _note(f"{recordings.left_out} lines could not be read and were left out.")
    wanted = _REMAINDERS[options.episodes]
    drives = [drive for drive in recordings.drives if drive.episode % 2 in wanted]
    reports = {}
    for car in CAR_SETS if options.car == _ALL_CARS else (options.car or DEFAULT_CAR,):
        windows = compare_motion(drives, CAR_SETS[car].parameters, horizon_s=options.horizon)
        if not len(windows.position_m):
            raise RecordingError(
                f"No drive in the {options.episodes} episodes of {options.folder} goes on for "
                f"{options.horizon:g} s. Choose a shorter --horizon, or a folder with longer "
                "drives."
            )
        reports[car] = summary(windows)
    return reports, _compare_track(options, drives)


def _compare_track(options: argparse.Namespace, drives: Sequence[Recording]) -> Agreement | None:
    try:
        track = load_track(options.world, options.tracks_dir)
    except TrackError as error:
        _note(f"What is recorded of the track was not checked. {error}")
        return None
    agreement = compare_track_columns(drives, track)
    if not agreement.fits:
        _note(
            f"The recording does not fit {options.world} (length {agreement.length_m:.2f} m, "
            f"recorded {_metres(agreement.recorded_length_m)}). Name the world that was driven."
        )
    return agreement


def _note(sentence: str) -> None:
    sys.stderr.write(f"Note: {sentence}\n")


def _as_json(
    options: argparse.Namespace, reports: dict[str, Fidelity], agreement: Agreement | None
) -> dict[str, Any]:
    track = None
    if agreement is not None:
        track = {
            name: None if isinstance(value, float) and math.isnan(value) else value
            for name, value in vars(agreement).items()
        }
    cars: list[dict[str, Any]] = [{"car": car, **report} for car, report in reports.items()]
    if options.car == _ALL_CARS:
        return {"cars": cars, "track": track}
    if options.car is None:
        del cars[0]["car"]
    return {**cars[0], "track": track}


def _as_text(
    options: argparse.Namespace, reports: dict[str, Fidelity], agreement: Agreement | None
) -> str:
    first = next(iter(reports.values()))
    rows = [
        f"{options.horizon:g} s ahead, medians of {first['windows']} windows in {options.episodes} "
        f"episodes, {first['driven_median_m']:.2f} m driven"
    ]
    rows += [
        f"  {car if options.car else 'our car':9} {report['median_m']:7.3f} m "
        f"{report['median_yaw_deg']:6.1f} degrees off; 9 of 10 within {report['p90_m']:.3f} m"
        for car, report in reports.items()
    ]
    rows.append(
        f"  bicycle   {first['bicycle_median_m']:7.3f} m "
        f"{first['bicycle_median_yaw_deg']:6.1f} degrees off, following at once"
    )
    text = "\n".join(rows)
    if agreement is None:
        return text
    backwards = ", driven backwards" if agreement.reverse else ""
    return (
        f"{text}\n"
        f"Recorded columns derived again on {options.world}{backwards}, {agreement.rows} rows\n"
        f"  progress             {_percent(agreement.progress)} within 0.02\n"
        f"  closest_waypoint     {_percent(agreement.closest_waypoint)} equal\n"
        f"  all_wheels_on_track  {_percent(agreement.all_wheels_on_track)} equal\n"
        f"  track_len            {_metres(agreement.length_m)}, recorded "
        f"{_metres(agreement.recorded_length_m)}"
    )


def _percent(share: float) -> str:
    return "not recorded" if math.isnan(share) else f"{100 * share:7.3f} %"


def _metres(length_m: float) -> str:
    return "nothing" if math.isnan(length_m) else f"{length_m:.3f} m"


if __name__ == "__main__":
    raise SystemExit(main())
