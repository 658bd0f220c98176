"""How long calls of a reward function took."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = {"reward_ms": 1.0, "reward_time_ms": 1.0, "reward_s": 1000.0, "reward_time": 1000.0}
"""Milliseconds in the unit of each column; ours is `reward_ms`."""

_NO_CALL = ("prepare", "pause", "park")


@dataclass(frozen=True)
class RewardFunctionTime:
    calls: int
    p50_ms: float
    p99_ms: float
    total_s: float


def reward_function_time(steps: "pd.DataFrame") -> RewardFunctionTime | None:
    """None if the trace does not have it."""
    import pandas as pd

    for name, unit in COLUMNS.items():
        if name in steps:
            measured = pd.to_numeric(steps[name], errors="coerce")
            values = np.asarray(measured, dtype=np.float64) * unit
            if "episode_status" in steps:  # a call may take less than what the trace can tell
                called = (values >= 0) & ~np.asarray(steps["episode_status"].isin(_NO_CALL))
            else:
                called = values > 0
            values = values[np.isfinite(values) & called]
            if len(values):
                half, most = np.percentile(values, [50.0, 99.0])
                # Tables hold the column in single precision; more digits would be noise.
                return RewardFunctionTime(
                    len(values),
                    round(float(half), 6),
                    round(float(most), 6),
                    round(float(values.sum()) / 1000.0, 9),
                )
    return None
