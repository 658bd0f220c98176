"""Which trainings Ray Tune ends or copies, with trials on paper."""

from types import SimpleNamespace

import pytest

pytest.importorskip("ray.tune", reason="the extra ray is not installed", exc_type=ImportError)

from ray.tune.schedulers import ASHAScheduler, PopulationBasedTraining

from drcli.sweeps.node_trial import MILLION
from drcli.sweeps.sweep_file import Budget, EarlyStopping, Span, SweepPlan, Vary
from drcli.sweeps.trial_score import levels_of
from drcli.sweeps.tune_schedulers import Explorer, Halving, scheduler_of
from drcli.sweeps.tune_sweep import place_for


def plan(**stopping):
    return SweepPlan(
        vary=Vary(seed=[1, 2]),
        budget=Budget(iterations=16),
        early_stopping=EarlyStopping(**stopping),
    )


class PaperTrial(SimpleNamespace):
    def __str__(self):
        return self.name


class Controller:
    """Tune on paper: trainings that get better by their number, `parallel` at a time."""

    def __init__(self, scheduler, levels, count, parallel):
        self.scheduler, self.levels, self.parallel = scheduler, levels, parallel
        self.trials = [
            PaperTrial(name=f"s-{number:02}", status="PENDING", checks=0, amount=0.0, ends=None)
            for number in range(1, count + 1)
        ]
        self.failing = set()
        for trial in self.trials:
            scheduler.on_trial_add(self, trial)

    def get_trials(self):
        return self.trials

    def pause_trial(self, trial, should_checkpoint):
        assert not should_checkpoint
        trial.status = "PAUSED"

    def stop_trial(self, trial):
        self.scheduler.on_trial_remove(self, trial)
        trial.status = "TERMINATED"

    def run(self):
        for _ in range(1000):
            running = [trial for trial in self.trials if trial.status == "RUNNING"]
            while len(running) < self.parallel:
                trial = self.scheduler.choose_trial_to_run(self)
                if trial is None:
                    break
                # A new actor tells all checks again.
                trial.status, trial.checks = "RUNNING", 0
                running.append(trial)
            if not running:
                return
            for trial in running:
                if trial.status == "RUNNING":
                    self._step(trial)
        raise AssertionError("It does not end.")

    def _step(self, trial):
        if trial.name in self.failing:
            self._complete(trial, "failed")
            return
        level = self.levels[trial.checks]
        trial.checks += 1
        trial.amount = max(trial.amount, level)
        if trial.checks == len(self.levels):
            self._complete(trial, "finished")
            return
        result = {"checks": trial.checks, "score": float(trial.name[-2:])}
        if self.scheduler.on_trial_result(self, trial, result) == "STOP":
            trial.status = "TERMINATED"
            self.scheduler.on_trial_complete(self, trial, {**result, "state": "running"})

    def _complete(self, trial, state):
        score = float(trial.name[-2:]) if state == "finished" else -1.0
        result = {"checks": trial.checks, "score": score, "state": state}
        self.scheduler.on_trial_complete(self, trial, result)
        trial.status = "TERMINATED"


@pytest.mark.parametrize("parallel", [1, 2, 6])
def test_the_worst_third_ends_at_the_first_check_however_many_run_at_a_time(parallel):
    halved = plan(method="halving")
    levels = levels_of(halved.budget, halved.early_stopping)
    scheduler = Halving(halved, levels, lambda sentence: None)
    controller = Controller(scheduler, levels, 6, parallel)

    controller.run()

    used = {trial.name: trial.amount for trial in controller.trials}
    assert used == {"s-01": 4, "s-02": 4, "s-03": 6, "s-04": 9, "s-05": 16, "s-06": 16}
    assert scheduler.places["s-02"] == "Check 1 at 4 iterations: place 5 of 6, 4 go on."


@pytest.mark.parametrize("parallel", [1, 2, 6])
def test_a_training_that_fails_is_not_waited_for(parallel):
    halved = plan(method="halving")
    levels = levels_of(halved.budget, halved.early_stopping)
    controller = Controller(Halving(halved, levels, lambda sentence: None), levels, 6, parallel)
    controller.failing = {"s-04"}

    controller.run()

    used = {trial.name: trial.amount for trial in controller.trials}
    assert used["s-04"] == 0
    assert used["s-06"] == used["s-05"] == 16
    assert sorted(used.values())[1] == 4
    assert all(trial.status == "TERMINATED" for trial in controller.trials)


def test_asha_and_population_based_training_are_those_of_ray():
    asha, copying = plan(method="asha"), plan(method="population", quantile=0.5)

    found = scheduler_of(asha, [4.0, 16.0], {}, 0, print)
    assert isinstance(found, ASHAScheduler)
    rungs = sorted(rung for rung, _ in found._brackets[0]._rungs)
    assert rungs[0] == MILLION / 4
    assert rungs[1] == pytest.approx(MILLION * 3 / 8)
    assert isinstance(scheduler_of(copying, [4.0, 16.0], {}, 0, print), PopulationBasedTraining)


def test_a_copy_gets_a_number_of_its_own_and_hyperparameters_near_those_of_the_other():
    explorer = Explorer({"lr": Span(1e-4, 1e-2, True)}, seed=1, copies=3)
    config = {"name": "s-01", "copy": 0, "hyperparameters": {"lr": 1e-3}}

    first, second = explorer(config), explorer(config)

    assert (first["copy"], second["copy"]) == (4, 5)
    assert 1e-4 <= first["hyperparameters"]["lr"] <= 1e-2
    assert first["hyperparameters"]["lr"] != 1e-3
    assert config["hyperparameters"] == {"lr": 1e-3}


@pytest.mark.parametrize(
    ("nodes", "threads", "parallel", "found"),
    [
        ([{"CPU": 2}], 0, None, (2, 0.0, 0)),
        ([{"CPU": 2}], 0, 2, (1, 0.0, 2)),
        ([{"CPU": 1}], 0, None, (1, 0.0, 0)),
        ([{"CPU": 1}, {"CPU": 1}, {"CPU": 1}], 0, None, (1, 0.0, 0)),
        ([{}], 0, None, (2, 0.0, 0)),
        ([{}, {"CPU": 64}], 4, None, (4, 0.0, 0)),
        ([{"CPU": 16, "GPU": 1}], 0, None, (2, 0.125, 0)),
        ([{"CPU": 8, "GPU": 4}, {"CPU": 8, "GPU": 4}], 0, 4, (2, 1.0, 4)),
    ],
)
def test_a_training_gets_two_cores_of_a_node_and_its_share_of_the_gpus(
    nodes, threads, parallel, found
):
    place = place_for(nodes, threads, parallel)

    assert (place.cpus, place.gpus, place.parallel) == found
