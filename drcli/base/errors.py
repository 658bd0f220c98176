"""Errors that a user can see: sentence, remedy, exit code."""

from typing import ClassVar


class DrError(Exception):
    """Explained to the user; other errors are shown as tracebacks."""

    code: ClassVar[int] = 1
    final: ClassVar[bool] = False

    def __init__(self, message: str, *, remedy: str) -> None:
        super().__init__(message)
        self.remedy = remedy


class SettingsError(DrError):
    code = 3
    final = True


class StorageError(DrError):
    code = 4


class NoAnswer(StorageError):
    """It is down or stuck."""


class NoKeys(StorageError):
    """For the bucket."""


class NotYet(StorageError):
    """Bucket or keys may come later.

    EX_TEMPFAIL of sysexits.h: schedulers try again.
    """

    code = 75


class DiskFull(StorageError):
    final = True


class WorkerDied(DrError):
    """Starting it again did not help."""

    code = 5


class TrainingFailed(DrError):
    """What was learned is kept."""

    code = 6
    final = True


class OwnershipLost(DrError):
    """To another training."""

    code = 8
    final = True


class TrainedElsewhere(DrError):
    """And it was asked not to wait."""

    code = 9
    final = True


class EndWorkFailed(DrError):
    """Only an upload or import after a complete training."""

    code = 10
    final = True


class BudgetUsedUp(DrError):
    """EX_TEMPFAIL of sysexits.h."""

    code = 75
    final = True


class NotAvailable(DrError):
    """Not implemented, or not installed."""

    code = 7
    final = True


class Aborted(DrError):
    """Source: the reference's code."""

    code = 1
    final = True


class Absent(DrError):
    """Source: the reference's code."""

    code = 1
    final = True


class OutputLost(DrError):
    code = 1
    final = True
