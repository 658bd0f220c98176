"""How often a worker shows what it drives: as its time budget allows."""

from collections.abc import Callable, Iterable, Mapping
from time import monotonic, process_time

from drcli.exchange.live_record import LiveView

BUDGET_SHARE = 0.01
"""Of a worker's processor time. Its threads also disturb others; together at most 1.5 %."""

SAVED_S = 20.0
"""Of unused budget: while the trainer learns, there is nothing to show."""

FASTEST_S = 0.1
SLOWEST_S: Mapping[LiveView, float] = {"camera": 5.0, "scene": 5.0, "chase": 60.0}
_FULL_SPEED: Mapping[LiveView, float] = {"camera": 0.03, "scene": 0.1, "chase": 1.0}
"""How full the account must be for the fastest rate. The view from behind costs most and becomes
rarer first; the camera, which people look at longest, does so last.
"""


class WorkTime:
    """Seconds of a worker's time, of which a live view may use a share.

    Wall time while it waits; else processor time, at most wall time: on a busy machine, a
    second of it delays by longer.
    """

    def __init__(self, waits: Callable[[], bool]) -> None:
        self._waits = waits
        self._total_s = 0.0
        self._wall_s, self._processor_s = monotonic(), process_time()

    def __call__(self) -> float:
        wall_s, processor_s = monotonic(), process_time()
        passed_s, used_s = wall_s - self._wall_s, processor_s - self._processor_s
        self._wall_s, self._processor_s = wall_s, processor_s
        self._total_s += passed_s if self._waits() else min(passed_s, used_s)
        return self._total_s


class Pace:
    """An account of processor time that fills steadily, and rates that follow it."""

    def __init__(
        self, worked_s: Callable[[], float], clock: Callable[[], float] = monotonic
    ) -> None:
        self._worked_s = worked_s
        self._clock = clock
        self._most_s = BUDGET_SHARE * SAVED_S
        self._left_s = self._most_s
        self._counted_s = worked_s()
        self._shown_s: dict[LiveView, float] = {}

    def spend(self, cost_s: float) -> None:
        self._left_s = max(-self._most_s, self._left_s - cost_s)

    def shown(self, views: Iterable[LiveView]) -> None:
        self._shown_s |= dict.fromkeys(views, self._clock())

    def pauses_s(self, views: Iterable[LiveView]) -> dict[LiveView, float]:
        """0 if a view may be shown now."""
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
        filled = self._left_s / self._most_s / _FULL_SPEED[view]
        if filled <= FASTEST_S / SLOWEST_S[view]:
            return SLOWEST_S[view]
        return FASTEST_S / min(1.0, filled)
