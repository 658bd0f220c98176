"""Evaluation results for tests of what is made of them."""

from drcli.records.scores import EvaluationResult


def evaluated(checkpoint: str, progress: float, lap_ms: float | None = None) -> EvaluationResult:
    """One evaluation episode of a checkpoint; it completed its lap where a lap time is given."""
    laps = [] if lap_ms is None else [lap_ms / 1000.0]
    return EvaluationResult(checkpoint, [progress], [0.0], laps)
