"""The trainer on a node of a cluster, as the machine of the training sees it."""

import logging
import os
import signal
from pathlib import Path

import pytest

from drcli.base.clock import elapsed_s
from drcli.base.errors import SettingsError
from drcli.base.log import add_handler, remove_handler
from drcli.checks.start_rules import refuse_start
from drcli.config.loading import load_settings
from drcli.metrics.open_sinks import tensorboard_folder
from drcli.records.heartbeat import HeartbeatRecord
from drcli.records.job import WorkerExit
from drcli.records.run_record import json_log, log_file
from drcli.run.launchers.placed_trainer import (
    SILENT_S,
    HostReport,
    PlacedTrainer,
    TrainerHost,
    gpus_to_ask,
)
from drcli.run.plan import planned_job
from drcli.train.ray_cluster import NodeLost, RayMessages
from drcli.workers.worker_process import StopRequested, StopSignal


class PaperHost:
    """A node that answers what a test says."""

    def __init__(self):
        self.answers, self.calls = [], []

    def look(self):
        answer = self.answers.pop(0) if self.answers else None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def stop(self):
        self.calls.append("stop")

    def call(self, method, *arguments):
        self.calls.append((method, *arguments))

    def give_back(self):
        self.calls.append("give back")


class Shown(logging.Handler):
    """What the log has."""

    def __init__(self):
        super().__init__()
        self.lines = []

    def emit(self, record):
        self.lines.append(record.getMessage())


class Stage:
    def __init__(self, folder, shown):
        self.job = planned_job(load_settings(folder), seed=1, began_at=0.0)
        self.job.folder.mkdir(parents=True)
        self.host, self.shown, self.now_s = PaperHost(), shown, 0.0
        self.stop_signal = StopSignal(os.getppid())
        self.placed = PlacedTrainer(self.host, self.job, self.stop_signal, lambda: self.now_s)

    def look(self, *answers):
        self.host.answers += answers
        return [self.placed.look() for _ in answers][-1]


@pytest.fixture
def stage(working_folder):
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    shown = Shown()
    add_handler(shown)
    yield Stage(working_folder, shown)
    remove_handler(shown)
    for number, handler in before.items():
        signal.signal(number, handler)


def heartbeat(**changes):
    fields = {
        "pid": 77,
        "beats": 1,
        "written_s": 5.0,
        "activity": "learns from 200 steps",
        "waits": False,
        "work": 0,
        "worked_s": None,
        "turned_s": 4.0,
        "memory_bytes": 300,
        "open_files": 9,
    }
    return HeartbeatRecord(**{**fields, **changes})


@pytest.mark.parametrize(
    ("wanted", "learners", "nodes", "here", "expected"),
    [
        ("auto", 1, [0, 0], 0, None),
        ("auto", 1, [0, 1], 0, 1),
        ("auto", 1, [0, 1], 1, None),
        ("cluster", 1, [0, 1], 1, 1),
        ("cluster", 1, [0, 0], 0, 0),
        ("cluster", 1, [], 0, 0),
        ("cluster", 2, [1, 4], 0, 2),
        ("gpu", 2, [], 1, 2),
    ],
)
def test_the_trainer_goes_where_a_gpu_is(wanted, learners, nodes, here, expected):
    assert gpus_to_ask(wanted, learners, nodes, lambda: here) == expected


def test_more_learners_than_gpus_of_a_node_are_refused():
    with pytest.raises(SettingsError, match="is 2, but no node of the cluster has more than 1 GPU"):
        gpus_to_ask("cluster", 2, [1, 1], lambda: 0)


def test_lines_and_files_of_the_trainer_appear_here(stage):
    prefix, directory = stage.job.config.model.prefix, stage.job.directory
    stage.look(
        HostReport("far", None, log=b"one\ntw", json_log=b'{"a": 1}\n', events={"e": b"12"}),
        HostReport("far", None, log=b"o\n", events={"e": b"3"}, files={"stage.json": b"{}"}),
        HostReport("far", 0, log=b"end", files={"trainer.requests.json": b"[]"}),
    )

    assert [line for line in stage.shown.lines if "far" not in line] == ["one", "two", "end"]
    assert json_log(log_file(directory, prefix, "trainer")).read_text() == '{"a": 1}\n'
    assert (tensorboard_folder(directory, prefix) / "e").read_bytes() == b"123"
    assert (stage.job.folder / "stage.json").read_bytes() == b"{}"
    assert (stage.job.folder / "trainer-0.requests.json").read_bytes() == b"[]"


def test_a_file_with_the_name_of_a_place_elsewhere_stays_in_the_folder_of_the_run(stage):
    stage.look(HostReport("far", None, files={"../../run.env": b"x"}))

    assert (stage.job.folder / "run.env").read_bytes() == b"x"


def test_its_pulse_counts_as_that_of_this_process(stage):
    began_s = elapsed_s()
    stage.look(HostReport("far", None, heartbeat=heartbeat(work=3, worked_s=4.0)))

    shown = stage.stop_signal.heartbeat.record()

    assert (shown.pid, shown.work, shown.activity) == (os.getpid(), 3, "learns from 200 steps")
    assert shown.worked_s >= began_s
    assert (shown.memory_bytes, shown.open_files) == (300, 9)


def test_a_lost_node_ends_this_process_and_is_nobodys_fault(stage):
    stage.look(HostReport("far", None))

    with pytest.raises(SystemExit) as ended:
        stage.look(NodeLost("NodeDiedError"))

    words = WorkerExit.read(stage.job.folder, "trainer")
    assert (ended.value.code, words.code, words.final, words.lost) == (5, 5, False, True)
    assert words.message == "The node of the trainer (far) is gone (NodeDiedError)."


def test_a_trainer_that_is_silent_although_its_node_answers_is_given_up(stage):
    stage.look(HostReport("far", None, heartbeat=heartbeat()))
    stage.now_s = SILENT_S + 1.0

    with pytest.raises(SystemExit):
        stage.look(HostReport("far", None, heartbeat=heartbeat()))

    assert not WorkerExit.read(stage.job.folder, "trainer").lost


def test_a_node_of_another_version_ends_the_training_with_the_reason(stage):
    refusal = WorkerExit("far cannot train: it has drcli 0.1.", "Install it.", 3, final=True)

    assert stage.look(HostReport("far", 3, refusal=refusal)) == 3

    assert WorkerExit.read(stage.job.folder, "trainer") == refusal


def test_a_request_to_stop_reaches_the_trainer_once_and_its_last_lines_come_back(stage):
    stage.look(HostReport("far", None))
    os.kill(os.getpid(), signal.SIGTERM)

    assert stage.look(HostReport("far", None), HostReport("far", 0, log=b"Stopped.\n")) == 0

    assert stage.host.calls == ["stop"]
    assert stage.shown.lines[-1] == "Stopped."


def test_a_request_to_stop_does_not_wait_for_a_node(stage):
    os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(StopRequested):
        stage.placed.look()


def test_the_stacks_are_those_of_the_trainer(stage):
    stage.look(HostReport("far", None))
    stage.placed.ask_stacks(12, None)

    stage.look(HostReport("far", None), HostReport("far", None))

    assert stage.host.calls == [("signal", 12)]


def test_a_node_checks_the_versions_before_anything_else(tmp_path: Path):
    host = TrainerHost({"job": "of another version"}, {"torch": "0.1"}, {})

    report = host.look()

    assert (report.code, report.refusal.code, report.refusal.final) == (3, 3, True)
    assert "cannot train: The training uses torch 0.1, this machine" in report.refusal.message


def test_of_what_ray_prints_the_first_lines_are_logged(stage):
    text = "\x1b[33m(raylet)\x1b[0m Raylet is terminated.\n    [state-dump] 1 total\n\n"
    RayMessages().write(text)

    assert stage.shown.lines == ["Ray: (raylet) Raylet is terminated."]


@pytest.mark.parametrize(
    ("lines", "environ", "expected"),
    [
        ("", {}, False),
        ("DR_RAY_ADDRESS=10.0.0.5:6379\n", {}, True),
        ("", {"RAY_ADDRESS": "10.0.0.5:6379"}, True),
        ("DR_RAY_ADDRESS=auto\nDR_RAY_TRAINER=here\n", {}, False),
    ],
)
def test_ray_places_the_trainer_where_there_is_a_cluster(
    lines, environ, expected, working_folder, monkeypatch
):
    for name, value in environ.items():
        monkeypatch.setenv(name, value)
    (working_folder / "system.env").write_text(f"DR_LAUNCHER=ray\n{lines}")

    job = planned_job(load_settings(working_folder), seed=1, began_at=0.0)

    assert job.ray_trainer == expected


def test_a_trainer_in_the_cluster_without_a_cluster_is_refused(working_folder, monkeypatch):
    monkeypatch.setattr("drcli.checks.start_rules.require_ray", lambda: None)
    (working_folder / "system.env").write_text("DR_LAUNCHER=ray\nDR_RAY_TRAINER=gpu\n")

    with pytest.raises(SettingsError, match=r"DR_RAY_TRAINER=gpu in system\.env: there is no"):
        refuse_start(load_settings(working_folder))
