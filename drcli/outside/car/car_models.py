"""Models on a car: list, upload, load."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar
from urllib.parse import quote

from drcli.base.archive import read_packed
from drcli.base.errors import SettingsError, closest, refuse, shown
from drcli.base.report import Col, View, table
from drcli.convert.car_archive import check_car_archive, without_leftovers
from drcli.convert.car_rules import END
from drcli.outside.car.car_address import CarError, CarRefused, CarSilent
from drcli.outside.car.car_web import CarWeb

# Checks archives before they are sent: the car names no reasons.


@dataclass(frozen=True)
class CarFile:
    """Checked."""

    path: Path
    name: str
    sensors: tuple[str, ...]
    content: bytes


def check_file(path: Path) -> CarFile:
    """Read an archive; SettingsError if the car would not take it."""
    content = without_leftovers(read_packed(path), str(path))
    check = check_car_archive(content, str(path))
    refuse(check.problems)
    return CarFile(path, path.name.removesuffix(END), check.sensors, content)


POLL_S = 1.0
UPLOAD_TIMEOUT_S = 180.0
"""The car's own gateway gives up after 60 s."""

LISTED_WITHIN_S = 60.0
"""The car reports a failure after 10 s, although the installation goes on."""

LOAD_TIMEOUT_S = 90.0
LOADED_WITHIN_S = 120.0
"""Models are converted for the car's processor."""

LOADED, LOADING = "loaded", "loading"
_SIMILAR = 0.6

T = TypeVar("T")


@dataclass(frozen=True)
class CarModel:
    """A model on the car."""

    name: Annotated[str, "Of its folder on the car.", Col("model")]
    usable: Annotated[
        bool,
        "Whether it can be loaded now.",
        Col("state", of=lambda each: "ready" if each.usable else each.why, side="left"),
    ]
    why: Annotated[str, "Why not; empty if it can."] = ""
    algorithm: Annotated[str, "As the car shows it.", Col("algorithm")] = ""
    action_space: Annotated[str, "As the car shows it.", Col("actions")] = ""
    sensors: Annotated[list[str], "As the car shows them.", Col("sensors", ", ".join)] = field(
        default_factory=list
    )
    size: Annotated[
        str, "As the car shows it, such as 12M; empty if unknown.", Col("size", side="right")
    ] = ""
    file: Annotated[str, "In its folder, without its end."] = "model"


@dataclass(frozen=True)
class CarModels:
    """The models on a car."""

    car: Annotated[str, "Address of the car."]
    models: Annotated[list[CarModel], "Usable ones first."]

    def view(self) -> View:
        order = ("name", "size", "algorithm", "action_space", "sensors", "usable")
        none = f"There are no models on the car {self.car}."
        return [table(self.models, *order) if self.models else none]


@dataclass(frozen=True)
class CarUpload:
    """The result of an upload."""

    car: Annotated[str, "Address of the car."]
    model: Annotated[str, "Name on the car."]
    size_bytes: Annotated[int, "Of the file."]
    usable: Annotated[bool, "Whether the model can be loaded now."]
    why: Annotated[str, "Why not; empty if it can."]

    def __str__(self) -> str:
        size = f"{self.size_bytes / 1e6:.1f} MB"
        return f"The car {self.car} has installed {self.model} ({size})."


@dataclass(frozen=True)
class CarLoad:
    """A model that the car has loaded."""

    car: Annotated[str, "Address of the car."]
    model: Annotated[str, "Name on the car."]
    seconds: Annotated[float, "How long it took."]

    def __str__(self) -> str:
        return f"The car {self.car} has loaded {self.model} in {self.seconds:.0f} s."


def list_models(car: CarWeb) -> CarModels:
    """Also those that the car cannot use."""
    listed = _listed(car)
    folders = car.get("/api/uploaded_model_list", action="list its folders")
    sizes = {
        str(one["name"]): str(one.get("size") or "")
        for one in (folders if isinstance(folders, list) else [])
        if isinstance(one, dict) and one.get("name")
    }
    known = {model.name for model in listed}
    broken = [
        CarModel(name, False, "it has no model file, or its metadata is wrong")
        for name in sizes
        if name not in known
    ]
    models = [replace(model, size=sizes.get(model.name, "")) for model in (*listed, *broken)]
    return CarModels(car.address.place, models)


def upload_model(car: CarWeb, file: CarFile, *, say: Callable[[str], None]) -> CarUpload:
    """Send an archive and wait for it; replaces a model.

    Raises:
        CarError: The car did not install it.
    """
    refusal: CarError | None = None
    try:
        path, action = "/api/uploadModels", f"install {file.name}"
        car.upload(path, file.path.name, file.content, action=action, timeout_s=UPLOAD_TIMEOUT_S)
    except (CarRefused, CarSilent) as e:
        refusal = e  # the car may have gone on installing
        say("The car has not confirmed the installation; waiting whether it lists the model ...")
    found = _wait_for(lambda: _found(_listed(car), file.name), LISTED_WITHIN_S)
    if found is None:
        raise _not_installed(car, file, refusal)
    place = car.address.place
    return CarUpload(place, file.name, len(file.content), found.usable, found.why)


def load_model(car: CarWeb, name: str) -> CarLoad:
    """Load a model and wait for that.

    Raises:
        SettingsError: The car has no such model, or cannot use it now.
        CarError: It failed.
    """
    started_s = time.monotonic()
    model = _usable(car, name)
    path = f"/api/models/{quote(model.name, safe='')}/{quote(model.file, safe='')}"
    refusal: CarError | None = None
    try:
        car.put(path, {}, action=f"load {shown(name)}", timeout_s=LOAD_TIMEOUT_S)
    except CarSilent as e:
        refusal = e
    except CarRefused as e:
        if loading_state(car) != LOADING:
            raise _not_loaded(car, name, e.reason) from e
        refusal = e
    state = _wait_for(lambda: _settled(loading_state(car)), LOADED_WITHIN_S)
    if state != LOADED:
        raise _not_loaded(car, name, f"its state is {shown(state)}" if state else "") from refusal
    return CarLoad(car.address.place, model.name, time.monotonic() - started_s)


def loading_state(car: CarWeb) -> str:
    answer = car.get("/api/isModelLoading", action="say which model is loaded")
    return str(answer.get("isModelLoading", "")) if isinstance(answer, dict) else ""


def _listed(car: CarWeb) -> list[CarModel]:
    """Usable ones first."""
    answer = car.get("/api/models", action="list its models")
    if not isinstance(answer, dict) or not isinstance(answer.get("models"), list):
        raise CarError(
            f"The car {car.address.place} answered with something that is not a list of models.",
            remedy="Restart the car, or update its software.",
        )
    states = answer.get("sensor_status")
    models = [
        _model(entry, states if isinstance(states, dict) else {})
        for entry in answer["models"]
        if isinstance(entry, dict) and entry.get("model_folder_name")
    ]
    return sorted(models, key=lambda model: not model.usable)


def _model(entry: dict[str, Any], states: dict[str, Any]) -> CarModel:
    sensors = entry.get("model_sensors") or []
    names = [str(sensor) for sensor in sensors] if isinstance(sensors, list) else [str(sensors)]
    usable = not entry.get("is_select_disabled")
    return CarModel(
        str(entry["model_folder_name"]),
        usable,
        "" if usable else _missing_sensor(names, states),
        str(entry.get("model_training_algorithm") or ""),
        str(entry.get("model_action_space_type") or ""),
        names,
        file=str(entry.get("model_name") or "model"),
    )


def _missing_sensor(sensors: list[str], states: dict[str, Any]) -> str:
    kinds = {"lidar": "lidar_status", "stereo": "stereo_status", "camera": "camera_status"}
    for sensor in sensors:
        kind = next((kind for kind in kinds if kind in sensor.casefold()), None)
        if kind is not None and states.get(kinds[kind]) != "connected":
            return f"its sensor ({sensor}) is not connected"
    return f"one of its sensors ({', '.join(sensors)}) is not connected"


def _found(models: list[CarModel], name: str) -> CarModel | None:
    return next((model for model in models if model.name == name), None)


def _usable(car: CarWeb, name: str) -> CarModel:
    models, place = _listed(car), car.address.place
    model = _found(models, name)
    if model is not None and model.usable:
        return model
    if model is not None:
        raise SettingsError(
            f"The car {place} cannot load {shown(name)}: {model.why}.",
            remedy="Connect that sensor, or load a model that does without it.",
        )
    near = closest(name, [model.name for model in models if model.usable], _SIMILAR)
    hint = f"Did you mean {near}? " if near else ""
    raise SettingsError(
        f"There is no model {shown(name)} on the car {place}.",
        remedy=f"{hint}`dr-car list` shows its models; `dr-car upload FILE.tar.gz` adds one.",
    )


def _settled(state: str) -> str | None:
    return None if state == LOADING else state


def _wait_for(look: Callable[[], T | None], most_s: float) -> T | None:
    """A busy car may be silent."""
    end_s = time.monotonic() + most_s
    while True:
        try:
            found = look()
        except CarSilent:
            found = None
        if found is not None or time.monotonic() >= end_s:
            return found
        time.sleep(POLL_S)


def _not_installed(car: CarWeb, file: CarFile, refusal: CarError | None) -> CarError:
    place, name = car.address.place, file.name
    if refusal is None:
        return CarError(
            f"The car {place} has accepted {name}, but does not list it after "
            f"{LISTED_WITHIN_S:g} s.",
            remedy="Look at `dr-car list` in a minute; if the model is not there, restart the car "
            "and upload it again.",
        )
    return CarError(
        f"{str(refusal).rstrip('.')}, and {name} is not in its list after {LISTED_WITHIN_S:g} s.",
        remedy="Check that the car has free space and no model with the same content under another "
        "name, which it would ignore; then upload it again.",
    )


def _not_loaded(car: CarWeb, name: str, reason: str) -> CarError:
    why = f": {reason.rstrip('.!')}" if reason else " in time"
    return CarError(
        f"The car {car.address.place} has not loaded {shown(name)}{why}.",
        remedy="Load it once more; if it fails again, restart the car, or export the model again "
        "and upload it.",
    )
