"""Calls a racer's reward function along a drive and notes all that it does.

For a process of its own: the racer's code is carried out here.
"""

import contextlib
import faulthandler
import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from drcli.checks.sandbox.calls import Call, Guard, Watched
from drcli.checks.sandbox.originals import Originals
from drcli.checks.sandbox.side_effects import Effects, Listener, growth, sizes
from drcli.checks.sandbox.statement import (
    Difference,
    Failure,
    FailureKind,
    Order,
    Place,
    Statement,
    Timing,
)
from drsim.episode.reward import RewardFunction, RewardParams, checked_reward, load_reward_function
from drsim.errors import RewardError

FIRST_PASS_S, OTHER_PASS_S = 20.0, 4.0
"""How long the calls of a pass may take; what is left over is not called."""

CALL_S, LOADING_S = 7.0, 62.0
"""A call is interrupted after 5 s, and loading after 60. What goes on all the same is ended, before
the simulation does so: it would look like code that ends its process."""

STUCK_S = 30.0
"""A pass that takes so long hangs within a library, where nothing but the end helps."""

Calls = Sequence[Sequence[RewardParams]]
Values = dict[tuple[int, int], float | None]
Where = tuple[int, int]


def testify(order: Order, faults: Any, guard: Guard) -> Statement:
    """Play all sequences, then the first ones again in several ways.

    Args:
        order: What to do.
        faults: Open file for what Python says where it is ended.
        guard: Told of each call.
    """
    effects = Effects(order.file)
    listener = Listener(order.file)
    with (
        contextlib.redirect_stdout(listener),
        contextlib.redirect_stderr(listener),
        effects.attached(),
    ):
        return _Witness(order, effects, listener, faults, guard).testify()


class _Witness:
    def __init__(
        self, order: Order, effects: Effects, listener: Listener, faults: Any, guard: Guard
    ) -> None:
        self._order = order
        self._effects = effects
        self._listener = listener
        self._faults = faults
        self._guard = guard
        self._originals = Originals()
        self._failures: dict[tuple[FailureKind, str, int | None], Failure] = {}
        self._returned: Counter[str] = Counter()
        self._changed: Counter[str] = Counter()
        self._took_s: dict[Where, float] = {}
        self._hangs = False

    def testify(self) -> Statement:
        order = self._order
        everything = list(_places(order.sequences))
        again = list(_places(order.sequences[: order.repeated]))
        begun_s = time.perf_counter()
        function = self._load(listening=True)
        if function is None:
            return self._statement({})
        load_s = time.perf_counter() - begun_s

        values = self._play(function, everything, FIRST_PASS_S, first=True)
        printed = self._listener.noted()
        if self._hangs or not values:
            return self._statement(values, load_s=load_s, printed=printed)
        module = getattr(function, "__globals__", {})
        before = sizes(module)
        repeated = self._play(function, again, OTHER_PASS_S)
        growing = growth(before, sizes(module), len(repeated)) if repeated else []
        del module, before

        random = self._difference(values, again)
        reads: set[str] = set()
        unknown: dict[str, int | None] = {}

        def watched(params: RewardParams) -> RewardParams:
            return Watched(params, reads, unknown, order.file)

        # The episodes the other way round. What is remembered within one is its own affair.
        turned = [
            where for k in reversed(range(order.repeated)) for where in again if where[0] == k
        ]
        memory = self._difference(values, turned, watched)
        return self._statement(
            values,
            load_s=load_s,
            printed=printed,
            growing=growing,
            random=random,
            memory=None if random is not None else memory,
            reads=sorted(reads),
            unknown=unknown,
        )

    def _load(self, *, listening: bool = False) -> RewardFunction | None:
        """A fresh copy of the function; None where that fails."""
        self._effects.listening = listening
        self._guard.begin(LOADING_S)
        try:
            return load_reward_function(Path(self._order.file))
        except RewardError as error:
            self._note("load", error, None)
            return None
        finally:
            self._regain()

    def _play(
        self,
        function: RewardFunction,
        places: Sequence[Where],
        budget_s: float,
        *,
        first: bool = False,
        dress: Callable[[RewardParams], RewardParams] = dict,
    ) -> Values:
        """Call the function for the places in turn, for as long as the budget lasts."""
        faulthandler.dump_traceback_later(STUCK_S, exit=True, file=self._faults)
        call = Call(function)
        values: Values = {}
        end_s = time.perf_counter() + budget_s
        for where in places:
            template = self._order.sequences[where[0]][where[1]]
            params = dress(self._params(template))
            printed = self._listener.characters
            self._effects.listening = first
            self._guard.begin(CALL_S)
            try:
                values[where] = checked_reward(call, params)
            except RewardError as error:
                values[where] = None
                kind = call.blame(error)
                if first:
                    self._note(kind, error, where, call.returned)
                self._hangs = self._hangs or kind == "endless"
            finally:
                self._regain()
            if first:
                self._listener.calls += self._listener.characters > printed
                if call.returned:
                    self._returned[call.returned] += 1
                if values[where] is not None:
                    self._took_s[where] = call.took_s
                self._compare(params, template)
            if self._hangs or time.perf_counter() > end_s:
                break
        faulthandler.cancel_dump_traceback_later()
        return values

    def _regain(self) -> None:
        """The racer's code is done: the process is ours again."""
        self._originals.restore()
        self._guard.end()
        self._effects.listening = False

    def _difference(
        self,
        values: Values,
        places: Sequence[Where],
        dress: Callable[[RewardParams], RewardParams] = dict,
    ) -> Difference | None:
        """The first place where a fresh copy, told of the places in this order, disagrees."""
        function = self._load()
        if function is None:
            return None
        others = self._play(function, places, OTHER_PASS_S, dress=dress)
        both = [where for where in others if where in values]
        unlike = sorted(where for where in both if others[where] != values[where])
        if not unlike:
            return None
        sequence, index = unlike[0]
        return Difference(
            place=Place(sequence=sequence, index=index),
            value=values[unlike[0]],
            other=others[unlike[0]],
            times=len(unlike),
            of=len(both),
        )

    def _params(self, template: RewardParams) -> RewardParams:
        """Parameters as the simulation gives them, fresh lists included."""
        params = {key: _copied(value) for key, value in template.items()}
        params["waypoints"] = list(self._order.waypoints[template["is_reversed"]])
        return params

    def _compare(self, params: RewardParams, template: RewardParams) -> None:
        """Count what the function has changed in its parameters."""
        original = self._params(template)
        if params == original:
            return
        for key in {*params, *original}:
            if key not in params or key not in original or params[key] != original[key]:
                self._changed[str(key)] += 1

    def _note(
        self, kind: FailureKind, error: RewardError, where: Where | None, returned: str = ""
    ) -> None:
        """Take note of a failure; of those that differ in numbers only, the first is enough."""
        alike = type(error.__cause__).__name__ if error.__cause__ else returned
        key = (kind, "" if kind == "range" else alike, error.line)
        known = self._failures.get(key)
        if known is not None:
            self._failures[key] = known.model_copy(update={"times": known.times + 1})
            return
        missing = error.__cause__.name if isinstance(error.__cause__, ImportError) else None
        self._failures[key] = Failure(
            kind=kind,
            what=str(error).splitlines()[0],
            line=error.line,
            source=error.source,
            missing=missing or "",
            first=None if where is None else Place(sequence=where[0], index=where[1]),
            times=1,
        )

    def _statement(self, values: Values, *, load_s: float = 0.0, **more: Any) -> Statement:
        return Statement(
            values=[
                [values.get((k, i)) for i in range(len(calls))]
                for k, calls in enumerate(self._order.sequences)
            ],
            failures=list(self._failures.values()),
            returned=dict(self._returned),
            timing=_timing(self._took_s, self._order.repeated, load_s),
            made=len(values),
            effects=self._effects.noted(),
            replaced=self._originals.replaced,
            changed=dict(self._changed),
            **more,
        )


def _places(sequences: Calls) -> Iterator[Where]:
    for k, calls in enumerate(sequences):
        for i in range(len(calls)):
            yield k, i


def _copied(value: Any) -> Any:
    return [_copied(item) for item in value] if isinstance(value, list) else value


def _timing(took_s: Mapping[Where, float], repeated: int, load_s: float) -> Timing | None:
    usual = {where: seconds for where, seconds in took_s.items() if where[0] < repeated}
    if not usual:
        return None
    worst = max(usual, key=lambda where: usual[where])
    return Timing(
        median_s=statistics.median(usual.values()),
        mean_s=statistics.fmean(usual.values()),
        worst_s=usual[worst],
        worst=Place(sequence=worst[0], index=worst[1]),
        load_s=load_s,
    )
