"""What `dr-evaluate` reports: trials, best lap, and the best average of laps in a row."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from drcli.exchange.episode_metrics import TrialMetrics

COMPLETE = "Lap complete"
"""Status of a trial that completed its lap."""


@dataclass(frozen=True)
class TrialReport:
    """One evaluation lap or trial.

    Attributes:
        trial: Counted from 1.
        progress: Percent of the lap.
        lap_s: Simulated seconds, penalties included.
        status: "Lap complete", "Off track", ...
        off_track: How often the car left the track.
        crashes: How often it crashed.
        resets: How often it was put back on the track.
    """

    trial: int
    progress: float
    lap_s: float
    status: str
    off_track: int
    crashes: int
    resets: int


@dataclass(frozen=True)
class EvaluationReport:
    """The result of `dr-evaluate`.

    Attributes:
        prefix: Model prefix in the bucket.
        world: The track.
        checkpoint: Name of the checkpoint or file that drove.
        trials: All trials, in order.
        simtrace: Key of the trace in the bucket.
        metrics: Key of the metrics in the bucket.
        runtime: What ran the policy: torch, pb, onnx, openvino or tflite.
        file: The file that drove; None for a checkpoint of the model.
        sha256: Of that file.
        opponent: The report of the other model in a HEAD_TO_MODEL race.
        average_laps: Number of consecutive laps of which `best_average_s` is the mean.
        notes: What was driven otherwise than the settings ask, and why.
        videos: Keys of its videos in the bucket; empty without DR_EVAL_SAVE_MP4.
    """

    prefix: str
    world: str
    checkpoint: str
    trials: list[TrialReport]
    simtrace: str
    metrics: str
    runtime: str = "torch"
    file: str | None = None
    sha256: str | None = None
    opponent: "EvaluationReport | None" = None
    average_laps: int = 3
    notes: list[str] = field(default_factory=list)
    videos: list[str] = field(default_factory=list)

    @property
    def completed(self) -> int:
        """How many trials completed the lap."""
        return sum(trial.status == COMPLETE for trial in self.trials)

    @property
    def total_s(self) -> float | None:
        """Simulated seconds of all trials together; None if a lap was not completed."""
        if self.completed < len(self.trials):
            return None
        return sum(trial.lap_s for trial in self.trials)

    @property
    def best_lap_s(self) -> float | None:
        """Fastest completed lap, simulated seconds."""
        laps = [trial.lap_s for trial in self.trials if trial.status == COMPLETE]
        return min(laps, default=None)

    @property
    def best_average_s(self) -> float | None:
        """Least mean time of `average_laps` completed laps in a row, penalties included.

        None if there are not that many in a row.
        """
        return best_average_s(self.trials, self.average_laps)


def best_average_s(trials: Sequence[TrialReport], laps: int) -> float | None:
    """Least mean time of so many completed laps in a row; None without them."""
    runs = (trials[first : first + laps] for first in range(len(trials) - laps + 1))
    whole = (run for run in runs if all(trial.status == COMPLETE for trial in run))
    return min((sum(trial.lap_s for trial in run) / laps for run in whole), default=None)


def trial_reports(records: list[TrialMetrics]) -> list[TrialReport]:
    """The trials of an evaluation as commands report them."""
    return [
        TrialReport(
            trial=record.trial,
            progress=record.completion_percentage,
            lap_s=record.elapsed_time_in_milliseconds / 1000.0,
            status=record.episode_status,
            off_track=record.off_track_count,
            crashes=record.crash_count,
            resets=record.reset_count,
        )
        for record in records
    ]
