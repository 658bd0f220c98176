"""What a car says about itself."""

from dataclasses import dataclass, field
from math import isfinite
from typing import Any, Literal

from drcli.remote.car_errors import CarError, CarRefused
from drcli.remote.car_models import loading_state
from drcli.remote.car_web import CarWeb

Software = Literal["original", "community"]


@dataclass(frozen=True)
class CarStatus:
    """The state of a car; None and empty for what it does not say.

    Attributes:
        car: Address of the car.
        software: original or community; only the community's software can list its requests.
        software_version: Of the car's core package.
        hardware_version: Of the car.
        battery_level: As the car counts it, not in percent.
        sensors: State by sensor, such as connected.
        model_state: loaded, loading, or another word of the car.
        metrics: Measured by the community's software: load and temperature of the processor, free
            disk, frames per second, latency.
    """

    car: str
    software: Software
    software_version: str | None
    hardware_version: str | None
    battery_level: float | None
    sensors: dict[str, str] = field(default_factory=dict)
    model_state: str | None = None
    metrics: dict[str, float] = field(default_factory=dict)


def read_status(car: CarWeb) -> CarStatus:
    """Ask a car for everything.

    Raises:
        NotLoggedIn: The login has expired.
        CarError: The car cannot be reached.
    """
    apis = car.find("/api/supported_apis", action="list its requests")
    device = _asked(car, "/api/get_device_info", "describe itself")
    battery = _asked(car, "/api/get_battery_level", "tell its battery level")
    sensors = _asked(car, "/api/get_sensor_status", "tell the state of its sensors")
    metrics = {}
    if apis is not None:
        metrics = _asked(car, "/api/get_device_status", "measure itself")
    level = _numbers(battery).get("battery_level", -1.0)
    return CarStatus(
        car=car.address.place,
        software="original" if apis is None else "community",
        software_version=_text(device.get("software_version")),
        hardware_version=_text(device.get("hardware_version")),
        battery_level=level if level >= 0 else None,
        sensors={
            name: str(sensors[key])
            for name, key in {
                "camera": "camera_status",
                "stereo": "stereo_status",
                "lidar": "lidar_status",
            }.items()
            if sensors.get(key)
        },
        model_state=_state(car),
        metrics=_numbers(metrics),
    )


def _asked(car: CarWeb, path: str, action: str) -> dict[str, Any]:
    try:
        answer = car.find(path, action=action)
    except CarRefused:
        return {}
    return answer if isinstance(answer, dict) else {}


def _state(car: CarWeb) -> str | None:
    try:
        return loading_state(car) or None
    except CarError:
        return None


def _text(value: object) -> str | None:
    return str(value) if value not in (None, "") else None


def _numbers(answer: dict[str, Any]) -> dict[str, float]:
    return {
        key: value
        for key, value in answer.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
    }
