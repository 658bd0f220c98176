"""`dr car`."""

import os
import ssl
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import SettingsError, refuse, shown
from drcli.base.files import refuse_existing
from drcli.base.installation import lazy_imports
from drcli.cli import prompts, terminal
from drcli.cli.options import Force, Replace
from drcli.cli.show import show
from drcli.cli.working_folder import settings, settings_or_defaults, working_folder
from drcli.config import activation
from drcli.outside.car.car_address import CarAddress, forget_login, read_address
from drcli.outside.car.car_certificate import readable
from drcli.outside.car.car_web import CarWeb, first_login

if TYPE_CHECKING:
    from drcli.config.run_config import DriveConfig

with lazy_imports():
    from drcli.checks import compare_on_drive
    from drcli.config import editing
    from drcli.outside.car import car_camera, car_config, car_driving, car_latency, car_models


@dataclass(frozen=True)
class CarLoginReport:
    """A login."""

    car: Annotated[str, "Address of the car."]
    trust: Annotated[str, "How the car is recognised later: fingerprint, ca or none."]
    fingerprint: Annotated[str, "SHA-256 of its certificate; empty if none was kept."]

    def __str__(self) -> str:
        return f"Logged in at the car {self.car}."


@dataclass(frozen=True)
class CarLogoutReport:
    """The end of a login."""

    car: Annotated[str, "Address of the car."]
    was_logged_in: Annotated[bool, "Whether there was a login."]

    def __str__(self) -> str:
        was = "is forgotten" if self.was_logged_in else "was not kept"
        return f"The login at the car {self.car} {was}."


app = typer.Typer(
    no_args_is_help=True,
    help="Send models to the physical car, and drive it.\n\nExample: dr-car status",
)

ADDRESS, PASSWORD = "DR_CAR_ADDRESS", "DR_CAR_PASSWORD"

_Car = Annotated[
    str | None,
    typer.Option(
        "--car", metavar="HOST[:PORT]", help="Address of the car; DR_CAR_ADDRESS if left out."
    ),
]
_Model = Annotated[str, typer.Argument(metavar="NAME", help="Name of a model on the car.")]


@app.command()
def login(
    car: _Car = None,
    password_file: Annotated[
        Path | None,
        typer.Option(
            "--password-file", metavar="FILE", help="Read the password from it; - for stdin."
        ),
    ] = None,
    ca: Annotated[
        Path | None,
        typer.Option("--ca", metavar="FILE", help="Trust certificates of these authorities only."),
    ] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Accept any certificate, now and later.")
    ] = False,
    new_certificate: Annotated[
        bool, typer.Option("--new-certificate", help="Accept a certificate that has changed.")
    ] = False,
) -> None:
    """Log in at the car, and keep the login for the other commands.

    Asks for the password of the car's web page, or takes it from DR_CAR_PASSWORD or a file. Only
    the car's cookies are kept, in a file that only you can read. The car's certificate is accepted
    at the first login; later it must be the same.

    Example: dr-car login --car 192.168.1.50
    """
    if sum((insecure, ca is not None, new_certificate)) > 1:
        raise typer.BadParameter("Use only one of --ca, --insecure and --new-certificate.")
    address = _address(car)
    authorities = "" if ca is None else str(_authorities(ca))
    trusted, first = first_login(
        address, ca_file=authorities, insecure=insecure, new_certificate=new_certificate
    )
    if first:
        terminal.say(
            f"The car {address.place} has a certificate of its own making. This login accepts it, "
            f"and later the car must show the same one. SHA-256: {readable(trusted.fingerprint)}"
        )
    if insecure:
        terminal.warn("Any machine at this address can pose as the car and read the password.")
    CarWeb(address, trusted).log_in(_password(address, password_file))
    show(CarLoginReport(address.place, trusted.trust, trusted.fingerprint))
    _suggest([("dr-car list", "list the models on the car")], car)


@app.command()
def logout(car: _Car = None) -> None:
    """Forget the login at the car. Its certificate is kept.

    Example: dr-car logout
    """
    address = _address(car)
    show(CarLogoutReport(address.place, forget_login(address)))


@app.command()
def upload(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Archive NAME.tar.gz.")],
    car: _Car = None,
    force: Force = False,
) -> None:
    """Check an archive by the car's rules, send it, and wait until the car lists the model.

    The name of the model is that of the file. A model of the same name on the car is replaced,
    after a question.

    Example: dr-car upload my-model.tar.gz
    """
    checked = car_models.check_file(file)
    web = _open(car)
    if any(model.name == checked.name for model in car_models.list_models(web).models):
        question = f"The car {web.address.place} already has {checked.name}. Replace it?"
        prompts.agree(question, yes=force)
    with terminal.waiting(f"Sending {file.name} to {web.address.place} ..."):
        report = car_models.upload_model(web, checked, say=terminal.say)
    if not report.usable:
        terminal.warn(f"The car cannot load {report.model} now: {report.why}.")
    show(report)
    _suggest([(f"dr-car load {report.model}", "load it")], car)


@app.command("list")
def list_all(car: _Car = None) -> None:
    """List the models on the car, also those that it cannot use now.

    Example: dr-car list
    """
    show(car_models.list_models(_open(car)))


@app.command()
def load(name: _Model, car: _Car = None) -> None:
    """Load a model, and wait until the car reports it as loaded.

    Cars report that even where the network in the file cannot be used: such a car does not move
    after `dr-car start`.

    Example: dr-car load my-model
    """
    web = _open(car)
    with terminal.waiting(f"Loading {shown(name)}; the car may need a minute ..."):
        report = car_models.load_model(web, name)
    show(report)
    slow = ("dr-car speed 8", "limit the speed: the first drives below 10 %")
    _suggest([slow, ("dr-car start", "drive")], car)


@app.command()
def start(
    car: _Car = None,
    force: Force = False,
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.1, help="Stop after this time.")
    ] = None,
    speed_limit: Annotated[
        int | None,
        typer.Option("--speed", min=0, max=100, help="Limit the throttle first, in percent."),
    ] = None,
    detach: Annotated[
        bool, typer.Option("--detach", help="Return at once; the car drives until `dr-car stop`.")
    ] = False,
) -> None:
    """Let the car drive with the loaded model, until Ctrl-C stops it.

    Asks first, unless -f is given. The car is also stopped when the terminal is closed and when the
    start fails. If the car's IMU stops it, the command says so and ends. With --detach nothing
    stops it but `dr-car stop`.

    Example: dr-car start --speed 30 --seconds 60
    """
    if detach and seconds is not None:
        raise typer.BadParameter("--detach does not wait; leave out --seconds.")
    web = _open(car)
    car_driving.refuse_without_model(web)
    prompts.agree(f"The car {web.address.place} will drive off. Is its way clear?", yes=force)
    if speed_limit is not None:
        car_driving.set_speed(web, speed_limit)
    if detach:
        report = car_driving.start(web)
    else:
        report = car_driving.drive(web, seconds=seconds, warn=terminal.warn, say=terminal.say)
    show(report)
    if report.driving:
        _suggest([("dr-car stop", "stop it")], car)
    if report.imu_stop:
        _suggest([("dr-car start", "drive on, once its way is clear")], car)
    if report.interrupted:
        raise SystemExit(130)


@app.command()
def stop(car: _Car = None) -> None:
    """Stop the car at once.

    Sends only the request to stop, and repeats it if the car does not answer.

    Example: dr-car stop
    """
    show(car_driving.stop(_open(car)))


@app.command()
def speed(
    percent: Annotated[int, typer.Argument(metavar="PERCENT", help="From 0 to 100.")],
    car: _Car = None,
) -> None:
    """Limit the throttle of autonomous driving, until the car restarts.

    Example: dr-car speed 30
    """
    if not 0 <= percent <= 100:
        raise typer.BadParameter(f"{percent} is not a number from 0 to 100.")
    show(car_driving.set_speed(_open(car), percent))


@app.command()
def status(car: _Car = None) -> None:
    """Show the car's software, battery, sensors and loaded model, and what its IMU stops it at.

    Example: dr-car status --json
    """
    show(car_driving.read_status(_open(car)))


@app.command()
def config(
    values: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME=VALUE]...", help="Settings to change; none shows them all."),
    ] = None,
    car: _Car = None,
) -> None:
    """Show or change the settings of the car's software: steering, camera, IMU and others.

    Needs version 2.3.0 or later of the community's software. The car applies changes when it starts
    next.

    Example: dr-car config camera.orientation=180 steering.mode=servo
    """
    web = _open(car)
    show(car_config.set_config(web, values) if values else car_config.read_config(web))


@app.command()
def check(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="Archive of a model, to check the gray overlay for."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", metavar="FILE", help="File or folder; car-picture.jpg if left out."
        ),
    ] = None,
    car: _Car = None,
    force: Replace = False,
) -> None:
    """Take a picture with the car's camera, and check that it is what models expect.

    Guesses whether it is upside down, so look at it yourself. If the car lays its gray overlay over
    pictures, tells for an archive in how many camera frames that changes the action.

    Example: dr-car check my-model.tar.gz
    """
    path = out or Path()
    if path.is_dir():
        path /= "car-picture.jpg"
    refuse_existing(path, force=force)
    report = car_camera.check_camera(_open(car), path)
    for problem in report.problems:
        terminal.warn(problem)
    show(report)
    if report.gray_overlay and file is not None:
        found = compare_on_drive.checked_archive(file, _race())
        refuse(found.errors)
        if found.overlay is not None:
            tell = terminal.warn if found.overlay.is_low else terminal.say
            tell(found.overlay.told())


@app.command()
def latency(
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FOLDER]...", help="Recordings of the car (ROS bags)."),
    ] = None,
    write: Annotated[
        bool, typer.Option("-w", "--write", help="Write the settings into run.env.")
    ] = False,
    car: _Car = None,
) -> None:
    """Tell how late the car acts on a picture, as DR_SIM_LATENCY and DR_SIM_LATENCY_JITTER.

    Asks the car what it measured in its last drive, or reads recordings, which needs drcli[bags].

    Example: dr-car latency --write
    """
    if recordings:
        report = car_latency.recorded_latency(recordings)
    else:
        report = car_latency.asked_latency(_open(car))
    if write:
        edit = editing.set_values(working_folder(), report.settings)
        for warning in edit.warnings:
            terminal.warn(warning)
        report = replace(report, written=edit.changes[0].file)
    show(report)


def _race() -> "DriveConfig | None":
    try:
        return settings().race
    except SettingsError:
        return None


def _open(car: str | None) -> "CarWeb":
    return CarWeb.opened(_address(car))


def _suggest(commands: list[tuple[str, str]], car: str | None) -> None:
    """What comes next must not reach another car than this call did."""
    car = car or activation.chosen(os.environ).get(ADDRESS)
    terminal.suggest(commands, options={"--car": car})


def _address(car: str | None) -> "CarAddress":
    """Files are read last: a mistake in them must not prevent a stop."""
    if car is not None:
        return read_address(car, "--car")
    named = os.environ.get(ADDRESS)
    if named:
        return read_address(named, f"environment: {ADDRESS}")
    return read_address(settings_or_defaults().car_address, ADDRESS)


def _authorities(file: Path) -> Path:
    try:
        ssl.create_default_context(cafile=str(file))
    except (OSError, ValueError) as e:
        reason = getattr(e, "strerror", "") or "it has no certificates in PEM format"
        raise SettingsError(
            f"--ca {file}: cannot be used ({reason}).",
            remedy="Give a file with certificates in PEM format.",
        ) from e
    return file.resolve()


def _password(address: "CarAddress", file: Path | None) -> str:
    if file is not None:
        return _password_in(file)
    if os.environ.get(PASSWORD):
        return os.environ[PASSWORD]
    if not sys.stdin.isatty():
        raise SettingsError(
            f"There is no password for the car {address.place}.",
            remedy=f"Run this on a terminal, set {PASSWORD} in the environment, or give a file "
            "with --password-file.",
        )
    return prompts.secret(
        f"Password of the car {address.place}",
        f"Run the command again, set {PASSWORD} in the environment, or give a file with "
        "--password-file.",
    )


def _password_in(file: Path) -> str:
    try:
        text = sys.stdin.readline() if str(file) == "-" else file.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as e:
        raise SettingsError(
            f"--password-file {file}: cannot be read ({getattr(e, 'strerror', '') or 'no text'}).",
            remedy="Write the password into the first line of a text file.",
        ) from e
    password = (text.splitlines() or [""])[0]
    if not password:
        raise SettingsError(
            f"--password-file {file}: its first line is empty.",
            remedy="Write the password into the first line.",
        )
    return password
