"""The address of a car."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

from drcli.base.errors import BadValue, DrError, SettingsError, shown
from drcli.base.files import load_record, write_private_json
from drcli.config.value_types import car_host_and_port

HTTPS_PORT = 443


@dataclass(frozen=True)
class CarAddress:
    """Of its page."""

    host: str
    port: int = HTTPS_PORT

    @property
    def place(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == HTTPS_PORT else f"{host}:{self.port}"

    @property
    def url(self) -> str:
        return f"https://{self.place}"


def read_address(text: str, given_by: str) -> CarAddress:
    """The address in a text; SettingsError if it is not one."""
    if not text:
        raise SettingsError(
            "No car is named.",
            remedy="Give its address with --car, as in --car 192.168.1.50, or set DR_CAR_ADDRESS "
            "in the shell or in system.env.",
        )
    try:
        host, port = car_host_and_port(text)
    except BadValue as e:
        raise SettingsError(f"{given_by} {shown(text)} {e}.", remedy=e.remedy) from None
    return CarAddress(host, port)


# The login at a car, in a file for this user alone.
#
# It holds cookies, never the password.


Trust = Literal["fingerprint", "ca", "none"]
"""By the certificate seen first, an authority, or not at all."""

LOGIN_HOURS = 12
"""With the community's software (source: its login page); the original forgets a login at the next
one.
"""


@dataclass(frozen=True)
class CarLogin:
    """What is kept about one car.

    Attributes:
        fingerprint: SHA-256, hexadecimal.
        ca_file: Certificates of authorities.
        csrf_token: For changes.
    """

    trust: Trust = "fingerprint"
    fingerprint: str = ""
    ca_file: str = ""
    cookies: Mapping[str, str] = field(default_factory=dict)
    csrf_token: str = ""

    @property
    def is_open(self) -> bool:
        return bool(self.cookies)


def load_login(address: CarAddress) -> CarLogin | None:
    """None if unreadable."""
    return load_record(CarLogin, login_file(address))


def save_login(address: CarAddress, login: CarLogin) -> None:
    path = login_file(address)
    try:
        write_private_json(path, {**asdict(login), "cookies": dict(login.cookies)})
    except OSError as e:
        raise SettingsError(
            f"{path}: the login at the car cannot be kept ({e.strerror or e}).",
            remedy=f"Check that you can write {path.parent}, or set XDG_CACHE_HOME to another "
            "folder.",
        ) from e


def forget_login(address: CarAddress) -> bool:
    kept = load_login(address)
    if kept is None or not kept.is_open:
        return False
    save_login(address, replace(kept, cookies={}, csrf_token=""))
    return True


def login_file(address: CarAddress) -> Path:
    named = os.environ.get("XDG_CACHE_HOME", "")
    cache = Path(named) if Path(named).is_absolute() else Path.home() / ".cache"
    host = address.host.casefold().replace(":", "-")
    return cache / "drcli" / "cars" / f"{host}_{address.port}.json"


# What can go wrong with a car.


class CarError(DrError):
    """The car cannot be reached, or does not do what it was asked."""

    code: ClassVar[int] = 4


class CarSilent(CarError):
    """It is unknown whether the car did what it was asked."""


class CarRefused(CarError):
    """The car did not do it; `reason` has its own words."""

    def __init__(self, message: str, *, remedy: str, reason: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.reason = reason


class NotLoggedIn(SettingsError):
    """There is no login, or the car does not accept it any more."""
