"""A training of a sweep on a node: what it tells at its checks, and how it ends."""

import json
import socket
from dataclasses import replace
from pathlib import Path

import pytest

from drcli.base.errors import SettingsError, TrainedElsewhere, WorkerDied
from drcli.records.run_record import RunRecord
from drcli.sweeps import node_trial
from drcli.sweeps.node_trial import (
    MILLION,
    MOST_STARTS,
    NodeTrial,
    TrialTask,
    files_for_nodes,
    folder_on_node,
)
from drcli.sweeps.sweep_file import Budget, EarlyStopping
from drcli.sweeps.sweep_record import TrialRecord
from drcli.sweeps.trial_run import Limits
from iterations import iteration_record
from memory_bucket import MemoryBucket

TASK = TrialTask(
    trial=TrialRecord("s-01", "s-01", 1),
    budget=Budget(iterations=8),
    stopping=EarlyStopping(method="halving", first_check=0.25, reduction_factor=2),
    levels=(2.0, 4.0, 8.0),
    compared=0,
    metric="progress",
    limits=Limits(),
    directory=Path("nowhere"),
)


class PaperRun:
    """A training on paper: an iteration at each look."""

    def __init__(self, prefix, changes, failures):
        self.prefix, self.changes, self.failures = prefix, changes, failures
        self.done, self.state, self.starts, self.most = [], None, 0, 8

    def start(self, limits):
        self.starts += 1
        if self.failures:
            raise self.failures.pop(0)
        self.state = "running"
        return ""

    @property
    def runs(self):
        return self.state == "running"

    def record(self):
        if self.state is None:
            return None
        return RunRecord(0, "", "", self.prefix, "", self.state, 1, 0.0, 0.0, message="Done.")

    def iterations(self):
        return self.done

    def interrupt(self):
        if self.runs:
            self.state = "interrupted"

    def look(self, _seconds):
        if self.runs:
            number = len(self.done)
            self.done.append(iteration_record(number, evaluation_progress=[10.0 + number]))
            if len(self.done) >= self.most:
                self.state = "finished"


class Node:
    """A node on paper."""

    def __init__(self, folder, task=TASK, failures=()):
        self.runs, self.failures = [], list(failures)
        self.trial = NodeTrial(
            task, folder, MemoryBucket(), open_run=self.open, pause=lambda s: self.runs[-1].look(s)
        )

    def open(self, trial, changes):
        self.runs.append(PaperRun(trial.prefix, changes, self.failures))
        return self.runs[-1]


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Steps end at checks, not at the clock."""
    monkeypatch.setattr(node_trial, "STEP_S", 60.0)


def test_a_training_stops_for_a_moment_at_each_check_and_ends_with_its_budget(tmp_path):
    node = Node(tmp_path)

    steps = [node.trial.step() for _ in range(3)]

    assert [(step.checks, step.amount, step.done) for step in steps] == [
        (1, 2.0, False),
        (2, 4.0, False),
        (3, 8.0, True),
    ]
    assert [step.state for step in steps] == ["running", "running", "finished"]
    assert node.runs[0].starts == 1
    assert steps[0].millionths >= 0.25 * MILLION
    assert steps[2].millionths >= MILLION


def test_its_score_at_a_check_is_that_of_the_amount_of_the_check(tmp_path):
    node = Node(tmp_path)
    run = node.runs[0]
    run.state = "running"
    for _ in range(3):
        run.look(0)  # it has run past the check

    at_check = node.trial.step().score

    run.done = run.done[:2]
    assert at_check == Node(tmp_path).trial.step().score


def test_a_training_that_goes_on_tells_earlier_checks_again_without_a_start(tmp_path):
    node = Node(tmp_path)
    run = node.runs[0]
    run.done = [iteration_record(k, evaluation_progress=[10.0 + k]) for k in range(5)]

    steps = [node.trial.step(), node.trial.step()]

    assert [step.checks for step in steps] == [1, 2]
    assert run.starts == 0


@pytest.mark.parametrize(("state", "amount"), [("stopped early", 2), ("finished", 8)])
def test_one_that_is_over_only_tells_its_checks(tmp_path, state, amount):
    over = replace(TASK, trial=replace(TASK.trial, state=state, message="It was so."))
    node = Node(tmp_path, over)
    node.runs[0].done = [iteration_record(k) for k in range(amount)]

    steps = [node.trial.step()]
    while not steps[-1].done:
        steps.append(node.trial.step())

    assert (steps[-1].state, steps[-1].message) == (state, "It was so.")
    assert node.runs[0].starts == 0


def test_an_interrupted_sweep_lets_it_save_its_checkpoint(tmp_path):
    node = Node(tmp_path)
    node.trial.step()

    step = node.trial.step(lambda: True)

    assert (step.state, step.done) == ("paused", True)
    assert node.runs[0].state == "interrupted"


def test_a_broken_reward_function_ends_it_with_the_reason(tmp_path):
    broken = SettingsError("The reward function is broken.", remedy="Mend it.")
    step = Node(tmp_path, failures=[broken]).trial.step()

    assert (step.state, step.done) == ("failed", True)
    assert (step.message, step.remedy) == ("The reward function is broken.", "Mend it.")


def test_a_worker_that_dies_is_started_again_but_not_forever(tmp_path):
    died = [WorkerDied("It died.", remedy="Look.") for _ in range(MOST_STARTS + 5)]
    node = Node(tmp_path, failures=died)

    step = node.trial.step()

    assert step.state == "failed"
    assert node.runs[0].starts == MOST_STARTS + 1


def test_a_supervisor_that_was_killed_is_started_again(tmp_path):
    node = Node(tmp_path)
    node.trial.step()
    node.runs[0].state = "lost"

    assert node.trial.step().checks == 2
    assert node.runs[0].starts == 2


def test_the_model_of_a_node_that_vanished_is_waited_for(tmp_path):
    node = Node(tmp_path, failures=[TrainedElsewhere("far trains it.", remedy="Wait.")] * 2)

    assert node.trial.step().checks == 1
    assert node.runs[0].starts == 3


def test_a_goal_that_was_reached_ends_it_before_its_budget(tmp_path):
    node = Node(tmp_path)
    node.runs[0].most = 3
    node.trial.step()

    step = node.trial.step()

    assert (step.state, step.done, step.amount) == ("finished", True, 3.0)


def _experiment(folder, name):
    custom = folder / "experiments" / name / "custom_files"
    custom.mkdir(parents=True)
    (custom / "hyperparameters.json").write_text('{"lr": 0.001, "batch_size": 32}')
    return custom / "hyperparameters.json"


def test_a_copy_is_a_new_model_with_the_weights_of_the_other_and_what_is_left_of_the_budget(
    tmp_path,
):
    file = _experiment(tmp_path, "s-01")
    other = Node(tmp_path, replace(TASK, trial=TrialRecord("s-02", "s-02-g3", 2)))
    other.trial.step()
    node = Node(tmp_path)
    node.trial.step()

    node.trial.restore(other.trial.state(), 4, {"lr": 0.002})

    copy = node.runs[-1]
    assert node.runs[0].state == "interrupted"
    assert copy.prefix == "s-01-g5"
    assert copy.changes["DR_LOCAL_S3_PRETRAINED_PREFIX"] == "s-02-g3"
    assert copy.changes["DR_TRAIN_MAX_ITERATIONS"] == "6"
    assert json.loads(file.read_text()) == {"lr": 0.002, "batch_size": 32}
    step = node.trial.step()
    assert (step.checks, step.amount) == (2, 4.0)
    assert step.trial["source"] == "s-02-g3"


def test_a_copy_whose_node_vanished_goes_on_as_the_same_model(tmp_path):
    _experiment(tmp_path, "s-01")
    node = Node(tmp_path)
    node.trial.restore(
        {"name": "s-02", "changed": {"prefix": "s-02"}, "checks": 1, "amount": 2.0}, 1, {"lr": 0.5}
    )
    saved = node.trial.state()

    again = Node(tmp_path)
    again.trial.restore(saved, 7, {"lr": 0.9})

    assert again.runs[-1].prefix == "s-01-g2"
    assert again.runs[-1].changes == node.runs[-1].changes


def test_another_machine_gets_its_own_copy_of_the_folder(tmp_path):
    folder = tmp_path / "racer"
    _experiment(folder, "s-01")
    _experiment(folder, "s-02")
    (folder / "system.env").write_text("DR_CLOUD=aws\n")
    (folder / "data").mkdir()
    task = replace(TASK, directory=folder, host="far", files=files_for_nodes(folder, "s-01"))

    there = folder_on_node(task, tmp_path / "cache")

    files = {str(path.relative_to(there)) for path in there.rglob("*") if path.is_file()}
    assert files == {"system.env", "experiments/s-01/custom_files/hyperparameters.json"}
    own = replace(task, host=socket.gethostname())
    assert folder_on_node(own, tmp_path / "cache") == folder
