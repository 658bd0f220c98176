"""What stored traces are called on the page."""

from collections.abc import Iterator
from datetime import UTC, datetime

from drcli.base.report import counted
from drcli.records.iteration import counted_resets
from drcli.view.playback.stored_traces import StoredTrace
from drcli.web.evaluation_words import stamp_text


def trace_title(trace: StoredTrace) -> str:
    if trace.kind == "training":
        return f"Iteration {trace.iteration}" + (f", worker {trace.worker}" if trace.worker else "")
    if trace.kind == "evaluation":
        return f"Evaluation of {stamp_text(trace.stamp)}"
    return "Last race as the opponent"


def trace_text(trace: StoredTrace) -> str:
    """A line to choose it by: its name, and how well it was driven."""
    match trace.kind:
        case "training":
            name = f"Iteration {trace.iteration}"
        case "evaluation":
            number = f" ({trace.iteration})" if trace.iteration else ""
            name = stamp_text(trace.stamp) + number
        case "opponent":
            driven = datetime.fromtimestamp(trace.modified, UTC).astimezone()
            name = f"{driven:%Y-%m-%d %H:%M}"
    numbers = ", ".join(_numbers(trace))
    return f"{name}: {numbers}" if numbers else name


def _numbers(trace: StoredTrace) -> Iterator[str]:
    if trace.mean_progress is not None:
        yield f"progress {trace.mean_progress:.0f} %"
    if trace.mean_reward is not None:
        yield f"reward {trace.mean_reward:.1f}"
    clean = trace.full_laps if trace.clean_laps is None else trace.clean_laps
    if clean is not None and (clean or trace.clean_laps is not None):
        yield counted(clean, "clean lap")
    if trace.resets:
        yield counted_resets(trace.resets)
    if trace.best_lap_s is not None:
        yield f"best {trace.best_lap_s:.2f} s"
