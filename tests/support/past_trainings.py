"""Records of trainings for tests of what lists and compares them."""

import hashlib
from dataclasses import replace
from typing import Any

from drcli.records.training_record import (
    GitState,
    Pretrained,
    RecordedStart,
    TrainingRecord,
    TrainingResults,
)

DAY_S = 86_400.0
FIRST_S = 1_795_000_000.0
"""2026-11-18, 11:06 UTC."""


def training(number: int = 0, prefix: str = "team/model", **changes: Any) -> TrainingRecord:
    """A finished training that began so many days after the first one; `results` add to others."""
    results = {"iterations": 10, "best_lap_s": 15.0, "best_progress": 100.0}
    results |= changes.pop("results", {})
    start = RecordedStart(
        session=f"session-{number}",
        host="vm",
        started_at=FIRST_S + DAY_S * number,
        ended_at=FIRST_S + DAY_S * number + 600.0,
        state="finished",
        message="Training is complete.",
        seed=number,
        settings={"DR_WORLD_NAME": "reinvent_base", "DR_LOCAL_S3_MODEL_PREFIX": prefix},
        versions={"python": "3.11.7", "drcli": "0.2.0"},
        git={"working_folder": GitState("0123456789abcdef", dirty=True)},
        machine={"processor": "Xeon", "cores": 2},
        files={"reward_function.py": hashlib.sha256(b"reward").hexdigest()},
    )
    start = replace(start, **changes.pop("start", {}))
    fields: dict[str, Any] = {
        "began_at": start.started_at,
        "state": "finished",
        "message": start.message,
        "ended_at": start.ended_at,
        "number_of_starts": 1,
        "starts": (start,),
        "results": TrainingResults(**results),
        "hours": 1.0 + number,
        "world": "reinvent_base",
        "race_type": "TIME_TRIAL",
        "workers": 1,
        "algorithm": "clipped_ppo",
        "action_space": "discrete, 7",
        "hyperparameters": {"lr": 0.001, "batch_size": 64},
    }
    return TrainingRecord(f"{number:08x}", prefix, **{**fields, **changes})


def child(number: int, prefix: str, of: TrainingRecord, **changes: Any) -> TrainingRecord:
    """A training that began with the weights of another one."""
    parent = Pretrained(of.prefix, "best", "5_Step-500.ckpt", 80.0, "0" * 64)
    return training(number, prefix, parent=parent, parent_training=of.id, **changes)
