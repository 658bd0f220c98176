"""What `dr-evaluate --laps` reports, and whether two samples differ."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from drcli.exchange.laps import paired_p
from drcli.exchange.trace import STEP_S
from drcli.exchange.track_limit import limit_text
from drcli.runs.evaluation_report import TrialReport, laps_of
from drcli.tracks.limit_store import StoredLimit

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
