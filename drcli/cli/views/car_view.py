"""Shows a physical car."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.text import Text

from drcli.cli.views.layout import Rows

if TYPE_CHECKING:
    from drcli.remote.car_driving import CarDrive
    from drcli.remote.car_models import CarLoad, CarModels, CarUpload
    from drcli.remote.car_status import CarStatus

_METRICS = {
    "cpu_percent": "{:.0f} % processor",
    "cpu_temp": "{:.0f} degrees C",
    "memory_usage": "{:.0f} % memory",
    "free_disk": "{:.0f} % disk free",
    "fps_mean": "{:.1f} frames/s",
    "latency_mean": "{:.0f} ms latency",
}


@dataclass(frozen=True)
class CarLoginReport:
    """A login.

    Attributes:
        car: Address of the car.
        trust: How the car is recognised later: fingerprint, ca or none.
        fingerprint: SHA-256 of its certificate; empty if none was kept.
    """

    car: str
    trust: str
    fingerprint: str


@dataclass(frozen=True)
class CarLogoutReport:
    """The end of a login.

    Attributes:
        car: Address of the car.
        was_logged_in: Whether there was a login.
    """

    car: str
    was_logged_in: bool


def models(report: "CarModels") -> RenderableType:
    if not report.models:
        return Text(f"There are no models on the car {report.car}.")
    names = ("model", "size", "algorithm", "actions", "sensors", "state")
    rows = [
        (
            model.name,
            model.size,
            model.algorithm,
            model.action_space,
            ", ".join(model.sensors),
            "ready" if model.usable else model.why,
        )
        for model in report.models
    ]
    return Rows(names, rows, left=("model", "algorithm", "actions", "sensors", "state"))


def upload(report: "CarUpload") -> RenderableType:
    size = f"{report.size_bytes / 1e6:.1f} MB"
    return Text(f"The car {report.car} has installed {report.model} ({size}).")


def load(report: "CarLoad") -> RenderableType:
    return Text(f"The car {report.car} has loaded {report.model} in {report.seconds:.0f} s.")


def drive(report: "CarDrive") -> RenderableType:
    if report.driving:
        return Text(f"The car {report.car} drives.")
    after = "" if report.seconds is None else f" after {report.seconds:.0f} s"
    return Text(f"The car {report.car} has stopped{after}.")


def status(report: "CarStatus") -> RenderableType:
    version = f" {report.software_version}" if report.software_version else ""
    lines = [
        f"car {report.car}, hardware {report.hardware_version or 'unknown'}",
        f"software: {report.software}{version}",
        f"model: {report.model_state or 'unknown'}",
        "battery: " + ("unknown" if report.battery_level is None else f"{report.battery_level:g}"),
    ]
    if report.sensors:
        states = (f"{name} {state.replace('_', ' ')}" for name, state in report.sensors.items())
        lines.append(f"sensors: {', '.join(states)}")
    known = [
        text.format(report.metrics[key]) for key, text in _METRICS.items() if key in report.metrics
    ]
    if known:
        lines.append(f"computer: {', '.join(known)}")
    return Group(*map(Text, lines))
