"""How late a car acts on a picture: as the car says, or as it recorded."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean, median
from typing import Annotated, Any, TypeGuard

from drcli.base.errors import SettingsError
from drcli.base.installation import lazy_imports
from drcli.base.report import View
from drcli.outside.car.car_web import CarWeb

with lazy_imports():
    from rosbags import highlevel, typesys

LATENCY, JITTER = "DR_SIM_LATENCY", "DR_SIM_LATENCY_JITTER"

_ACTIONS = "/deepracer_navigation_pkg/auto_drive"
_STATUS = "/device_info_pkg/device_status"
"""Topics of a recording (source: the car's launch file). An action has the time of its picture."""

_SERVO_CTRL = "float32 angle\nfloat32 throttle\nbuiltin_interfaces/Time source_stamp\n"
_DEVICE_STATUS = "".join(
    f"float32 {name}\n"
    for name in (
        *("cpu_percent", "cpu_temp", "cpu_freq", "cpu_freq_max", "memory_usage", "free_disk"),
        *("latency_mean", "latency_p95", "fps_mean"),
    )
)
_LAYOUTS = {
    "deepracer_interfaces_pkg/msg/ServoCtrlMsg": _SERVO_CTRL,
    "deepracer_interfaces_pkg/msg/DeviceStatusMsg": _DEVICE_STATUS,
}
"""For recordings that do not hold the layout of their messages: those before ROS Jazzy."""

LONGEST_MS = 500.0
"""Of what DR_SIM_LATENCY can say; a later action is a fault of a clock or a car that hung."""


@dataclass(frozen=True)
class CarLatency:
    """How late a car acts."""

    source: Annotated[str, "Address of the car, or the recording."]
    until: Annotated[
        str, "The end of what was measured: servo, or action if the recording has no more."
    ]
    typical_ms: Annotated[float, "From the camera's picture: the mean, or the median of actions."]
    p95_ms: Annotated[float, "19 of 20 are no later."]
    frames_per_s: Annotated[float | None, "Pictures that the car acted on; null if unknown."] = None
    actions: Annotated[int, "Number of recorded actions; 0 for what the car says itself."] = 0
    written: Annotated[str, "The file in which the settings were changed; empty if none was."] = ""

    @property
    def settings(self) -> dict[str, str]:
        """The settings that stand for it, by name."""
        values = {LATENCY: self.typical_ms, JITTER: self.p95_ms - self.typical_ms}
        return {name: f"{min(ms, LONGEST_MS) / 1000:.3f}" for name, ms in values.items()}

    def view(self) -> View:
        rate = "" if self.frames_per_s is None else f", {self.frames_per_s:.1f} pictures a second"
        counted = f", {self.actions} actions" if self.actions else ""
        verb = "Wrote into" if self.written else "Settings for"
        return [
            f"{self.source}: {self.typical_ms:.0f} ms from picture to {self.until}, "
            f"{self.p95_ms:.0f} ms in the slowest of 20{rate}{counted}.",
            f"{verb} {self.written or 'run.env'}:",
            *(f"{name}={value}" for name, value in self.settings.items()),
        ]


def asked_latency(car: CarWeb) -> CarLatency:
    """What the car's software has measured in its last drive.

    Raises:
        SettingsError: It has not driven, or does not measure.
        CarError: The car cannot be reached.
    """
    answer = car.find("/api/get_device_status", action="measure itself")
    found = answer if isinstance(answer, dict) else {}
    typical, slow = found.get("latency_mean"), found.get("latency_p95")
    if not _is_latency(typical) or not _is_latency(slow):
        raise SettingsError(
            f"The car {car.address.place} has measured no latency.",
            remedy="Let it drive with a model for some seconds (`dr-car start --seconds 10`, the "
            "wheels may be in the air), then ask again. It needs version 2.1.7 or later of the "
            "community's software.",
        )
    rate = found.get("fps_mean") or None
    return CarLatency(car.address.place, "servo", typical, max(typical, slow), rate)


def _is_latency(found: Any) -> TypeGuard[float]:
    return isinstance(found, int | float) and 0.0 < found < LONGEST_MS


def recorded_latency(folders: Sequence[Path]) -> CarLatency:
    """What recordings (ROS bags) of a car say, all together.

    Raises:
        NotAvailable: The library that reads them is not installed.
        SettingsError: There is no recording, or it does not tell.
    """
    late_ms: list[float] = []
    apart_s: list[float] = []
    means: list[float] = []
    slow: list[float] = []
    for bag in _bags(folders):
        before_ns: int | None = None
        for topic, time_ns, message in _messages(bag):
            if topic == _STATUS:
                if _is_latency(message.latency_mean):
                    means.append(message.latency_mean)
                    slow.append(message.latency_p95)
                continue
            stamp = getattr(message, "source_stamp", None)
            if stamp is None:  # software before 2.1.7
                continue
            ms = (time_ns - stamp.sec * 1_000_000_000 - stamp.nanosec) / 1e6
            if _is_latency(ms):
                late_ms.append(ms)
            if before_ns is not None:
                apart_s.append((time_ns - before_ns) / 1e9)
            before_ns = time_ns
    name = ", ".join(map(str, folders))
    if not late_ms:
        raise SettingsError(
            f"{name}: no recorded action has the time of its picture.",
            remedy="Record an autonomous drive with version 2.1.7 or later of the community's "
            "software.",
        )
    rate = 1.0 / median(apart_s) if apart_s and median(apart_s) > 0 else None
    found = CarLatency(name, "action", median(late_ms), _slow_ms(late_ms), rate, len(late_ms))
    if not means:
        return found
    mean_ms = fmean(means)
    return replace(found, until="servo", typical_ms=mean_ms, p95_ms=max(mean_ms, fmean(slow)))


def _slow_ms(late_ms: Sequence[float]) -> float:
    """19 of 20 are no later."""
    return sorted(late_ms)[math.ceil(0.95 * len(late_ms)) - 1]


def _bags(folders: Sequence[Path]) -> list[Path]:
    """Each of them, or those below."""
    found = []
    for folder in folders:
        inside = sorted(each.parent for each in folder.rglob("metadata.yaml"))
        if not inside:
            raise SettingsError(
                f"{folder} holds no recording of a car: no metadata.yaml, in it or below.",
                remedy="Copy a whole folder from /opt/aws/deepracer/logs of the car. A recording "
                "during which the car was switched off has no such file; `ros2 bag reindex` on "
                "the car writes it.",
            )
        found += inside
    return found


def _messages(bag: Path) -> Iterator[tuple[str, int, Any]]:
    """Topic, time of receipt in nanoseconds, message."""
    known = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for name, layout in _LAYOUTS.items():
        known.register(typesys.get_types_from_msg(layout, name))
    try:
        with highlevel.AnyReader([bag], default_typestore=known) as reader:
            wanted = [each for each in reader.connections if each.topic in (_ACTIONS, _STATUS)]
            if not wanted:
                return  # without any, it gives all messages
            for each, time_ns, data in reader.messages(wanted):
                yield each.topic, time_ns, reader.deserialize(data, each.msgtype)
    except (highlevel.AnyReaderError, KeyError, AttributeError, OSError) as error:
        raise SettingsError(
            f"{bag}: cannot be read as a recording of a car ({error}).",
            remedy="Copy the whole folder from the car again; recordings of software before 2.1.7 "
            "hold no latency.",
        ) from error
