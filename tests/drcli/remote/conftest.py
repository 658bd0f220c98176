"""A car on localhost, and the commands as a racer calls them."""

import hashlib
import ssl
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drcli.remote import car_models
from drcli.remote.car_address import CarAddress
from drcli.remote.car_login import CarLogin, save_login
from fake_car import FakeCar, make_certificate, served


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return make_certificate(tmp_path_factory.mktemp("certificate"))


@pytest.fixture(scope="session")
def fingerprint(certificate: tuple[Path, Path]) -> str:
    """SHA-256 of the car's certificate."""
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(certificate[0].read_text())).hexdigest()


class Garage:
    """A car, its address, and how to talk to it."""

    def __init__(self, car: FakeCar, port: int, dr: Callable[..., int]) -> None:
        self.car = car
        self.port = port
        self.address = f"127.0.0.1:{port}"
        self._dr = dr

    def __call__(self, *arguments: str) -> int:
        """Run `dr-car` with these arguments for this car."""
        return self._dr("car", *arguments, "--car", self.address)


@pytest.fixture(scope="module")
def serving(certificate: tuple[Path, Path]) -> Iterator[tuple[FakeCar, int]]:
    car = FakeCar()
    with served(car, certificate) as port:
        yield car, port


@pytest.fixture
def garage(
    serving: tuple[FakeCar, int],
    working_folder: Path,
    dr: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
) -> Garage:
    """A fresh car that nobody has logged in at; no waits between questions."""
    car, port = serving
    car.__dict__.clear()
    car.__init__()  # type: ignore[misc]
    monkeypatch.setattr(car_models, "POLL_S", 0.005)
    monkeypatch.setenv("XDG_CACHE_HOME", str(working_folder / "cache"))
    return Garage(car, port, dr)


@pytest.fixture
def logged_in(garage: Garage, fingerprint: str) -> Garage:
    """A car with a login, as an earlier command has kept it."""
    garage.car.tokens = {"token"}
    garage.car.csrf = {"page": "csrf"}
    cookies = {"deepracer_token": "token", "session": "page"}
    address = CarAddress("127.0.0.1", garage.port)
    save_login(address, CarLogin("fingerprint", fingerprint, "", cookies, "csrf"))
    return garage
