"""A budget for all trainings of a folder together, counted by the day."""

import json
import time
from dataclasses import dataclass

import pytest

from drcli.base.errors import BudgetUsedUp, SettingsError
from drcli.config.loading import load_settings
from drcli.records.training_record import FOLDER, DaySpending, day_of, read_day, write_day
from drcli.run.cost import DailyBudget, forget_old_days
from drcli.run.outcome import INTERRUPTED
from memory_bucket import MemoryBucket
from unwatched import ending, job_of, running

NOON_S = 1_777_636_800.0
DAY = day_of(NOON_S)


@dataclass
class Meter:
    own_hours: float = 0.0
    own_usd: float = 0.0


class Counting:
    """A training whose time passes when a test says so."""

    def __init__(self, folder, *lines: str, session: str = "one") -> None:
        self.folder = folder
        self.meter = Meter()
        self.now_s = NOON_S
        self.job = job_of(folder, *lines, session=session)
        run = running(self.job, MemoryBucket())
        self.duty = DailyBudget(run, self.meter, now=lambda: self.now_s)
        self.duty.start()

    def train(self, hours: float, usd: float = 0.0) -> None:
        self.meter.own_hours += hours
        self.meter.own_usd += usd
        self.duty.work()


def test_all_trainings_of_a_folder_count_together(tmp_path):
    first = Counting(tmp_path, "DR_DAILY_BUDGET_HOURS=3", session="one")
    second = Counting(tmp_path, "DR_DAILY_BUDGET_HOURS=3", session="two")

    first.train(2.0)
    second.train(0.9)
    assert second.duty.check() is None
    second.train(0.1)

    outcome = second.duty.check()
    assert outcome is not None
    assert outcome.code == INTERRUPTED
    assert not outcome.stays_ended
    assert "took 3.00 machine hours, DR_DAILY_BUDGET_HOURS is 3" in outcome.message
    assert "--resume-or-start" in outcome.remedy


def test_money_has_a_budget_too(tmp_path):
    it = Counting(tmp_path, "DR_SPOT_PRICE=2", "DR_DAILY_BUDGET_MONEY=5")

    it.train(2.0, 4.9)
    assert it.duty.check() is None
    it.train(0.1, 0.1)

    assert "cost 5.00 USD, DR_DAILY_BUDGET_MONEY is 5" in it.duty.check().message


def test_a_budget_of_money_needs_a_price(tmp_path):
    with pytest.raises(SettingsError, match="DR_DAILY_BUDGET_MONEY=5 cannot be kept"):
        Counting(tmp_path, "DR_DAILY_BUDGET_MONEY=5")


def test_each_day_begins_anew(tmp_path):
    it = Counting(tmp_path, "DR_DAILY_BUDGET_HOURS=3")
    it.train(2.5)
    it.now_s += 86_400.0
    it.train(1.0)
    it.train(1.0)

    assert it.duty.check() is None
    assert read_day(tmp_path, DAY).hours == pytest.approx(3.5)
    assert read_day(tmp_path, day_of(it.now_s)).hours == pytest.approx(1.0)


def test_what_a_start_that_vanished_has_used_stays_counted(tmp_path):
    Counting(tmp_path, session="killed").train(1.5)  # it never comes to its end

    it = Counting(tmp_path, "DR_DAILY_BUDGET_HOURS=2", session="next")
    it.train(0.5)

    assert it.duty.check() is not None


def test_without_a_limit_the_day_is_counted_and_nothing_ends(tmp_path):
    it = Counting(tmp_path)
    it.train(100.0)
    it.duty.finish(ending())

    assert it.duty.check() is None
    assert read_day(tmp_path, DAY).hours == pytest.approx(100.0)


@pytest.mark.parametrize("data", [b"", b"{", b'{"hours": -3}', b'{"hours": "many"}', b"\xff"])
def test_a_damaged_file_is_left_out_and_told(tmp_path, data):
    write_day(tmp_path, DAY, "good", DaySpending(1.0))
    (tmp_path / FOLDER / DAY / "bad.json").write_bytes(data)

    budget = read_day(tmp_path, DAY, max_hours=8.0)

    assert (budget.hours, budget.damaged) == (1.0, 1)
    assert "1 unreadable" in str(budget)


def test_a_full_disk_ends_no_training(tmp_path, monkeypatch):
    it = Counting(tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("drcli.run.cost.write_day", full)
    it.train(1.0)

    assert it.duty.check() is None


def test_old_days_are_deleted(tmp_path):
    for day in ("2026-01-01", "2026-01-02", "2026-01-03"):
        write_day(tmp_path, day, "one", DaySpending(1.0))

    forget_old_days(tmp_path, keep=2)

    assert sorted(path.name for path in (tmp_path / FOLDER).iterdir()) == [
        "2026-01-02",
        "2026-01-03",
    ]


def test_nothing_starts_on_a_day_whose_budget_is_used_up(racer):
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_DAILY_BUDGET_HOURS=2")
    write_day(racer.folder, day_of(time.time()), "earlier", DaySpending(2.0))

    with pytest.raises(BudgetUsedUp, match="is used up") as refused:
        racer.start()

    assert refused.value.code == INTERRUPTED
    assert "raise DR_DAILY_BUDGET_HOURS" in refused.value.remedy
    assert list(racer.bucket.list("")) == []
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_DAILY_BUDGET_HOURS=3")
    assert racer.start().job.session


def test_the_status_and_the_summary_tell_the_budget(working_folder, dr, capsys):
    with (working_folder / "system.env").open("a") as file:
        file.write("DR_DAILY_BUDGET_HOURS=8\n")
    write_day(working_folder, day_of(time.time()), "earlier", DaySpending(2.0))
    assert load_settings(working_folder, environ={}).daily_budget_hours == 8.0

    assert dr("status", "--json") == 0
    status = json.loads(capsys.readouterr().out.splitlines()[-1])

    assert status["budget"]["hours"] == 2.0
    assert status["budget"]["max_hours"] == 8.0
