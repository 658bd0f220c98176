"""What can go wrong with a car."""

from typing import ClassVar

from drcli.base.errors import DrError, SettingsError


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
