"""Processes that do not come up in time, or fail: none is left behind, and its reason is told."""

import subprocess
import sys
from contextlib import contextmanager

import pytest

from drcli.base import log
from drcli.base.errors import SettingsError, StorageError, TrainingFailed, WorkerDied
from drcli.model.files.custom_files import InputFile, Inputs
from drcli.records.job import Job, WorkerExit
from drcli.records.run_record import log_file
from drcli.run import evaluation, training, worker_processes
from drcli.run.evaluation_plan import EvaluationPlan
from drcli.run.plan import RunPlan

SOON_S = 30.0
SLEEPS = "import time; time.sleep(600)"
STUBBORN = (
    f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); {SLEEPS}"
)


@pytest.fixture
def job(racer) -> Job:
    folder = racer.folder / "data" / "job"
    folder.mkdir(parents=True)
    return Job(racer.settings().run, "ours", 7, None, folder, 1)


@pytest.fixture
def started(monkeypatch):
    """Puts small programs in the place of workers, and tells which were started."""
    processes: list[subprocess.Popen[bytes]] = []

    def run(program: str, ready_s: float = 0.0) -> list[subprocess.Popen[bytes]]:
        def start(*_: object, **__: object) -> subprocess.Popen[bytes]:
            process = subprocess.Popen([sys.executable, "-c", program])
            processes.append(process)
            return process

        for module in (training, evaluation):
            monkeypatch.setattr(module, "start_process", start)
            monkeypatch.setattr(module, "READY_TIMEOUT_S", ready_s)
        return processes

    yield run
    for process in processes:
        process.kill()
        process.wait()


def test_a_supervisor_that_is_not_ready_in_time_is_ended(job, started):
    processes = started(SLEEPS)
    files = (InputFile(name, b"", "") for name in ("reward", "hyperparameters", "metadata"))

    with pytest.raises(WorkerDied, match="did not start"):
        training.launch(RunPlan(job, Inputs(*files), [], None, ""))

    assert [process.returncode for process in processes] == [-15]


def test_an_evaluation_that_is_not_ready_in_time_is_ended(job, started):
    processes = started(SLEEPS)

    with pytest.raises(WorkerDied, match="did not start: it was not ready within") as late:
        evaluation.launch_evaluation(EvaluationPlan(job, ["0_Step-0.ckpt"], "20260102030405"))

    assert [process.returncode for process in processes] == [-15]
    assert not job.folder.exists()
    assert "less busy" in late.value.remedy


def _launch_training(job: Job) -> None:
    files = (InputFile(name, b"", "") for name in ("reward", "hyperparameters", "metadata"))
    training.launch(RunPlan(job, Inputs(*files), [], None, ""))


def _launch_evaluation(job: Job) -> None:
    evaluation.launch_evaluation(EvaluationPlan(job, ["0_Step-0.ckpt"], "20260102030405"))


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("launch", "name"), [(_launch_training, "supervisor"), (_launch_evaluation, "evaluation")]
)
@pytest.mark.parametrize(
    ("written", "said"),
    [("The bucket is full.\n\n", "The bucket is full."), ("", "(nothing)")],
)
def test_a_process_that_exits_at_once_is_told_from_a_late_one(
    job, started, launch, name, written, said
):
    path = log_file(job.directory, job.config.model.prefix, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("Of an earlier start.\n")
    started(f"import sys; open({str(path)!r}, 'a').write({written!r}); sys.exit(3)", ready_s=SOON_S)

    with pytest.raises(WorkerDied) as died:
        launch(job)

    assert f"exited (exit code 3). The last line of its log is: {said}" in str(died.value)
    assert str(path) in died.value.remedy


def test_a_start_may_take_a_minute_on_a_busy_machine():
    assert training.READY_TIMEOUT_S == evaluation.READY_TIMEOUT_S == 60.0


def test_a_process_that_does_not_leave_is_killed():
    with subprocess.Popen([sys.executable, "-c", STUBBORN], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()

        left = worker_processes.end_process(process, 0.0)

    assert not left
    assert process.returncode == -9


@pytest.mark.parametrize(
    "failure",
    [SettingsError, StorageError, TrainingFailed, WorkerDied],
    ids=lambda kind: kind.__name__,
)
def test_an_evaluation_fails_as_its_worker_failed(job, started, failure, tmp_path):
    WorkerExit.of(failure("Nothing answers.", remedy="Start the bucket.")).write(
        tmp_path, "evaluation"
    )
    [words] = tmp_path.glob("evaluation.*")
    started(f"import shutil; shutil.copy('{words}', '{job.folder}'); raise SystemExit(1)")

    with pytest.raises(failure, match="Nothing answers") as raised:
        evaluation.run_evaluation(EvaluationPlan(job, ["0_Step-0.ckpt"], "20260102030405"))

    assert raised.value.code == failure.code
    assert raised.value.remedy == "Start the bucket."


@pytest.mark.nightly
def test_an_evaluation_whose_worker_says_nothing_names_its_log(job, started):
    started("raise SystemExit(9)")

    with pytest.raises(WorkerDied, match="exit code 9") as raised:
        evaluation.run_evaluation(EvaluationPlan(job, ["0_Step-0.ckpt"], "20260102030405"))

    assert "evaluation.log" in raised.value.remedy


def test_the_log_of_an_evaluation_is_sent_while_its_worker_runs(job, started, monkeypatch):
    sent = []

    @contextmanager
    def sending(job, names):
        sent.append((names, len(processes)))
        yield
        sent.append([process.returncode for process in processes])

    monkeypatch.setattr(evaluation, "sent_to_cloud_watch", sending)
    processes = started("raise SystemExit(0)")

    with pytest.raises(WorkerDied, match="no results"):
        evaluation.run_evaluation(EvaluationPlan(job, ["0_Step-0.ckpt"], "20260102030405"))

    assert sent == [(["evaluation"], 0), [0]]


def test_a_process_knows_its_log_so_that_it_can_rotate_it(job):
    say = f"import os; print(os.environ['{log.VARIABLE}'])"

    process = worker_processes.start_process(job, "sim-0", "timeit", "-n1", "-r1", say)

    assert process.wait(60) == 0
    path = log_file(job.directory, job.config.model.prefix, "sim-0")
    assert path.read_text().splitlines()[0] == str(path)
