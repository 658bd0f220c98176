"""Runs the command of DR_ON_END or --on-end when everything is saved."""

import os
import subprocess
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress

from drcli.base.log import get_logger
from drcli.config import secret_environment
from drcli.exchange.job import Job
from drcli.runs.checkpoint_watch import LAST_LOOK_S, CheckpointWatch
from drcli.runs.duty import Duty, RunningTraining
from drcli.runs.outcome import Ending

_logger = get_logger(__name__)

PATIENCE_S = 3600.0
_LOOK_S = 0.1


class EndCommand(Duty):
    """Runs after every end: complete, stopped, interrupted or failed.

    It has the whole environment, access keys included: the reward function no longer runs then.
    """

    name = "command at the end"

    def __init__(
        self, job: Job, watch: CheckpointWatch, facts: Callable[[], Mapping[str, object]]
    ) -> None:
        self._job = job
        self._watch = watch
        self._facts = facts
        self._command = job.config.unattended.on_end

    def start(self, run: RunningTraining) -> None:
        if self._command:
            self._watch.start(run.open_bucket, run.job.config.model.prefix)

    def finish(self, ending: Ending) -> None:
        if self._command and ending.left_s() > LAST_LOOK_S:
            self._watch.look_last()

    def leave(self, ending: Ending) -> None:
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
                cwd=self._job.directory,
                env=environment,
                start_new_session=True,
            )
        except OSError as error:
            _logger.warning("The command at the end could not be started: %s.", error.strerror)
            return
        reader = threading.Thread(target=_log_output, args=(process,), daemon=True)
        reader.start()
        code = _wait(process, min(PATIENCE_S, ending.left_s()), ending)
        reader.join(1.0)
        if code is None:
            _logger.warning("The command at the end was killed: its time was over.")
        elif code != 0:
            _logger.warning("The command at the end failed with exit code %d.", code)
        else:
            _logger.info("The command at the end succeeded.")

    def _told(self, ending: Ending) -> dict[str, str]:
        outcome, config = ending.outcome, self._job.config
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
    rounds = int(within_s / _LOOK_S) + 1
    for _ in range(rounds):
        with suppress(subprocess.TimeoutExpired):
            return process.wait(_LOOK_S)
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
