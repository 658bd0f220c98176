"""The errors that a user can see: one sentence, one remedy, one exit code."""

from typing import ClassVar


class DrError(Exception):
    """An error that is explained to the user; anything else is shown as a traceback.

    Args:
        message: One sentence with file, line, key and value if there are any.
        remedy: What to do, starting with a verb.
    """

    code: ClassVar[int] = 1
    """Exit code of a process that ends with this error."""

    final: ClassVar[bool] = False
    """Whether trying again is pointless until somebody changes something."""

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
    """The server of the bucket does not answer: it is down or stuck."""


class NoKeys(StorageError):
    """This machine has no access keys for the bucket, or has none yet."""


class NotYet(StorageError):
    """A bucket or keys for it did not come; the same command may find them later.

    Source of the code: EX_TEMPFAIL of sysexits.h. Service managers and schedulers try again.
    """

    code = 75


class DiskFull(StorageError):
    """The bucket can be reached, but has no room left."""

    final = True


class WorkerDied(DrError):
    """A worker process ended, and starting it again did not help."""

    code = 5


class TrainingFailed(DrError):
    """Learning cannot continue; what was learned before is kept."""

    code = 6
    final = True


class OwnershipLost(DrError):
    """Another training has taken over the model; this one must not write to it any more."""

    code = 8
    final = True


class TrainedElsewhere(DrError):
    """Another machine or process trains the model, and it was asked not to wait for its end."""

    code = 9
    final = True


class EndWorkFailed(DrError):
    """The training is complete, but the upload or import at its end failed."""

    code = 10
    final = True


class BudgetUsedUp(DrError):
    """The budget of the day is used up. Source of the code: EX_TEMPFAIL of sysexits.h."""

    code = 75
    final = True


class NotAvailable(DrError):
    """A feature is not implemented yet, or needs a program that is not installed."""

    code = 7
    final = True


class Aborted(DrError):
    """The user did not answer yes; nothing was changed. Source: the reference's code."""

    code = 1
    final = True


class Absent(DrError):
    """Something is not running, or never ran. Source: the reference's code."""

    code = 1
    final = True


class OutputLost(DrError):
    """There is a result, but it cannot be printed."""

    code = 1
    final = True
