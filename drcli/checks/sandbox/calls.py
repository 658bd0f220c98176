"""A racer's function and its parameters, watched from outside. For a process of their own."""

import faulthandler
import math
import sys
import threading
from collections.abc import Callable, Iterator
from time import monotonic, perf_counter_ns, sleep  # which racers' code may put elsewhere in time
from typing import Any, TextIO

from drcli.checks.sandbox.side_effects import line_in
from drcli.checks.sandbox.statement import HANGS, FailureKind
from drsim.episode.reward import RewardFunction, RewardParams, as_number
from drsim.episode.reward_errors import code_of
from drsim.errors import RewardError


class Call:
    """A reward function with a watch and a witness.

    Attributes:
        took_s: How long the last call took.
        returned: Type of what it returned; empty if it returned nothing.
    """

    def __init__(self, function: RewardFunction) -> None:
        self._function = function
        # Failures are placed by the code of the function itself.
        self.__code__ = code_of(function)
        self.took_s = 0.0
        self.returned = ""
        self._number = False

    def __call__(self, params: RewardParams) -> float:
        self.returned = ""
        begun_ns = perf_counter_ns()
        try:
            value = self._function(params)
        finally:
            self.took_s = (perf_counter_ns() - begun_ns) / 1e9
        kind = type(value)
        self._number = as_number(value) is not None
        own = kind.__module__ in ("builtins", self._function.__module__)
        self.returned = kind.__name__ if own else f"{kind.__module__}.{kind.__name__}"
        return value

    def blame(self, error: RewardError) -> FailureKind:
        """Why the last call failed with this error."""
        if error.__cause__ is not None:
            return "raises"
        if not self.returned:
            return "endless"
        return "range" if self._number else "returns"


class Guard:
    """Ends the process when a call goes on and on, though it was interrupted.

    Args:
        faults: Open file for where that was.
        end: What ends the process, with an exit code.
    """

    def __init__(self, faults: TextIO, end: Callable[[int], object]) -> None:
        self._faults = faults
        self._end = end
        self._deadline_s = math.inf
        threading.Thread(target=self._watch, daemon=True).start()

    def begin(self, limit_s: float) -> None:
        """A call begins."""
        self._deadline_s = monotonic() + limit_s

    def end(self) -> None:
        """It is over."""
        self._deadline_s = math.inf

    def _watch(self) -> None:
        while monotonic() < self._deadline_s:
            sleep(0.5)
        self._faults.write(f"{HANGS}\n")
        self._faults.flush()
        faulthandler.dump_traceback(self._faults)
        self._end(1)


class Watched(dict[str, Any]):
    """Parameters that take note of what is looked at."""

    def __init__(
        self,
        params: RewardParams,
        reads: set[str],
        unknown: dict[str, int | None],
        file: str,
    ) -> None:
        super().__init__(params)
        self._reads = reads
        self._unknown = unknown
        self._file = file

    def __getitem__(self, key: str) -> Any:
        self._look(key)
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        """As a dictionary does."""
        self._look(key)
        return super().get(key, default)

    def __iter__(self) -> Iterator[str]:
        self._look_at_all()
        return super().__iter__()

    def items(self) -> Any:
        """As a dictionary does."""
        self._look_at_all()
        return super().items()

    def values(self) -> Any:
        """As a dictionary does."""
        self._look_at_all()
        return super().values()

    def _look(self, key: str) -> None:
        if super().__contains__(key):
            self._reads.add(key)
        elif isinstance(key, str):
            self._unknown.setdefault(key, line_in(self._file, sys._getframe(2)))

    def _look_at_all(self) -> None:
        # The sentence about a failure quotes the parameters, which is not the racer's doing.
        if line_in(self._file, sys._getframe(2)) is not None:
            self._reads.update(super().keys())
