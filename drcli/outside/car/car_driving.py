"""Starts and stops a car, and limits its speed."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from math import inf, isfinite
from types import FrameType
from typing import Annotated, Any, Literal

from drcli.base.errors import DrError, SettingsError, shown
from drcli.base.processes import handle, restore
from drcli.base.report import View
from drcli.outside.car.car_address import CarError, CarRefused, NotLoggedIn
from drcli.outside.car.car_config import (
    CAMERA_MODE,
    ORIENTATION,
    OVERLAY,
    STEERING,
    Value,
    find_config,
)
from drcli.outside.car.car_models import LOADED, LOADING, loading_state
from drcli.outside.car.car_web import CarWeb

STOP_ATTEMPTS = 3
STOP_TIMEOUT_S = 5.0
WATCH_S = 3.0
METRICS = {
    "cpu_percent": "{:.0f} % processor",
    "cpu_temp": "{:.0f} degrees C",
    "memory_usage": "{:.0f} % memory",
    "free_disk": "{:.0f} % disk free",
    "fps_mean": "{:.1f} frames/s",
    "latency_mean": "{:.0f} ms latency",
}
_BY_HAND = "Stop the car by hand: lift it, and switch it off."


@dataclass(frozen=True)
class CarSpeed:
    """The limit of the throttle."""

    car: Annotated[str, "Address of the car."]
    percent: Annotated[int, "The limit, 0 to 100."]

    def __str__(self) -> str:
        return f"The throttle of the car {self.car} is limited to {self.percent} %."


@dataclass(frozen=True)
class CarDrive:
    """A drive, or its end."""

    car: Annotated[str, "Address of the car."]
    driving: Annotated[bool, "Whether the car still drives, because the command did not wait."]
    seconds: Annotated[float | None, "How long it drove; None if unknown."] = None
    interrupted: Annotated[bool, "Whether Ctrl-C or another signal ended it."] = False
    imu_stop: Annotated[
        str, "Why the car's IMU stopped it: crash, pickup or another word of the car; else empty."
    ] = ""

    def __str__(self) -> str:
        after = "" if self.seconds is None else f" after {self.seconds:.0f} s"
        why = f": its IMU noticed a {self.imu_stop}" if self.imu_stop else ""
        return f"The car {self.car} {'drives' if self.driving else f'has stopped{after}{why}'}."


def set_speed(car: CarWeb, percent: int) -> CarSpeed:
    """Limit the throttle until the car restarts.

    Raises:
        SettingsError: It is not from 0 to 100; the car would take it unchecked.
    """
    if not 0 <= percent <= 100:
        raise SettingsError(
            f"{percent} is not a speed limit in percent.", remedy="Give a number from 0 to 100."
        )
    car.put("/api/max_nav_throttle", {"throttle": percent}, action="limit its speed")
    return CarSpeed(car.address.place, percent)


def refuse_without_model(car: CarWeb) -> None:
    """SettingsError if no model is loaded yet."""
    state = loading_state(car)
    if state == LOADING:
        raise SettingsError(
            f"The car {car.address.place} is still loading a model.",
            remedy="Start it again in a few seconds.",
        )
    if state != LOADED:
        raise SettingsError(
            f"The car {car.address.place} has no model loaded.",
            remedy="Load one with `dr-car load NAME`.",
        )


def stop(car: CarWeb) -> CarDrive:
    """Stop the car at once, and again if it does not answer.

    Raises:
        CarError: It did not confirm.
        NotLoggedIn: It has forgotten the login.
    """
    failure: CarError | None = None
    place = car.address.place
    for _ in range(STOP_ATTEMPTS):
        try:
            content = {"start_stop": "stop"}
            car.put("/api/start_stop", content, action="stop", timeout_s=STOP_TIMEOUT_S)
        except NotLoggedIn as e:
            raise NotLoggedIn(
                f"The car may still drive! {e}",
                remedy="Lift the car and switch it off, or run "
                f"`dr-car login --car {place}` and `dr-car stop --car {place}`.",
            ) from e
        except CarError as e:
            failure = e
        else:
            return CarDrive(car.address.place, driving=False)
    raise CarError(f"The car may still drive! {failure}", remedy=_BY_HAND) from failure


def start(car: CarWeb) -> CarDrive:
    """Leave the car driving; a failed start stops it.

    Raises:
        KeyboardInterrupt: A signal came; the car has stopped.
        CarError: It failed.
    """
    _set_autonomous(car)
    with _ending_signals() as signals:
        try:
            _start(car)
        except BaseException:
            # Without an answer, or after Ctrl-C, nobody knows whether it drives.
            signals.raises = False
            stop(car)
            raise
        signals.raises = False
        if signals.ended.is_set():
            stop(car)
            raise KeyboardInterrupt
    return CarDrive(car.address.place, driving=True)


def drive(
    car: CarWeb, *, seconds: float | None, warn: Callable[[str], None], say: Callable[[str], None]
) -> CarDrive:
    """Start the car, and stop it after the time, at a signal, or when its IMU has stopped it.

    The stop is sent whatever ends the wait, also at Ctrl-C.

    Raises:
        CarError: The car did not confirm start or stop.
    """
    _set_autonomous(car)
    started_s = time.monotonic()
    with _ending_signals() as signals:
        try:
            _start(car)
            signals.raises = False
            threading.Thread(target=_listen, args=(car, signals), daemon=True).start()
            started_s = time.monotonic()
            until = "" if seconds is None else f" for {seconds:g} s"
            say(f"The car {car.address.place} drives{until}; Ctrl-C stops it.")
            _watch(car, signals.ended, started_s, seconds, warn)
        except KeyboardInterrupt:  # during the start
            signals.ended.set()
        finally:
            signals.raises = False
            stop(car)
    driven_s = round(time.monotonic() - started_s, 1)
    interrupted = signals.ended.is_set() and not signals.imu_stop
    signals.ended.set()  # nobody listens any more
    return CarDrive(car.address.place, False, driven_s, interrupted, signals.imu_stop)


EVENTS = "/api/events"
_SILENT_S = 40.0
"""The car says something every 15 s."""


def _listen(car: CarWeb, signals: "_Signals") -> None:
    """Wait for the IMU to stop the car (community's software, pull request 72).

    Server-sent events: the name of one, then its data in JSON. A car without them is not told of.
    """
    own = CarWeb(car.address, car.login)  # sessions are not for two threads
    event = ""
    with (
        suppress(DrError, OSError, ValueError),
        closing(own.stream(EVENTS, action="tell what happens", timeout_s=_SILENT_S)) as answer,
    ):
        for line in answer.iter_lines(1, decode_unicode=True):
            if signals.ended.is_set():
                return
            name, _, value = line.partition(":")
            event = value.strip() if name == "event" else event
            if name == "data" and event == "imu_stop":
                signals.imu_stop = shown(str(json.loads(value))) or "stop"
                signals.ended.set()
                return


def _set_autonomous(car: CarWeb) -> None:
    car.put("/api/drive_mode", {"drive_mode": "auto"}, action="change to autonomous driving")


def _start(car: CarWeb) -> None:
    car.put("/api/start_stop", {"start_stop": "start"}, action="start")


def _watch(
    car: CarWeb,
    ended: threading.Event,
    started_s: float,
    seconds: float | None,
    warn: Callable[[str], None],
) -> None:
    reachable = True
    end_s = inf if seconds is None else started_s + seconds
    while not ended.wait(max(0.0, min(WATCH_S, end_s - time.monotonic()))):
        if time.monotonic() >= end_s:
            return
        try:
            with suppress(CarRefused):  # a battery that is not connected
                car.find("/api/get_battery_level", action="tell its battery level")
            reachable = True
        except DrError as e:
            if reachable:
                warn(f"The car may not stop when asked to: {e} {_BY_HAND}")
            reachable = False


@dataclass
class _Signals:
    raises: bool = True
    ended: threading.Event = field(default_factory=threading.Event)
    imu_stop: str = ""

    def handle(self, _number: int, _frame: FrameType | None) -> None:
        self.ended.set()
        if self.raises:
            self.raises = False
            raise KeyboardInterrupt


@contextmanager
def _ending_signals() -> Iterator[_Signals]:
    signals = _Signals()
    if threading.current_thread() is not threading.main_thread():
        yield signals
        return
    before = handle(signals.handle)
    try:
        yield signals
    finally:
        restore(before)


# What a car says about itself.


Software = Literal["original", "community"]


@dataclass(frozen=True)
class CarStatus:
    """The state of a car; None and empty for what it does not say."""

    car: Annotated[str, "Address of the car."]
    software: Annotated[
        Software, "original or community; only the community's software can list its requests."
    ]
    software_version: Annotated[str | None, "Of the car's core package."]
    hardware_version: Annotated[str | None, "Of the car."]
    battery_level: Annotated[float | None, "As the car counts it, not in percent."]
    sensors: Annotated[dict[str, str], "State by sensor, such as connected."] = field(
        default_factory=dict
    )
    model_state: Annotated[str | None, "loaded, loading, or another word of the car."] = None
    metrics: Annotated[
        dict[str, float],
        "Measured by the community's software: load and temperature of the processor, "
        "free disk, frames per second, latency.",
    ] = field(default_factory=dict)
    settings: Annotated[
        dict[str, bool | int | float | str], "Of its software, since 2.3.0 of the community's."
    ] = field(default_factory=dict)

    def view(self) -> View:
        battery = "unknown" if self.battery_level is None else f"level {self.battery_level:g}"
        sensors = (f"{name} {state.replace('_', ' ')}" for name, state in self.sensors.items())
        known = (
            form.format(self.metrics[key]) for key, form in METRICS.items() if key in self.metrics
        )
        return [
            {
                "car": f"{self.car}, hardware {self.hardware_version or 'unknown'}",
                "software": f"{self.software} {self.software_version or ''}".rstrip(),
                "model": self.model_state or "unknown",
                "battery": battery,
                "sensors": ", ".join(sensors),
                "computer": ", ".join(known),
                **(_settings_in_words(self.settings) if self.settings else {}),
            }
        ]


def _settings_in_words(settings: dict[str, Value]) -> dict[str, str]:
    overlay = "on" if settings.get(OVERLAY) else "off"
    stops = [
        f"at a {kind} ({settings.get(f'imu.{kind}_threshold_g', 0):g} g)"
        for kind in ("crash", "pickup")
        if settings.get("imu.enabled") and settings.get(f"imu.{kind}_enabled")
    ]
    return {
        "steering": str(settings.get(STEERING, "unknown")),
        "picture": f"{settings.get(CAMERA_MODE, 'unknown')}, turned by "
        f"{settings.get(ORIENTATION, 0)} degrees, gray overlay {overlay}",
        "IMU stops": " and ".join(stops) or "never",
    }


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
        settings={} if apis is None else _settings(car),
    )


def _settings(car: CarWeb) -> dict[str, Value]:
    try:
        found = find_config(car)
    except CarRefused:
        found = None
    return {each.name: each.value for each in found.settings} if found is not None else {}


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
