"""What `dr-evaluate` reports."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated

from drcli.base.report import Col, Rows, View, bold, table
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
from drcli.records.iteration import (
    Laps,
    counted_resets,
    is_clean_lap,
    lap_time,
    laps_summary,
    paired_p,
)
from drcli.records.trace import STATUS_LABELS, STEP_S
from drcli.tracks.limit_store import StoredLimit
from drcli.tracks.track_limit import limit_text

COMPLETE = STATUS_LABELS["lap_complete"]


@dataclass(frozen=True)
class TrialReport:
    """One evaluation lap or trial."""

    trial: Annotated[int, "Counted from 1.", Col("trial")]
    progress: Annotated[float, "Percent of the lap.", Col("progress", "{:.0f} %")]
    lap_s: Annotated[float, "Simulated seconds, penalties included.", Col("lap time", "{:.2f} s")]
    status: Annotated[
        str,
        '"Lap complete", "Off track", ...',
        Col("ended", of=lambda trial: trial.ended(), side="left"),
    ]
    off_track: Annotated[int, "How often the car left the track.", Col("off track")]
    crashes: Annotated[int, "How often it crashed.", Col("crashes", lambda count: str(count or ""))]
    resets: Annotated[int, "How often it was put back on the track.", Col("resets")]
    penalty_s: Annotated[
        float | None,
        "Penalties in the lap time; None if nobody recorded them.",
        Col("penalty", lambda s: f"{s:.2f} s" if s else "", none=""),
    ] = None
    start_position: Annotated[
        float | None, "Where on the lap it began, as a fraction of it; None if unknown."
    ] = None
    start_offset_m: Annotated[
        float | None, "How far to the left of the centre line it began; None if unknown."
    ] = None
    start_angle_deg: Annotated[
        float | None, "How far the car was turned to the left; None if unknown."
    ] = None
    end_waypoint: Annotated[int | None, "Waypoint closest to its end; None if unknown."] = None
    immobilized: Annotated[int, "How often the car stood still for too long."] = 0
    reversed: Annotated[int, "How often it drove in the wrong direction."] = 0
    clean: Annotated[
        bool, "Whether the lap was completed without violation, reset and penalty."
    ] = field(init=False)
    time_text: Annotated[
        str, 'Such as "7.80 s" or "12.80 s = 7.80 driven + 5.00 penalty, 1 reset".'
    ] = field(init=False)

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

    def ended(self) -> str:
        if not self.finished:
            return self.status
        return "clean lap" if self.clean else "finished"


@dataclass(frozen=True, kw_only=True)
class _Driven:
    prefix: Annotated[str, "Model prefix in the bucket."]
    world: Annotated[str, "The track."]
    checkpoint: Annotated[str, "Name of the checkpoint or file that drove."]
    simtrace: Annotated[str, "Key of the trace in the bucket."]
    metrics: Annotated[str, "Key of the metrics in the bucket."]
    runtime: Annotated[str, "What ran the policy: torch, pb, onnx, openvino or tflite."] = "torch"
    file: Annotated[str | None, "The file that drove; None for a checkpoint of the model."] = None

    def driver(self) -> str:
        name = self.checkpoint
        if self.file is None:
            name = f"checkpoint {name} of {self.prefix}"
        engine = "" if self.runtime == "torch" else f" with --runtime {self.runtime}"
        return f"{name}{engine} on {self.world}"


@dataclass(frozen=True, kw_only=True)
class EvaluationReport(_Driven):
    """The result of `dr-evaluate`."""

    trials: Annotated[list[TrialReport], "All trials, in order."]
    sha256: Annotated[str | None, "Of that file."] = None
    opponent: Annotated[
        "EvaluationReport | None", "The report of the other model in a HEAD_TO_MODEL race."
    ] = None
    average_laps: Annotated[
        int, "Number of consecutive laps of which `best_average_s` is the mean."
    ] = 3
    notes: Annotated[list[str], "What was driven otherwise than the settings ask, and why."] = (
        field(default_factory=list)
    )
    videos: Annotated[
        list[str], "Keys of its videos in the bucket; empty without DR_EVAL_SAVE_MP4."
    ] = field(default_factory=list)
    limit: Annotated[
        str,
        "How far its best clean lap is from the limit of the car on the track; empty if "
        "there is no such lap, or no limit is known.",
    ] = ""
    lost: Annotated[list[str], "Where that lap loses most time, the worst place first."] = field(
        default_factory=list
    )

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

    def name(self) -> str:
        return self.prefix if self.file is None else self.checkpoint

    def sentence(self) -> str:
        words = summary(self.trials)
        run = best_average(self.trials, self.average_laps)
        if run and self.average_laps > 1:
            words += f", best average of {self.average_laps} laps {self.best_average_s:.2f} s"
            resets = sum(trial.resets for trial in run)
            words += f" with {counted_resets(resets)}" if resets else ""
        return f"{words}; {self.driver()}."

    def winner(self, other: "EvaluationReport") -> str:
        """More finished laps win, then less time."""
        if self.completed != other.completed:
            first = self if self.completed > other.completed else other
            return f"{first.name()} wins with more finished laps."
        if self.total_s is None or other.total_s is None or self.total_s == other.total_s:
            return "Nobody wins."
        first, second = (self, other) if self.total_s < other.total_s else (other, self)
        ahead_s = abs(self.total_s - other.total_s)
        return f"{first.name()} wins, {ahead_s:.2f} s ahead of {second.name()}."

    def view(self) -> View:
        driven = Col(
            "driven",
            of=lambda each: f"{each.lap_s - each.penalty_s:.2f} s" if each.penalty_s else "",
        )
        order = (
            "trial",
            "progress",
            "lap_s",
            driven,
            "penalty_s",
            "status",
            "off_track",
            "crashes",
            "resets",
        )
        other = self.opponent
        cars = [self] if other is None else [self, other]
        for each in cars:
            yield other and bold(each.name())
            yield table(each.trials, *order)
        yield from (bold(each.sentence()) for each in cars)
        if other is not None:
            yield bold(self.winner(other))
        else:
            yield self.limit and f"{self.limit}."
            yield self.lost and f"Most time is lost at {'; '.join(self.lost)}."
        yield from (f"Video: {key}" for each in cars for key in each.videos[-1:])


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
    """Where some laps ended that were not completed."""

    laps: Annotated[int, "How many ended there.", Col("laps")]
    first_waypoint: Annotated[
        int,
        "Closest to the first of them in driving order.",
        Col(
            "ended near",
            of=lambda each: _span("waypoint", each.first_waypoint, each.last_waypoint),
            side="left",
        ),
    ]
    last_waypoint: Annotated[int, "Closest to the last of them."]
    from_percent: Annotated[
        float,
        "Where the first of them ended, in percent of the lap from waypoint 0 on.",
        Col(
            "of the lap",
            of=lambda each: _span("", round(each.from_percent), round(each.to_percent)) + " %",
            side="left",
        ),
    ]
    to_percent: Annotated[float, "Where the last of them ended."]
    statuses: Annotated[
        dict[str, int],
        'How often each status ended them: "Off track", "Crashed", ...',
        Col("how", of=lambda each: each.how(), side="left"),
    ]

    def how(self) -> str:
        if len(self.statuses) == 1:
            return next(iter(self.statuses)).lower()
        return ", ".join(f"{count} {status.lower()}" for status, count in self.statuses.items())


@dataclass(frozen=True)
class Comparison:
    """Whether two checkpoints that drove from the same starts differ by more than chance."""

    clean_only_first: Annotated[int, "Starts from which only the first drove a clean lap."]
    clean_only_second: Annotated[int, "Starts from which only the second did."]
    clean_p: Annotated[float, "McNemar's exact test of the clean shares, two-sided."]
    both_clean: Annotated[int, "Starts from which both drove a clean lap."]
    faster_s: Annotated[
        float | None,
        "By how much the first was faster there, on average; None without such a start.",
    ]
    time_p: Annotated[
        float | None,
        "Exact permutation test of these pairs of lap times, two-sided; None likewise.",
    ]
    verdict: Annotated[str, "What it means, in words."]


@dataclass(frozen=True, kw_only=True)
class LapsReport(_Driven):
    """The result of `dr-evaluate --laps`: laps from fresh starts, each to its first violation."""

    seed: Annotated[int, "Of the starts; equal seeds give equal starts."]
    driven: Annotated[int, "Number of laps."]
    clean: Annotated[int, "Number of clean laps."]
    clean_share: Annotated[float, "Share of clean laps, 0 to 1."]
    clean_interval: Annotated[
        tuple[float, float], "Between which shares the true one is, with a confidence of 95 %."
    ]
    fastest_s: Annotated[
        float | None, "Time of the fastest clean lap; None without a clean lap, as the next ones."
    ]
    median_s: Annotated[float | None, "Median time of the clean laps."]
    p90_s: Annotated[float | None, "The time that nine of ten clean laps do not exceed."]
    slowest_s: Annotated[float | None, "Time of the slowest clean lap."]
    ends: Annotated[list[EndPlace], "Where the other laps ended, the most frequent place first."]
    laps: Annotated[list[TrialReport], "All laps, in the order of their starts along the track."]
    against: Annotated[
        "LapsReport | None", "The other checkpoint, which drove from the same starts."
    ] = None
    comparison: Annotated[Comparison | None, "What the two say together."] = None
    limit: Annotated[
        str, "How far its fastest lap is from the limit of the car on the track; empty if unknown."
    ] = ""

    @property
    def name(self) -> str:
        """What messages call what drove: a checkpoint of a model, or a file."""
        return self.checkpoint if self.file is not None else f"{self.checkpoint} of {self.prefix}"

    def sentence(self) -> str:
        low, high = (round(100.0 * share) for share in self.clean_interval)
        laps = "lap" if self.driven == 1 else "laps"
        words = (
            f"{self.clean} of {self.driven} {laps} clean ({low} to {high} % with 95 % confidence)"
        )
        if self.clean == 1:
            words += f", {self.fastest_s:.2f} s"
        elif self.clean:
            words += (
                f", median {self.median_s:.2f} s, 90 % within {self.p90_s:.2f} s, "
                f"slowest {self.slowest_s:.2f} s, best {self.fastest_s:.2f} s"
            )
        return f"{words}; {self.driver()}, seed {self.seed}."

    def view(self) -> View:
        both = [self] if self.against is None else [self, self.against]
        edges = _edges([lap.lap_s for each in both for lap in each.laps if lap.clean])
        order = ("first_waypoint", "from_percent", "laps", "statuses")
        for each in both:
            yield len(both) > 1 and bold(each.name)
            yield _histogram(each, edges)
            yield table(each.ends, *order)
        yield from (bold(each.sentence()) for each in both)
        yield from (each.limit and f"The best lap, {each.limit}." for each in both)
        yield self.comparison and bold(self.comparison.verdict)


_MOST_BARS = 12
_BAR = 16
_WIDTHS_S = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


def _edges(times_s: Sequence[float]) -> list[float]:
    if not times_s:
        return []
    low, high = min(times_s), max(times_s)
    width = next((w for w in _WIDTHS_S if high - low < (_MOST_BARS - 1) * w), _WIDTHS_S[-1])
    first, last = math.floor(low / width + 1e-9), math.floor(high / width + 1e-9)
    return [place * width for place in range(first, last + 2)]


def _histogram(report: LapsReport, edges: Sequence[float]) -> Rows:
    times_s = [lap.lap_s for lap in report.laps if lap.clean]
    counts = [
        (f"{low:.1f} to {high:.1f} s", sum(low <= time_s + 1e-9 < high for time_s in times_s))
        for low, high in pairwise(edges)
    ]
    counts += Counter(lap.status.lower() for lap in report.laps if not lap.clean).most_common()
    most = max(count for _, count in counts)
    cells = [
        (name, str(count), "\u2588" * math.ceil(_BAR * count / most)) for name, count in counts
    ]
    return Rows(("lap time", "laps", ""), cells, left=("lap time", ""))


def _span(word: str, first: int, last: int) -> str:
    """Such as "waypoint 7" or "waypoints 7 to 9"."""
    if first == last:
        return f"{word} {first}".strip()
    return f"{word and f'{word}s'} {first} to {last}".strip()


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
