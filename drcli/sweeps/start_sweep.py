"""Starts, continues and compares sweeps."""

import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import psutil

from drcli.base.errors import (
    DrError,
    NotAvailable,
    Problem,
    ProblemsError,
    SettingsError,
    WorkerDied,
)
from drcli.base.installation import lazy_imports
from drcli.base.processes import NotedSignals, started_s
from drcli.base.report import Rows, View, bold, counted
from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_bucket
from drcli.checks.machine_rules import TRAINER_BYTES, WORKER_BYTES
from drcli.checks.validate import validate
from drcli.config.settings import Settings
from drcli.config.settings_files import EXPERIMENT
from drcli.model.lease import live_holder
from drcli.model.model_store import ModelStore
from drcli.records.run_record import WaitingStart, run_folder
from drcli.run.outcome import CTRL_C, TERMINATED
from drcli.sweeps.stored_sweep import read_sweep, refuse_used_models, wipe_sweep
from drcli.sweeps.sweep_file import SweepFile, read_sweep_file
from drcli.sweeps.sweep_record import SweepRecord, TrialRecord
from drcli.sweeps.sweep_report import SweepProgress, SweepReport, report_of
from drcli.sweeps.sweep_run import Pace, SweepRun
from drcli.sweeps.trial_files import TrialFiles
from drcli.sweeps.trial_run import Run, TrialRun
from drcli.sweeps.trials import Trial, trials_of
from drcli.workers.cores import usable_cores
from drcli.workers.ray_extra import require_ray

with lazy_imports():
    from drcli.analysis import outputs, read_run
    from drcli.sweeps import ray_trials

CORES = 2
"""One drives, one learns."""


@dataclass(frozen=True)
class SweepPlanned:
    """A sweep that can start."""

    name: Annotated[str, "Of the sweep."]
    trials: Annotated[
        dict[str, dict[str, str]], "Its trainings: name, and what distinguishes each."
    ]
    parallel: Annotated[int | None, "How many run at a time; null if Ray decides."]
    continues: Annotated[bool, "Whether it has begun before."]

    def at_a_time(self) -> str:
        if self.parallel is None:
            return "as many at a time as Ray has room for"
        return f"{self.parallel} at a time"

    def view(self) -> View:
        verb = "continues" if self.continues else "has"
        varied = list(dict.fromkeys(key for trial in self.trials.values() for key in trial))
        names = ["training", *varied]
        rows = [[name, *(of.get(key, "") for key in varied)] for name, of in self.trials.items()]
        count = counted(len(self.trials), "training")
        head = (bold(f"Sweep {self.name}"), f" {verb} {count}, {self.at_a_time()}.")
        return [head, Rows(names, rows, left=names)]


class SweepStart:
    """A checked sweep before its begin.

    Raises:
        SettingsError: The file, what it names, or the settings are wrong.
        StorageError: The bucket does not answer.
    """

    def __init__(self, settings: Settings, path: Path) -> None:
        self._settings = settings
        if self._by_ray:
            require_ray()
        self._sweep: SweepFile = read_sweep_file(path)
        _refuse_curriculum(settings, self._sweep)
        self._trials: list[Trial] = trials_of(self._sweep)
        self._bucket: Bucket = open_bucket(settings.storage)
        self._files = TrialFiles(settings, self._sweep, self._bucket)
        self._files.check(self._trials)
        self._record: SweepRecord | None = read_sweep(self._bucket, self._sweep.name)

    @property
    def worlds(self) -> list[str]:
        own = self._settings.world_name
        return sorted({trial.settings.get("DR_WORLD_NAME", own) for trial in self._trials})

    def planned(self, parallel: int | None) -> SweepPlanned:
        return SweepPlanned(
            self._sweep.name,
            {trial.name: dict(trial.varied) for trial in self._trials},
            self._parallel(parallel),
            self._record is not None,
        )

    def wipe(self) -> int:
        """Delete an earlier sweep's models and record; returns the number of trainings.

        Raises:
            SettingsError: One of them is being trained.
        """
        if self._record is None:
            return 0
        for trial in self._record.trials:
            held = live_holder(ModelStore(self._bucket, trial.prefix))
            if held is not None:
                raise SettingsError(
                    f"{trial.name} is being trained by {held.owner}.",
                    remedy="Stop the sweep first.",
                )
        wipe_sweep(self._bucket, self._record)
        found, self._record = self._record, None
        return len(found.trials)

    def run(
        self,
        *,
        parallel: int | None,
        say: Callable[[str], None],
        warn: Callable[[str], None],
        on_change: Callable[[SweepReport], None],
    ) -> SweepReport:
        """Train all; `parallel` of None leaves it to file or cores.

        Raises:
            SettingsError: A model of this name exists, or something cannot be written.
            StorageError: The bucket does not answer; nothing is lost.
            TrainedElsewhere: Another machine runs one of the trainings.
            Stopped: SIGTERM came; the same command continues. For Ctrl-C, KeyboardInterrupt.
        """
        directory, name = self._settings.directory, self._sweep.name
        if self._record is None:
            refuse_used_models(self._bucket, self._trials)
        own = WaitingStart(
            os.getpid(), started_s(os.getpid()) or 0.0, self._bucket.name, name, "sweep"
        )
        folder = run_folder(directory, self._settings.run_id)
        _refuse_second(folder, own)
        with own.shown(folder), NotedSignals() as signals:
            progress = SweepProgress(
                directory,
                self._sweep,
                self._trials,
                self._files,
                self._bucket,
                say=say,
                on_change=lambda record: on_change(report_of(record, self._bucket.name)),
            )
            for sentence in self._warnings(progress.record):
                warn(sentence)
            start = self._run_on_ray if self._by_ray else self._run_here
            record = start(progress, parallel, say, signals)
        return report_of(record, self._bucket.name)

    def compare(self, report: SweepReport, page: Path) -> SweepReport:
        """Write the page of `dr-analyze compare`; raises DrError."""
        models = [trial.model for trial in report.trials if trial.progress is not None]
        if len(models) < 2:
            return report
        outputs.check_targets(page, None, force=True)
        found = outputs.write_comparison_of(read_run.read_runs(self._settings, models), page)
        return replace(report, comparison=found.html)

    @property
    def _by_ray(self) -> bool:
        return self._settings.launcher == "ray"

    def _run_on_ray(
        self,
        progress: SweepProgress,
        parallel: int | None,
        say: Callable[[str], None],
        signals: NotedSignals,
    ) -> SweepRecord:
        if progress.record.ended_at is not None:
            return progress.record
        directory, name = self._settings.directory, self._sweep.name

        def end() -> None:
            if signals.first is None:
                say(f"Ray has ended, and with it the sweep {name}.")
            else:
                say(f"The sweep {name} was interrupted.")
            say("Continue it with the same command.")
            sys.stderr.flush()
            codes = {None: WorkerDied.code, signal.SIGINT: CTRL_C}
            os._exit(codes.get(signals.first, TERMINATED))

        runs = [TrialRun(directory, trial, self._bucket) for trial in progress.record.trials]
        address, cloud = self._settings.run.train.ray_address, self._settings.storage.cloud
        with ray_trials.connected(address, cloud, runs, end) as ray:
            nodes = ray_trials.RayNodes(
                ray,
                directory,
                self._bucket,
                threads=self._settings.threads,
                parallel=self._parallel(parallel),
                trials=len(self._trials),
                say=say,
            )
            pace = Pace(nodes.room, nodes.place.cpus, waits=False)
            return self._sweep_run(progress, pace, say, signals, nodes.open_run).run()

    def _run_here(
        self,
        progress: SweepProgress,
        parallel: int | None,
        say: Callable[[str], None],
        signals: NotedSignals,
    ) -> SweepRecord:
        many = self._parallel(parallel) or 1
        shared = many > 1 and not self._settings.threads
        cores = usable_cores(self._settings.run.train)
        pace = Pace(lambda: many, max(1, cores // many) if shared else 0)
        directory = self._settings.directory
        return self._sweep_run(
            progress, pace, say, signals, lambda trial: TrialRun(directory, trial, self._bucket)
        ).run()

    def _sweep_run(
        self,
        progress: SweepProgress,
        pace: Pace,
        say: Callable[[str], None],
        signals: NotedSignals,
        open_run: Callable[[TrialRecord], Run],
    ) -> SweepRun:
        return SweepRun(
            progress, self._sweep, self._bucket, pace, say=say, signals=signals, open_run=open_run
        )

    def _parallel(self, parallel: int | None) -> int | None:
        wanted = parallel or self._sweep.plan.parallel
        if self._by_ray:
            return wanted
        config = self._settings.run.train
        room = psutil.virtual_memory().available // (config.workers * WORKER_BYTES + TRAINER_BYTES)
        fitting = max(1, min(usable_cores(config) // CORES, room))
        return min(wanted or fitting, len(self._trials))

    def _warnings(self, record: SweepRecord) -> list[str]:
        """Files that would fail only after hours."""
        found = []
        seen: set[tuple[str, str]] = set()
        fresh = {trial.name for trial in record.trials if trial.state == "waiting"}
        for trial in self._trials:
            pair = (trial.reward_function, trial.model_metadata)
            if trial.name not in fresh or pair in seen:
                continue
            seen.add(pair)
            environ = {**os.environ, EXPERIMENT: trial.name}
            report = validate(self._settings.directory, environ=environ)
            found += [
                f"{trial.name} cannot start. {str(error).splitlines()[0]}"
                for error in report.errors
            ]
        return found


def comparison_page(directory: Path, name: str) -> Path:
    return directory / f"{name}-comparison.html"


def try_to_compare(start: SweepStart, report: SweepReport, page: Path) -> tuple[SweepReport, str]:
    try:
        return start.compare(report, page), ""
    except NotAvailable as error:
        return report, f"The trainings are not compared: {error} {error.remedy}"
    except DrError as error:
        return report, f"The trainings cannot be compared: {error}"


def _refuse_second(folder: Path, own: WaitingStart) -> None:
    for other in WaitingStart.all(folder):
        if other.kind == "sweep" and (other.prefix, other.bucket) == (own.prefix, own.bucket):
            raise SettingsError(
                f"The sweep {own.prefix} already runs here, as process {other.pid}.",
                remedy="Look at it with `dr-sweep list`, or stop it with `dr-stop-training`.",
            )


def _refuse_curriculum(settings: Settings, sweep: SweepFile) -> None:
    if settings.curriculum_file and sweep.plan.settings.get("DR_CURRICULUM_FILE") != "":
        problem: Problem = sweep.problem(
            ("settings",),
            f"A sweep trains without stages, but DR_CURRICULUM_FILE is {settings.curriculum_file}.",
            'Add settings: {DR_CURRICULUM_FILE: ""}, or remove it from run.env.',
        )
        raise ProblemsError([problem])
