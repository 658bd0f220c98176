"""What can go wrong with a car."""

from typing import ClassVar

from drcli.base.errors import DrError, SettingsError


class CarError(DrError):
    """It cannot be reached, or does not do what it was asked."""

    code: ClassVar[int] = 4


class CarSilent(CarError):
    """It is unknown whether the car has done it."""


class CarRefused(CarError):
    """`reason` has the car's own words."""

    def __init__(self, message: str, *, remedy: str, reason: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.reason = reason


class NotLoggedIn(SettingsError):
    """The car does not accept the login any more, or there is none."""
