"""Iteration records for tests that do not care about most of their numbers."""

from typing import Any

from drcli.records.iteration import IterationRecord


def iteration_record(iteration: int = 0, **changes: Any) -> IterationRecord:
    """One iteration of 4 episodes and 100 steps, with `changes` by field."""
    fields: dict[str, Any] = {
        "iteration": iteration,
        "checkpoint": f"{iteration}_Step-{100 * iteration}.ckpt",
        "episodes": 4,
        "steps": 100,
        "total_steps": 100 * (iteration + 1),
        "mean_reward": 1.5,
        "mean_progress": 20.0,
        "full_laps": 0,
        "best_lap_s": None,
        "entropy": 1.0,
        "surrogate_loss": 0.1,
        "value_loss": 0.2,
        "kl": 0.01,
        "steps_per_s": 500.0,
        "real_time_factor": 30.0,
        "drive_s": 0.3,
        "learn_s": 0.4,
        "exchange_s": 0.1,
        "elapsed_s": float(iteration),
    }
    return IterationRecord(**{**fields, **changes})
