"""Calls a reward function in a separate process, which it may end, hang or crash.

`python -m drcli.rewards.sandbox.sandbox_process FOLDER PARENT_PID`. FOLDER holds the request and a
copy of the file, or only worlds and races are loaded. The result is written before loading the
racer's code, and at the end. With `-` as FOLDER, a request is read from standard input, and it is
tried in a copy of this process for each line that follows.
"""

import contextlib
import faulthandler
import gc
import json
import math
import os
import signal
import statistics
import subprocess
import sys
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from time import monotonic, perf_counter  # which racers' code may replace in `time`
from types import FunctionType
from typing import NamedTuple, NoReturn, TextIO

from drcli.base.early_process import Divided
from drcli.base.errors import Problem, ProblemsError
from drcli.base.installation import lazy_imports
from drcli.base.processes import keep_descendants, search_as_usual
from drcli.base.system_calls import limit_data
from drcli.config.run_config import DriveConfig
from drcli.drive.reward_access import confine_reward
from drcli.model.keys import REWARD_FUNCTION_FILE
from drcli.rewards.course import Call, Course, each_race
from drcli.rewards.sandbox.run_sandbox import (
    FAULTS_FILE,
    SERVES,
    CallIndex,
    Difference,
    Failure,
    FailureKind,
    Printed,
    SandboxRequest,
    SandboxResult,
    Timing,
    write_course,
)
from drcli.rewards.sandbox.sample_calls import is_sudden, sample_races, state_of
from drcli.rewards.sandbox.shared_state import (
    Effects,
    Originals,
    PrintCounter,
    SharedStateTrial,
    copied,
)
from drcli.rewards.scripted_drive import drive, read_actions
from drcli.rewards.track_grid import DrivenCourse
from drsim.car.actions import Actions
from drsim.episode.load_reward import load_reward_function
from drsim.episode.reward import RewardFunction, RewardParams, checked_reward
from drsim.errors import RewardError

with lazy_imports():
    from drcli.model.files import hyperparameters

FIRST_PASS_S, OTHER_PASS_S = 20.0, 4.0
_GRACE_S = 2.0
_PARENT_POLL_S = 1.0
_MEMORY_BYTES = 16 << 30
_ROUNDING = 1e-4
"""Rewards that differ by a smaller share are the same to a training."""

Values = dict[CallIndex, float | None]


class Calls(NamedTuple):
    """Episodes, `driven` of them driven; then the samples of races.

    The first `repeated` are called again, `placed` have places instead of a drive; `course` is the
    one that was driven.
    """

    sequences: Sequence[Sequence[Call]]
    driven: int
    races: Sequence[str]
    problems: list[Problem]
    repeated: int
    placed: range
    course: Course | None = None
    discount: float = 1.0


def calls_of(request: SandboxRequest) -> Calls:
    """Raises ProblemsError if the race to drive cannot be loaded."""
    actions = read_actions(request.metadata.encode() or None)
    sent, waypoints, repeated = request.sequences, request.waypoints, request.repeated
    course = None
    if request.drive is not None:
        course = DrivenCourse.of(drive(request.drive, actions)).course
        sent, waypoints, repeated = course.sequences, course.waypoints, len(course.trips)
    sequences = [
        [{**call, "waypoints": waypoints[call["is_reversed"]]} for call in calls] for calls in sent
    ]
    driven = Calls(
        sequences,
        len(sequences),
        [],
        [],
        repeated,
        range(repeated, len(sequences)),
        course,
        _discount_of(request.hyperparameters),
    )
    if request.races is None:
        return driven
    if request.drives:
        sequences += _driven(request.races, actions)
    samples, races, problems = sample_races(request.races, actions)
    return driven._replace(
        sequences=[*sequences, *samples], driven=len(sequences), races=races, problems=problems
    )


def _discount_of(file: str | None) -> float:
    """The default for a file with faults, which other checks tell."""
    if file is None:
        return 1.0
    with contextlib.suppress(ProblemsError):
        if file:
            return hyperparameters.Hyperparameters.from_bytes(file.encode()).discount_factor
    default: float = hyperparameters.Hyperparameters.model_fields["discount_factor"].default
    return default


def _driven(races: Sequence[DriveConfig], actions: Actions | None) -> Iterator[list[RewardParams]]:
    for own in each_race([each for each in races if each.untrainable is None]):
        with contextlib.suppress(ProblemsError):  # the samples tell what is wrong with the race
            driven = drive(own, actions)
            ways = driven.waypoints()
            for trip in driven.trips:
                yield [{**call, "waypoints": ways[call["is_reversed"]]} for call in trip.calls]


def try_function(
    request: SandboxRequest, file: Path, calls: Calls, faults: TextIO
) -> SandboxResult:
    """Make all calls, then repeat some."""
    passes = _Passes(request, file, calls, faults)
    with (
        contextlib.redirect_stdout(passes.printed),
        contextlib.redirect_stderr(passes.printed),
        SharedStateTrial(file, calls.sequences) as trial,  # begins before the file is loaded
    ):
        return passes.run(trial)


class _Passes:
    def __init__(self, request: SandboxRequest, file: Path, calls: Calls, faults: TextIO) -> None:
        self.printed = PrintCounter(str(file))
        self._request = request
        self._file = file
        self._calls = calls.sequences
        self._driven = calls.driven
        self._repeated = calls.repeated
        self._placed = calls.placed
        self._races = calls.races
        self._problems = calls.problems
        self._discount = calls.discount
        self._counting = True
        self._faults = faults
        self._effects = Effects(str(file))
        self._originals = Originals()
        self._failures: dict[tuple[FailureKind, str, int | None], Failure] = {}
        self._returned: Counter[str] = Counter()
        self._took_s: dict[CallIndex, float] = {}
        self._watched_until_s = 0.0
        self._hangs = False
        self._line: int | None = None
        self._discards: list[tuple[RewardError, CallIndex]] = []

    def run(self, trial: SharedStateTrial) -> SandboxResult:
        everything = [
            CallIndex(k, i) for k, calls in enumerate(self._calls) for i in range(len(calls))
        ]
        samples = [where for where in everything if where.sequence >= self._driven]
        driven = everything[: len(everything) - len(samples)]
        values: Values = {}
        counted, printed = 0, Printed()
        for places in filter(None, (samples, driven)):
            # The drive begins with a fresh copy, as each time that it is repeated.
            function = None if self._hangs else self._load(first=self._counting)
            if function is None:
                break
            self._took_s.clear()
            values |= self._play(function, places, FIRST_PASS_S, first=True)
            if self._counting:
                counted, printed, self._counting = len(values), self.printed.noted(), False
        if self._discards and len(self._discards) == len(values):
            self._record(*self._discards[0])  # every episode is broken: nothing can be learned
        random = memory = None
        repeated = [where for where in driven if where.sequence < self._repeated]
        if values and repeated and not self._hangs:
            random = self._difference(values, repeated)
            # The episodes in reverse order. To remember something within one is fine.
            turned = sorted(repeated, key=lambda where: -where.sequence)
            memory = self._difference(values, turned) if random is None else None
        if replaced := ", ".join(self._originals.replaced):
            what = f"The file replaces {replaced}, which the simulation and other packages use too."
            self._failures["replaces", "", None] = Failure("replaces", what)
        whole = values and (samples or repeated)
        shared = trial.result() if whole and not self._failures else None
        if shared is not None:  # what earlier passes have left is why these differ
            random = memory = None
        return SandboxResult(
            problems=self._problems,
            values=[
                [values.get(CallIndex(k, i)) for i in range(len(calls))]
                for k, calls in enumerate(self._calls)
            ],
            failures=list(self._failures.values()),
            returned=dict(self._returned),
            discount=self._discount,
            line=self._line,
            timing=_timing(self._took_s),
            calls=len(values),
            counted=counted,
            effects=self._effects.noted(),
            printed=printed,
            random=random,
            memory=memory,
            shared=shared,
        )

    def _load(self, *, first: bool = False) -> RewardFunction | None:
        self._effects.listening = first
        self._watch(self._request.load_s)
        try:
            function = load_reward_function(self._file)
        except RewardError as error:
            self._record(error, None)
            return None
        else:
            if isinstance(function, FunctionType):
                self._line = function.__code__.co_firstlineno
            return function
        finally:
            self._regain()
            self._unwatch()

    def _play(
        self,
        function: RewardFunction,
        places: Sequence[CallIndex],
        budget_s: float,
        *,
        first: bool = False,
    ) -> Values:
        last = _LastCall()
        timed = _timed(function, last)
        values: Values = {}
        end_s = monotonic() + budget_s
        for where in places:
            self._watch(self._request.call_s)
            params = copied(self._calls[where.sequence][where.index])
            self._effects.listening = first
            try:
                values[where] = checked_reward(timed, params, self._request.call_s)
            except RewardError as error:
                values[where] = None
                self._hangs = self._hangs or error.kind == "endless"
                if first and error.kind == "discard":
                    self._discards.append((error, where))
                elif first:
                    self._record(error, where, last.returned)
            finally:
                self._regain()
            if first and last.returned:
                self._returned[last.returned] += 1
            if first and values[where] is not None:
                self._took_s[where] = last.took_s
            if self._hangs or monotonic() > end_s:
                break
        self._unwatch()
        return values

    def _watch(self, limit_s: float) -> None:
        """End the process if one call takes far too long, even within a library.

        A thread for each call would cost more than most calls.
        """
        if monotonic() > self._watched_until_s - limit_s - _GRACE_S / 2:
            until_s = limit_s + _GRACE_S
            faulthandler.dump_traceback_later(until_s, exit=True, file=self._faults)
            self._watched_until_s = monotonic() + until_s

    def _unwatch(self) -> None:
        faulthandler.cancel_dump_traceback_later()
        self._watched_until_s = 0.0

    def _regain(self) -> None:
        self._originals.restore()
        self._effects.listening = False

    def _difference(self, values: Values, places: Sequence[CallIndex]) -> Difference | None:
        function = self._load()
        if function is None:
            return None
        others = self._play(function, places, OTHER_PASS_S)
        both = [where for where in others if where in values]
        unlike = sorted(
            (where for where in both if _differ(values[where], others[where])),
            key=lambda where: (where.sequence, where.index),
        )
        if not unlike:
            return None
        first = unlike[0]
        return Difference(first, values[first], others[first], len(unlike), len(both))

    def _record(self, error: RewardError, where: CallIndex | None, returned: str = "") -> None:
        """Failures that differ in numbers only count once."""
        cause = error.__cause__
        kind: FailureKind = (
            "undefined"
            if type(cause) is NameError
            else "raises"
            if error.kind == "discard"
            else error.kind
        )
        alike = "" if kind == "range" else returned
        key = (kind, type(cause).__name__ if cause else alike, error.line)
        times = int(self._counting)
        unusual = where is not None and self._is_unusual(where, kind)
        known = self._failures.get(key)
        if known is not None:
            both = known.unusual and unusual
            self._failures[key] = replace(known, times=known.times + times, unusual=both)
            return
        missing = cause.name if isinstance(cause, ImportError) else None
        self._failures[key] = Failure(
            kind=kind,
            reason=error.reason.replace(str(self._file), self._request.name),
            line=error.line or None,
            source=error.source,
            state=self._state(where) if where is not None else "",
            params=str(error.params) if error.params else "",
            missing=missing or "",
            times=times,
            unusual=unusual,
        )

    def _is_unusual(self, where: CallIndex, kind: FailureKind) -> bool:
        """Rewards of places also depend on the way there, which the drive shows."""
        if where.sequence < self._driven:
            return where.sequence in self._placed
        if kind == "range" and self._driven:
            return True
        return is_sudden(where.index, len(self._calls[where.sequence]))

    def _state(self, where: CallIndex) -> str:
        sample = where.sequence - self._driven
        race = self._races[sample] if sample >= 0 and self._races[1:] else ""
        return state_of(self._calls[where.sequence][where.index], race)


def _differ(one: float | None, other: float | None) -> bool:
    if one is None or other is None:
        return one is not other
    return not math.isclose(one, other, rel_tol=_ROUNDING)


@dataclass
class _LastCall:
    took_s: float = 0.0
    returned: str = ""


def _timed(function: RewardFunction, last: _LastCall) -> RewardFunction:
    @wraps(function)  # failures are placed by the code of the function itself
    def timed(params: RewardParams) -> float:
        last.returned = ""
        begun_s = perf_counter()
        try:
            value = function(params)
        finally:
            last.took_s = perf_counter() - begun_s
        kind = type(value)
        own = kind.__module__ in ("builtins", function.__module__)
        last.returned = kind.__name__ if own else f"{kind.__module__}.{kind.__name__}"
        return value

    return timed


def _timing(took_s: Mapping[CallIndex, float]) -> Timing | None:
    if not took_s:
        return None
    worst = max(took_s, key=lambda where: took_s[where])
    seconds = took_s.values()
    return Timing(statistics.median(seconds), statistics.fmean(seconds), took_s[worst], worst)


def _serve(parent_pid: int) -> tuple[Path, bool]:
    """Return in a copy of this process for each line: folder and `grid_only`, as an array.

    This process tells the number of the copy and then its exit code, each on a line, and ends with
    its input or the parent.
    """
    gc.freeze()  # a search for garbage would write to memory that the copies share
    for line in sys.stdin.buffer:
        pid = os.fork()
        if not pid:
            with Path(os.devnull).open("r+b") as nothing:
                os.dup2(nothing.fileno(), 0)
                os.dup2(nothing.fileno(), 1)
            folder, grid_only = json.loads(line)
            return Path(folder), grid_only
        os.write(1, f"{pid}\n".encode())
        copy, code = Divided(pid), None
        while code is None and os.getppid() == parent_pid:
            with contextlib.suppress(subprocess.TimeoutExpired):
                code = copy.wait(_PARENT_POLL_S)
        if code is None:
            break
        os.write(1, f"{code}\n".encode())
    os._exit(0)


def main(place: str, parent_pid: int) -> None:
    folder, request, calls = Path(place), None, None
    if place == SERVES:
        request = SandboxRequest.decode(sys.stdin.buffer.readline())
        calls = calls_of(request)
        own = os.getpid()
        folder, grid_only = _serve(parent_pid)
        if grid_only:
            calls = Calls([calls.sequences[len(request.sequences) - 1]], 1, [], [], 0, range(1))
        parent_pid = own
    keep_descendants(parent_pid)
    faults = (folder / FAULTS_FILE).open("w", encoding="utf-8", errors="backslashreplace")
    faulthandler.enable(faults)
    sys.excepthook = lambda _, error, trace: traceback.print_exception(error, file=faults)
    ends_at_once = os._exit

    def tell_and_end(status: int) -> NoReturn:
        faulthandler.dump_traceback(faults)
        ends_at_once(status)

    os._exit = tell_and_end
    # The simulation's own timer would end this process before the watch, which tells the line.
    signal.signal(signal.SIGPROF, signal.SIG_IGN)
    limit_data(_MEMORY_BYTES)
    request = request or SandboxRequest.read(folder)
    file = folder / REWARD_FUNCTION_FILE
    try:
        calls = calls or calls_of(request)
    except ProblemsError as error:
        SandboxResult(problems=[*error.problems]).write(folder)
        ends_at_once(0)
    if calls.course is not None:
        write_course(calls.course, folder)
    result = SandboxResult(problems=calls.problems, finished=not file.exists())
    result.write(folder)
    if not result.finished:
        confine_reward(folder)
        search_as_usual()
        try_function(request, file, calls, faults).write(folder)
    ends_at_once(0)  # does not wait for threads of the racer's code


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
