"""The physical car."""

from drcli.config.fields import Group, setting
from drcli.config.value_types import CarHost


class PhysicalCarSettings(Group, title="Physical car", file="system.env"):
    """Its password is never a setting."""

    car_address: CarHost = setting(
        "DR_CAR_ADDRESS",
        "",
        "Address of the car's web page, host or host:port; `dr-car --car` overrides it.",
    )
