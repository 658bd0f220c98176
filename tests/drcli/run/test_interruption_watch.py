"""When a notice ends a training, and how much time it leaves."""

from types import SimpleNamespace
from typing import ClassVar

import pytest

from drcli.clouds.cloud import Notice
from drcli.config.loading import load_settings
from drcli.model.model_store import ModelStore
from drcli.outside.notices.notice_watch import Announced
from drcli.records.job import Job
from drcli.run import interruption_watch
from drcli.run.interruption_watch import InterruptionWatch, chosen_source
from drcli.run.journal import Journal, read_journal
from drcli.run.outcome import Ending
from memory_bucket import MemoryBucket


def settings_of(folder, environ):
    (folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model\n")
    (folder / "system.env").write_text("")
    return load_settings(folder, environ=environ).run


@pytest.fixture
def watch(tmp_path, monkeypatch):
    """A watch whose notices are laid down; `at` is its clock."""

    class Laid:
        announced_now: ClassVar[list[Announced]] = []
        stopped: ClassVar = False

        def __init__(self, *_: object) -> None:
            pass

        def start(self) -> None:
            pass

        def stop(self) -> None:
            Laid.stopped = True

        def announced(self) -> list[Announced]:
            return self.announced_now

    class Clock:
        now = 1000.0

        def monotonic(self) -> float:
            return self.now

    clock = Clock()
    monkeypatch.setattr(interruption_watch, "NoticeWatch", Laid)
    monkeypatch.setattr(interruption_watch, "time", clock)
    journal = Journal("model", 1, "a")

    def start(**settings: str) -> SimpleNamespace:
        config = settings_of(tmp_path, settings)
        job = Job(config, "a", 1, None, tmp_path, 1)
        duty = InterruptionWatch(SimpleNamespace(job=job, journal=journal), tmp_path)
        duty.start()
        return SimpleNamespace(duty=duty, clock=clock, journal=journal, laid=Laid)

    yield start
    Laid.announced_now = []


def announce(found, kind="interruption", left_s=120.0):
    notice = Notice("aws", kind, "terminate", left_s, "It goes.")
    found.laid.announced_now = [Announced(notice, found.clock.now)]


def test_without_a_notice_the_training_goes_on(watch):
    assert watch().duty.check() is None


def test_a_notice_of_two_minutes_ends_the_training_with_half_a_minute_to_spare(watch):
    found = watch()
    announce(found)

    outcome = found.duty.check()

    assert (outcome.code, outcome.state) == (75, "interrupted")
    assert outcome.save_within_s == 90.0
    assert not outcome.stays_ended
    assert "--resume-or-start" in outcome.remedy
    found.duty.finish(Ending(outcome, None, lambda: False))
    assert found.laid.stopped


@pytest.mark.parametrize(
    ("left_s", "save_s"),
    [(118.0, 88.0), (85.0, 55.0), (60.0, 55.0), (30.0, 25.0), (2.0, 8.0), (None, 55.0)],
)
def test_the_time_to_save_is_what_the_notice_leaves(watch, left_s, save_s):
    found = watch()
    announce(found, left_s=left_s)

    assert found.duty.check().save_within_s == save_s


def test_a_machine_that_has_a_quarter_of_an_hour_left_trains_on(watch):
    found = watch()
    announce(found, left_s=900.0)

    assert found.duty.check() is None
    found.clock.now += 790.0

    assert found.duty.check().code == 75


def test_the_settings_say_that_it_stays_stopped(watch):
    found = watch(DR_CONTINUE_ON_SPOT_INTERRUPTION="False")
    announce(found)

    outcome = found.duty.check()

    assert outcome.stays_ended
    assert outcome.code == 75
    assert "stays stopped" in outcome.remedy


def test_a_recommendation_is_noted_once_and_ends_nothing(watch):
    found = watch()
    announce(found, "rebalance", None)

    assert found.duty.check() is None
    assert found.duty.check() is None

    bucket = MemoryBucket()
    found.journal.write(bucket)
    (event,) = read_journal(ModelStore(bucket, "model")).events
    assert (event.kind, event.facts["what"]) == ("notice", "rebalance")


def test_a_recommendation_ends_the_training_where_that_is_set(watch):
    found = watch(DR_ON_REBALANCE="stop")
    announce(found, "rebalance", None)

    assert found.duty.check().code == 75


@pytest.mark.parametrize("variable", ["", "off"])
def test_a_machine_outside_the_clouds_asks_nobody(tmp_path, variable):
    chosen = {"DR_INTERRUPTION_WATCH": variable} if variable else {}
    settings = settings_of(tmp_path, chosen).unattended
    environment = {"AWS_EC2_METADATA_SERVICE_ENDPOINT": "http://x"} if variable else {}

    assert chosen_source(settings, environment, tmp_path) is None


def test_a_wrong_address_is_no_reason_not_to_train(tmp_path):
    settings = settings_of(tmp_path, {"DR_INTERRUPTION_WATCH": "aws"}).unattended

    assert chosen_source(settings, {"AWS_EC2_METADATA_SERVICE_ENDPOINT": "x"}, tmp_path) is None
