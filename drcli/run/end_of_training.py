"""Uploads and imports the best checkpoint once when a training is complete.

Each piece may be repeated; a successor on another machine may complete it.
"""

import os
import re
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Literal, get_args

from drcli.base.errors import EndWorkFailed
from drcli.base.log import get_logger
from drcli.config import secret_environment
from drcli.outside.droa.droa_site import PASSWORD_VARIABLE, URL_SETTING
from drcli.records.job import Job
from drcli.run.checkpoint_watch import LAST_LOOK_S, CheckpointWatch
from drcli.run.command_process import CommandEnd, CommandProcess, Start
from drcli.run.duty import Duty, RunningTraining
from drcli.run.outcome import Ending, Outcome
from drcli.run.timed_uploads import BEST, uploads_models

_logger = get_logger(__name__)

EndWork = Literal["upload", "import"]
PATIENCE_S = 2700.0
"""DeepRacer on AWS may check a model for half an hour."""

_WHAT = {"upload": "upload of the best checkpoint", "import": "import into DeepRacer on AWS"}


def wanted_work(job: Job) -> list[str]:
    settings, given = job.config.unattended, job.config.given
    wanted: list[EndWork] = []
    if uploads_models(settings):
        wanted.append("upload")
    if settings.import_model_on_completion and given.get(URL_SETTING):
        wanted.append("import")
    return list(wanted)


class EndOfTraining(Duty):
    name = "end of the training"

    def __init__(self, run: RunningTraining, *, start: Start = CommandProcess) -> None:
        super().__init__(run)
        self._start = start
        self._left: list[str] | None = None
        self._results: list[Outcome] = []

    def start(self) -> None:
        """Say what will not work at the end."""
        if "import" not in wanted_work(self.run.job):
            return
        if not secret_environment.all_secrets().get(PASSWORD_VARIABLE):
            _logger.info(
                "The import into DeepRacer on AWS at the end needs the password in the variable "
                "%s of the environment, or `droa-login` less than an hour before.",
                PASSWORD_VARIABLE,
            )

    def finish(self, ending: Ending) -> None:
        self._left = self.pending(ending)
        for name in list(self._left):
            within_s = min(PATIENCE_S, ending.left_s(0.8))
            if within_s <= 0.0:
                break
            process = self._start(self.run.job, *self._command(name))
            if self._note(name, process.wait(within_s, lambda: ending.left_s() <= 0.0)):
                self._left.remove(name)
        for name in self._left[sum(result.code != 0 for result in self._results) :]:
            text = f"There was no time for the {_WHAT[name]}."
            self._results.append(Outcome(EndWorkFailed.code, text, self._again(name)))
            _logger.warning("%s", text)

    def end_result(self) -> Outcome | None:
        if not self._results:
            return None
        return Outcome(
            max(result.code for result in self._results),
            " ".join(result.message for result in self._results),
            " ".join(result.remedy for result in self._results).strip(),
        )

    def pending(self, ending: Ending) -> list[str]:
        """Before `finish`, all pieces; or those of an earlier start."""
        if self._left is not None:
            return list(self._left)
        if ending.outcome.code != 0:
            return []
        return [
            name for name in ending.only or wanted_work(self.run.job) if name in get_args(EndWork)
        ]

    def _command(self, name: str) -> tuple[str, ...]:
        if name == "upload":
            return BEST
        prefix = self.run.job.config.model.prefix
        options = ("--model-prefix", prefix, "--model-name", import_name(prefix), "--best")
        return "droa-import-model", *options, "--once", "--json"

    def _again(self, name: str) -> str:
        words = [word for word in self._command(name) if word != "--json"]
        program = words[0] if words[0].startswith("droa-") else f"dr-{words[0]}"
        return (
            f"Repeat it with `{' '.join([program, *words[1:]])}`, or with the same start and "
            "`--resume-or-start`; without its limits the training would go on."
        )

    def _note(self, name: str, end: CommandEnd) -> bool:
        what = _WHAT[name]
        if not end.ok:
            text = f"The {what} failed: {end.reason}"
            self._results.append(Outcome(EndWorkFailed.code, text, self._again(name)))
            text = f"{text} {self._again(name)}"
            _logger.warning("%s", text)
            self.run.journal.note("fault", text, event="upload", what=name)
            return False
        report = end.report
        place = report.get("target") or f"{report.get('site', '')} ({report.get('model_id', '')})"
        text = f"The {what} is done: {place}."
        self._results.append(Outcome(0, text))
        _logger.info("%s", text)
        self.run.journal.note("upload", text, what=name, seconds=round(end.seconds, 1))
        return True


def import_name(prefix: str) -> str:
    """DeepRacer on AWS allows letters, digits and hyphens, 64 at most."""
    usable = re.sub(r"[^a-zA-Z0-9]+", "-", prefix).strip("-")
    return usable[-64:].strip("-") or "model"


# Runs the command of DR_ON_END or --on-end when everything is saved.


COMMAND_PATIENCE_S = 3600.0
_POLL_S = 0.1


class EndCommand(Duty):
    """Runs after every end: complete, stopped, interrupted or failed.

    It has the whole environment, access keys included: the reward function no longer runs then.
    """

    name = "command at the end"

    def __init__(
        self,
        run: RunningTraining,
        watch: CheckpointWatch,
        facts: Callable[[], Mapping[str, object]],
    ) -> None:
        super().__init__(run)
        self._watch = watch
        self._facts = facts
        self._command = run.job.config.unattended.on_end

    def start(self) -> None:
        if self._command:
            self._watch.turn_on()

    def finish(self, ending: Ending) -> None:
        if self._command and ending.left_s() > LAST_LOOK_S:
            self._watch.look_last()

    def after_release(self, ending: Ending) -> None:
        if not self._command:
            return
        _logger.info("Running the command at the end: DR_ON_END.")
        environment = {**os.environ, **secret_environment.all_secrets(), **self._told(ending)}
        try:
            process = subprocess.Popen(
                ["/bin/sh", "-c", self._command],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                cwd=self.run.job.directory,
                env=environment,
                start_new_session=True,
            )
        except OSError as error:
            _logger.warning("The command at the end could not be started: %s.", error.strerror)
            return
        reader = threading.Thread(target=_log_output, args=(process,), daemon=True)
        reader.start()
        code = _wait(process, min(COMMAND_PATIENCE_S, ending.left_s()), ending)
        reader.join(1.0)
        if code is None:
            _logger.warning("The command at the end was killed: its time was over.")
        elif code != 0:
            _logger.warning("The command at the end failed with exit code %d.", code)
        else:
            _logger.info("The command at the end succeeded.")

    def _told(self, ending: Ending) -> dict[str, str]:
        outcome, config = ending.outcome, self.run.job.config
        last, best = self._watch.last, self._watch.best
        metric = best.avg_eval_metric if best is not None else None
        left_s = ending.left_s()
        values: dict[str, object] = {
            "STATE": outcome.state,
            "CODE": outcome.code,
            "MESSAGE": outcome.message,
            "BUCKET": config.storage.bucket,
            "PREFIX": config.model.prefix,
            "LAST_CHECKPOINT": last.name if last is not None else "",
            "BEST_CHECKPOINT": best.name if best is not None else "",
            "BEST_METRIC": "" if metric is None else metric,
            "BEST_LAPS": "" if best is None or best.episodes is None else best.episodes.laps,
            "SECONDS_LEFT": "" if left_s == float("inf") else int(left_s),
            **{name.upper(): value for name, value in self._facts().items()},
        }
        return {f"DR_END_{name}": str(value) for name, value in values.items()}


def _wait(process: "subprocess.Popen[bytes]", within_s: float, ending: Ending) -> int | None:
    rounds = int(within_s / _POLL_S) + 1
    for _ in range(rounds):
        with suppress(subprocess.TimeoutExpired):
            return process.wait(_POLL_S)
        if ending.left_s() <= 0.0:
            break
    with suppress(ProcessLookupError):
        os.killpg(process.pid, 9)
    process.wait()
    return None


def _log_output(process: "subprocess.Popen[bytes]") -> None:
    assert process.stdout is not None
    with process.stdout as pipe:
        for line in pipe:
            if text := line.decode("utf-8", "replace").rstrip():
                _logger.info("on end: %s", text)
