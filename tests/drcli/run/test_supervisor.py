"""What becomes of a run whose workers end, told by short processes in their places."""

import errno
import logging
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from drcli.base.log import LogFile
from drcli.base.processes import STOPS
from drcli.config.loading import load_settings
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import RunRecord, log_file
from drcli.run import heartbeat_monitor, run_ending, stall_watch, supervisor
from drcli.run.duty import Duty, RunningTraining
from drcli.run.heartbeat_monitor import HeartbeatMonitor
from drcli.run.interruption_watch import Renewal
from drcli.run.stall_watch import FrozenWatch
from drcli.run.supervisor import Supervisor
from memory_bucket import MemoryBucket

STAYS = "import time; time.sleep(60)"
ENDS = WorkerExit("Training is complete.", "", 0)
"""A trainer that says so when it has finished; one that only exits was told to."""


@dataclass(frozen=True)
class Late:
    """A trainer that finishes after a second."""


@dataclass(frozen=True)
class Stuck:
    """An end inside an operation of the reward function that Python cannot interrupt."""

    copy: Path

    def leave(self, log: Path) -> None:
        """Write the stacks that are in the log then."""
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text(
            "Current thread 0x00007f8ac224ab80 (most recent call first):\n"
            f'  File "{self.copy}", line 2 in slow\n'
            f'  File "{self.copy}", line 5 in reward_function\n'
            '  File "drsim/episode/reward.py", line 109 in checked_rewards\n'
        )


class Stage:
    """A run whose processes do what a test says."""

    def __init__(self, folder):
        (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model\n")
        (folder / "system.env").write_text("")
        self.job = Job(
            config=load_settings(folder, environ={}).run,
            session="start",
            seed=1,
            max_minutes=None,
            folder=folder,
            launcher_pid=os.getpid(),
        )
        self.scripts = {"trainer": [ENDS], "sim-0": [STAYS]}
        self.server_restarts = 0
        self.trainers: list[tuple[int | None, int]] = []
        self.duties: Callable[[RunningTraining], list[Duty]] = lambda run: []
        self.bucket = MemoryBucket()
        self.revive_server: Callable[[], None] = lambda: None

    def start_process(self, job, name, module, *arguments, gpus=""):
        if job.trainer is not None:
            self.trainers.append(
                (job.trainer, lease.read_lease(ModelStore(self.bucket, "model")).trainer)
            )
        script = self.scripts[name].pop(0)
        if isinstance(script, Stuck):
            script.leave(log_file(job.directory, job.config.model.prefix, name))
            script = "import os, signal; os.kill(os.getpid(), signal.SIGPROF)"
        if isinstance(script, WorkerExit):
            script.write(job.folder, name)
            script = f"raise SystemExit({script.code})"
        if isinstance(script, Late):
            ENDS.write(job.folder, name)
            script = "import time; time.sleep(1)"
        return subprocess.Popen([sys.executable, "-S", "-c", script])

    def restart_server(self):
        self.server_restarts += 1

    def run(self) -> int:
        record = RunRecord(
            run_id=0,
            session="start",
            bucket="bucket",
            prefix="model",
            world="reinvent_base",
            state="starting",
            pid=os.getpid(),
            pid_started=0.0,
            started_at=time.time(),
        )
        taken = lease.take(ModelStore(self.bucket, "model"), "start")
        return Supervisor(
            self.job,
            self.bucket,
            record,
            Renewal(ModelStore(self.bucket, "model"), taken),
            open_bucket=MemoryBucket,
            revive_server=self.revive_server,
            restart_server=self.restart_server,
            duties=self.duties,
        ).run()


@pytest.fixture
def stage(tmp_path, monkeypatch):
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *STOPS)}
    stage = Stage(tmp_path)
    monkeypatch.setattr(supervisor, "start_process", stage.start_process)
    monkeypatch.setattr(supervisor, "POLL_S", 0.01)
    yield stage
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_run_ends_with_its_trainer(stage):
    assert stage.run() == 0
    assert stage.server_restarts == 0


def test_a_trainer_that_somebody_told_to_exit_has_not_finished(stage):
    stage.scripts["trainer"] = ["pass", ENDS]

    assert stage.run() == 0

    assert RunRecord.read(stage.job.folder).workers[0].restarts == 1


def test_an_end_without_a_remedy_is_logged_without_a_blank(stage, monkeypatch, caplog):
    monkeypatch.setattr(run_ending, "_logger", logging.getLogger("supervisor"))
    with caplog.at_level("INFO", "supervisor"):
        stage.run()

    assert "Training is complete." in [record.getMessage() for record in caplog.records]


def test_a_worker_that_the_bucket_failed_gets_a_fresh_server(stage):
    stage.scripts["trainer"] = [WorkerExit("Nothing answers there.", "Wait.", 4, silent=True), ENDS]

    assert stage.run() == 0
    assert stage.server_restarts == 1


def test_a_worker_that_says_so_ends_the_run(stage):
    stage.scripts["trainer"] = [WorkerExit("It is not JSON.", "Correct it.", 3, final=True)]

    assert stage.run() == 3


def test_a_server_is_not_restarted_again_for_what_failed_before_its_restart(stage):
    silent = WorkerExit("Nothing answers there.", "Wait.", 4, silent=True)
    stage.scripts = {"trainer": [silent, Late()], "sim-0": [silent, STAYS]}

    assert stage.run() == 0
    assert stage.server_restarts == 1


@pytest.mark.parametrize("code", [1, 4])
def test_a_worker_that_failed_otherwise_does_not(stage, code):
    stage.scripts["trainer"] = [WorkerExit("A bug, or damage.", "Report it.", code), ENDS]

    assert stage.run() == 0
    assert stage.server_restarts == 0


def test_a_trainer_elsewhere_may_write_only_while_no_later_one_was_started(stage):
    stage.job = replace(stage.job, ray_trainer=True)
    stage.scripts["trainer"] = [WorkerExit("Its node is gone.", "", 5, lost=True), ENDS]

    assert stage.run() == 0

    assert stage.trainers == [(0, 0), (1, 1)]


def test_a_trainer_whose_nodes_are_lost_quickly_may_try_more_often_than_one_that_fails(stage):
    lost = WorkerExit("Its node is gone.", "", 5, lost=True)
    stage.scripts["trainer"] = [*[lost] * 8, ENDS]

    assert stage.run() == 0


def test_the_exit_file_of_an_earlier_run_explains_nothing(stage):
    WorkerExit("NaN detected.", "Lower lr.", 6, final=True).write(stage.job.folder, "trainer")
    stage.scripts["trainer"] = ["import os; os.kill(os.getpid(), 9)", ENDS]

    assert stage.run() == 0


def test_a_worker_that_dies_again_and_again_ends_the_run(stage):
    stage.scripts["trainer"] = [WorkerExit("A bug.", "Report it.", 1)] * 4

    assert stage.run() == 5


def test_a_reward_function_that_cannot_be_interrupted_is_named_with_its_line(stage, tmp_path):
    copy = tmp_path / "sim-0" / "reward_function.py"
    copy.parent.mkdir()
    copy.write_text("def slow():\n    return sum(range(10**12))\n")
    stage.scripts = {"trainer": [STAYS], "sim-0": [Stuck(copy)]}

    assert stage.run() == 3

    record = RunRecord.read(stage.job.folder)
    assert "reward_function.py, line 2, failed: one operation takes far longer" in record.message
    assert record.message.endswith("\n  return sum(range(10**12))")
    assert "--resume" in record.remedy


def test_what_would_only_repeat_ends_the_run_at_once(stage):
    stage.scripts["trainer"] = [WorkerExit("No such action.", "Correct it.", 3, final=True)]

    assert stage.run() == 3


def test_a_training_that_lost_its_model_ends_at_once_and_leaves_the_bucket_alone(
    stage, monkeypatch
):
    monkeypatch.setattr(supervisor, "LEASE_POLL_S", 0.05)
    stage.scripts = {"trainer": [STAYS], "sim-0": [STAYS]}
    start = stage.start_process

    def start_process(job, name, *rest, **options):
        if name == "sim-0":
            lease.take(ModelStore(stage.bucket, "model"), "theirs")
        return start(job, name, *rest, **options)

    monkeypatch.setattr(supervisor, "start_process", start_process)
    began = time.monotonic()

    assert stage.run() == 8

    assert time.monotonic() - began < 15.0
    record = RunRecord.read(stage.job.folder)
    assert "took over" in record.message
    assert [info.key for info in stage.bucket.list("")] == [keys.lease("model")]
    assert lease.holder(ModelStore(stage.bucket, "model")).session == "theirs"


class Silent(MemoryBucket):
    """A bucket that answers nobody any more, once it is told so."""

    silent = False

    def __init__(self) -> None:
        super().__init__()
        self.end = threading.Event()

    def hang(self) -> None:
        if self.silent:
            self.end.wait(60.0)

    def get_with_age(self, key):
        self.hang()
        return super().get_with_age(key)

    def put(self, key, data, *, watch=None):
        self.hang()
        super().put(key, data, watch=watch)

    def list(self, folder):
        self.hang()
        return super().list(folder)


def test_a_silent_bucket_holds_up_neither_the_workers_nor_the_end(stage, monkeypatch):
    for name in ("LOOK_PATIENCE_S", "LOGS_PATIENCE_S", "RELEASE_PATIENCE_S"):
        monkeypatch.setattr(run_ending, name, 0.05)
    stage.bucket = Silent()
    stage.revive_server = stage.bucket.hang
    stage.scripts = {"trainer": [STAYS], "sim-0": ["raise SystemExit(1)", STAYS]}
    start = stage.start_process

    def start_process(job, name, *rest, **options):
        stage.bucket.silent = True
        if len(stage.scripts[name]) == 1 and name == "sim-0":  # it is brought back
            signal.raise_signal(signal.SIGTERM)
        return start(job, name, *rest, **options)

    monkeypatch.setattr(supervisor, "start_process", start_process)
    began = time.monotonic()

    code = stage.run()
    stage.bucket.end.set()

    assert code == 143
    assert time.monotonic() - began < 10.0
    assert RunRecord.read(stage.job.folder).state == "stopped"


@pytest.mark.parametrize("number", STOPS)
def test_the_trainer_leaves_after_the_simulation_so_that_it_can_score_what_was_evaluated(
    stage, number
):
    order = stage.job.folder / "order"
    tells = (
        "import signal, sys, time\n"
        "def leave(*_):\n"
        f"    open({str(order)!r}, 'a').write('{{}} ')\n"
        "    sys.exit()\n"
        "signal.signal(signal.SIGTERM, leave)\n"
        f"open({str(order)!r} + '-{{}}', 'w').close()\n"
        "time.sleep(60)"
    )
    names = ("trainer", "sim-0")
    stage.scripts = {name: [tells.format(name, name)] for name in names}

    def stop_once_they_run() -> None:
        deadline = time.monotonic() + 20.0
        while not all(order.with_name(f"order-{name}").exists() for name in names):
            assert time.monotonic() < deadline
            time.sleep(0.01)
        for _ in range(1 + (number == signal.SIGHUP)):  # a shell repeats that of its terminal
            os.kill(os.getpid(), number)

    threading.Thread(target=stop_once_they_run).start()

    assert stage.run() == 143

    assert order.read_text().split() == ["sim-0", "trainer"]
    assert RunRecord.read(stage.job.folder).message == f"Stopped by {number.name}."
    assert lease.holder(ModelStore(stage.bucket, "model")) is None


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full disk to try it on")
def test_a_full_disk_costs_lines_of_the_log_and_not_the_end(stage, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    stage.scripts = {"trainer": [ENDS], "sim-0": [STAYS]}
    monkeypatch.setattr(RunRecord, "write", full)
    (stage.job.folder / "full.log").symlink_to("/dev/full")
    log = LogFile(stage.job.folder / "full.log", 1 << 20)

    try:
        assert stage.run() == 0
    finally:
        log.end()
    assert lease.holder(ModelStore(stage.bucket, "model")) is None


@pytest.mark.nightly
def test_a_worker_that_crashes_again_and_again_ends_the_run_and_names_the_fault(stage):
    crashes = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
    stage.scripts = {"trainer": [STAYS], "sim-0": [crashes] * 4}

    assert stage.run() == 5

    record = RunRecord.read(stage.job.folder)
    assert record.message == "sim-0 died 4 times in a row: a memory fault (signal SIGSEGV)."
    assert "dr-logs sim-0" in record.remedy


class LeavesOut(Duty):
    """Lets the run go on without the worker that ended."""

    def died(self, child, code, words):
        """Leave it out."""
        child.excluded = True


def test_a_run_goes_on_without_a_worker_that_a_duty_leaves_out(stage):
    stage.duties = lambda run: [LeavesOut(run)]
    stage.scripts = {"trainer": [Late()], "sim-0": ["raise SystemExit(1)"]}

    assert stage.run() == 0

    workers = {worker.name: worker for worker in RunRecord.read(stage.job.folder).workers}
    assert (workers["sim-0"].pid, workers["sim-0"].restarts) == (None, 0)


def test_a_worker_that_somebody_stops_is_replaced(stage, monkeypatch):
    monkeypatch.setattr(stall_watch, "STARTING_S", 0.3)
    monkeypatch.setattr(FrozenWatch, "check_s", 0.02)
    monkeypatch.setattr(heartbeat_monitor, "QUIET_S", 0.1)
    ends = stage.job.folder / "end"
    waits = f"import os, time\nwhile not os.path.exists({str(ends)!r}): time.sleep(0.01)"
    stops = "import os, signal; os.kill(os.getpid(), signal.SIGSTOP)"
    second = f"open({str(ends)!r}, 'w').close(); import time; time.sleep(60)"
    stage.scripts = {"trainer": [waits, ENDS], "sim-0": [stops, second]}
    heartbeats = HeartbeatMonitor(stage.job.folder)
    stage.duties = lambda run: [FrozenWatch(run, heartbeats)]

    assert stage.run() == 0

    restarts = {w.name: w.restarts for w in RunRecord.read(stage.job.folder).workers}
    assert restarts["sim-0"] == 1


class Removes(Duty):
    """Removes the folder of the run once, as somebody who tidies up, and waits for its record."""

    name = "removes"

    def __init__(self, run: RunningTraining, folder: Path, back: Path) -> None:
        super().__init__(run)
        self._folder, self._back = folder, back
        self._removed = False

    def check(self) -> None:
        if not self._removed:
            shutil.rmtree(self._folder)
        elif RunRecord.read(self._folder) is not None:
            self._back.touch()
        self._removed = True


def test_a_run_whose_folder_is_removed_is_known_again(stage, tmp_path):
    back = tmp_path / "back"
    stage.job = replace(stage.job, folder=tmp_path / "runs" / "0")
    stage.job.folder.mkdir(parents=True)
    waits = f"import os, time\nwhile not os.path.exists({str(back)!r}): time.sleep(0.01)"
    stage.scripts = {"trainer": [waits, ENDS], "sim-0": [STAYS]}
    stage.duties = lambda run: [Removes(run, stage.job.folder, back)]

    assert stage.run() == 0
