"""One of several evaluations that share worker processes, and its outcome."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean
from typing import Annotated, Literal

from msgspec import Meta

from drcli.base.files import FileRecord
from drcli.base.json_record import JsonRecord, SafeInt, Seconds
from drcli.base.report import Col, View, bold, table
from drcli.records.episode_metrics import TrialMetrics

# What drives a racer of an evaluation, and which engine.


Runtime = Literal["torch", "pb", "onnx", "openvino", "tflite"]
"""PyTorch, our interpreter of frozen graphs, onnxruntime, OpenVINO, TensorFlow Lite."""


@dataclass(frozen=True)
class PolicySource:
    """A checkpoint of a model in the bucket, or a file here.

    Attributes:
        runtime: None: PyTorch, or a file's own engine.
        metadata: model_metadata.json; None if beside or inside the file.
        sha256: Of the checked file, so that no other drives.
    """

    runtime: Runtime | None = None
    file: Path | None = None
    metadata: Path | None = None
    sha256: str = ""


# How far a policy gets with each of the simulator's cars.


@dataclass(frozen=True)
class CarTrial:
    """What one car achieved."""

    car: Annotated[str, "Name of the set, a value of DR_SIM_CAR.", Col("car")]
    laps: Annotated[
        SafeInt,
        "Starts that completed a full lap.",
        Col("clean laps", of=lambda each: f"{each.laps} of {each.starts}"),
    ]
    starts: Annotated[SafeInt, "All starts."]
    mean_progress: Annotated[float, "Percent of the lap.", Col("progress", "{:.1f} %")]
    lap_times_s: Annotated[
        list[Seconds],
        "Of the full laps, simulated seconds.",
        Col("fastest s", "{:.2f}", of=lambda each: min(each.lap_times_s, default=None)),
    ]


@dataclass(frozen=True)
class CarTrials:
    """What all cars achieved."""

    world: Annotated[str, "The track."]
    cars: Annotated[list[CarTrial], "One trial for each car."]
    best: Annotated[
        str,
        "The car that suits the model: that of the settings, unless another completes "
        "more laps than by chance.",
    ]
    present: Annotated[str, "The car of the settings."]

    def view(self) -> View:
        best = next(trial for trial in self.cars if trial.car == self.best)
        advice = f"The car that suits it better: write DR_SIM_CAR={self.best} into run.env."
        if not best.laps:
            advice = (
                f"It drives no clean lap on {self.world}; if it learned another track, try that "
                "one with --world."
            )
        elif self.best == self.present:
            advice = f"No car suits it better than that of the settings: DR_SIM_CAR={self.best}."
        slowest = Col("slowest s", "{:.2f}", of=lambda each: max(each.lap_times_s, default=None))
        cars = table(self.cars, "car", "laps", "mean_progress", "lap_times_s", slowest)
        return [f"Likeliest actions on {self.world}:", cars, advice]


@dataclass(frozen=True)
class DrivenCars(FileRecord):
    FILE = "cars.json"

    cars: Annotated[list[CarTrial], Meta(min_length=1)]


# How a model drives under each disturbance, and one number.


NOMINAL_AXIS = "none"


@dataclass(frozen=True)
class RobustCell(JsonRecord):
    """All trials under one level of one disturbance.

    Attributes:
        axis: What is disturbed, such as "latency".
        level: How far, such as "0.1 s".
        trials: Laps tried, each from another start.
        completed: Laps completed without leaving the track or crashing.
        progress: Mean percent of the lap before the first violation.
        lap_s: Mean time of completed laps, simulated seconds; None without one.
        ended_by: How most other trials ended, such as "Off track"; empty without others.
    """

    axis: str
    level: str
    trials: SafeInt
    completed: SafeInt
    progress: float
    lap_s: Seconds | None
    ended_by: str = ""


_COLUMNS = (
    Col("disturbed", of=lambda cell: cell.axis, side="left"),
    Col("level", of=lambda cell: cell.level, side="left"),
    Col("clean laps", of=lambda cell: f"{cell.completed}/{cell.trials}"),
    Col("progress", "{:.0f} %", of=lambda cell: cell.progress),
    Col("lap time", "{:.2f} s", of=lambda cell: cell.lap_s, none=""),
    Col("ended by", of=lambda cell: cell.ended_by, side="left"),
)


@dataclass(frozen=True)
class RobustResult(JsonRecord):
    """A robust evaluation of one model on one track.

    Attributes:
        prefix: Model prefix in the bucket.
        checkpoint: Name of the checkpoint or file that drove.
        world: The track.
        seed: The same seed gives the same trials.
        cells: Axis by axis, from the nominal trials on.
        seconds: How long the driving took.
    """

    prefix: str
    checkpoint: str
    world: str
    seed: SafeInt
    cells: list[RobustCell]
    seconds: float

    @property
    def axis_scores(self) -> dict[str, float]:
        """Mean progress over the levels, percent."""
        axes = dict.fromkeys(cell.axis for cell in self.cells)
        return {
            axis: round(fmean(cell.progress for cell in self.cells if cell.axis == axis), 2)
            for axis in axes
        }

    @property
    def robust_score(self) -> float:
        """0 to 100: mean of the axes' scores."""
        return robust_score(self.cells)

    @property
    def broken_by(self) -> list[str]:
        """Levels with at most half as many completed laps as without disturbance."""
        nominal = [cell for cell in self.cells if cell.axis == NOMINAL_AXIS]
        share = fmean(cell.completed / cell.trials for cell in nominal) if nominal else 0.0
        return [
            f"{cell.axis} {cell.level}"
            for cell in self.cells
            if share > 0.0 and cell.completed / cell.trials <= share / 2
        ]

    def view(self) -> View:
        broken = ", ".join(self.broken_by)
        said = f"Broken by: {broken}." if broken else "No level of the grid broke it."
        if self.cells[0].completed == 0:
            said = "It completes no clean lap even without disturbance."
        firsts = {cell.axis: cell for cell in reversed(self.cells)}
        score = Col(
            "score of axis",
            of=lambda cell: (
                f"{self.axis_scores[cell.axis]:.1f}" if firsts[cell.axis] is cell else ""
            ),
        )
        driver = f"checkpoint {self.checkpoint} of {self.prefix} on {self.world}, seed {self.seed}"
        return [
            table(self.cells, *_COLUMNS, score),
            said,
            bold(f"Robust score {self.robust_score:.1f} of 100: {driver}."),
        ]


def robust_score(cells: Sequence[RobustCell]) -> float:
    """Mean over axes of mean progress over levels, 0 to 100."""
    axes: dict[str, list[float]] = {}
    for cell in cells:
        axes.setdefault(cell.axis, []).append(cell.progress)
    return round(fmean(fmean(levels) for levels in axes.values()), 2)


@dataclass(frozen=True)
class EvaluationTask:
    """A model to evaluate on a track.

    Attributes:
        source: May name a file instead of the checkpoint.
        robust: Drive the grid of disturbances.
        fresh_laps: Laps from fresh starts instead; 0: none.
    """

    number: SafeInt
    prefix: str
    metrics_prefix: str
    checkpoint: str
    world: str
    stamp: str
    source: PolicySource = field(default_factory=PolicySource)
    robust: bool = False
    fresh_laps: SafeInt = 0

    @property
    def outcome_file(self) -> str:
        return f"outcome-{self.number}.json"


@dataclass(frozen=True)
class TaskOutcome(JsonRecord):
    """What came of a task; `reason` says why nothing could be driven."""

    trials: list[TrialMetrics] = field(default_factory=list)
    robust: RobustResult | None = None
    notes: list[str] = field(default_factory=list)
    reason: str = ""
    remedy: str = ""
    code: SafeInt = 0


# What a trace does not tell about an evaluation, to film it later.


@dataclass(frozen=True)
class RecordedObjects(JsonRecord):
    """What stood and drove around the car in one episode of a trace.

    Attributes:
        poses: x and y in metres, yaw in radians, by row of the episode and object; a single row if
            nothing moved.
    """

    episode: SafeInt
    poses: list[list[list[float]]]


@dataclass(frozen=True)
class RaceRecording(JsonRecord):
    """What a film needs besides a trace; `shapes` are of `drsim.race.solids.SHAPES`."""

    world: str
    reverse: bool
    race_type: str
    model: str
    checkpoint: str
    racer: str
    color: str
    shapes: list[str] = field(default_factory=list)
    episodes: list[RecordedObjects] = field(default_factory=list)
    other_color: str = ""
    off_track_penalty_s: Seconds | None = None
    collision_penalty_s: Seconds | None = None
