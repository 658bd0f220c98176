"""How often a worker shows what it drives: as often as its time budget allows."""

from collections.abc import Callable, Iterable, Mapping
from time import monotonic, process_time

from drcli.exchange.live_record import LiveView

BUDGET_SHARE = 0.01
"""Share of the time of a worker that its live view may use, as processor time. Its threads also
disturb the others a little, and together they shall not cost more than 1.5 %."""

SAVED_S = 20.0
"""Unused budget of so many seconds is kept: while the trainer learns, there is nothing to show."""

FASTEST_S = 0.1
"""Least time between two messages of a view."""

SLOWEST_S: Mapping[LiveView, float] = {"camera": 5.0, "scene": 5.0, "chase": 60.0}
"""Most time between two messages of a view while cars drive."""

_FULL_SPEED: Mapping[LiveView, float] = {"camera": 0.03, "scene": 0.1, "chase": 1.0}
"""How full the account must be for the fastest rate. The view from behind costs by far the most,
so it becomes rarer first; what the car sees is what people look at longest, so it does so last."""


class WorkTime:
    """Seconds of a worker's time, of which a live view may use a share.

    While it waits for another worker, these are seconds of wall time. While it drives, they are
    seconds of processor time, but not more than of wall time: where other programs want the
    processor, a second of processor time delays it by longer than a second.
    """

    def __init__(self, waits: Callable[[], bool]) -> None:
        """Begin at 0."""
        self._waits = waits
        self._total_s = 0.0
        self._wall_s, self._processor_s = monotonic(), process_time()

    def __call__(self) -> float:
        """The seconds so far."""
        wall_s, processor_s = monotonic(), process_time()
        passed_s, used_s = wall_s - self._wall_s, processor_s - self._processor_s
        self._wall_s, self._processor_s = wall_s, processor_s
        self._total_s += passed_s if self._waits() else min(passed_s, used_s)
        return self._total_s


class Pace:
    """An account of processor time that fills steadily, and rates that follow what is left."""

    def __init__(
        self, worked_s: Callable[[], float], clock: Callable[[], float] = monotonic
    ) -> None:
        """Begin with a full account.

        Args:
            worked_s: The time of the worker, such as `WorkTime`.
            clock: Wall time, seconds.
        """
        self._worked_s = worked_s
        self._clock = clock
        self._most_s = BUDGET_SHARE * SAVED_S
        self._left_s = self._most_s
        self._counted_s = worked_s()
        self._shown_s: dict[LiveView, float] = {}

    def spend(self, cost_s: float) -> None:
        """Take used processor time from the account."""
        self._left_s = max(-self._most_s, self._left_s - cost_s)

    def shown(self, views: Iterable[LiveView]) -> None:
        """Note that these views were shown now."""
        self._shown_s |= dict.fromkeys(views, self._clock())

    def pauses_s(self, views: Iterable[LiveView]) -> dict[LiveView, float]:
        """How long each of these views is not to be shown yet; 0 if it may be shown now."""
        now_s, worked_s = self._clock(), self._worked_s()
        earned_s = BUDGET_SHARE * (worked_s - self._counted_s)
        self._left_s = min(self._most_s, self._left_s + earned_s)
        self._counted_s = worked_s
        return {
            view: max(0.0, self._shown_s[view] + self.interval_s(view) - now_s)
            if view in self._shown_s
            else 0.0
            for view in views
        }

    def interval_s(self, view: LiveView) -> float:
        """Time between two messages of a view with what is left now."""
        filled = self._left_s / self._most_s / _FULL_SPEED[view]
        if filled <= FASTEST_S / SLOWEST_S[view]:
            return SLOWEST_S[view]
        return FASTEST_S / min(1.0, filled)
