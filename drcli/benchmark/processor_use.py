"""Other use of the processor during a measurement."""

import os
from collections.abc import Mapping

import psutil


class ProcessorUse:
    def __init__(self) -> None:
        self._all, self._own_s = self._read()

    def of_others(self) -> tuple[float, float]:
        """Shares of other programs, and of what the host took."""
        now, own_s = self._read()
        passed = {name: now[name] - self._all[name] for name in now}
        total_s = max(1e-9, sum(passed.values()))
        idle_s = passed.get("idle", 0.0) + passed.get("iowait", 0.0)
        stolen_s = passed.get("steal", 0.0)
        others_s = total_s - idle_s - stolen_s - (own_s - self._own_s)
        return max(0.0, others_s / total_s), max(0.0, stolen_s / total_s)

    @staticmethod
    def _read() -> tuple[Mapping[str, float], float]:
        times = psutil.cpu_times()._asdict()
        for part in ("guest", "guest_nice"):  # counted in user and nice already
            times.pop(part, None)
        spent = os.times()
        own_s = spent.user + spent.system + spent.children_user + spent.children_system
        return times, own_s
