"""Writes the learner's numbers of each iteration, by CleanRL's names: CSV and log."""

import csv
import io
import math
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from statistics import fmean, median
from typing import TYPE_CHECKING

from drcli.base.errors import StorageError
from drcli.base.log import get_logger
from drcli.bucket.bucket import ObjectMissing
from drcli.metrics.figure_events import Ended, EpochPoint, Point, TrainingFacts
from drcli.metrics.open_sinks import FigureSender, sender_of_trainer
from drcli.model import keys
from drcli.model.files.network_shape import Design
from drcli.model.growing_file import GrowingFile, Layout, list_parts
from drcli.model.history import ITERATIONS_PER_PART
from drcli.model.model_store import ModelStore
from drcli.records.iteration import IterationRecord
from drcli.records.job import Job
from drcli.train.scoring import REMEMBERED_SCORES

if TYPE_CHECKING:
    from drcli.learn.update_result import Stats  # loads torch, which a command does without

_logger = get_logger(__name__)

NUMBER, STEPS = "iteration", "global_step"


Row = dict[str, float]


def row_of(record: IterationRecord, stats: "Stats | None" = None) -> Row:
    row: dict[str, float | None] = {
        NUMBER: record.iteration,
        STEPS: record.total_steps,
        "charts/episodic_return": record.mean_reward,
        "charts/episodic_length": record.steps / record.episodes if record.episodes else None,
        "charts/SPS": record.total_steps / record.elapsed_s if record.elapsed_s else None,
        "losses/value_loss": record.value_loss,
        "losses/policy_loss": record.surrogate_loss,
        "losses/approx_kl": record.kl,
        "losses/actor_loss": record.actor_loss,
        "losses/qf_loss": record.critic_loss,
        "losses/alpha": record.alpha,
        "losses/entropy": record.entropy,
        "losses/imitation_loss": record.imitation_loss,
    }
    if stats is not None:
        row |= stats.metrics()
    return {name: x for name, x in row.items() if x is not None and math.isfinite(x)}


def with_losses(record: IterationRecord, stats: "Stats | None") -> IterationRecord:
    numbers = {} if stats is None else stats.metrics()
    return replace(
        record,
        entropy=numbers.get("losses/entropy", math.nan),
        surrogate_loss=numbers.get("losses/policy_loss", math.nan),
        value_loss=numbers.get("losses/value_loss", math.nan),
        kl=numbers.get("losses/approx_kl", math.nan),
        actor_loss=numbers.get("losses/actor_loss"),
        critic_loss=numbers.get("losses/qf_loss"),
        alpha=numbers.get("losses/alpha"),
        imitation_loss=numbers.get("losses/imitation_loss"),
    )


def line_of(row: Row) -> str:
    return "Metrics> " + " ".join(f"{name}={_text(value)}" for name, value in row.items())


class LearnerMetrics:
    """`metrics/learner.csv`: a row for each iteration.

    It never stops a training. After `restore`, only one thread may use it.
    """

    def __init__(self, model: ModelStore) -> None:
        self._bucket = model.bucket
        self._key = keys.learner_metrics(model.prefix)
        self._columns = [NUMBER, STEPS]
        self._file = GrowingFile(
            model.bucket, self._key, _layout(self._columns), iterations_per_part=ITERATIONS_PER_PART
        )

    def restore(self, history: Iterable[IterationRecord]) -> str | None:
        """Fills gaps from the history; returns what is wrong with the file."""
        problem, written, parts = None, dict[int, Row](), list[str]()
        try:
            parts = list_parts(self._bucket, self._key)
            for key in (self._key, *parts):
                with suppress(ObjectMissing):
                    written |= _read(self._bucket.get(key))
        except (StorageError, ValueError, csv.Error) as error:
            problem = f"{self._bucket.name}/{self._key} cannot be read and is replaced: {error}"
        rows = [(r.iteration, row_of(r) | written.get(r.iteration, {})) for r in history]
        self._columns = columns_of(row for _, row in rows)
        self._file.layout = _layout(self._columns)
        lines = ((iteration, _line(row, self._columns)) for iteration, row in rows)
        self._file.restore(lines, parts, outdated=True)
        return problem

    def add(self, row: Row) -> None:
        columns = columns_of([dict.fromkeys(self._columns, 0.0), row])
        new = len(columns) - len(self._columns)
        if new:
            self._columns = columns
            self._file.replace(_layout(columns), lambda line: line[:-1] + b"," * new + b"\n")
        try:
            self._file.put(int(row[NUMBER]), _line(row, columns))
        except StorageError as error:
            _logger.warning("%s/%s was not written: %s", self._bucket.name, self._key, error)

    def finish(self) -> None:
        self._file.finish()


def columns_of(rows: Iterable[Mapping[str, float]]) -> list[str]:
    return list(dict.fromkeys([NUMBER, STEPS, *(name for row in rows for name in row)]))


def _layout(columns: Sequence[str]) -> Layout:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(columns)  # quotes a name with a comma
    return Layout(text.getvalue().encode(), b"", b"")


def _line(row: Mapping[str, float], columns: Sequence[str]) -> bytes:
    cells = (_text(row[name]) if name in row else "" for name in columns)
    return f"{','.join(cells)}\n".encode()


def _read(data: bytes) -> dict[int, Row]:
    """The readable rows by iteration.

    Raises:
        ValueError, csv.Error: It is another kind of file.
    """
    reader = csv.DictReader(io.StringIO(data.decode(), newline=""))
    if not {NUMBER, STEPS} <= set(reader.fieldnames or ()):
        raise ValueError(f"it has no columns {NUMBER} and {STEPS}")
    rows = {}
    for cells in reader:
        row = {name: x for name, text in cells.items() if (x := _number(name, text)) is not None}
        if NUMBER in row:
            rows[int(row[NUMBER])] = row
    return rows


def _number(name: object, text: object) -> float | None:
    if not isinstance(name, str) or not isinstance(text, str):
        return None  # more or fewer cells than columns
    if name not in (NUMBER, STEPS) and not name.startswith(("charts/", "losses/")):
        return None
    try:
        number = int(text) if name in (NUMBER, STEPS) else float(text)
        return number if math.isfinite(number) else None
    except (ValueError, OverflowError):  # not a number, or an integer larger than any float
        return None


def _text(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"


# The figures of a training for the tools of others.


class LiveFigures:
    """What a trainer sends: each iteration, each scored evaluation, each epoch's entropy."""

    def __init__(self, sender: FigureSender, records: Iterable[IterationRecord] = ()) -> None:
        """The evaluations of `records` are sent already."""
        self._sender = sender
        self._evaluated = {record.iteration for record in records if record.evaluation_progress}

    @staticmethod
    def of_trainer(
        job: Job, design: Design, records: Sequence[IterationRecord], steps: int
    ) -> "LiveFigures":
        config = job.config
        if not is_wanted(job):
            return LiveFigures(FigureSender([]))
        parameters = design.parameters.canonical_json(design.metadata.training_algorithm)
        texts = {name: data.decode("utf-8-sig", "replace") for name, data in design.files.items()}
        given = "\n".join(f"{name}={text}" for name, text in sorted(config.given.items()))
        facts = TrainingFacts(
            config.model.prefix,
            config.run_id,
            steps,
            {"hyperparameters": parameters, **texts, "settings": given},
        )
        sender = sender_of_trainer(
            config.figures,
            config.directory,
            facts,
            earlier=earlier_points(records),
            parameters=parameters_of(design, config.given),
        )
        return LiveFigures(sender, records)

    def epoch(self, stats: "Stats") -> None:
        entropy = stats.metrics().get("losses/entropy", math.nan)
        if math.isfinite(entropy):
            self._sender.send(EpochPoint(time.time(), entropy))

    def learned(self, row: Row, records: Sequence[IterationRecord]) -> None:
        """An iteration, the last of the records, and new scores."""
        values = _named(row) | (progress_of(records[-1]) if records else {})
        self._sender.send(Point(int(row[STEPS]), time.time(), values))
        self._send_scores(records)

    def end(self, records: Sequence[IterationRecord], *, finished: bool) -> None:
        """Waits a little until all is sent."""
        self._send_scores(records)
        self._sender.send(Ended(time.time(), finished))
        self._sender.close()

    def _send_scores(self, records: Sequence[IterationRecord]) -> None:
        for record in records[-2 * REMEMBERED_SCORES :]:
            if record.evaluation_progress and record.iteration not in self._evaluated:
                self._evaluated.add(record.iteration)
                self._sender.send(evaluation_point(record, time.time()))


def is_wanted(job: Job) -> bool:
    f = job.config.figures
    servers = f.telegraf_host, f.prometheus_port, f.mlflow_url, f.trackio_url
    return bool(f.tensorboard or f.prometheus_folder or any(servers))


def earlier_points(records: Iterable[IterationRecord]) -> list[Point]:
    """The history does not tell pauses: times are counted back from now."""
    known = list(records)
    if not known:
        return []
    began_s = time.time() - known[-1].elapsed_s
    points = []
    for record in known:
        at_s = began_s + record.elapsed_s
        values = _named(row_of(record)) | progress_of(record)
        points.append(Point(record.total_steps, at_s, values))
        if record.evaluation_progress:
            points.append(evaluation_point(record, at_s))
    return points


def progress_of(record: IterationRecord) -> dict[str, float]:
    """What CleanRL has no name for."""
    numbers: dict[str, float | None] = {
        "charts/episodic_progress": record.mean_progress,
        "charts/full_laps": float(record.full_laps),
        "charts/best_lap_s": record.best_lap_s,
    }
    return {name: x for name, x in numbers.items() if x is not None and math.isfinite(x)}


def evaluation_point(record: IterationRecord, time_s: float) -> Point:
    values = _scores("evaluation", record.evaluation_progress, record.evaluation_lap_s)
    if record.second_world:
        values |= _scores("evaluation_second", record.second_progress, record.second_lap_s)
    steps = max(0, record.total_steps - record.steps)
    return Point(steps, time_s, values, is_evaluation=True)


def parameters_of(design: Design, given: Mapping[str, str]) -> dict[str, str]:
    metadata = design.metadata
    values = design.parameters.model_dump(mode="json", exclude_none=True)
    numbers = {name: str(value) for name, value in values.items() if name != "problems"}
    return {
        **numbers,
        "training_algorithm": metadata.training_algorithm,
        "neural_network": metadata.neural_network,
        "num_actions": str(metadata.action_space.num_actions),
        **{name: text for name, text in given.items() if text},
    }


def _scores(name: str, progress: Sequence[float], lap_s: Sequence[float]) -> dict[str, float]:
    values = {f"{name}/laps": float(len(lap_s))}
    if progress:
        values[f"{name}/progress"] = fmean(progress)
        values[f"{name}/clean_share"] = len(lap_s) / len(progress)
    if lap_s:
        values[f"{name}/median_lap_s"] = median(lap_s)
        values[f"{name}/best_lap_s"] = min(lap_s)
        values[f"{name}/mean_lap_s"] = fmean(lap_s)
    return {key: value for key, value in values.items() if math.isfinite(value)}


def _named(row: Row) -> dict[str, float]:
    iteration = {"charts/iteration": float(row[NUMBER])} if NUMBER in row else {}
    return iteration | {
        name: float(value) for name, value in row.items() if name not in (NUMBER, STEPS)
    }
