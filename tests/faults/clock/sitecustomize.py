"""Lets the clock of one machine jump: Python loads this at the start of each of its processes.

The file that FAULT_CLOCK names holds by how many seconds `time.time` is ahead. Monotonic clocks
never jump, on a real machine either.
"""

import os
import time
from pathlib import Path

_FILE = Path(os.environ.get("FAULT_CLOCK", ""))
_POLL_S = 0.2

_real = time.time
_monotonic = time.monotonic
_ahead_s = 0.0
_looked_s = -_POLL_S


def _jumping() -> float:
    global _ahead_s, _looked_s
    now_s = _monotonic()
    if now_s - _looked_s >= _POLL_S:
        _looked_s = now_s
        try:
            _ahead_s = float(_FILE.read_text())
        except (OSError, ValueError):
            _ahead_s = 0.0
    return _real() + _ahead_s


if "FAULT_CLOCK" in os.environ:
    time.time = _jumping
