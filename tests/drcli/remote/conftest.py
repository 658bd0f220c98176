"""A car on localhost, and the commands as a racer calls them."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drcli.remote import car_models
from fake_car import PASSWORD, FakeCar, make_certificate, served


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return make_certificate(tmp_path_factory.mktemp("certificate"))


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
def logged_in(garage: Garage, monkeypatch: pytest.MonkeyPatch) -> Garage:
    """A car with a login."""
    monkeypatch.setenv("DR_CAR_PASSWORD", PASSWORD)
    assert garage("login") == 0
    monkeypatch.delenv("DR_CAR_PASSWORD")
    garage.car.requests.clear()
    return garage
