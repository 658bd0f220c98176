"""The physical car's rules for archives; see docs/car.md.

Source: its model loader and web server.
"""

import json
import math
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from drcli.base.problems import Problem, closest, few, shown
from drcli.formats.car_actions import CAR_SENSORS
from drcli.modelfiles.action_space import ActionSpace, Pair

GRAPH = "agent/model.pb"
METADATA = "model_metadata.json"
END = ".tar.gz"
_FILE_NAME = re.compile(r"[A-Za-z0-9_-]+\.tar\.gz", re.ASCII)
_RESERVED = ("AWS Sample", "AWS_Sample", "aws-golden-model-for-reinvent")

_TAKEN_FOR_MODELS = ("", ".", ".p", ".b")
"""It looks for a name's end inside of `.pb`."""

_LIDAR_KEYS = (
    "num_values",
    "min_angle",
    "max_angle",
    "min_distance",
    "max_distance",
    "clipping_distance",
    "num_sectors",
)
_LARGEST = 1e6
"""Degrees or m/s."""

ALGORITHMS = ("clipped_ppo", "sac")
_TYPES = ("discrete", "continuous")

_FILES_REMEDY = "Pack only agent/model.pb and model_metadata.json, as `dr-export car` does."


@dataclass(frozen=True)
class CarMetadata:
    """What the car reads, with its defaults; `space` is None if unreadable."""

    sensors: tuple[str, ...] = ("observation",)
    algorithm: str = "clipped_ppo"
    space: ActionSpace | None = None
    problems: list[Problem] = field(default_factory=list)


def file_name_problems(name: str) -> Iterator[Problem]:
    """Why the car's page would refuse or change a name."""
    if name.removesuffix(END) in _RESERVED:
        what = f"{name}: the car has a model of that name itself."
        yield Problem("C-05", "error", name, None, what, "Rename the file.")
    elif not _FILE_NAME.fullmatch(name):
        what = (
            f"{shown(name)} is not a name that the car keeps: it cuts names at the first dot and "
            "changes spaces."
        )
        remedy = f"Rename it to {car_file_name(name.removesuffix(END))}."
        yield Problem("C-05", "error", name, None, what, remedy)


def car_file_name(name: str) -> str:
    """A name that the car takes, close to a model's."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-") or "model"
    return (f"{plain}-model" if plain in _RESERVED else plain) + END


def member_problems(names: Collection[str], file: str) -> Iterator[Problem]:
    """About names, kinds and places."""
    graphs = sorted(name for name in names if _end(name) == ".pb")
    if len(graphs) != 1:
        what = f"it contains {len(graphs)} files that end in .pb, but the car wants exactly one"
        listed = f" ({', '.join(few(map(shown, graphs)))})" if graphs else ""
        yield _problem("C-02", file, f"{what}{listed}.", _FILES_REMEDY)
    for name in sorted(names):
        if _end(name) in _TAKEN_FOR_MODELS:
            what = f"the car takes {shown(name)} for a second model, because of the end of its name"
            yield _problem("C-03", file, f"{what}.", _FILES_REMEDY)
    if METADATA not in names:
        elsewhere = [name for name in sorted(names) if PurePosixPath(name).name == METADATA]
        there = f"; the car does not see {shown(elsewhere[0])}" if elsewhere else ""
        what = f"it contains no {METADATA} at its root{there}, so the model never appears."
        yield _problem("C-04", file, what, _FILES_REMEDY)


def read_car_metadata(data: bytes, file: str) -> CarMetadata:
    try:
        values = json.loads(data.decode("utf-8"))
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        what = f"the car cannot read it: {shown(str(error))}."
        return CarMetadata(problems=[_problem("C-06", file, what, "Write valid JSON in UTF-8.")])
    if not isinstance(values, dict):
        what = "the car cannot read it: it is not a JSON object."
        return CarMetadata(problems=[_problem("C-06", file, what, "Put it between { and }.")])
    problems: list[Problem] = []
    sensors = values.get("sensor", ["observation"])
    if not isinstance(sensors, list) or not sensors:
        what = f"sensor={_written(sensors)} is not a list of sensors."
        remedy = 'Write "sensor": ["FRONT_FACING_CAMERA"].'
        problems.append(_problem("C-06", file, what, remedy))
        sensors = []
    problems += [
        _unknown("sensor", name, CAR_SENSORS, file)
        for name in sensors
        if name not in CAR_SENSORS and name != "DISCRETIZED_SECTOR_LIDAR"
    ]
    algorithm = values.get("training_algorithm", ALGORITHMS[0])
    if algorithm not in ALGORITHMS:
        problems.append(_unknown("training_algorithm", algorithm, ALGORITHMS, file))
        algorithm = ALGORITHMS[0]
    kind = values.get("action_space_type", _TYPES[0])
    space = None
    if kind not in _TYPES:
        problems.append(_unknown("action_space_type", kind, _TYPES, file))
    else:
        found = _space(values.get("action_space"), kind)
        if isinstance(found, ActionSpace):
            space = found
        else:
            remedy = "Take the metadata file that the model was trained with."
            problems.append(_problem("C-06", file, f"action_space {found}.", remedy))
    problems += _lidar_problems(values, file)
    known = tuple(name for name in sensors if isinstance(name, str))
    return CarMetadata(known, algorithm, space, problems)


def _end(name: str) -> str:
    """Empty for `checkpoint` and `.ready`."""
    last = name.rpartition("/")[2]
    stem = last.lstrip(".")
    return stem[stem.rindex(".") :] if "." in stem else ""


def _space(written: Any, kind: str) -> ActionSpace | str:
    """The actions, or what is wrong with them."""
    if kind == "discrete":
        if not isinstance(written, list) or not written:
            return "is not a list of actions" if written is not None else "is missing"
        pairs = [_pair(action, "steering_angle", "speed") for action in written]
        wrong = [number for number, pair in enumerate(pairs) if pair is None]
        if wrong:
            return f"has no numbers as steering_angle and speed in action {wrong[0]}"
        return ActionSpace(tuple(pair for pair in pairs if pair is not None))
    if not isinstance(written, dict):
        return "has no ranges of steering_angle and speed" if written is not None else "is missing"
    steering = _pair(written.get("steering_angle"), "low", "high")
    speed = _pair(written.get("speed"), "low", "high")
    for name, pair in (("steering_angle", steering), ("speed", speed)):
        if pair is None:
            return f"has no numbers as low and high of {name}"
        if pair[0] >= pair[1]:
            return f"has a low of {name} that is not below its high"
    assert steering is not None
    assert speed is not None
    return ActionSpace(low=(steering[0], speed[0]), high=(steering[1], speed[1]))


def _pair(written: Any, first: str, second: str) -> Pair | None:
    values = [written.get(key) if isinstance(written, dict) else None for key in (first, second)]
    one, other = (
        float(value)
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST
        else math.nan
        for value in values
    )
    return None if math.isnan(one + other) else (one, other)


def _lidar_problems(values: dict[str, Any], file: str) -> Iterator[Problem]:
    if "lidar_config" not in values:
        return
    written = values["lidar_config"]
    missing = [key for key in _LIDAR_KEYS if not isinstance(written, dict) or key not in written]
    if missing:
        what = (
            f"lidar_config lacks {', '.join(missing)}; the car needs all of its own keys there, "
            "which are not those of the simulator."
        )
        yield _problem("C-08", file, what, "Remove lidar_config; the car then takes its defaults.")


def _unknown(key: str, value: Any, known: tuple[str, ...], file: str) -> Problem:
    meant = closest(str(value), known)
    remedy = f"Write one of {', '.join(known)}."
    remedy = remedy if meant is None else f"Did you mean {meant}? {remedy}"
    rule = "C-07" if key == "sensor" else "C-06"
    return _problem(rule, file, f"{key}: the car does not know {_written(value)}.", remedy)


def _written(value: Any) -> str:
    return shown(json.dumps(value, ensure_ascii=False))


def _problem(rule: str, file: str, what: str, remedy: str) -> Problem:
    return Problem(rule, "error", file, None, what, remedy)
