"""What can go wrong with a car, apart from wrong settings and files."""

from typing import ClassVar

from drcli.base.errors import DrError, SettingsError


class CarError(DrError):
    """The car cannot be reached, or does not do what it was asked."""

    code: ClassVar[int] = 4


class CarSilent(CarError):
    """No answer came, so it is unknown whether the car has done what it was asked."""


class CarRefused(CarError):
    """The car answered that it did not do what it was asked.

    Args:
        message: The whole sentence.
        remedy: What to do.
        reason: The car's own words; empty without any.
    """

    def __init__(self, message: str, *, remedy: str, reason: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.reason = reason


class NotLoggedIn(SettingsError):
    """There is no login at the car, or the car does not accept it any more."""
