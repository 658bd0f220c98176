"""What `dr-evaluate` reports."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from drcli.exchange.episode_metrics import TrialMetrics
from drcli.exchange.laps import Laps, is_clean_lap, lap_time, laps_summary
from drcli.exchange.trace import STATUS_LABELS

COMPLETE = STATUS_LABELS["lap_complete"]


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
        penalty_s: Penalties in the lap time; None if nobody recorded them.
        start_position: Where on the lap it began, as a fraction of it; None if unknown.
        start_offset_m: How far to the left of the centre line it began; None if unknown.
        start_angle_deg: How far the car was turned to the left; None if unknown.
        end_waypoint: Waypoint closest to its end; None if unknown.
        immobilized: How often the car stood still for too long.
        reversed: How often it drove in the wrong direction.
        clean: Whether the lap was completed without violation, reset and penalty.
        time_text: Such as "7.80 s" or "12.80 s = 7.80 driven + 5.00 penalty, 1 reset".
    """

    trial: int
    progress: float
    lap_s: float
    status: str
    off_track: int
    crashes: int
    resets: int
    penalty_s: float | None = None
    start_position: float | None = None
    start_offset_m: float | None = None
    start_angle_deg: float | None = None
    end_waypoint: int | None = None
    immobilized: int = 0
    reversed: int = 0
    clean: bool = field(init=False)
    time_text: str = field(init=False)

    def __post_init__(self) -> None:
        """Decide whether the lap is clean, and put its time into words."""
        violations = self.off_track, self.crashes, self.immobilized, self.reversed
        clean = is_clean_lap(self.finished, *violations, self.resets, self.penalty_s)
        object.__setattr__(self, "clean", clean)
        text = lap_time(self.lap_s, self.penalty_s, self.resets)
        object.__setattr__(self, "time_text", text)

    @property
    def finished(self) -> bool:
        """Whether the lap was completed, with or without resets, as the reference counts it."""
        return self.status == COMPLETE


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
        limit: How far its best clean lap is from the limit of the car on the track; empty if there
            is no such lap, or no limit is known.
        lost: Where that lap loses most time, the worst place first.
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
    limit: str = ""
    lost: list[str] = field(default_factory=list)

    @property
    def clean(self) -> int:
        """How many laps were completed without reset and penalty."""
        return sum(trial.clean for trial in self.trials)

    @property
    def completed(self) -> int:
        """How many trials completed the lap, with or without resets."""
        return sum(trial.finished for trial in self.trials)

    @property
    def resets(self) -> int:
        """How often the car was put back on the track in all trials."""
        return sum(trial.resets for trial in self.trials)

    @property
    def total_s(self) -> float | None:
        """Simulated seconds of all trials together; None if a lap was not completed."""
        if self.completed < len(self.trials):
            return None
        return sum(trial.lap_s for trial in self.trials)

    @property
    def best_lap_s(self) -> float | None:
        """Fastest clean lap, simulated seconds; None without one."""
        return laps_of(self.trials).fastest_s

    @property
    def best_finished_s(self) -> float | None:
        """Fastest completed lap, penalties included; its resets are among those of the trials."""
        return best_finished_s(self.trials)

    @property
    def best_average_s(self) -> float | None:
        """Least mean time of `average_laps` completed laps in a row, penalties included.

        None if there are not that many in a row.
        """
        return best_average_s(self.trials, self.average_laps)


def laps_of(trials: Sequence[TrialReport]) -> Laps:
    return Laps(len(trials), [trial.lap_s for trial in trials if trial.clean])


def best_finished_s(trials: Sequence[TrialReport]) -> float | None:
    return min((trial.lap_s for trial in trials if trial.finished), default=None)


def best_lap(trials: Sequence[TrialReport]) -> TrialReport | None:
    """The fastest clean lap; else the fastest completed lap."""
    finished = [trial for trial in trials if trial.finished]
    return min(finished, key=lambda trial: (not trial.clean, trial.lap_s), default=None)


def best_average(trials: Sequence[TrialReport], laps: int) -> Sequence[TrialReport]:
    runs = (trials[first : first + laps] for first in range(len(trials) - laps + 1))
    whole = (run for run in runs if all(trial.finished for trial in run))
    return min(whole, key=lambda run: sum(trial.lap_s for trial in run), default=())


def best_average_s(trials: Sequence[TrialReport], laps: int) -> float | None:
    run = best_average(trials, laps)
    return sum(trial.lap_s for trial in run) / laps if run else None


def summary(trials: Sequence[TrialReport]) -> str:
    """Such as "2 of 3 laps clean (1 reset), 3 finished, best 7.73 s"."""
    best = best_lap(trials)
    return laps_summary(
        laps_of(trials),
        resets=sum(trial.resets for trial in trials),
        finished=sum(trial.finished for trial in trials),
        best="" if best is None else best.time_text,
    )


def trial_reports(records: Sequence[TrialMetrics]) -> list[TrialReport]:
    return [
        TrialReport(
            trial=record.trial,
            progress=record.completion_percentage,
            lap_s=record.elapsed_time_in_milliseconds / 1000.0,
            status=record.episode_status,
            off_track=record.off_track_count,
            crashes=record.crash_count,
            resets=record.reset_count,
            penalty_s=_seconds(record.penalty_in_milliseconds),
            start_position=record.start_position,
            start_offset_m=record.start_offset_m,
            start_angle_deg=record.start_angle_deg,
            end_waypoint=record.end_waypoint,
            immobilized=record.immobilized_count,
            reversed=record.reversed_count,
        )
        for record in records
    ]


def _seconds(milliseconds: float | None) -> float | None:
    return None if milliseconds is None else milliseconds / 1000.0
