"""Errors that a user can see: sentence, remedy, exit code."""

from typing import ClassVar


class DrError(Exception):
    """An error that is explained to the user; others are shown as tracebacks.

    `remedy` starts with a verb.
    """

    code: ClassVar[int] = 1
    final: ClassVar[bool] = False

    def __init__(self, message: str, *, remedy: str) -> None:
        super().__init__(message)
        self.remedy = remedy


class SettingsError(DrError):
    """A setting, parameter file or reward function is wrong."""

    code = 3
    final = True


class StorageError(DrError):
    """The bucket cannot be reached, read or written."""

    code = 4


class NoAnswer(StorageError):
    """The bucket's server is down or stuck."""


class NoKeys(StorageError):
    """This machine has no keys for the bucket."""


class NotYet(StorageError):
    """The same command may find a bucket or keys later.

    EX_TEMPFAIL of sysexits.h: service managers and schedulers try again.
    """

    code = 75


class DiskFull(StorageError):
    """Of the bucket."""

    final = True


class WorkerDied(DrError):
    """Starting a worker again did not help."""

    code = 5


class TrainingFailed(DrError):
    """Learning cannot continue; what was learned is kept."""

    code = 6
    final = True


class OwnershipLost(DrError):
    """Another training has taken over the model."""

    code = 8
    final = True


class TrainedElsewhere(DrError):
    """Another process trains the model, and this one was asked not to wait."""

    code = 9
    final = True


class EndWorkFailed(DrError):
    """An upload or import after a complete training failed."""

    code = 10
    final = True


class BudgetUsedUp(DrError):
    """Of the day. EX_TEMPFAIL of sysexits.h."""

    code = 75
    final = True


class NotAvailable(DrError):
    """A feature is not implemented, or a program is not installed."""

    code = 7
    final = True


class Aborted(DrError):
    """Nothing was changed. Source of the code: the reference."""

    code = 1
    final = True


class Absent(DrError):
    """Not running. Source of the code: the reference."""

    code = 1
    final = True


class OutputLost(DrError):
    """The result cannot be printed."""

    code = 1
    final = True
