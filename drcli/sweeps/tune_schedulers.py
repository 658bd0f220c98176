"""Schedulers of Ray Tune for sweeps.

ASHA and population based training are Tune's own. Imported only where Ray is installed.
"""

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Self

import ray
from ray import tune
from ray.tune.experiment import Trial
from ray.tune.schedulers import (
    ASHAScheduler,
    FIFOScheduler,
    PopulationBasedTraining,
    TrialScheduler,
)

from drcli.sweeps.node_trial import MILLION, TrialTask, open_on_node
from drcli.sweeps.sweep_file import Choices, SweepPlan
from drcli.sweeps.trial_score import changed_value, comparable, kept_of

METRIC = "score"


def scheduler_of(
    plan: SweepPlan,
    levels: Sequence[float],
    vary: Mapping[str, Choices],
    copies: int,
    say: Callable[[str], None],
) -> TrialScheduler:
    stopping = plan.early_stopping
    if stopping.method == "halving":
        return Halving(plan, levels, say)
    if stopping.method == "asha":
        return ASHAScheduler(
            time_attr="millionths",
            metric=METRIC,
            mode="max",
            grace_period=int(MILLION * stopping.first_check),
            reduction_factor=stopping.reduction_factor,
            max_t=MILLION,
        )
    if stopping.method == "population":
        return PopulationBasedTraining(
            time_attr="checks",
            metric=METRIC,
            mode="max",
            perturbation_interval=1,
            quantile_fraction=stopping.quantile,
            custom_explore_fn=Explorer(vary, plan.seed, copies),
            log_config=False,
        )
    # Types are ignored here and below because Ray's constructors have none.
    return FIFOScheduler()  # type: ignore[no-untyped-call]


class Unsaved:
    """Tune saves it without fields, as it could continue trials by itself.

    A sweep continues from its record, and fields may hold threads and connections.
    """

    def __getstate__(self) -> dict[str, Any]:
        return {}

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self


class Explorer:
    """Numbers copies, and changes their hyperparameters."""

    def __init__(self, vary: Mapping[str, Choices], seed: int, copies: int) -> None:
        self._vary = vary
        self._chance = random.Random(f"{seed} {copies}")
        self._copies = copies

    def __call__(self, config: dict[str, Any]) -> dict[str, Any]:
        self._copies += 1
        values = config["hyperparameters"]
        changed = {key: changed_value(values[key], self._vary[key], self._chance) for key in values}
        return {**config, "copy": self._copies, "hyperparameters": changed}


class Halving(Unsaved, FIFOScheduler):
    """Ends the worst trainings at each check, as without Ray.

    A training at a check gives its place back until the others are there, so that all are
    compared at the same amount.
    """

    def __init__(
        self, plan: SweepPlan, levels: Sequence[float], say: Callable[[str], None]
    ) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._factor = plan.early_stopping.reduction_factor
        self._resource = plan.budget.resource
        self._levels = levels
        self._say = say
        self._check = 1
        self._scores: dict[int, dict[str, float]] = {}
        self._out: set[str] = set()  # stopped early, or failed
        self._final: dict[str, float] = {}
        self.places: dict[str, str] = {}

    def on_trial_add(self, tune_controller: Any, trial: Trial) -> None:
        self._scores.setdefault(0, {})[str(trial)] = 0.0

    def on_trial_result(self, tune_controller: Any, trial: Trial, result: dict[str, Any]) -> str:
        number, name = int(result["checks"]), str(trial)
        if number < self._check or number >= len(self._levels):
            return str(TrialScheduler.CONTINUE)
        self._scores.setdefault(number, {})[name] = float(result[METRIC])
        self._compare(tune_controller)
        if name in self._out:
            return str(TrialScheduler.STOP)
        if number < self._check:
            return str(TrialScheduler.CONTINUE)
        tune_controller.pause_trial(trial, should_checkpoint=False)  # the bucket has it
        return str(TrialScheduler.NOOP)

    def on_trial_complete(self, tune_controller: Any, trial: Trial, result: dict[str, Any]) -> None:
        """Finished trainings count at all further checks, failed ones at none."""
        state, name = result.get("state"), str(trial)
        if state in ("finished", "stopped"):
            self._final[name] = float(result[METRIC])
        elif state == "failed" or state == "stopped early":
            self._out.add(name)
        if state != "paused":
            self._compare(tune_controller)

    def on_trial_error(self, tune_controller: Any, trial: Trial) -> None:
        self._out.add(str(trial))
        self._compare(tune_controller)

    def on_trial_remove(self, tune_controller: Any, trial: Trial) -> None:
        self._out.add(str(trial))

    def choose_trial_to_run(self, tune_controller: Any) -> Trial | None:
        reached = self._scores.get(self._check, {})
        for status in (Trial.PENDING, Trial.PAUSED):
            for trial in tune_controller.get_trials():
                if trial.status == status and str(trial) not in reached:
                    found: Trial = trial
                    return found
        return None

    def _compare(self, tune_controller: Any) -> None:
        while self._check < len(self._levels):
            compared = self._scores.get(0, {}).keys() - self._out
            kept = kept_of(len(compared), self._factor)
            reached = {**self._final, **self._scores.get(self._check, {})}
            if kept < len(compared):
                if any(name not in reached for name in compared):
                    return
                self._end_worst(tune_controller, {n: reached[n] for n in compared}, kept)
            self._check += 1

    def _end_worst(self, tune_controller: Any, scores: Mapping[str, float], kept: int) -> None:
        at = comparable(self._resource, self._levels[self._check - 1])
        self._say(f"Check {self._check} at {at}: {kept} of {len(scores)} go on.")
        ranked = sorted(scores, key=lambda name: scores[name], reverse=True)
        trials = {str(trial): trial for trial in tune_controller.get_trials()}
        for place, name in enumerate(ranked[kept:], kept + 1):
            self._out.add(name)
            if name in self._final:
                continue
            self.places[name] = (
                f"Check {self._check} at {at}: place {place} of {len(scores)}, {kept} go on."
            )
            if trials[name].status == Trial.PAUSED:
                tune_controller.stop_trial(trials[name])


# A training of a sweep as an actor of Ray Tune.
#
# Imported only where Ray is installed.


ANSWER_S = 10.0


class StopFlag:
    """Tells all actors that the sweep is interrupted; an actor itself."""

    def __init__(self) -> None:
        self._stopping = False

    def stop(self) -> None:
        self._stopping = True

    def is_stopping(self) -> bool:
        return self._stopping


class TuneTrial(tune.Trainable):
    """Named as its trial."""

    def setup(
        self,
        config: Mapping[str, Any],
        tasks: Mapping[str, TrialTask] | None = None,
        flag: Any = None,
    ) -> None:
        """`config` is a population's; `flag` an actor of `StopFlag`."""
        assert tasks is not None
        self._flag = flag
        self._copy = int(config["copy"])
        self._hyperparameters = dict(config["hyperparameters"])
        self._node = open_on_node(tasks[str(self.trial_name)])

    def step(self) -> dict[str, Any]:
        return asdict(self._node.step(self._is_stopping))

    def save_checkpoint(self, checkpoint_dir: str) -> dict[str, Any]:
        """The real checkpoint is in the bucket."""
        return self._node.state()

    def load_checkpoint(self, checkpoint: Any) -> None:
        self._node.restore(checkpoint, self._copy, self._hyperparameters)

    def cleanup(self) -> None:
        self._node.end()

    def _is_stopping(self) -> bool:
        try:
            stopping: bool = ray.get(self._flag.is_stopping.remote(), timeout=ANSWER_S)
        except ray.exceptions.GetTimeoutError:
            return False  # its machine is busy
        except ray.exceptions.RayError:
            return True  # the command is gone
        return stopping
