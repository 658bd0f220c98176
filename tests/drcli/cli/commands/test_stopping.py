"""`dr stop-all` and `dr stop-evaluation` as their caller meets them, with real processes."""

import json
import signal
import subprocess
import sys
import time

import psutil
import pytest

from drcli.base.processes import started_s
from drcli.records.run_record import EvaluationRecord, RunRecord, WaitingStart

OBEDIENT = "import time; print('ready', flush=True); time.sleep(60)"
STUBBORN = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); " + OBEDIENT


@pytest.fixture
def process():
    """Starts processes that wait to be stopped, and sweeps up after the test."""
    started = []

    def start(program=OBEDIENT):
        child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
        started.append(child)
        assert child.stdout is not None
        child.stdout.readline()
        return child

    yield start
    for child in started:
        child.kill()
        child.communicate()


@pytest.fixture
def training(working_folder, process):
    """Makes a folder believe that a process is the supervisor of a training."""

    def start(run_id=0):
        child = process()
        RunRecord(
            run_id=run_id,
            session="abc",
            bucket="bucket",
            prefix=f"model-{run_id}",
            world="reinvent_base",
            state="running",
            pid=child.pid,
            pid_started=psutil.Process(child.pid).create_time(),
            started_at=time.time(),
        ).write(working_folder / "data" / "runs" / str(run_id))
        return child

    return start


@pytest.fixture
def evaluation(working_folder, process):
    """Makes a folder believe that a process waits for an evaluation."""

    def start(run_id=0, program=OBEDIENT):
        child = process(program)
        stamp = f"2026010203040{len(list(working_folder.rglob('running.json')))}"
        folder = working_folder / "data" / "runs" / str(run_id) / "evaluations" / stamp
        folder.mkdir(parents=True)
        EvaluationRecord(
            run_id=run_id,
            stamp=stamp,
            bucket="bucket",
            prefix="model",
            world="reinvent_base",
            checkpoint="8_Step-4000.ckpt",
            pid=child.pid,
            pid_started=psutil.Process(child.pid).create_time(),
            worker_pid=child.pid,
            started_at=time.time(),
        ).write(folder)
        return child

    return start


def test_stop_all_ends_every_run_of_this_folder_and_nothing_else(
    dr, training, evaluation, process, capsys
):
    trainings = [training(0), training(3)]
    evaluations = [evaluation(0), evaluation(3)]
    bystander = process()

    code = dr("stop-all", "--json")

    report = json.loads(capsys.readouterr().out)
    assert code == 0
    assert [(run["kind"], run["run_id"]) for run in report["stopped"]] == [
        ("training", 0),
        ("training", 3),
        ("evaluation", 0),
        ("evaluation", 3),
    ]
    assert [run["pid"] for run in report["stopped"]] == [c.pid for c in trainings + evaluations]
    assert {child.wait(5) for child in trainings + evaluations} == {-signal.SIGTERM}
    assert bystander.poll() is None


def test_stop_all_in_a_wrong_folder_says_only_that(dr, tmp_path, monkeypatch, capsys):
    wrong = tmp_path / "wrong"
    wrong.mkdir()
    monkeypatch.chdir(wrong)

    code = dr("stop-all")

    assert code == 3
    assert capsys.readouterr().err.startswith("Error: run.env: ")


def test_stop_all_says_what_it_ended(dr, training, capsys):
    child = training(3)

    dr("stop-all")

    expected = f"Stopped the training of s3://bucket/model-3 (run 3, process {child.pid}).\n"
    assert capsys.readouterr().out == expected


def test_stopping_where_nothing_runs_is_harmless_and_takes_one_line(dr, working_folder, capsys):
    codes = dr("stop-all"), dr("stop-evaluation")

    assert codes == (0, 0)
    assert capsys.readouterr().out == "Nothing is running.\nNo evaluation is running.\n"


def test_runs_are_stopped_even_where_the_settings_have_become_wrong(
    dr, training, working_folder, capsys
):
    child = training()
    (working_folder / "run.env").write_text("DR_WORKERS=many\n")

    code = dr("stop-all")

    assert code == 3
    assert "run.env line 1" in capsys.readouterr().err
    assert child.wait(5) == -signal.SIGTERM


def test_stop_evaluation_ends_those_of_this_run_number_alone(dr, evaluation, capsys):
    own, other = evaluation(0), evaluation(1)

    code = dr("stop-evaluation", "--json")

    report = json.loads(capsys.readouterr().out)
    assert code == 0
    assert [run["pid"] for run in report["stopped"]] == [own.pid]
    assert own.wait(5) == -signal.SIGTERM
    assert other.poll() is None


def test_a_process_that_does_not_exit_is_named_with_the_way_to_end_it(
    dr, evaluation, monkeypatch, capsys
):
    child = evaluation(program=STUBBORN)
    monkeypatch.setattr("drcli.run.stopping.EVALUATION_PATIENCE_S", 0.0)

    code = dr("stop-evaluation")

    said = capsys.readouterr().err
    assert code == 5
    assert f"Process {child.pid} did not exit." in said
    assert f"kill -9 {child.pid}" in said


@pytest.mark.parametrize("command", ["stop-training", "stop-all"])
def test_settings_that_were_broken_meanwhile_do_not_keep_a_training_alive(
    dr, working_folder, training, command
):
    child = training()
    (working_folder / "run.env").write_text("broken\n")

    dr(command)

    assert child.wait(5) == -signal.SIGTERM


def test_of_several_trainings_broken_settings_stop_none(dr, working_folder, training, capsys):
    children = [training(0), training(1)]
    (working_folder / "run.env").write_text("broken\n")

    code = dr("stop-training")

    assert code == 3
    assert [child.poll() for child in children] == [None, None]
    assert "run.env line 1" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["stop-training", "stop-all"])
def test_a_worker_for_the_training_of_another_machine_ends_too(
    dr, working_folder, process, capsys, command
):
    child = process()
    since = started_s(child.pid)
    worker = WaitingStart(child.pid, since, "bucket", "far/model", "worker")

    with worker.shown(working_folder / "data" / "runs" / "0"):
        code = dr(command)

    said = capsys.readouterr().out
    assert code == 0
    assert child.wait(5) == -signal.SIGTERM
    assert (
        "Stopped the worker for the training of s3://bucket/far/model "
        f"(run 0, process {child.pid})." in said
    )
