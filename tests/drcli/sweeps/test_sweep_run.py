"""The order in which the trainings of a sweep run, pause, end and copy each other."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest

from drcli.base.errors import ProblemsError, SettingsError, StorageError, TrainedElsewhere
from drcli.base.processes import NotedSignals, Stopped, started_s
from drcli.config.loading import load_settings
from drcli.model import keys
from drcli.model.notes import DESCRIPTION
from drcli.records.run_record import RunRecord, WaitingStart, run_folder
from drcli.sweeps import start_sweep, sweep_run
from drcli.sweeps.start_sweep import SweepStart
from drcli.sweeps.stored_sweep import read_sweep, refuse_used_models, wipe_sweep
from drcli.sweeps.sweep_file import read_sweep_file
from drcli.sweeps.sweep_report import SweepProgress
from drcli.sweeps.sweep_run import Pace, SweepRun
from drcli.sweeps.trial_files import TrialFiles
from drcli.sweeps.trials import trials_of
from iterations import iteration_record
from memory_bucket import MemoryBucket

FILE = """
name: s
vary:
  hyperparameters: {lr: [1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4]}
budget: {iterations: 8}
metric: progress
early_stopping: {method: halving}
"""


class PaperRun:
    """A training on paper: an iteration each second, and a progress that its lr decides."""

    def __init__(self, shop, trial):
        self.shop, self.trial = shop, trial
        self.done = shop.models.setdefault(trial.prefix, [])
        self.state = None

    def start(self, limits):
        failure = self.shop.failures.get(self.trial.name)
        if failure:
            raise failure.pop(0) if isinstance(failure, list) else failure
        self.state = "running"
        self.shop.starts.append(self.trial.name)

    @property
    def runs(self):
        return self.state == "running"

    def record(self):
        if self.state is None:
            return None
        return RunRecord(0, "", "", self.trial.prefix, "", self.state, 1, 0.0, 0.0, message="Done.")

    def iterations(self):
        return self.done

    def interrupt(self):
        if self.state == "running":
            self.state = "interrupted"

    def second(self):
        if self.state == "running":
            progress = float(self.trial.name[-2:])
            number = len(self.done)
            evaluated = [progress + 0.1 * number]
            self.done.append(iteration_record(number, evaluation_progress=evaluated))
            if self.trial.earlier + len(self.done) >= self.shop.most:
                self.state = "finished"


class Shop:
    """A sweep of trainings on paper, in a real working folder."""

    def __init__(self, folder: Path):
        self.folder, self.bucket = folder, MemoryBucket()
        self.models, self.starts, self.failures, self.said = {}, [], {}, []
        self.most = 8
        self.runs, self.busiest, self.interrupt_at = {}, 0, None
        self.signals = NotedSignals()

    def sweep(self, text=FILE, parallel=1, waits=True):
        path = self.folder / "sweep.yaml"
        path.write_text(text)
        file = read_sweep_file(path)
        trials = trials_of(file)
        files = TrialFiles(load_settings(self.folder), file, self.bucket)
        files.check(trials)
        self.runs = {}
        progress = SweepProgress(
            self.folder, file, trials, files, self.bucket, say=self.said.append
        )
        return SweepRun(
            progress,
            file,
            self.bucket,
            Pace(lambda: parallel, waits=waits),
            say=self.said.append,
            signals=self.signals,
            open_run=self.open_run,
            pause=self.second,
        )

    def open_run(self, trial):
        self.runs[trial.prefix] = PaperRun(self, trial)
        return self.runs[trial.prefix]

    def second(self, _seconds):
        running = [run for run in self.runs.values() if run.runs]
        self.busiest = max(self.busiest, len(running))
        for run in running:
            run.second()
        if self.interrupt_at is not None and len(self.starts) >= self.interrupt_at:
            self.interrupt_at = None
            self.signals._note(15, None)


@pytest.fixture
def shop(working_folder):
    return Shop(working_folder)


def states(record):
    return {trial.name: trial.state for trial in record.trials}


def used(record):
    return {trial.name: trial.amount for trial in record.trials}


@pytest.mark.parametrize("parallel", [1, 2, 6])
def test_the_worst_third_ends_at_the_first_check(shop, parallel):
    record = shop.sweep(parallel=parallel).run()

    assert states(record) == {
        "s-01": "stopped early",
        "s-02": "stopped early",
        "s-03": "stopped early",
        "s-04": "stopped early",
        "s-05": "finished",
        "s-06": "finished",
    }
    assert used(record)["s-06"] == 8
    assert all(amount <= 4 for name, amount in used(record).items() if name in ("s-01", "s-02"))
    assert record.best == "s-06"
    assert shop.busiest == parallel


def test_the_experiments_are_those_of_a_racer(shop):
    shop.sweep().run()

    settings = load_settings(shop.folder, flags={"DR_EXPERIMENT_NAME": "s-03"})
    custom = shop.folder / "experiments" / "s-03" / "custom_files"
    assert settings.model_prefix == "s-03"
    assert settings.metrics_prefix == "s-03/metrics"
    assert settings.train_max_iterations == 8
    assert settings.model_description == "Sweep s: lr=0.0003"
    assert settings.run_id == 3
    assert json.loads((custom / "hyperparameters.json").read_text())["lr"] == 3e-4


def test_the_best_is_marked(shop):
    shop.sweep().run()

    description = keys.note("s-06", DESCRIPTION)
    assert "Best of sweep s: lr=0.0006" in shop.bucket.get(description).decode()


def test_one_that_fails_does_not_stop_the_others(shop):
    shop.failures["s-06"] = SettingsError("The reward function is broken.", remedy="Mend it.")

    record = shop.sweep().run()

    assert states(record)["s-06"] == "failed"
    assert record.best == "s-05"
    failed = record.trials[5]
    assert (failed.message, failed.remedy) == ("The reward function is broken.", "Mend it.")


def test_what_failed_is_tried_again_when_the_sweep_is_started_again(shop):
    shop.failures["s-06"] = SettingsError("Broken.", remedy="Mend it.")
    shop.sweep().run()
    del shop.failures["s-06"]
    shop.starts.clear()

    record = shop.sweep().run()

    assert set(shop.starts) == {"s-06"}
    assert record.best == "s-06"


def test_a_sweep_that_has_ended_starts_nothing(shop):
    shop.sweep().run()
    shop.starts.clear()

    assert shop.sweep().run().best == "s-06"
    assert shop.starts == []


def test_an_interrupted_sweep_goes_on_where_it_was(shop):
    shop.interrupt_at = 3
    with pytest.raises(Stopped, match="The sweep s was interrupted"):
        shop.sweep().run()
    before = used(read_sweep(shop.bucket, "s"))
    assert not any(run.runs for run in shop.runs.values())
    shop.signals = NotedSignals()

    record = shop.sweep().run()

    assert before["s-01"] > 0
    assert record.best == "s-06"
    assert all(used(record)[name] >= amount for name, amount in before.items())


def test_ctrl_c_that_ends_a_start_too_interrupts_the_sweep_and_no_training_has_failed(shop):
    class Ended(PaperRun):
        def start(self, limits):
            shop.signals._note(2, None)
            raise SettingsError("The supervisor has ended.", remedy="Read its log.")

    sweep = shop.sweep()
    sweep._open_run = lambda trial: Ended(shop, trial)

    with pytest.raises(KeyboardInterrupt):
        sweep.run()

    assert set(states(read_sweep(shop.bucket, "s")).values()) == {"waiting"}


def test_a_bucket_that_does_not_answer_ends_the_sweep_and_loses_nothing(shop):
    shop.failures["s-02"] = [StorageError("It does not answer.", remedy="Wait.")]
    with pytest.raises(StorageError):
        shop.sweep().run()
    assert not any(run.runs for run in shop.runs.values())
    shop.failures.clear()

    assert shop.sweep().run().best == "s-06"


def test_a_training_on_a_machine_that_vanished_is_waited_for(shop):
    elsewhere = TrainedElsewhere("far trains s-01.", remedy="Wait.")
    shop.failures["s-01"] = [elsewhere, elsewhere]

    record = shop.sweep().run()

    assert states(record)["s-01"] == "stopped early"
    assert shop.said.count("s-01 waits: far trains s-01.") == 2


def test_a_supervisor_that_is_killed_is_started_again_but_not_forever(shop):
    class Dying(PaperRun):
        def second(self):
            self.state = "lost"

    def open_run(trial):
        run = Dying if trial.name == "s-02" else PaperRun
        shop.runs[trial.prefix] = run(shop, trial)
        return shop.runs[trial.prefix]

    sweep = shop.sweep()
    sweep._open_run = open_run

    record = sweep.run()

    assert shop.starts.count("s-02") == 1 + sweep_run.MOST_STARTS
    assert states(record)["s-02"] == "failed"


def test_a_start_that_fails_only_later_is_told_as_one_that_fails_at_once(shop):
    class Late(PaperRun):
        """As on a node: the reason comes after the start."""

        refused = None

        def start(self, limits):
            super().start(limits)
            if self.trial.name == "s-06":
                self.refused = SettingsError("The reward function is broken.", remedy="Mend it.")
                self.state = "failed"

        def record(self):
            if self.refused:
                raise self.refused
            return super().record()

    def open_run(trial):
        shop.runs[trial.prefix] = Late(shop, trial)
        return shop.runs[trial.prefix]

    sweep = shop.sweep()
    sweep._open_run = open_run

    record = sweep.run()

    failed = record.trials[5]
    assert (failed.state, failed.message) == ("failed", "The reward function is broken.")
    assert record.best == "s-05"


ASHA = FILE.replace("halving", "asha, first_check: 0.25, reduction_factor: 2")


def test_with_asha_each_is_compared_with_those_that_reached_the_check_before(shop):
    worse = shop.sweep(ASHA.replace("[1e-4", "[7e-4, 1e-4"), parallel=1, waits=False)

    record = worse.run()

    # One after the other, each better than all before: none ends.
    assert set(states(record).values()) == {"finished"}


def test_with_asha_a_worse_training_ends_at_its_first_check_and_none_waits(shop):
    class Falling(PaperRun):
        def second(self):
            if self.runs:
                number = len(self.done)
                progress = 90.0 - float(self.trial.name[-2:])
                self.done.append(iteration_record(number, evaluation_progress=[progress]))
                if len(self.done) >= shop.most:
                    self.state = "finished"

    def open_run(trial):
        shop.runs[trial.prefix] = Falling(shop, trial)
        return shop.runs[trial.prefix]

    shop.interrupt_at = 3
    sweep = shop.sweep(ASHA, waits=False)
    sweep._open_run = open_run
    with pytest.raises(Stopped):
        sweep.run()
    shop.signals = NotedSignals()
    sweep = shop.sweep(ASHA, waits=False)
    sweep._open_run = open_run

    record = sweep.run()

    assert states(record)["s-01"] == "finished"
    assert states(record)["s-02"] == "stopped early"
    assert record.trials[1].message == "ASHA ended it at the check at 2 iterations."
    assert all(used(record)[name] <= 4 for name in ("s-02", "s-04", "s-05", "s-06"))
    assert record.best == "s-01"


POPULATION = """
name: p
vary: {hyperparameters: {lr: {min: 1e-5, max: 1e-3, log: true}}}
search: random
trials: 4
budget: {iterations: 8}
metric: progress
early_stopping: {method: population, every: 0.25}
"""


@pytest.mark.parametrize("parallel", [1, 4])
def test_the_worst_of_a_population_goes_on_with_the_weights_of_the_best(shop, parallel):
    record = shop.sweep(POPULATION, parallel).run()

    first = record.trials[0]
    assert first.prefix == "p-01-g4"  # the worst at each of three checks
    assert first.source == "p-04"
    assert set(states(record).values()) == {"finished"}
    assert all(8 <= amount <= 9 for amount in used(record).values())
    settings = load_settings(shop.folder, flags={"DR_EXPERIMENT_NAME": "p-01"})
    assert settings.pretrained
    assert settings.pretrained_prefix == "p-04"
    assert settings.model_prefix == "p-01-g4"
    assert settings.train_max_iterations == 8 - first.earlier
    custom = shop.folder / "experiments" / "p-01" / "custom_files" / "hyperparameters.json"
    assert json.loads(custom.read_text())["lr"] == first.hyperparameters["lr"]


def test_a_sweep_runs_once_in_a_folder(shop, monkeypatch):
    monkeypatch.setattr(start_sweep, "open_bucket", lambda _: shop.bucket)
    monkeypatch.setattr(SweepStart, "_warnings", lambda *_: [])
    monkeypatch.setattr(SweepStart, "_run_here", lambda _, progress, *rest: progress.record)
    (shop.folder / "sweep.yaml").write_text(FILE)
    start = SweepStart(load_settings(shop.folder), shop.folder / "sweep.yaml")
    here, pid = run_folder(shop.folder, 0), os.getpid()
    same = WaitingStart(pid, started_s(pid), shop.bucket.name, "s", "sweep")
    calls = {"say": print, "warn": print, "on_change": print}

    with same.shown(here), pytest.raises(SettingsError, match="sweep s already runs here"):
        start.run(parallel=1, **calls)
    with replace(same, prefix="another").shown(here):
        assert start.run(parallel=1, **calls).name == "s"


def test_other_trainings_under_the_same_name_are_refused(shop):
    shop.sweep().run()

    with pytest.raises(ProblemsError, match="s-01 would be another training"):
        shop.sweep(FILE.replace("1e-4", "9e-4"))


def test_models_of_others_are_not_touched(shop):
    shop.bucket.put("s-02/model/model_metadata.json", b"{}")
    sweep = read_sweep_file(_written(shop))

    with pytest.raises(SettingsError, match="s-02 exists, and is not of this sweep"):
        refuse_used_models(shop.bucket, trials_of(sweep))


def test_a_wiped_sweep_leaves_nothing_but_what_is_not_its_own(shop):
    record = shop.sweep(POPULATION).run()
    for name in ("p-01/model/a", "p-01-g2/model/a", "p-01-g4/model/a", "p-011/model/a"):
        shop.bucket.put(name, b"")

    wipe_sweep(shop.bucket, record)

    left = [info.key for info in shop.bucket.list("") if info.key.startswith("p-0")]
    assert left == ["p-011/model/a"]
    assert read_sweep(shop.bucket, "p") is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("  reward_function: [none.py]\n", "there is no file none.py"),
        ("  model_metadata: [none.json]\n", "there is no file none.json"),
    ],
)
def test_a_missing_file_is_named_with_its_line(shop, change, said):
    with pytest.raises(ProblemsError, match=said) as caught:
        shop.sweep(FILE.replace("vary:\n", "vary:\n" + change))

    assert "sweep.yaml line 4" in str(caught.value)


def test_a_hyperparameter_out_of_range_is_refused_before_anything_is_written(shop):
    with pytest.raises(ProblemsError, match=r"sweep\.yaml line 4: lr=3 is above"):
        shop.sweep(FILE.replace("2e-4", "3"))

    assert not (shop.folder / "experiments").exists()


def test_a_setting_that_is_wrong_is_refused_in_the_line_of_the_sweep(shop):
    with pytest.raises(
        ProblemsError, match=r"sweep\.yaml line 4: DR_TRAIN_MIN_EVAL_TRIALS=many is not"
    ):
        shop.sweep(
            FILE.replace("vary:\n", "vary:\n  settings: {DR_TRAIN_MIN_EVAL_TRIALS: [many]}\n")
        )


def test_a_training_that_was_stopped_early_may_have_the_best_model(shop):
    class Late(PaperRun):
        """The first is best of all just after its check, which the slow last one reaches later."""

        turns = 0

        def second(self):
            self.turns += 1
            if self.trial.name == "s-06" and self.turns % 3:
                return
            super().second()
            if self.trial.name == "s-01" and len(self.done) == 3:
                self.done[-1] = iteration_record(2, evaluation_progress=[99.0])

    def open_run(trial):
        shop.runs[trial.prefix] = Late(shop, trial)
        return shop.runs[trial.prefix]

    sweep = shop.sweep(parallel=6)
    sweep._open_run = open_run

    record = sweep.run()

    assert states(record)["s-01"] == "stopped early"
    assert record.best == "s-01"


def test_a_record_survives_its_encoding(shop):
    record = shop.sweep(POPULATION).run()

    assert read_sweep(shop.bucket, "p") == replace(record)


def _written(shop):
    path = shop.folder / "sweep.yaml"
    path.write_text(FILE)
    return path
