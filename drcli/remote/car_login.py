"""The login at a car, in a file for this user alone.

It holds cookies, never the password.
"""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

from drcli.base.atomic_file import load_record, write_private_json
from drcli.base.errors import SettingsError
from drcli.remote.car_address import CarAddress

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
