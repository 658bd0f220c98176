"""The record of a sweep, kept from what Ray Tune says about its trials."""

from dataclasses import asdict
from types import SimpleNamespace

import pytest

pytest.importorskip("ray.tune", reason="the extra ray is not installed", exc_type=ImportError)

from drcli.base.errors import BudgetUsedUp
from drcli.base.processes import NotedSignals
from drcli.config.loading import load_settings
from drcli.sweeps.node_trial import TrialStep
from drcli.sweeps.sweep_file import read_sweep_file
from drcli.sweeps.sweep_report import SweepProgress
from drcli.sweeps.trial_files import TrialFiles
from drcli.sweeps.trial_score import levels_of
from drcli.sweeps.trials import trials_of
from drcli.sweeps.tune_sweep import Watch
from iterations import iteration_record
from memory_bucket import MemoryBucket

FILE = """
name: s
vary:
  hyperparameters: {lr: [1e-4, 2e-4]}
budget: {iterations: 8}
metric: progress
early_stopping: {method: population}
"""


class Tuned(SimpleNamespace):
    """A trial of Tune on paper."""

    def __init__(self, name):
        super().__init__(name=name, status="PENDING", last_result=None, error_file=None)

    def __str__(self):
        return self.name

    def step(self, state, *, name="", **values):
        trial = {"prefix": self.name, "source": "", "earlier": 0.0, "hyperparameters": {}}
        given = {"done": False, "amount": 1.0, "checks": 1, "millionths": 1, "score": 1.0}
        given |= {"message": "", "remedy": "", "trial": trial}
        step = TrialStep(name=name or self.name, state=state, **{**given, **values})
        self.last_result = asdict(step)
        return self


class Desk:
    """A sweep in a real folder, and two trials on paper."""

    def __init__(self, folder):
        path = folder / "sweep.yaml"
        path.write_text(FILE)
        sweep = read_sweep_file(path)
        bucket = MemoryBucket()
        trials = trials_of(sweep)
        files = TrialFiles(load_settings(folder), sweep, bucket)
        self.said, self.stops, self.signals = [], [], NotedSignals()
        self.progress = SweepProgress(folder, sweep, trials, files, bucket, say=self.said.append)
        self.scheduler = SimpleNamespace()
        self.folder, self.iterations = folder, [iteration_record(0)]
        self.watch = Watch(
            self.progress,
            sweep,
            bucket,
            levels_of(sweep.plan.budget, sweep.plan.early_stopping),
            self.scheduler,
            lambda trial: SimpleNamespace(iterations=lambda: self.iterations),
            say=self.said.append,
            signals=self.signals,
            stop=lambda: self.stops.append(True),
        )
        self.first, self.second = Tuned("s-01"), Tuned("s-02")

    def look(self):
        self.watch._looked_s = 0.0
        self.watch.on_step_end(1, [self.first, self.second])
        return {trial.name: trial.state for trial in self.progress.record.trials}


@pytest.fixture
def desk(working_folder):
    return Desk(working_folder)


def test_a_training_runs_once_its_actor_has_answered(desk):
    desk.iterations, desk.first.status = [], "RUNNING"
    assert desk.look() == {"s-01": "waiting", "s-02": "waiting"}

    desk.first.step("running")

    assert desk.look() == {"s-01": "running", "s-02": "waiting"}
    assert desk.said == ["s-01 begins: lr=0.0001"]


def test_a_training_that_gives_its_place_back_is_paused(desk):
    desk.first.step("running").status = "RUNNING"
    desk.look()
    desk.first.status = "PAUSED"

    assert desk.look()["s-01"] == "paused"


@pytest.mark.parametrize(
    ("said", "state"),
    [("finished", "finished"), ("failed", "failed"), ("running", "stopped early")],
)
def test_how_a_training_ended_is_noted(desk, said, state):
    desk.first.step("running").status = "RUNNING"
    desk.look()
    desk.first.step(said, done=said != "running", message="It was so.", remedy="Do it.")
    assert desk.look()["s-01"] == "running"
    desk.first.status = "TERMINATED"

    assert desk.look()["s-01"] == state
    trial = desk.progress.trial("s-01")
    if state == "stopped early":
        assert trial.message == "ASHA ended it at the check at 2 iterations."
    else:
        assert (trial.message, trial.remedy) == ("It was so.", "Do it.")


def test_a_trial_that_ray_cannot_run_has_failed(desk):
    desk.first.status = "ERROR"

    assert desk.look()["s-01"] == "failed"
    assert desk.progress.trial("s-01").message.startswith("Ray could not run it: its node was lost")


def test_a_copy_is_a_new_model_of_its_experiment(desk):
    desk.first.step("running").status = "RUNNING"
    desk.look()
    copy = {
        "prefix": "s-01-g2",
        "source": "s-02",
        "earlier": 2.0,
        "hyperparameters": {"lr": 0.0002},
    }

    desk.first.step("running", trial=copy)
    desk.look()

    trial = desk.progress.trial("s-01")
    assert (trial.prefix, trial.source, trial.amount) == ("s-01-g2", "s-02", 3.0)
    assert desk.progress.record.checks == 1
    assert "s-01 goes on with the weights of s-02 and lr=0.0002." in desk.said
    settings = load_settings(desk.folder, flags={"DR_EXPERIMENT_NAME": "s-01"})
    assert (settings.model_prefix, settings.pretrained_prefix) == ("s-01-g2", "s-02")


def test_the_result_of_another_training_that_tune_gives_a_copy_does_not_count(desk):
    desk.first.step("running").status = "RUNNING"
    desk.look()
    other = {"prefix": "s-02", "source": "", "earlier": 0.0, "hyperparameters": {}}

    desk.first.step("running", name="s-02", trial=other)
    desk.look()

    assert desk.progress.trial("s-01").prefix == "s-01"


def test_a_signal_lets_all_save_their_checkpoints_before_tune_ends(desk):
    desk.first.step("running").status = "RUNNING"
    desk.look()
    assert not desk.watch.stopper.stop_all()
    desk.signals._note(15, None)

    desk.look()
    assert desk.stops == [True]
    assert not desk.watch.stopper.stop_all()
    desk.first.step("paused", done=True).status = "TERMINATED"

    assert desk.look() == {"s-01": "paused", "s-02": "waiting"}
    assert desk.watch.stopper.stop_all()


def test_the_budget_of_the_day_ends_the_sweep_and_loses_nothing(desk):
    desk.first.step("failed", done=True, code=BudgetUsedUp.code, message="It is used up.")
    desk.first.status = "TERMINATED"

    assert desk.look()["s-01"] in ("waiting", "paused")
    assert isinstance(desk.watch.error, BudgetUsedUp)
