"""Evaluates a model's newest checkpoint again and again, and keeps the best laps."""

import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Annotated

from drcli.base.errors import DrError
from drcli.base.json_record import JsonRecord, SafeInt, Seconds
from drcli.base.processes import Stopped, started_s
from drcli.base.report import Col, View, bold, counted, table
from drcli.bucket.bucket import Bucket, readable_record
from drcli.bucket.connect import COMMAND_PATIENCE_S, open_bucket
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.iteration import lap_time
from drcli.records.run_record import EvaluationRecord
from drcli.run.evaluation import run_evaluation, until_stopped
from drcli.run.evaluation_plan import choose_checkpoint, claim_stamp, prepare_evaluation
from drcli.run.evaluation_report import EvaluationReport, best_lap, summary

MOST_ROWS = 20
"""What other rounds wrote is deleted."""

POLL_S = 2.0
LONGEST_PAUSE_S = 60.0


@dataclass(frozen=True)
class BestLap(JsonRecord):
    """A round with at least one completed lap.

    Attributes:
        world: The track.
        checkpoint: What drove.
        best_lap_s: Fastest clean lap, simulated seconds; without one the fastest completed lap,
            penalties included.
        best_average_s: Least mean time of DR_EVAL_AVERAGE_LAPS completed laps in a row.
        completed: Completed laps of the round.
        trials: All laps of the round.
        driven_at: When, as ISO 8601.
        stamp: Fourteen digits that name the evaluation.
        clean: Laps of the round without reset and penalty; None in tables of version 0.1.0.
        penalty_s: Penalties in `best_lap_s`; None if unknown.
        resets: Resets in `best_lap_s`; None if unknown.
    """

    world: str
    checkpoint: str
    best_lap_s: Seconds
    best_average_s: Seconds | None
    completed: SafeInt
    trials: SafeInt
    driven_at: str
    stamp: str
    clean: SafeInt | None = None
    penalty_s: Seconds | None = None
    resets: SafeInt | None = None

    @property
    def rank(self) -> tuple[bool, float, str]:
        """Sorts rounds: those with a clean lap first, then the fastest, then the oldest."""
        return not self.clean, self.best_lap_s, self.driven_at


@dataclass(frozen=True)
class BestLaps(JsonRecord):
    laps: list[BestLap] = field(default_factory=list)

    def with_lap(self, lap: BestLap) -> "BestLaps":
        return BestLaps(sorted([*self.laps, lap], key=lambda one: one.rank)[:MOST_ROWS])


_COLUMNS = (
    Col("track", of=lambda lap: lap.world, side="left"),
    Col("best lap", of=lambda lap: lap_time(lap.best_lap_s, lap.penalty_s, 0), side="left"),
    Col("resets", of=lambda lap: lap.resets, none="?"),
    Col("best average", "{:.2f} s", of=lambda lap: lap.best_average_s, none=""),
    Col("clean laps", of=lambda lap: f"{'?' if lap.clean is None else lap.clean}/{lap.trials}"),
    Col("checkpoint", of=lambda lap: lap.checkpoint, side="left"),
    Col("driven", of=lambda lap: lap.driven_at, side="left"),
)


@dataclass(frozen=True)
class LoopReport:
    """The result of `dr-evaluate --loop`."""

    prefix: Annotated[str, "Model prefix."]
    world: Annotated[str, "The track."]
    rounds: Annotated[int, "Evaluations that were completed."]
    failures: Annotated[int, "Rounds that failed."]
    best: Annotated[list[BestLap], "The table of best laps, earlier loops included."]
    table: Annotated[str, "Its key in the bucket."]

    def view(self) -> View:
        failed = f", {self.failures} failed" if self.failures else ""
        rounds = f"{counted(self.rounds, 'round')}{failed}"
        return [
            table(self.best, *_COLUMNS) if self.best else "No lap was completed.",
            bold(f"{rounds} of {self.prefix} on {self.world}."),
        ]


def run_loop(
    settings: Settings,
    *,
    seed: int | None = None,
    on_progress: Callable[[str], None] = lambda text: None,
    on_failure: Callable[[str], None] = lambda text: None,
) -> LoopReport:
    """Evaluate the newest checkpoints until Ctrl-C or SIGTERM, which are not failures.

    Where lights, traffic or disturbances are drawn, each round has the next seed; elsewhere it
    waits for a new checkpoint.

    Raises:
        DrError: The first round fails; later ones are tried again.
    """
    settings = settings.replaced(eval_checkpoint="last")
    bucket = open_bucket(settings.storage, patience_s=COMMAND_PATIENCE_S)
    loop = _Loop(settings, bucket, settings.train_seed or 0 if seed is None else seed)
    stamp, folder = claim_stamp(settings, bucket, settings.directory)
    EvaluationRecord(
        run_id=settings.run_id,
        stamp=stamp,
        bucket=bucket.name,
        prefix=settings.model_prefix,
        world=settings.world_name,
        checkpoint="",
        pid=os.getpid(),
        pid_started=started_s(os.getpid()) or 0.0,
        worker_pid=os.getpid(),
        started_at=time.time(),
    ).write(folder)
    try:
        with until_stopped():
            while True:
                try:
                    on_progress(loop.drive())
                except DrError as error:
                    if not loop.rounds or isinstance(error, Stopped):
                        raise
                    on_failure(f"{error} {error.remedy} The loop goes on.")
                    loop.pause_after_failure()
                loop.wait_for_something_new()
    except (KeyboardInterrupt, Stopped):
        return loop.report()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class _Loop:
    def __init__(self, settings: Settings, bucket: Bucket, seed: int) -> None:
        self.rounds = 0
        self._settings = settings
        self._bucket = bucket
        self._seed = seed
        self._failures = 0
        self._failures_in_a_row = 0
        self._last: EvaluationReport | None = None
        self._key = keys.best_laps(settings.metrics_prefix)
        self._table = read_best_laps(bucket, self._key)
        self._loose: list[str] = []
        self._noted: set[str] = set()

    def drive(self) -> str:
        plan = prepare_evaluation(self._settings, seed=self._seed + self.rounds)
        try:
            report = run_evaluation(plan)
        except BaseException:
            self._loose.append(plan.stamp)  # it may have written something before it ended
            raise
        self.rounds += 1
        self._failures_in_a_row = 0
        self._last = report
        before = self._best_here()
        said = f"Round {self.rounds}, {report.checkpoint}: {summary(report.trials)}"
        self._keep(report, plan.stamp)
        if report.best_lap_s is not None and (before is None or report.best_lap_s < before):
            said += ", the best lap so far"
        fresh = [note for note in report.notes if note not in self._noted]
        self._noted.update(fresh)
        return " ".join([f"{said}.", *fresh])

    def _best_here(self) -> float | None:
        laps = [
            lap.best_lap_s
            for lap in self._table.laps
            if lap.world == self._settings.world_name and lap.clean
        ]
        return min(laps, default=None)

    def _keep(self, report: EvaluationReport, stamp: str) -> None:
        before = {lap.stamp for lap in self._table.laps}
        best = best_lap(report.trials)
        if best is not None:
            lap = BestLap(
                world=report.world,
                checkpoint=report.checkpoint,
                best_lap_s=best.lap_s,
                best_average_s=report.best_average_s,
                completed=report.completed,
                trials=len(report.trials),
                driven_at=datetime.now(UTC).isoformat(timespec="seconds"),
                stamp=stamp,
                clean=report.clean,
                penalty_s=best.penalty_s,
                resets=best.resets,
            )
            self._table = self._table.with_lap(lap)
            self._bucket.put(self._key, self._table.encode())
        kept = {lap.stamp for lap in self._table.laps}
        gone = (before | set(self._loose)) - kept
        model = self._settings.model
        traces = [keys.evaluation_trace(model.prefix, old) for old in sorted(gone)]
        self._bucket.delete(
            traces
            + [keys.recording_of(trace) for trace in traces]
            + [keys.evaluation_video(model.prefix, old) for old in sorted(gone)]
            + [keys.evaluation_metrics(model.metrics_prefix, old) for old in sorted(gone)]
        )
        self._loose = [] if stamp in kept else [stamp]  # the newest stays until the next round

    def pause_after_failure(self) -> None:
        self._failures += 1
        self._failures_in_a_row += 1
        time.sleep(min(LONGEST_PAUSE_S, POLL_S * 2.0**self._failures_in_a_row))

    def wait_for_something_new(self) -> None:
        while self._last is not None and not draws_anything(self._settings):
            with suppress(DrError):
                prefix = self._settings.model_prefix
                chosen = choose_checkpoint(self._settings, ModelStore(self._bucket, prefix))
                if chosen != self._last.checkpoint:
                    return
            time.sleep(POLL_S)

    def report(self) -> LoopReport:
        return LoopReport(
            prefix=self._settings.model_prefix,
            world=self._settings.world_name,
            rounds=self.rounds,
            failures=self._failures,
            best=self._table.laps,
            table=self._key,
        )


def read_best_laps(bucket: Bucket, key: str) -> BestLaps:
    return readable_record(bucket, key, BestLaps.decode) or BestLaps()


def draws_anything(settings: Settings) -> bool:
    """Whether two evaluations can differ by their seeds."""
    s = settings
    disturbed = s.sim_extras_in != "training" and any(
        isinstance(value, float) and value != 0.0
        for name, value in vars(s).items()
        if name.startswith("sim_")
    )
    traffic = s.race_type == "HEAD_TO_BOT" or (
        s.race_type == "OBJECT_AVOIDANCE" and s.oa_randomize_obstacle_locations
    )
    return disturbed or traffic or s.enable_domain_randomization
