"""What a worker does when the racer's reward function fails: end, or count."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from drcli.base.errors import SettingsError
from drcli.base.json_record import RecordError
from drcli.base.log import get_logger
from drcli.bucket.bucket import Bucket, ObjectMissing
from drcli.config.groups.train_settings import FailureSettings
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.reward import MOST_ERRORS, RewardCounts, RewardErrorEntry, RewardErrorRecord
from drcli.workers.print_limit import reward_logger

if TYPE_CHECKING:
    from drsim.errors import RewardError

_logger = get_logger(__name__)

WINDOW_CALLS = 2_000
"""A car makes 15 calls in a simulated second. A function that always fails ends a training after
101 with the default share; one that fails once a lap never does, even if all cars are there at
once.
"""

SAVED_EVERY_S = 60.0
"""As long as no call has failed; a later share needs the number."""


_PACKAGES = {
    "PIL": "pillow",
    "cv2": "opencv-python",
    "skimage": "scikit-image",
    "sklearn": "scikit-learn",
    "yaml": "pyyaml",
}
"""Where the name of the module is another."""


_RETURNED = "it returned "
_RETURNS = (
    (
        ("None",),
        "Write a `return` with a number on every path, as in `return float(reward)`: a path "
        "without `return` gives None.",
    ),
    (
        ("'", '"', "b'", 'b"'),
        "Return the number instead of a text: without quotes, or as `return float(reward)`.",
    ),
    (
        ("array(", "[", "(", "{"),
        "Return one number of these, as in `return float(rewards[0])` or `float(sum(rewards))`; a "
        "comma after `return reward` makes a tuple.",
    ),
)
"""What helps against values that begin like this."""


class RewardErrorsExceeded(SettingsError):
    """More calls failed than DR_REWARD_MAX_ERROR_SHARE allows."""


class AllEpisodesDiscarded(SettingsError):
    """Every episode was declared broken: there is nothing to learn from."""


class RewardFailures:
    """Counts one worker's failures, in the bucket; `record` has the first `MOST_ERRORS`."""

    def __init__(
        self,
        settings: FailureSettings,
        worker: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.record = RewardErrorRecord(worker)
        self.newest_discard = ""
        self._settings = settings
        self._calls = 0
        self._failed_at: deque[int] = deque()
        self._bucket: Bucket | None = None
        self._key = ""
        self._clock = clock
        self._saved_s = clock()

    def restore(self, model: ModelStore) -> None:
        self._bucket = model.bucket
        self._key = keys.reward_errors(model.prefix, self.record.worker)
        try:
            self.record = RewardErrorRecord.decode(self._bucket.get(self._key))
        except ObjectMissing:
            return
        except RecordError as error:
            _logger.warning("%s is damaged and starts over: %s.", self._key, error)

    def begin(self, iteration: int) -> None:
        self.record = self.record.begun(iteration)

    def begin_simulation(self) -> None:
        self._calls = 0
        self._failed_at.clear()

    def count_calls(self, calls: int) -> None:
        made = calls - self._calls
        self._calls = calls
        newest = self.record.newest
        self.record = replace(self.record, newest=replace(newest, calls=newest.calls + made))

    def handle(self, error: "RewardError", calls: int) -> float:
        """The reward of a failed step, or 0 if its episode is broken.

        Raises:
            RewardError: Failures end the run, by DR_REWARD_ON_ERROR or because memory is short.
            RewardErrorsExceeded: Too many of the newest calls failed.
        """
        if error.kind == "discard":
            self._note(error, discarded=1)
            return 0.0
        if self._settings.reward_on_error == "stop" or isinstance(error.__cause__, MemoryError):
            raise error from error.__cause__
        self._note(error, failed=1)
        self._failed_at.append(calls)
        while self._failed_at[0] <= calls - WINDOW_CALLS:
            self._failed_at.popleft()
        share = self._settings.reward_max_error_share
        if WINDOW_CALLS > len(self._failed_at) <= share * WINDOW_CALLS:
            return self._settings.reward_fallback
        message, cure = message_of(error), _cure(error)
        raise RewardErrorsExceeded(
            f"{len(self._failed_at):,} of the last {WINDOW_CALLS:,} calls of the reward function "
            f"failed, and DR_REWARD_MAX_ERROR_SHARE is {share:g}. The newest failure: {message}",
            remedy=f"{cure} Continue with `dr-start-training --resume-or-start`. "
            "DR_REWARD_MAX_ERROR_SHARE is the limit; a training needs some calls that succeed.",
        )

    def save(self) -> None:
        """Unless something has failed, not every time."""
        total, now_s = self.record.total, self._clock()
        is_due = total.failed or total.discarded or now_s >= self._saved_s + SAVED_EVERY_S
        if self._bucket is not None and is_due:
            self._bucket.put(self._key, self.record.encode())
            self._saved_s = now_s

    def _note(self, error: "RewardError", *, failed: int = 0, discarded: int = 0) -> None:
        iteration = max(0, self.record.iteration)
        entry = RewardErrorEntry(
            kind=error.kind,
            exception="" if error.__cause__ is None else type(error.__cause__).__name__,
            reason=error.reason if error.file is None else _without_path(error.reason, error),
            line=error.line,
            source=error.source,
            params=str(error.params) if error.params else "",
            first_iteration=iteration,
            last_iteration=iteration,
        )
        if discarded:
            self.newest_discard = entry.text
        known = self.record.total.errors
        is_new = len(known) < MOST_ERRORS and entry.key not in {each.key for each in known}
        counts = RewardCounts(failed=failed, discarded=discarded, errors=[entry])
        self.record = replace(self.record, newest=self.record.newest.joined(counts))
        if is_new:
            what = "declares an episode broken" if discarded else "failed and is counted"
            reward_logger.warning("The reward function %s: %s", what, message_of(error))


def message_of(error: "RewardError") -> str:
    """Without the path of our copy of the file."""
    return _without_path(str(error), error)


def file_of(error: "RewardError") -> str:
    return keys.REWARD_FUNCTION_FILE if error.file is None else error.file.name


def _without_path(text: str, error: "RewardError") -> str:
    return text if error.file is None else text.replace(str(error.file), error.file.name)


def reward_failure(error: "RewardError") -> SettingsError:
    """The failure of a reward function for the person who runs a command."""
    text, cure = message_of(error), _cure(error)
    return SettingsError(
        f"Reward function error: {text}",
        remedy=f"{cure} Then run the command again; a training "
        "continues with `dr-start-training --resume-or-start`.",
    )


def cure_of(reason: str, missing: str, source: str = "") -> str:
    """What helps against the commonest failures, else nothing.

    `missing`: a module; `source`: the line that failed.
    """
    if module := missing.partition(".")[0]:
        package = _PACKAGES.get(module, module)
        return f"Install it where trainings run, as with `pip install {package}`, or do without."
    if reason.startswith("IndexError") and ("out of range" in reason or "out of bounds" in reason):
        if "objects_" in source:
            return (
                "In a race without objects, such as a time trial, their lists are empty: use them "
                'only below `if params["objects_location"]:`.'
            )
        return (
            "After the last waypoint comes the first: write `waypoints[i % len(waypoints)]` where "
            "an index may pass the end."
        )
    if reason.startswith(_RETURNED):
        value = reason.removeprefix(_RETURNED)
        if value.partition(",")[0].rstrip(")").endswith("j"):
            return (
                "A root of a negative number is complex: limit what is below it, as in "
                "`max(0.0, x) ** 0.5`."
            )
        return next((cure for begins, cure in _RETURNS if value.startswith(begins)), "")
    return ""


def _cure(error: "RewardError") -> str:
    cause = error.__cause__
    missing = (isinstance(cause, ImportError) and cause.name) or ""
    known = cure_of(error.reason, missing, error.source)
    return known or f"Correct {file_of(error)}."
