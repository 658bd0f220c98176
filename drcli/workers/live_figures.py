"""The figures of a training for the tools of others."""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from statistics import fmean, median
from typing import TYPE_CHECKING

from drcli.exchange.iteration import IterationRecord
from drcli.exchange.job import Job
from drcli.modelfiles.network_shape import Design
from drcli.tracking.figure_events import Ended, EpochPoint, Point, TrainingFacts
from drcli.tracking.figure_sender import FigureSender
from drcli.tracking.open_sinks import sender_of_trainer
from drcli.workers.learner_metrics import NUMBER, STEPS, Row, row_of
from drcli.workers.scoring import REMEMBERED_SCORES

if TYPE_CHECKING:
    from drcli.learn.update_result import Stats  # loads torch, which a command does without


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
        if self._sender.is_active and math.isfinite(entropy):
            self._sender.send(EpochPoint(time.time(), entropy))

    def learned(self, row: Row, records: Sequence[IterationRecord]) -> None:
        """An iteration, the last of the records, and new scores."""
        if self._sender.is_active:
            values = _named(row) | (progress_of(records[-1]) if records else {})
            self._sender.send(Point(int(row[STEPS]), time.time(), values))
            self._send_scores(records)

    def end(self, records: Sequence[IterationRecord], *, finished: bool) -> None:
        """Waits a little until all is sent."""
        if self._sender.is_active:
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
