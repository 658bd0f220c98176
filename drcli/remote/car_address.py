"""The address of a car."""

from dataclasses import dataclass

from drcli.base.errors import SettingsError
from drcli.base.problems import BadValue, shown
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
            "in system.env.",
        )
    try:
        host, port = car_host_and_port(text)
    except BadValue as e:
        raise SettingsError(f"{given_by} {shown(text)} {e}.", remedy=e.remedy) from None
    return CarAddress(host, port)
