"""What the physical car makes of a model's actions and sensors."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from drcli.base.problems import Problem, few
from drcli.modelfiles.action_space import ActionSpace

FULL_THROTTLE = 5 / 6
"""Share of the top speed from which the throttle stays at 1."""

_SPEED_STEPS = 5
_NOTHING = 1e-9

CAR_CAMERAS = ("observation", "FRONT_FACING_CAMERA", "LEFT_CAMERA", "STEREO_CAMERAS")
CAR_LIDARS = ("LIDAR", "SECTOR_LIDAR")
CAR_SENSORS = (*CAR_CAMERAS, *CAR_LIDARS)


@dataclass(frozen=True)
class CarAction:
    """An action as the car drives it.

    Attributes:
        index: Position in the action space; null for a point of continuous ranges.
        steering_deg: Steering angle, degrees, positive to the left.
        speed_mps: Its speed in the simulator, m/s.
        steering: Share of the car's full steering angle, -1 to 1, positive to the left; the car's
            servo refuses values beyond that.
        throttle: Share of the maximum speed that is set in the car's console, 0 to 1.
    """

    index: int | None
    steering_deg: float
    speed_mps: float
    steering: float
    throttle: float


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
        if name == "DISCRETIZED_SECTOR_LIDAR":
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
