"""The physical car's rules for archives; see docs/car.md.

Source: its model loader and web server.
"""

import json
import math
import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Annotated, Any

from drcli.base.errors import Problem, closest, few, shown
from drcli.base.report import Col
from drcli.convert.policy_file import METADATA
from drcli.model.files.action_space import ActionSpace, Pair
from drcli.model.files.sensors import SENSORS

# What the physical car makes of a model's actions and sensors.


FULL_THROTTLE = 5 / 6
"""Share of the top speed from which the throttle stays at 1."""

_SPEED_STEPS = 5
_NOTHING = 1e-9

CAR_SENSORS = tuple(name for name, sensor in SENSORS.items() if sensor.on_car)


@dataclass(frozen=True)
class CarAction:
    """An action as the car drives it."""

    index: Annotated[
        int | None,
        "Position in the action space; null for a point of continuous ranges.",
        Col("action", none=""),
    ]
    steering_deg: Annotated[
        float, "Steering angle, degrees, positive to the left.", Col("steering (deg)", "{:g}")
    ]
    speed_mps: Annotated[float, "Its speed in the simulator, m/s.", Col("speed (m/s)", "{:g}")]
    steering: Annotated[
        float,
        "Share of the car's full steering angle, -1 to 1, positive to the left; the "
        "car's servo refuses values beyond that.",
        Col("steering on the car", "{:.0%}"),
    ]
    throttle: Annotated[
        float,
        "Share of the maximum speed that is set in the car's console, 0 to 1.",
        Col("throttle", "{:.1%}"),
    ]


def throttle(speed: float, top_speed: float) -> float:
    """The throttle for a speed: -1.2 u^2 + 2.2 u, at most 1, where u is its share of the top speed.

    The car only sees these shares. Source: navigation node of the car.
    """
    if top_speed <= 0:
        return 0.0
    share = speed / top_speed
    return max(-1.0, min(1.0, -1.2 * share * share + 2.2 * share))


def car_actions(space: ActionSpace) -> list[CarAction]:
    """All discrete actions, or points of continuous ranges."""
    if space.low is None or space.high is None:
        most_deg = max((abs(angle) for angle, _ in space.values), default=0.0)
        top = max((abs(speed) for _, speed in space.values), default=0.0)
        return [
            CarAction(index, angle, speed, _share(angle, most_deg), _rounded(throttle(speed, top)))
            for index, (angle, speed) in enumerate(space.values)
        ]
    (right, slow), (left, fast) = space.low, space.high
    steps = range(_SPEED_STEPS)
    speeds = [slow + (fast - slow) * step / (_SPEED_STEPS - 1) for step in steps]
    return [
        CarAction(None, angle, speed, _share(angle, left), _rounded(throttle(speed, fast)))
        for angle in (right, (right + left) / 2, left)
        for speed in speeds
    ]


def action_problems(space: ActionSpace, file: str) -> Iterator[Problem]:
    """What the car does differently."""
    if space.low is not None and space.high is not None:
        yield from _range_problems(space.low, space.high, file)
        return
    if not space.values:
        return
    if all(abs(angle) < _NOTHING for angle, _ in space.values):
        what = "no action steers, so the car only drives straight ahead."
        yield _problem("V-30", file, what, "Add actions that steer to both sides.")
    top = max(abs(speed) for _, speed in space.values)
    if top < _NOTHING or not any(speed > 0 for _, speed in space.values):
        what = "no action has a speed above 0, so the car never drives forward."
        yield _problem("V-32", file, what, "Give the actions speeds above 0.", error=True)
        return
    same: dict[tuple[float, float], list[CarAction]] = defaultdict(list)
    for action in car_actions(space):
        same[action.steering, action.throttle].append(action)
    alike = [
        " and ".join(f"{a.speed_mps:g}" for a in group) + f" m/s at {group[0].steering_deg:g} deg"
        for group in same.values()
        if len({action.speed_mps for action in group}) > 1
    ]
    full = sorted({speed for _, speed in space.values if throttle(speed, top) >= 1})
    if alike:
        what = f"{_full_throttle(top)}, so these actions are the same there: "
        what += f"{'; '.join(few(alike))}."
        remedy = f"Keep one speed above {FULL_THROTTLE * top:.3g} m/s if they should differ."
        yield _problem("V-32", file, what, remedy)
    elif len(full) > 1:
        what = f"{_full_throttle(top)}: {', '.join(f'{speed:g}' for speed in full)} m/s."
        yield Problem("V-32", "note", file, None, what, "Ignore this, or spread the speeds more.")


def sensor_problems(sensors: Sequence[str], file: str) -> Iterator[Problem]:
    """What the car refuses or treats differently."""
    for name in sensors:
        if name in SENSORS and not SENSORS[name].on_car:
            what = f"sensor contains {name}, which the car does not know; it refuses the model."
            remedy = "Train with SECTOR_LIDAR, or without a lidar, for the car."
            yield _problem("V-33", file, what, remedy, error=True)
    if "STEREO_CAMERAS" in sensors:
        what = (
            "sensor contains STEREO_CAMERAS; the car hands the two pictures over in the order of "
            "OpenVINO 2021, so cars with newer software (OpenVINO 2024, TensorFlow Lite) mix them "
            "up."
        )
        yield _problem(
            "V-33", file, what, "Use one camera, unless the car has its original software."
        )
    if len(sensors) > 1:
        what = (
            "the model has several sensors, and the car reads them in an order that changes from "
            "start to start, so it may take one for another."
        )
        yield _problem("V-33", file, what, "Use the camera alone for a car that drives reliably.")
    if "LIDAR" in sensors:
        what = (
            "LIDAR ends at 0.5 m on the car, but at 1 m in the simulator, so objects between "
            "them are not where the model expects them."
        )
        remedy = "Use SECTOR_LIDAR, which ends at 0.5 m in both."
        yield _problem("V-33", file, what, remedy)


def stack_problems(stack_size: int, file: str) -> Iterator[Problem]:
    """The car shows a network one frame at a time."""
    if stack_size > 1:
        what = (
            f"stack_size={stack_size}: the car shows a model one frame at a time and forgets it, "
            "so a model that sees several cannot drive there."
        )
        yield _problem("V-36", file, what, "Train with stack_size 1 for the car.", error=True)


def _range_problems(
    low: tuple[float, float], high: tuple[float, float], file: str
) -> Iterator[Problem]:
    (right, slow), (left, fast) = low, high
    if left <= 0 or abs(right) > left:
        what = (
            f"action_space.steering_angle from {right:g} to {left:g}: the car divides angles by "
            f"{left:g}, and its servo ignores every result beyond -1 to 1, so it cannot steer "
            "further to the right than to the left."
        )
        if left > 0:
            remedy = f"Train with a low of {-left:g} or more, or a high of {abs(right):g}."
        else:
            remedy = "Train with angles to both sides."
        yield _problem("V-31", file, what, remedy, error=True)
    if fast <= 0:
        what = f"action_space.speed ends at {fast:g}, so the car never drives forward."
        yield _problem("V-32", file, what, "Train with speeds above 0.", error=True)
        return
    if slow >= FULL_THROTTLE * fast:
        what = f"action_space.speed from {slow:g} to {fast:g}: {_full_throttle(fast)}, so it "
        what += "drives every action at the same speed."
        remedy = f"Train with a low below {FULL_THROTTLE * fast:.3g} m/s if speeds should differ."
        yield _problem("V-32", file, what, remedy)
    else:
        what = f"action_space.speed from {slow:g} to {fast:g}: {_full_throttle(fast)}."
        yield Problem("V-32", "note", file, None, what, "Ignore this, or widen the range.")


def _full_throttle(top: float) -> str:
    return (
        f"speeds from {FULL_THROTTLE * top:.3g} m/s ({FULL_THROTTLE:.0%} of the fastest) are all "
        "full throttle on the car"
    )


def _share(angle: float, most_deg: float) -> float:
    return _rounded(angle / most_deg) if abs(most_deg) > _NOTHING else 0.0


def _rounded(share: float) -> float:
    return round(share, 4) + 0.0  # no -0.0


def _problem(rule: str, file: str, what: str, remedy: str, *, error: bool = False) -> Problem:
    return Problem(rule, "error" if error else "warning", file, None, what, remedy)


GRAPH = "agent/model.pb"
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
        yield _broken_rule("C-02", file, f"{what}{listed}.", _FILES_REMEDY)
    for name in sorted(names):
        if _end(name) in _TAKEN_FOR_MODELS:
            what = f"the car takes {shown(name)} for a second model, because of the end of its name"
            yield _broken_rule("C-03", file, f"{what}.", _FILES_REMEDY)
    if METADATA not in names:
        elsewhere = [name for name in sorted(names) if PurePosixPath(name).name == METADATA]
        there = f"; the car does not see {shown(elsewhere[0])}" if elsewhere else ""
        what = f"it contains no {METADATA} at its root{there}, so the model never appears."
        yield _broken_rule("C-04", file, what, _FILES_REMEDY)


def read_car_metadata(data: bytes, file: str) -> CarMetadata:
    try:
        values = json.loads(data.decode("utf-8"))
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        what = f"the car cannot read it: {shown(str(error))}."
        return CarMetadata(
            problems=[_broken_rule("C-06", file, what, "Write valid JSON in UTF-8.")]
        )
    if not isinstance(values, dict):
        what = "the car cannot read it: it is not a JSON object."
        return CarMetadata(problems=[_broken_rule("C-06", file, what, "Put it between { and }.")])
    problems: list[Problem] = []
    sensors = values.get("sensor", ["observation"])
    if not isinstance(sensors, list) or not sensors:
        what = f"sensor={_written(sensors)} is not a list of sensors."
        remedy = 'Write "sensor": ["FRONT_FACING_CAMERA"].'
        problems.append(_broken_rule("C-06", file, what, remedy))
        sensors = []
    problems += [
        _unknown("sensor", name, CAR_SENSORS, file) for name in sensors if name not in list(SENSORS)
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
            problems.append(_broken_rule("C-06", file, f"action_space {found}.", remedy))
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
        yield _broken_rule(
            "C-08", file, what, "Remove lidar_config; the car then takes its defaults."
        )


def _unknown(key: str, value: Any, known: tuple[str, ...], file: str) -> Problem:
    meant = closest(str(value), known)
    remedy = f"Write one of {', '.join(known)}."
    remedy = remedy if meant is None else f"Did you mean {meant}? {remedy}"
    rule = "C-07" if key == "sensor" else "C-06"
    return _broken_rule(rule, file, f"{key}: the car does not know {_written(value)}.", remedy)


def _written(value: Any) -> str:
    return shown(json.dumps(value, ensure_ascii=False))


def _broken_rule(rule: str, file: str, what: str, remedy: str) -> Problem:
    return Problem(rule, "error", file, None, what, remedy)
