"""What `dr-evaluate` reports."""

import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from drcli.bucket.bucket import (
    Bucket,
    ObjectDamaged,
    ObjectMissing,
    ObjectNewer,
    find_record,
    read_record,
)
from drcli.config.run_config import ModelConfig
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.model.training_records import at_once
from drcli.records.episode_metrics import TrialMetrics, decode_metrics_file
from drcli.records.evaluation_task import RaceRecording
from drcli.records.iteration import Laps, is_clean_lap, lap_time, laps_summary, paired_p
from drcli.records.trace import STATUS_LABELS, STEP_S
from drcli.tracks.limit_store import StoredLimit
from drcli.tracks.track_limit import limit_text

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


# What `dr-evaluate --laps` reports, and whether two samples differ.


SIGNIFICANT = 0.05
FEWEST_PAIRS = 6
APART_PERCENT = 4.0
"""Of the lap, between different places."""


@dataclass(frozen=True)
class EndPlace:
    """Where some laps ended that were not completed.

    Attributes:
        laps: How many ended there.
        first_waypoint: Closest to the first of them in driving order.
        last_waypoint: Closest to the last of them.
        from_percent: Where the first of them ended, in percent of the lap from waypoint 0 on.
        to_percent: Where the last of them ended.
        statuses: How often each status ended them: "Off track", "Crashed", ...
    """

    laps: int
    first_waypoint: int
    last_waypoint: int
    from_percent: float
    to_percent: float
    statuses: dict[str, int]


@dataclass(frozen=True)
class Comparison:
    """Whether two checkpoints that drove from the same starts differ by more than chance.

    Attributes:
        clean_only_first: Starts from which only the first drove a clean lap.
        clean_only_second: Starts from which only the second did.
        clean_p: McNemar's exact test of the clean shares, two-sided.
        both_clean: Starts from which both drove a clean lap.
        faster_s: By how much the first was faster there, on average; None without such a start.
        time_p: Exact permutation test of these pairs of lap times, two-sided; None likewise.
        verdict: What it means, in words.
    """

    clean_only_first: int
    clean_only_second: int
    clean_p: float
    both_clean: int
    faster_s: float | None
    time_p: float | None
    verdict: str


@dataclass(frozen=True)
class LapsReport:
    """The result of `dr-evaluate --laps`: laps from fresh starts, each to its first violation.

    Attributes:
        prefix: Model prefix in the bucket.
        world: The track.
        checkpoint: Name of the checkpoint or file that drove.
        seed: Of the starts; equal seeds give equal starts.
        driven: Number of laps.
        clean: Number of clean laps.
        clean_share: Share of clean laps, 0 to 1.
        clean_interval: Between which shares the true one is, with a confidence of 95 %.
        fastest_s: Time of the fastest clean lap; None without a clean lap, as the next ones.
        median_s: Median time of the clean laps.
        p90_s: The time that nine of ten clean laps do not exceed.
        slowest_s: Time of the slowest clean lap.
        ends: Where the other laps ended, the most frequent place first.
        laps: All laps, in the order of their starts along the track.
        simtrace: Key of the trace in the bucket.
        metrics: Key of the metrics in the bucket.
        runtime: What ran the policy: torch, pb, onnx, openvino or tflite.
        file: The file that drove; None for a checkpoint of the model.
        against: The other checkpoint, which drove from the same starts.
        comparison: What the two say together.
        limit: How far its fastest lap is from the limit of the car on the track; empty if unknown.
    """

    prefix: str
    world: str
    checkpoint: str
    seed: int
    driven: int
    clean: int
    clean_share: float
    clean_interval: tuple[float, float]
    fastest_s: float | None
    median_s: float | None
    p90_s: float | None
    slowest_s: float | None
    ends: list[EndPlace]
    laps: list[TrialReport]
    simtrace: str
    metrics: str
    runtime: str = "torch"
    file: str | None = None
    against: "LapsReport | None" = None
    comparison: Comparison | None = None
    limit: str = ""

    @property
    def name(self) -> str:
        """What messages call what drove: a checkpoint of a model, or a file."""
        return self.checkpoint if self.file is not None else f"{self.checkpoint} of {self.prefix}"


def laps_report(
    laps: list[TrialReport],
    *,
    prefix: str,
    world: str,
    checkpoint: str,
    seed: int,
    simtrace: str,
    metrics: str,
    runtime: str,
    file: str | None,
    line: StoredLimit | None = None,
) -> LapsReport:
    sample = laps_of(laps)
    return LapsReport(
        prefix=prefix,
        world=world,
        checkpoint=checkpoint,
        seed=seed,
        driven=sample.driven,
        clean=sample.clean,
        clean_share=sample.clean / sample.driven,
        clean_interval=sample.interval,
        fastest_s=sample.fastest_s,
        median_s=sample.median_s,
        p90_s=sample.p90_s,
        slowest_s=sample.slowest_s,
        ends=end_places(laps),
        laps=laps,
        simtrace=simtrace,
        metrics=metrics,
        runtime=runtime,
        file=file,
        limit=limit_text(sample.fastest_s, line),
    )


def end_places(laps: Sequence[TrialReport]) -> list[EndPlace]:
    """The most frequent place first."""
    ended = sorted(
        ((100.0 * lap.start_position + lap.progress) % 100.0, lap.end_waypoint, lap.status)
        for lap in laps
        if not lap.finished and lap.start_position is not None and lap.end_waypoint is not None
    )
    places: list[list[tuple[float, int, str]]] = []
    for end in ended:
        if places and end[0] - places[-1][-1][0] <= APART_PERCENT:
            places[-1].append(end)
        else:
            places.append([end])
    if len(places) > 1 and places[0][0][0] + 100.0 - places[-1][-1][0] <= APART_PERCENT:
        places[0] = [*places.pop(), *places[0]]  # one place around waypoint 0
    found = [
        EndPlace(
            laps=len(ends),
            first_waypoint=ends[0][1],
            last_waypoint=ends[-1][1],
            from_percent=ends[0][0],
            to_percent=ends[-1][0],
            statuses=dict(Counter(status for *_, status in ends).most_common()),
        )
        for ends in places
    ]
    return sorted(found, key=lambda place: -place.laps)


def compare(first: LapsReport, second: LapsReport) -> Comparison:
    """Of the same starts, in the same order."""
    pairs = list(zip(first.laps, second.laps, strict=True))
    both = [(one.lap_s, other.lap_s) for one, other in pairs if one.clean and other.clean]
    # Lap times are whole steps of the simulation.
    faster = [round((other_s - one_s) / STEP_S) for one_s, other_s in both]
    clean_p = paired_p(one.clean - other.clean for one, other in pairs)
    time_p = paired_p(faster) if both else None
    faster_s = sum(faster) / len(faster) * STEP_S if faster else None
    names = first.name, second.name
    if first.prefix == second.prefix:
        names = first.checkpoint, second.checkpoint
    verdict = _clean_verdict(first, second, names, clean_p)
    verdict += " " + _time_verdict(faster_s or 0.0, len(both), names, time_p or 1.0)
    return Comparison(
        clean_only_first=sum(one.clean and not other.clean for one, other in pairs),
        clean_only_second=sum(other.clean and not one.clean for one, other in pairs),
        clean_p=clean_p,
        both_clean=len(both),
        faster_s=faster_s,
        time_p=time_p,
        verdict=verdict,
    )


def _clean_verdict(
    first: LapsReport, second: LapsReport, names: tuple[str, str], clean_p: float
) -> str:
    shares = f"{first.clean} against {second.clean} of {first.driven}"
    if first.clean == second.clean:
        return f"Both drive equally many clean laps: {shares}."
    better, other = names if first.clean > second.clean else names[::-1]
    return f"{better} drives more clean laps than {other}, {shares}: {_chance(clean_p)}."


def _time_verdict(faster_s: float, starts: int, names: tuple[str, str], time_p: float) -> str:
    if starts < FEWEST_PAIRS:
        return "Their times cannot be compared: from too few starts both drove a clean lap."
    where = f"from the {starts} starts where both were clean"
    if faster_s == 0.0:
        return f"Both are equally fast {where}."
    better = names[0] if faster_s > 0.0 else names[1]
    return f"{better} is {abs(faster_s):.2f} s a lap faster {where}: {_chance(time_p)}."


def _chance(p: float) -> str:
    shown = f"p = {p:.3f}" if p >= 0.001 else "p < 0.001"
    return f"more than chance ({shown})" if p < SIGNIFICANT else f"may be chance ({shown})"


# Lists the stored stand-alone evaluations of a model.


MOST_EVALUATIONS = 200
_METRICS = re.compile(r"(?:EvaluationMetrics-|evaluation/(?:evaluation-)?)(\d{14})[^/]*\.json")


@dataclass(frozen=True)
class ListedEvaluation:
    """A stored evaluation; what nobody recorded is None or empty.

    Attributes:
        stamp: Its name, fourteen digits of its local time.
        best_lap_s: Fastest clean lap, simulated seconds.
        mean_lap_s: Of completed laps, penalties included.
        problem: Why its trials cannot be read.
        best_finished_s: Fastest completed lap, penalties included.
    """

    stamp: str
    world: str
    race_type: str
    reverse: bool | None
    checkpoint: str
    trials: list[TrialReport]
    complete_laps: int
    best_lap_s: float | None
    mean_lap_s: float | None
    off_track_penalty_s: float | None
    collision_penalty_s: float | None
    video: bool
    trace: bool
    problem: str = ""
    clean_laps: int = 0
    resets: int = 0
    best_finished_s: float | None = None
    summary: str = ""


@dataclass(frozen=True)
class EvaluationList:
    """The newest first, of `total`; `videos` such as `mp4/camera-pip/0-video.mp4`."""

    model: str
    evaluations: list[ListedEvaluation]
    total: int
    videos: list[str] = field(default_factory=list)


_VIDEO = re.compile(
    r"mp4/camera-(?:pip|45degree|topview)/\d{1,6}-video\.mp4|evaluation-\d{14}/video\.mp4"
)


def is_video(name: str) -> bool:
    return _VIDEO.fullmatch(name) is not None


def list_evaluations(config: ModelConfig, model: ModelStore) -> EvaluationList:
    folder = keys.folder(model.prefix)
    present = {info.key.removeprefix(folder) for info in model.bucket.list(folder)}
    metrics_prefix = ModelStore.of(config, model.bucket, model.prefix).metrics_prefix
    metrics_folder = keys.folder(metrics_prefix)
    metrics = {}
    for info in model.bucket.list(metrics_folder):
        found = _METRICS.fullmatch(info.key.removeprefix(metrics_folder))
        if found is not None:
            metrics[found[1]] = info.key
    stamps = sorted(metrics, reverse=True)

    def read(stamp: str) -> ListedEvaluation:
        recording = None
        if f"evaluation-{stamp}/recording.json" in present:
            recording = _recording(model.bucket, keys.evaluation_trace(model.prefix, stamp))
        return _listed(model.bucket, stamp, metrics[stamp], recording, present)

    videos = sorted(name for name in present if is_video(name))
    found_evaluations = at_once(read, stamps[:MOST_EVALUATIONS])
    return EvaluationList(model.url, found_evaluations, len(stamps), videos)


def _listed(
    bucket: Bucket, stamp: str, key: str, recording: RaceRecording | None, present: set[str]
) -> ListedEvaluation:
    trials: list[TrialReport] = []
    problem = ""
    try:
        trials = trial_reports(read_record(bucket, key, decode_metrics_file))
    except (ObjectMissing, ObjectDamaged, ObjectNewer) as error:
        problem = f"{error} {error.remedy}"
    laps, clean = [trial.lap_s for trial in trials if trial.finished], laps_of(trials)
    return ListedEvaluation(
        stamp=stamp,
        world=recording.world if recording is not None else "",
        race_type=recording.race_type if recording is not None else "",
        reverse=recording.reverse if recording is not None else None,
        checkpoint=recording.checkpoint if recording is not None else "",
        trials=trials,
        complete_laps=len(laps),
        best_lap_s=clean.fastest_s,
        mean_lap_s=sum(laps) / len(laps) if laps else None,
        off_track_penalty_s=recording.off_track_penalty_s if recording is not None else None,
        collision_penalty_s=recording.collision_penalty_s if recording is not None else None,
        video=f"evaluation-{stamp}/video.mp4" in present,
        trace=f"evaluation-{stamp}/evaluation-simtrace/0-iteration.csv" in present,
        problem=problem,
        clean_laps=clean.clean,
        resets=sum(trial.resets for trial in trials),
        best_finished_s=best_finished_s(trials),
        summary=summary(trials),
    )


def _recording(bucket: Bucket, trace: str) -> RaceRecording | None:
    with suppress(ObjectDamaged, ObjectNewer):
        return find_record(bucket, keys.recording_of(trace), RaceRecording.decode)
    return None
