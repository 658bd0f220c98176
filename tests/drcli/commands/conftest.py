"""A run that exists only on paper, in place of processes and bucket."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drcli.job import Job
from drcli.runs.inputs import InputFile, Inputs
from drcli.runs.plan import RunPlan, StartOptions
from drcli.runs.report import RunReport


class PaperRun:
    """Stands in for drcli.runs: takes what the commands ask, answers what a test has laid down.

    Attributes:
        looks: What is seen at each look from the launch on; the last one stays. An exception is
            raised instead, as Ctrl-C would be.
        between: Called before the last look, when something is to happen meanwhile.
        asked: Names of the functions called, in order.
    """

    PID = 4242

    def __init__(self, folder: Path, before: RunReport) -> None:
        self.folder = folder
        self.before = before
        self.looks: list[RunReport | BaseException] = []
        self.between: Callable[[], object] | None = None
        self.asked: list[str] = []
        self.options: StartOptions | None = None
        self.refusal: Exception | None = None
        self.warnings: list[str] = []
        self.wiped = False
        self.running = True
        self._started = False

    def prepare(self, settings: Any, options: StartOptions, directory: Path) -> RunPlan:
        self.asked.append("prepare")
        self.options = options
        if self.refusal is not None:
            raise self.refusal
        job = Job(settings, directory, "abc", 7, None, None, directory / "data", 1)
        names = ("reward_function.py", "hyperparameters.json", "model_metadata.json")
        files = (InputFile(name, b"", f"custom_files/{name}") for name in names)
        return RunPlan(job, Inputs(*files), self.warnings, None, wiped=self.wiped)

    def launch(self, plan: RunPlan) -> int:
        self.asked.append("launch")
        self._started = True
        return self.PID

    def supervise(self, plan: RunPlan) -> int:
        self.asked.append("supervise")
        self._started = True
        return 0

    def stop(self, settings: Any, *, directory: Path) -> RunReport:
        self.asked.append("stop")
        return self.inspect(settings, directory)

    def is_running(self, settings: Any, directory: Path) -> bool:
        return self.running

    def inspect(self, settings: Any, directory: Path) -> RunReport:
        if not self._started and "stop" not in self.asked:
            return self.before
        if len(self.looks) == 1 and self.between is not None:
            self.between()
            self.between = None
        look = self.looks.pop(0) if len(self.looks) > 1 else self.looks[0]
        if isinstance(look, BaseException):
            raise look
        return look


@pytest.fixture
def run(
    working_folder: Path, make_report: Callable[..., RunReport], monkeypatch: pytest.MonkeyPatch
) -> PaperRun:
    """The run of the working folder, with nothing started yet."""
    paper = PaperRun(working_folder, make_report("none", pid=None))
    monkeypatch.setattr("drcli.runs.plan.prepare", paper.prepare)
    for name in ("launch", "supervise", "stop", "is_running"):
        monkeypatch.setattr(f"drcli.runs.training.{name}", getattr(paper, name))
    monkeypatch.setattr("drcli.runs.status.inspect", paper.inspect)
    monkeypatch.setattr("drcli.commands.watching.POLL_S", 0.0)
    return paper


@pytest.fixture
def log(working_folder: Path) -> Callable[[str], Path]:
    """Path of a worker's log, its folder made."""

    def path_of(worker: str) -> Path:
        kind = "robomaker" if worker.startswith("sim") else "sagemaker"
        path = working_folder / "data" / "logs" / kind / "model" / f"{worker}.log"
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    return path_of
