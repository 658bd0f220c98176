"""The reference's names for logs, processes and speed as their caller meets them."""

import json
import os
import time

import psutil
import pytest

from drcli.cli.commands import reference_logs
from drcli.records.run_record import EvaluationRecord, RunRecord, WorkerRecord
from drcli.run.worker_processes import SpeedReport


def this_process():
    return {"pid": os.getpid(), "pid_started": psutil.Process().create_time()}


@pytest.fixture
def record(working_folder) -> RunRecord:
    """A training on two workers that runs in this very process."""
    made = RunRecord(
        run_id=0,
        session="abc",
        bucket="bucket",
        prefix="model",
        world="reinvent_base",
        state="running",
        started_at=time.time(),
        workers=[WorkerRecord(name, os.getpid(), 0) for name in ("trainer", "sim-0", "sim-1")],
        **this_process(),
    )
    made.write(working_folder / "data" / "runs" / "0")
    return made


@pytest.fixture
def evaluation(working_folder) -> EvaluationRecord:
    """An evaluation that runs in this very process."""
    folder = working_folder / "data" / "runs" / "0" / "evaluations" / "20260102030405"
    folder.mkdir(parents=True)
    made = EvaluationRecord(
        run_id=0,
        stamp=folder.name,
        bucket="bucket",
        prefix="model-E",
        world="reinvent_base",
        checkpoint="8_Step-4000.ckpt",
        worker_pid=os.getpid(),
        started_at=time.time(),
        **this_process(),
    )
    made.write(folder)
    return made


@pytest.fixture
def meanwhile(monkeypatch):
    """Makes something happen at each wait."""

    def plan(*events):
        left = list(events)
        monkeypatch.setattr(reference_logs.time, "sleep", lambda seconds: left.pop(0)())

    return plan


@pytest.mark.parametrize(
    ("command", "title", "log"),
    [
        (["logs-sagemaker"], "Sagemaker", "trainer"),
        (["logs-robomaker"], "Robomaker #1", "sim -n 0"),
        (["logs-robomaker", "-n", "2"], "Robomaker #2", "sim -n 1"),
        (["logs-robomaker", "-e"], "Robomaker #1", "evaluation"),
        (["find-sagemaker"], "Sagemaker", "trainer"),
        (["find-robomaker"], "Robomaker", "sim -n 0"),
        (["find-robomaker", "-n", "3"], "Robomaker #3", "sim -n 2"),
        (["get-robomaker-stats", "-n", "2"], "Robomaker #2", "sim -n 1"),
    ],
)
def test_what_does_not_run_is_said_in_the_references_words_with_its_code(
    dr, working_folder, capsys, command, title, log
):
    code = dr(*command)

    printed = capsys.readouterr()
    assert code == 1
    assert printed.out == ""
    assert f"{title} is not running." in printed.err
    assert f"`dr-logs {log}` shows the log of the last one" in printed.err


def test_a_log_is_followed_until_its_training_ends(
    dr, record, working_folder, log, meanwhile, capsys
):
    path = log("trainer")
    path.write_text("".join(f"line {k}\n" for k in range(200)))

    def end():
        with path.open("a") as file:
            file.write("the last words")
        finished = record.ended("finished", 0, "", "", time.time())
        finished.write(working_folder / "data" / "runs" / "0")

    meanwhile(end)
    code = dr("logs-sagemaker")

    lines = capsys.readouterr().out.splitlines()
    assert code == 0
    assert lines == [*(f"line {k}" for k in range(100, 200)), "the last words"]


def test_all_of_a_log_is_shown_on_request_and_ctrl_c_is_no_failure(
    dr, record, log, meanwhile, capsys
):
    log("sim-1").write_text("".join(f"line {k}\n" for k in range(200)))

    def interrupt():
        raise KeyboardInterrupt

    meanwhile(interrupt)
    code = dr("logs-robomaker", "-n", "2", "-a")

    assert code == 0
    assert len(capsys.readouterr().out.splitlines()) == 200


def test_a_start_may_be_waited_for(dr, record, working_folder, log, meanwhile, capsys):
    folder = working_folder / "data" / "runs" / "0"
    log("trainer").write_text("hello\n")
    (folder / "run.json").unlink()
    ended = record.ended("finished", 0, "", "", time.time())
    meanwhile(lambda: record.write(folder), lambda: ended.write(folder))

    code = dr("logs-sagemaker", "-w", "60")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out == "hello\n"
    assert printed.err == "Waiting for Sagemaker to start ...\n"


def test_the_log_of_an_evaluated_copy_is_found(dr, evaluation, working_folder, meanwhile, capsys):
    path = working_folder / "data" / "logs" / "sagemaker" / "model-E" / "evaluation.log"
    path.parent.mkdir(parents=True)
    path.write_text("drives\n")
    note = next(working_folder.rglob("running.json"))
    meanwhile(note.unlink)

    dr("logs-robomaker", "-e")

    assert capsys.readouterr().out == "drives\n"


@pytest.mark.parametrize(
    ("command", "count"),
    [(["find-sagemaker"], 1), (["find-robomaker"], 2), (["find-robomaker", "-n", "2"], 1)],
)
def test_process_numbers_are_printed_one_a_line(dr, record, capsys, command, count):
    code = dr(*command)

    assert code == 0
    assert capsys.readouterr().out == f"{os.getpid()}\n" * count


def test_programs_get_processes_with_their_logs(dr, evaluation, capsys):
    dr("find-robomaker", "-e", "--json")

    [found] = json.loads(capsys.readouterr().out)["processes"]
    assert (found["name"], found["pid"]) == ("evaluation", os.getpid())
    assert found["log"].endswith("data/logs/sagemaker/model-E/evaluation.log")


def test_finding_nothing_leaves_an_empty_list_and_a_failure(dr, working_folder, capsys):
    code = dr("find-robomaker", "--json")

    assert code == 1
    assert json.loads(capsys.readouterr().out) == {"processes": []}


def test_programs_get_the_speed_of_one_worker(dr, record, monkeypatch, capsys):
    monkeypatch.setattr(
        "drcli.run.worker_processes.speed_of",
        lambda process, _: SpeedReport(process.name, process.pid, 3, 4, 2.0, 2.0 / 15.0),
    )

    code = dr("get-robomaker-stats", "-n", "2", "--json")

    report = json.loads(capsys.readouterr().out)
    assert code == 0
    assert report["worker"] == "sim-1"
    assert report["iteration"] == 3
    assert report["steps"] == 4
    assert report["steps_per_s"] == pytest.approx(2.0)
    assert report["real_time_factor"] == pytest.approx(2.0 / 15.0)


def test_before_the_first_iteration_there_is_no_speed(dr, record, capsys):
    code = dr("get-robomaker-stats")

    assert code == 0
    assert capsys.readouterr().out == "sim-0 has not finished an iteration yet.\n"


def test_speed_reads_as_one_line(dr, record, monkeypatch, capsys):
    measured = SpeedReport("sim-0", 4243, 12, 1500, 412.3, 27.4)
    monkeypatch.setattr("drcli.run.worker_processes.speed_of", lambda *_: measured)

    dr("get-robomaker-stats")

    expected = "sim-0: 412 steps/s, 27 x real time, in the 1,500 steps of iteration 12.\n"
    assert capsys.readouterr().out == expected
