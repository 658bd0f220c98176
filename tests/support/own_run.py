"""The record of a training that this process seems to supervise."""

import os
import time
from typing import Any

import psutil

from drcli.records.run_record import RunRecord


def own_run(**changes: Any) -> RunRecord:
    """A run that began just now and goes on, with other values for some of its fields."""
    values: dict[str, Any] = {
        "run_id": 0,
        "session": "one",
        "bucket": "bucket",
        "prefix": "model-1",
        "world": "reinvent_base",
        "state": "running",
        "pid": os.getpid(),
        "pid_started": psutil.Process().create_time(),
        "started_at": time.time(),
    }
    return RunRecord(**{**values, **changes})
