"""The settings of the car's software, which its page reads and writes.

Since 2.3.0 of the community's (pull requests 68, 69, 70, 71 and 72). They apply when the car starts
next.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from drcli.base.errors import SettingsError, closest, shown
from drcli.base.report import Col, View, table
from drcli.outside.car.car_address import CarError
from drcli.outside.car.car_web import CarWeb

PATH = "/api/car_config"
Value = bool | int | float | str

ORIENTATION, OVERLAY = "camera.orientation", "camera.enable_gray_overlay"
CAMERA_MODE, STEERING = "camera.mode", "steering.mode"

_CHOICES = {
    "camera_modes": CAMERA_MODE,
    "camera_orientations": ORIENTATION,
    "gray_overlay": OVERLAY,
    "inference_engines": "inference.engine",
    "logging_modes": "logging.mode",
    "logging_providers": "logging.provider",
    "steering_modes": STEERING,
    "imu": "imu.enabled",
    "imu_crash_thresholds": "imu.crash_threshold_g",
    "imu_pickup_thresholds": "imu.pickup_threshold_g",
}
"""What each of the car's capabilities is about."""

_FOUND_BY_ITSELF = (CAMERA_MODE, "inference.engine")
"""May also be `auto`."""

_DERIVED = {
    "imu.crash_enabled": "imu.crash_threshold_g",
    "imu.pickup_enabled": "imu.pickup_threshold_g",
}
"""The car computes them, whatever it is sent."""

_SIMILAR = 0.6


@dataclass(frozen=True)
class CarSetting:
    """A setting of a car's software."""

    name: Annotated[str, "Section and key, such as camera.orientation.", Col("setting")]
    value: Annotated[bool | int | float | str, "What is set.", Col("value", lambda v: _text(v))]
    choices: Annotated[
        list[bool | int | float | str],
        "What this car offers; empty where it does not say.",
        Col("choices", lambda values: ", ".join(map(_text, values))),
    ] = field(default_factory=list)


@dataclass(frozen=True)
class CarConfig:
    """The settings of a car's software."""

    car: Annotated[str, "Address of the car."]
    settings: Annotated[list[CarSetting], "In the car's order."]
    changed: Annotated[list[str], "Names of those that were set."] = field(default_factory=list)

    def value(self, name: str) -> Value | None:
        return next((each.value for each in self.settings if each.name == name), None)

    def view(self) -> View:
        said = f"The car {self.car} applies this when it starts next." if self.changed else ""
        return [*([said] if said else []), table(self.settings)]


def find_config(car: CarWeb) -> CarConfig | None:
    """None if the car's software is too old to tell."""
    answer = car.find(PATH, action="tell its settings")
    return None if answer is None else _config(car, answer)


def read_config(car: CarWeb) -> CarConfig:
    """CarError if the car's software is too old to tell."""
    found = find_config(car)
    if found is None:
        raise CarError(
            f"The software of the car {car.address.place} keeps no settings that its page can read "
            "(answer 404).",
            remedy="Update it to version 2.3.0 or later of the community's software "
            "(deepracer-custom-car).",
        )
    return found


def set_config(car: CarWeb, texts: Iterable[str]) -> CarConfig:
    """Set what NAME=VALUE says; the rest stays.

    Raises:
        SettingsError: There is no such setting, or this car does not offer the value.
        CarError: The car did not take it.
    """
    known = read_config(car)
    wanted = dict(_wanted(text, known) for text in texts)
    content: dict[str, dict[str, Value]] = {}
    for name, value in wanted.items():
        section, _, key = name.partition(".")
        content.setdefault(section, {})[key] = value
    car.post(PATH, content, action="change its settings")
    now = read_config(car)
    for name, value in wanted.items():
        if now.value(name) != value:
            raise CarError(
                f"The car {car.address.place} has not kept {name}={_text(value)}; it says "
                f"{_text(now.value(name))}.",
                remedy="Try again; if it fails again, set it on the car's page.",
            )
    return CarConfig(now.car, now.settings, list(wanted))


def _config(car: CarWeb, answer: Any) -> CarConfig:
    config = answer.get("config") if isinstance(answer, dict) else None
    if not isinstance(config, dict):
        raise CarError(
            f"The car {car.address.place} answered with something that has no settings.",
            remedy="Restart the car, or update its software.",
        )
    offered = answer.get("capabilities")
    choices = _choices(offered if isinstance(offered, dict) else {})
    settings = [
        CarSetting(f"{section}.{key}", value, choices.get(f"{section}.{key}", []))
        for section, values in config.items()
        if isinstance(values, dict)
        for key, value in values.items()
        if isinstance(value, Value)
    ]
    return CarConfig(car.address.place, settings)


def _choices(offered: Mapping[str, Any]) -> dict[str, list[Value]]:
    found: dict[str, list[Value]] = {}
    for capability, name in _CHOICES.items():
        values = offered.get(capability)
        if isinstance(values, bool):
            found[name] = [False, True] if values else [False]
        elif isinstance(values, list):
            found[name] = [each for each in values if isinstance(each, Value)]
            if name in _FOUND_BY_ITSELF:
                found[name].insert(0, "auto")
    return found


def _wanted(text: str, known: CarConfig) -> tuple[str, Value]:
    name, sign, written = text.partition("=")
    if not sign or not name:
        raise SettingsError(
            f"{shown(text)} is not a setting with a value.",
            remedy=f"Write NAME=VALUE, as in {ORIENTATION}=180.",
        )
    setting = next((each for each in known.settings if each.name == name), None)
    if setting is None:
        near = closest(name, [each.name for each in known.settings], _SIMILAR)
        raise SettingsError(
            f"The car {known.car} has no setting {shown(name)}.",
            remedy=(f"Did you mean {near}? " if near else "") + "`dr-car config` shows them all.",
        )
    if name in _DERIVED:
        raise SettingsError(
            f"{name} follows from {_DERIVED[name]}, so it cannot be set.",
            remedy=f"Set {_DERIVED[name]}; 0 switches it off.",
        )
    value = _parsed(written, setting)
    same = [each for each in setting.choices if _text(each).casefold() == _text(value).casefold()]
    if isinstance(value, type(setting.value)) and (same or not setting.choices):
        return name, same[0] if same else value
    allowed = ", ".join(map(_text, setting.choices)) or f"like {_text(setting.value)}"
    raise SettingsError(
        f"{name}={shown(written)} is nothing that the car {known.car} offers.",
        remedy=f"Choose from: {allowed}." if setting.choices else f"Write a value {allowed}.",
    )


def _parsed(text: str, setting: CarSetting) -> Value:
    if isinstance(setting.value, str):
        return text
    try:
        value = json.loads(text.casefold())
    except ValueError:
        return text
    if isinstance(setting.value, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value if isinstance(value, Value) else text


def _text(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value}"
