"""A car and a DeepRacer on AWS, both on localhost, and the commands as a racer calls them."""

import hashlib
import ssl
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drcli.outside.car import car_models
from drcli.outside.car.car_address import CarAddress, CarLogin, save_login
from droa_models import Files, accepted_model, write_files
from droa_server import PASSWORD, USER, FakeDroa
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
    car.__init__()
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


@pytest.fixture
def fake() -> Iterator[FakeDroa]:
    server = FakeDroa()
    yield server
    server.stop()


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The home folder of the user, without keys of anything else."""
    folder = tmp_path / "home"
    folder.mkdir()
    monkeypatch.setenv("HOME", str(folder))
    for name in ("AWS_PROFILE", "AWS_ENDPOINT_URL", "AWS_ACCESS_KEY_ID", "HTTPS_PROXY"):
        monkeypatch.delenv(name, raising=False)
    return folder


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The seconds that commands would have waited; they do not."""
    waited: list[float] = []
    monkeypatch.setattr("drcli.cli.commands.droa.pause", waited.append)
    return waited


@pytest.fixture
def droa(
    dr: Callable[..., int],
    fake: FakeDroa,
    home: Path,
    pauses: list[float],
    working_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[..., int]:
    """Runs a droa command line of a user whose settings name the fake; its exit code."""
    with (working_folder / "system.env").open("a") as file:
        file.write(
            f"DR_DROA_URL={fake.url}/\nDR_DROA_USERNAME={USER}\n"
            f"DR_DROA_AWS_ENDPOINT_URL={fake.url}\n"
        )
    monkeypatch.setattr("drcli.cli.prompts.secret", lambda question, remedy: PASSWORD)
    return dr


@pytest.fixture
def model() -> Files:
    return accepted_model()


@pytest.fixture
def laid(tmp_path: Path) -> Callable[[Files], Path]:
    """Writes files into a folder, and returns it."""
    return lambda files: write_files(tmp_path / "my-model", files)
