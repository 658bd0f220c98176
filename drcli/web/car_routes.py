"""The physical car, as `dr-car` sees it: models, camera, and a model that is sent to it."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import anyio
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Route
from starlette.types import Receive, Scope, Send

from drcli.base.errors import SettingsError
from drcli.base.installation import lazy_imports
from drcli.outside.car.car_address import CarAddress, NotLoggedIn, read_address
from drcli.outside.car.car_certificate import readable
from drcli.outside.car.car_web import CarWeb, first_login
from drcli.web import model_work
from drcli.web.answers import Body, Text, accepts, answers, error_of, status_of
from drcli.web.model_action_routes import Checkpoint
from drcli.web.model_reader import Prefix
from drcli.web.served_folder import ServedFolder
from drcli.web.stream_route import BOUNDARY
from drcli.web.subprocess_work import in_subprocess
from drcli.web.tasks import Progress

if TYPE_CHECKING:
    from requests import Response as CarAnswer

with lazy_imports():
    import requests

    from drcli.outside.car import car_camera, car_driving, car_models


class CarPassword(Body):
    password: Text


class SendToCar(Body):
    prefix: Prefix
    checkpoint: Checkpoint = "best"


class LoadOnCar(Body):
    name: Text


class _Pictures(StreamingResponse):
    """The camera of a car; the car hears at once when nobody looks any more."""

    def __init__(self, answer: "CarAnswer") -> None:
        kind = f"multipart/x-mixed-replace; boundary={BOUNDARY}"
        super().__init__(_parts(answer), media_type=kind)
        self._answer = answer

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._answer.close()


def _parts(answer: "CarAnswer") -> Iterator[bytes]:
    """Only the pictures: what else the car says must not become a page of the console."""
    with suppress(requests.exceptions.RequestException):  # the car is away
        for jpeg in car_camera.pictures_of(answer):
            head = (
                f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            )
            yield head.encode() + jpeg + b"\r\n"


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def address() -> CarAddress:
        text = folder.settings().car_address
        if not text:
            raise SettingsError(
                "No car is named.",
                remedy="Write its address into DR_CAR_ADDRESS on the page “Settings”.",
            )
        return read_address(text, "DR_CAR_ADDRESS")

    def show(_: Request) -> Any:
        place = address()
        try:
            car = CarWeb.opened(place)
            status, found = car_driving.read_status(car), car_models.list_models(car)
        except NotLoggedIn as error:
            return {"car": place.place, "login": str(error)}
        known = cast("dict[str, str]", next(iter(status.view())))
        facts = {name: text for name, text in known.items() if text}
        return {"car": place.place, "login": "", "facts": facts, "models": found.models}

    def login(_: Request, body: CarPassword) -> Any:
        place = address()
        trusted, first = first_login(place, ca_file="", insecure=False, new_certificate=False)
        CarWeb(place, trusted).log_in(body.password)
        return {"fingerprint": readable(trusted.fingerprint) if first else ""}

    def sent(body: SendToCar, progress: Progress) -> Any:
        car = CarWeb.opened(address())
        with tempfile.TemporaryDirectory(prefix="dr-car-") as scratch:
            given = body.prefix, "car", body.checkpoint, Path(scratch)
            made = in_subprocess(progress, model_work.make_download, folder.directory, *given)
            file = car_models.check_file(Path(made["file"]))
            progress(f"Sends {file.name} to {car.address.place}.")
            return car_models.upload_model(car, file, say=progress)

    def loaded(body: LoadOnCar, progress: Progress) -> Any:
        progress("The car may need a minute.")
        return car_models.load_model(CarWeb.opened(address()), body.name)

    def send(_: Request, body: SendToCar) -> Any:
        title = f"Send {body.prefix} to the car"
        return {"task": folder.tasks.start("car-send", body.prefix, title, partial(sent, body)).id}

    def load(_: Request, body: LoadOnCar) -> Any:
        title = f"Load {body.name} on the car"
        return {"task": folder.tasks.start("car-load", "", title, partial(loaded, body)).id}

    def open_camera() -> "CarAnswer":
        car = CarWeb.opened(address())
        within_s = car_camera.PICTURE_WITHIN_S
        return car.stream(car_camera.STREAM, action="show its camera", timeout_s=within_s)

    async def camera(_: Request) -> Response:
        try:
            return _Pictures(await anyio.to_thread.run_sync(open_camera))
        except Exception as error:
            return JSONResponse(error_of(error), status_of(error))

    return [
        Route("/api/car", answers(show)),
        Route("/api/car/camera", camera, methods=["GET"]),
        Route("/api/car/login", accepts(login), methods=["POST"]),
        Route("/api/car/send", accepts(send), methods=["POST"]),
        Route("/api/car/load", accepts(load), methods=["POST"]),
    ]
