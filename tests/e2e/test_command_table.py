"""Every row of the command table, called as a user calls it, in text and in JSON.

Programs take long, so all of them are called beforehand, around one short training; the tests then
look at what each said.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import typer.main

from drcli.cli.command_line import application
from drcli.cli.command_table import COMMANDS

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(900),  # of a busy machine, for all together
]

AT_ONCE = 3
"""Programs that run at the same time; two cores and some waiting."""

PATIENCE_S = 120.0
LONG = (("DR_EVAL_NUMBER_OF_TRIALS", "3000"), ("DR_EVAL_MAX_RESETS", "100000"))
"""An evaluation that does not end before it is stopped."""

UNUSED = (("DR_LOCAL_S3_MODEL_PREFIX", "unused"),)
"""A name that a new model could have."""

NO_CLOUD = (("AWS_EC2_METADATA_DISABLED", "true"),)
"""On a machine of Amazon, nothing is asked either."""


@dataclass(frozen=True)
class Call:
    """A command line and what it must answer.

    Attributes:
        words: What follows `dr`.
        says: A piece of its output; in JSON, the keys of its report.
        code: Its exit code.
        env: Settings for this call alone.
    """

    words: str
    says: str
    code: int = 0
    env: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """The row of the table."""
        return self.words.split()[0]


NO_KEYS = (
    ("AWS_SHARED_CREDENTIALS_FILE", "/dev/null"),
    ("AWS_CONFIG_FILE", "/dev/null"),
    ("AWS_EC2_METADATA_DISABLED", "true"),
    ("AWS_ACCESS_KEY_ID", ""),
)
"""No keys of Amazon, whatever the machine of the test has."""

STARTED = Call("start-training -q --json", "run_id bucket prefix state pid workers history")

WHILE_TRAINING = [
    Call("start-training", "is training s3://bucket/model already", 3),
    Call("status", "running"),
    Call("status --json", "run_id bucket prefix state workers history best last dead"),
    Call("journal", "begins a new model"),
    Call("journal --json", "model events damaged"),
    Call("history", "running"),
    Call("history --json", "bucket trainings total damaged"),
    Call("spot watch --once", "belongs to no cloud", 3, NO_CLOUD),
    Call("summary", "training"),
    Call("summary --json", "folder prefix world workers bucket running versions gpus"),
    Call("find-sagemaker", ""),
    Call("find-sagemaker --json", "processes"),
    Call("find-robomaker -n 1", ""),
    Call("find-robomaker --json", "processes"),
    Call("get-robomaker-stats", "steps/s"),
    Call("get-robomaker-stats -n 1 --json", "worker pid iteration steps steps_per_s"),
]

FOLLOWING = [
    Call("logs-sagemaker -w 5 -a", "Policy training> Surrogate loss="),
    Call("logs-robomaker -n 1 -a", "SIM_TRACE_LOG:"),
]
"""End with the training."""

STOPPED = Call("stop-training", "Stopped the training of s3://bucket/model")

AFTERWARDS = [
    Call("attach", "s3://bucket/model"),
    Call("attach --json", "run_id bucket prefix state workers history best last dead"),
    Call("docs hyperparameters", "beta_entropy"),
    Call("saliency -n 1 --spacing 20 --html page.html", "Page: page.html"),
    Call("saliency -n 1 --method hires-cam --json", "model checkpoint world steps lap"),
    Call("validate", "", 0, UNUSED),
    Call("validate --json", "ok skipped", 0, UNUSED),
    Call("reward check", ""),
    Call("reward check --json", ""),
    Call("tracks show reinvent_base", "reinvent_base"),
    Call("tracks show reinvent_base --json", "facts"),
    Call("stop-training --json", "stopped server"),
    Call("start-worker --join s3://bucket/model", "The training of s3://bucket/model has ended"),
    Call("start-worker --join s3://bucket/model --json", "model message code took_over"),
    Call("start-worker --join s3://bucket/nothing", "is not being trained.", 3),
    Call("start-worker --join bucket/model", "does not name a model", 2),
    Call("sweep init", "Wrote"),
    Call("sweep sweep.yaml -d", "first-sweep-04"),
    Call("sweep sweep.yaml -d --json", "name trials parallel continues"),
    Call("sweep start none.yaml", "none.yaml cannot be read", 3),
    Call("sweep list", "has no sweeps"),
    Call("sweep list --json", "bucket sweeps damaged"),
    Call("sweep show none", "has no sweep none", 3),
    Call("logs trainer -a", "Policy training> Surrogate loss="),
    Call("logs-robomaker", "Robomaker #1 is not running.", 1),
    Call("logs-sagemaker", "Sagemaker is not running.", 1),
    Call("history show model", "Training"),
    Call("history show model --json", "training record files saved"),
    Call("history compare model model", "are equal"),
    Call("history tree", "model"),
    Call("logs reward", "has printed nothing yet", 1),
    Call("list-models", "model"),
    Call("list-models --json", "models"),
    Call("list-checkpoints", "last"),
    Call("list-checkpoints --json", "model checkpoints milestones not_reached"),
    Call("note add words", "words"),
    Call("note list --json", "model notes"),
    Call("delete-model nothing", "There is no model nothing", 3),
    Call("delete-model model --dry-run --json", "bucket models size_bytes"),
    Call("analyze", "Verdict:"),
    Call("analyze --json", "iterations verdict advice complete_laps best_lap_s"),
    Call("analyze compare model model", "model is named twice", 3),
    Call("url-loganalysis", "There is no report of model", 1),
    Call("start-loganalysis --no-open --json", "model html url"),
    Call("url-loganalysis --json", "model html url"),
    Call("tidy --dry-run", ""),
    Call("tidy --dry-run --json", "bucket items busy"),
    Call("list-aws-models", ""),
    Call("list-aws-models --json", "models"),
    Call("upload-custom-files", "s3://bucket/custom_files"),
    Call("upload-custom-files --json", "copied unchanged"),
    Call("download-custom-files", "s3://bucket/custom_files"),
    Call("download-custom-files --json", "copied unchanged"),
    Call("init elsewhere --world reinvent_base", "files written"),
    Call("init somewhere --json", "folder written"),
    Call("config show DR_WORLD_NAME", "reinvent_base"),
    Call("config check --json", "errors valid rules", 0, UNUSED),
    Call("config check --settings", "Settings:"),
    Call("config preset", "student-league"),
    Call("config preset physical --json", "presets"),
    Call("action-space show", "3 actions."),
    Call("action-space show --json", "file actions low high notes changes written backup picture"),
    Call("action-space generate --angles 3", "6 actions."),
    Call("action-space generate --continuous --json", "actions low high written"),
    Call("action-space from-histogram --json", "actions notes"),
    Call("action-space from-histogram", "They cover"),
    Call("action-space from-lap nowhere.csv", "nowhere.csv cannot be read", 3),
    Call("action-space from-lap nowhere.csv --json", "nowhere.csv cannot be read", 3),
    Call("video nowhere.csv --gif", "nowhere.csv does not exist", 3),
    Call("video nowhere.csv --gif --json", "nowhere.csv does not exist", 3),
    Call("bench --json --no-bucket", "number standard bucket busy_share"),
    Call("doctor", "s3://bucket"),
    Call("doctor --json", "folder seconds findings problems warnings exit_code"),
    Call("support-bundle bundle.tar.gz", "none is in the archive"),
    Call("support-bundle bundle.tgz --without-files --json", "file files redactions left_out"),
    Call("update", "are right"),
    Call("update -q --json", "files settings warnings"),
    Call("update-env", "are right"),
    Call("update-env -q --json", "files settings warnings"),
    Call("reload", "are right"),
    Call("reload -q --json", "files settings warnings"),
    Call("explain lr", "Learning rate"),
    Call("explain lr --json", "question entries"),
    Call("explain nothing-like-this", "Nothing is known about", 3),
    Call("url", "s3://bucket/model/"),
    Call("url metrics --json", "cloud endpoint running region places"),
    Call("local-aws s3 ls --recursive", "s3 ls --recursive", 3),
    Call("completion show bash", "complete"),
    Call("completion install bash --json", "shell script"),
    Call("car status", "No car is named", 3),
    Call("car logout --car 127.0.0.1:9 --json", "car was_logged_in"),
    Call("help race submit", "Usage: dr race submit"),
    Call("version", "mujoco"),
    Call("version --json", "version python torch mujoco platform"),
    Call("console status", "No console is running.", 1),
    Call("stop-viewer", "No console is running."),
    Call("stop-viewer --json", "stopped pid"),
    Call("start-viewer -w 640 -h 480 -q 75 -b true", "http://127.0.0.1:"),
    Call("start-viewer --json", "url pid host port needs_token started"),
    Call("console --no-open", "http://127.0.0.1:"),
    Call("console --no-open --json", "url pid host port needs_token started"),
    Call("console status --json", "url pid host port needs_token started"),
    Call("update-viewer", "http://127.0.0.1:"),
    Call("update-viewer --json", "url pid host port needs_token started"),
    Call("view-stream -w 320 -h 240", "/stream?topic=/racecar/deepracer/kvs_stream&quality=75"),
    Call("view-stream --json", "topic urls"),
    Call("view-stream -t /none", "there is no topic /none", 2),
    Call("logs-loganalysis", "No log analysis is running."),
    Call("logs-loganalysis --json", "stopped"),
    Call("metrics stop --json", "stopped pid"),
    Call("start-metrics --port 70000", "must be at most 65535", 2),
    Call("start-metrics --port 70000 --json", "must be at most 65535", 2),
    Call("stop-metrics", "No TensorBoard is running."),
    Call("stop-metrics --json", "stopped pid"),
    Call("stop-loganalysis", "No log analysis is running."),
    Call("stop-loganalysis --json", "stopped"),
    Call("race create Cup --laps 1", "Cup (cup)"),
    Call("race edit cup --max-submissions 3", "Cup (cup)"),
    Call("race submit cup model --racer Ann", "Submitted checkpoint"),
    Call("race show cup --json", "race state rules leaderboard queue runner submissions winner"),
    Call("race list", "cup"),
    Call("race delete cup -f --json", "race objects size_bytes"),
    Call("start-tournament", "has no race in pairs", 3),
    Call("start-tournament nothing --json", "There is no race nothing", 3),
    Call("droa list --json", "DR_DROA_URL", 3),
    Call("droa races --json", "DR_DROA_URL", 3),
    Call("droa submit ID RACE --json", "DR_DROA_URL", 3),
    Call("droa-login --json", "DR_DROA_URL", 3),
    Call("droa-logout --json", "DR_DROA_URL", 3),
    Call("droa-list-models --json", "DR_DROA_URL", 3),
    Call("droa-get-model ID --json", "DR_DROA_URL", 3),
    Call("droa-download-logs ID -o there --json", "DR_DROA_URL", 3),
    Call("droa-delete-model ID -y --json", "DR_DROA_URL", 3),
    Call("droa-import-model --best --json", "DR_DROA_URL", 3),
    Call("spot list --json", "no access keys", 4, NO_KEYS),
    Call("send-message hello --json", "DR_WEBHOOK_URL", 3),
]

TRANSFERS = [
    Call("upload-model -f", "checkpoint = "),
    Call("upload-model -f -b --to best-1 --json", "target"),
    Call("download-model -s s3://uploads/model-1 -t copy-1 -f", "copy-1"),
    Call("download-model -s s3://uploads/best-1 -t copy-2 -f --json", "target"),
    Call("export car -b", "Wrote "),
    Call("export pb --out policy.pb --json", "file engine same_actions greatest_difference"),
    Call("import policy.pb -t copy-3 -f --no-drive --json", "form network fresh verified"),
    Call("upload-car-zip -f --json", "source files actions same_actions"),
]

EVALUATIONS = [
    Call("evaluate -q", "checkpoint"),
    Call("evaluate --json", "prefix world checkpoint trials simtrace metrics completed clean"),
    Call("evaluate --laps 3 --json", "clean clean_interval median_s p90_s slowest_s ends laps"),
]
INTERRUPTED = Call("evaluate", "The evaluation was stopped.", 143, LONG)
INTERRUPTING = Call("stop-evaluation", "Stopped the evaluation of s3://bucket/model")
IN_BACKGROUND = [
    Call("start-evaluation -q", "Evaluation of model s3://bucket/model starting.", 0, LONG),
    Call("find-robomaker -e", ""),
    Call("start-evaluation -q", "An evaluation of s3://bucket/model is running", 1, LONG),
    Call("stop-evaluation", "Stopped the evaluation"),
    Call("start-evaluation -q --json", "prefix checkpoint pid simtrace metrics", 0, LONG),
    Call("stop-evaluation --json", "stopped server"),
    Call("stop-evaluation", "No evaluation is running."),
]

EDITS = [
    Call("config set DR_EVAL_NUMBER_OF_TRIALS=2 --json", "changes"),
    Call("set-upload-model team/car-1", "team/car-1"),
    Call("set-upload-model team/car-2 --json", "file before after target"),
    Call("increment-upload-model -f", "Incrementing model from team/car-2 to team/car-3"),
    Call("increment-upload-model -f --json", "before after"),
    Call("increment-training -f --json", "file before after pretrained"),
    Call("increment-training -f", "there is no checkpoint at s3://bucket/model-1", 3),
    Call("start-evaluation", "s3://bucket/model-1 has no trained model", 3),
    Call("stop-all", "Stopped the local S3 server; objects stay."),
    Call("stop-all --json", "stopped server"),
]

CALLS = [
    *(STARTED, *WHILE_TRAINING, *FOLLOWING, STOPPED, *AFTERWARDS, *TRANSFERS),
    *(*EVALUATIONS, INTERRUPTED, INTERRUPTING, *IN_BACKGROUND, *EDITS),
]

STARTING = {"start-training", "evaluate", "start-evaluation"}
"""Rows that start workers."""

ROWS = {command.name for command in COMMANDS if not command.hidden}


class Programs:
    """Calls the program in a working folder and keeps what it answered."""

    def __init__(self, workspace: Any, forks: Any) -> None:
        self.folder: Path = workspace.folder
        self.environment = {**workspace.environment, "HOME": str(self.folder / "home")}
        self.answers: dict[Call, subprocess.CompletedProcess[str]] = {}
        self.objects: list[set[Path]] = []
        self.left_s = 0.0
        self._forks = forks
        self._dr = str(Path(sys.executable).parent / "dr")

    def start(self, call: Call) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            [self._dr, *call.words.split()],
            cwd=self.folder,
            env={**self.environment, **dict(call.env)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def finish(self, call: Call, process: "subprocess.Popen[str]") -> None:
        out, err = process.communicate(timeout=PATIENCE_S)
        self.answers[call] = subprocess.CompletedProcess(process.args, process.returncode, out, err)

    def call(self, call: Call) -> None:
        """Start a program that starts workers; others begin in a process that has all loaded."""
        if call.name in STARTING:
            self.finish(call, self.start(call))
        else:
            environment = {**self.environment, **dict(call.env)}
            self.answers[call] = self._forks.run(call.words.split(), self.folder, environment)

    def in_turn(self, calls: Sequence[Call]) -> None:
        for call in calls:
            self.call(call)

    def interrupt(self) -> None:
        """Stop an evaluation from another shell, and note what it changed and how fast it left."""
        self.objects.append(self._objects())
        process = self.start(INTERRUPTED)
        deadline = time.monotonic() + PATIENCE_S
        while not list(self.folder.glob("data/runs/0/evaluations/*/running.json")):
            assert time.monotonic() < deadline, "the evaluation did not start"
            time.sleep(0.05)
        self.call(INTERRUPTING)
        began = time.monotonic()
        self.finish(INTERRUPTED, process)
        self.left_s = time.monotonic() - began
        self.objects.append(self._objects())

    def _objects(self) -> set[Path]:
        model = self.folder / "data" / "s3" / "bucket" / "model"
        return {path for path in model.rglob("*") if path.is_file()}

    def can_upload(self) -> None:
        """Make the local server the bucket of uploads too, under a profile of its own."""
        server = json.loads((self.folder / "data" / "s3" / ".server.json").read_text())
        (self.folder / "data" / "s3" / "uploads").mkdir()
        credentials = self.folder / "credentials"
        credentials.write_text(
            f"[uploads]\naws_access_key_id={server['access_key']}\n"
            f"aws_secret_access_key={server['secret_key']}\n"
        )
        self.environment["AWS_SHARED_CREDENTIALS_FILE"] = str(credentials)
        with (self.folder / "system.env").open("a") as file:
            file.write(
                f"DR_UPLOAD_S3_ENDPOINT_URL=http://127.0.0.1:{server['port']}\n"
                "DR_UPLOAD_S3_PROFILE=uploads\nDR_UPLOAD_S3_BUCKET=uploads\n"
            )

    def has_aws(self) -> None:
        """Put an aws program on the PATH that says how it was called."""
        program = self.folder / "programs" / "aws"
        program.parent.mkdir()
        program.write_text('#!/bin/sh\necho "$@"\nexit 3\n')
        program.chmod(0o755)
        self.environment["PATH"] = f"{program.parent}{os.pathsep}{self.environment['PATH']}"


def at_once(jobs: Sequence[Callable[[], None]]) -> None:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for running in [pool.submit(job) for job in jobs]:
            running.result()


@contextmanager
def asleep(pids: Sequence[int]) -> Iterator[None]:
    """Let processes live without working, so that they leave the machine to others."""
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in pids:
            os.kill(pid, signal.SIGCONT)


@pytest.fixture(scope="module")
def programs(shared_workspace: Any, forks: Any) -> Iterator[Programs]:
    """Everything called once, in an order that a user might choose."""
    space = shared_workspace
    space.hyperparameters["term_cond_max_episodes"] = 100_000
    space.write_custom_files()
    called = Programs(space, forks)
    called.has_aws()
    called.call(STARTED)
    called.can_upload()
    # After the second one, the simulation worker has told everything about the first.
    space.wait_for(lambda: space.iterations() >= 2, "two iterations")
    followers = [(call, called.start(call)) for call in FOLLOWING]
    with asleep([space.pid_of("trainer"), space.pid_of("sim-0")]):
        called.in_turn(WHILE_TRAINING)
    called.call(STOPPED)
    for call, process in followers:
        called.finish(call, process)
    at_once([partial(called.in_turn, calls) for calls in (EVALUATIONS, TRANSFERS, AFTERWARDS)])
    called.interrupt()
    called.in_turn(IN_BACKGROUND)
    called.in_turn(EDITS)
    return called


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.words)
def test_a_command_answers_and_ends_with_its_exit_code(programs, call):
    answer = programs.answers[call]

    assert answer.returncode == call.code, answer.stderr
    assert "Traceback" not in answer.stderr
    if "--json" in call.words.split() and not call.code:
        report = json.loads(answer.stdout.splitlines()[-1])
        assert set(call.says.split()) <= report.keys()
    else:
        assert call.says in answer.stdout + answer.stderr


def test_a_stopped_evaluation_leaves_at_once_and_nothing_half_written(programs):
    before, after = programs.objects

    assert programs.left_s < 1.0
    assert after == before


def test_every_row_of_the_table_is_called():
    assert {call.name for call in CALLS} == ROWS


def test_every_command_that_reports_in_json_is_asked_for_it():
    asked = {call.name for call in CALLS if "--json" in call.words.split()}

    assert {command.name for command in COMMANDS if _reports(command)} <= asked


def _reports(command: Any) -> bool:
    group: Any = typer.main.get_command(application([command.name]))
    loaded = group.commands[command.name]
    parts = getattr(loaded, "commands", {"": loaded}).values()
    return any("--json" in parameter.opts for part in parts for parameter in part.params)
