"""Evaluations that go on until somebody stops them (001-47, 001-50)."""

from dataclasses import dataclass

import pytest

from drcli.base.errors import SettingsError, StorageError
from drcli.model import keys
from drcli.records.run_record import running_evaluations
from drcli.run import evaluation_loop
from drcli.run.evaluation_loop import MOST_ROWS, BestLap, BestLaps, read_best_laps, run_loop
from drcli.run.evaluation_report import EvaluationReport, TrialReport

TABLE = keys.best_laps("model-1/metrics")


@dataclass(frozen=True)
class Plan:
    stamp: str
    checkpoint: str
    seed: int


class Rounds:
    """Rounds with given lap times; after the last one Ctrl-C is pressed.

    A lap time of None is a round without a lap, a negative one that of a lap with a reset; an error
    ends its round.
    """

    def __init__(self, bucket, laps):
        self.bucket = bucket
        self.laps = iter(laps)
        self.plans = []
        self.pauses = []
        self.newest = "0_Step-0.ckpt"

    def prepare(self, settings, *, seed):
        assert settings.eval_checkpoint == "last"  # the newest, also where the settings say best
        lap = next(self.laps, KeyboardInterrupt())
        if isinstance(lap, BaseException):
            raise lap
        number = len(self.plans)
        stamp = f"{20260102030405 + number}"
        self.plans.append((Plan(stamp, self.newest, seed), lap))
        self.bucket.put(keys.evaluation_trace("model-1", stamp), b"trace")
        self.bucket.put(keys.evaluation_metrics("model-1/metrics", stamp), b"metrics")
        self.bucket.put(keys.evaluation_video("model-1", stamp), b"video")
        return self.plans[-1][0]

    def run(self, plan):
        lap = self.plans[-1][1]
        status = "Off track" if lap is None else "Lap complete"
        resets, lap = (1, -lap) if lap is not None and lap < 0 else (0, lap)
        trials = [TrialReport(1, 100.0, lap or 3.0, status, 0, 0, resets, 2.0 * resets)]
        notes = ["The evaluation has no video."]
        return EvaluationReport(
            prefix="model-1",
            world="reinvent_base",
            checkpoint=plan.checkpoint,
            trials=trials,
            simtrace="",
            metrics="",
            notes=notes,
        )

    def stamps_of(self, part):
        found = [info.key for info in self.bucket.list("model-1/") if part in info.key]
        return {key.split("/")[1].removeprefix("evaluation-") for key in found}


@pytest.fixture
def loop(racer, monkeypatch):
    """Runs a loop over lap times; every round finds a newer checkpoint."""
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_EVAL_CHECKPOINT=best")

    def run(*laps, seen=(), **options):
        rounds, left = Rounds(racer.bucket, laps), list(seen)

        def newest(settings, model):
            number = len(rounds.plans)
            rounds.newest = left.pop(0) if left else f"{number}_Step-{number}.ckpt"
            return rounds.newest

        monkeypatch.setattr(evaluation_loop, "open_bucket", lambda *_, **__: racer.bucket)
        monkeypatch.setattr(evaluation_loop, "prepare_evaluation", rounds.prepare)
        monkeypatch.setattr(evaluation_loop, "run_evaluation", rounds.run)
        monkeypatch.setattr(evaluation_loop, "choose_checkpoint", newest)
        monkeypatch.setattr(evaluation_loop.time, "sleep", rounds.pauses.append)
        return rounds, run_loop(racer.settings(), **options)

    return run


def test_a_loop_drives_each_new_checkpoint_until_it_is_stopped(loop, racer):
    said = []
    rounds, report = loop(12.0, None, 10.5, 11.0, on_progress=said.append, seed=7)

    assert [plan.seed for plan, _ in rounds.plans] == [7, 8, 9, 10]
    assert len({plan.checkpoint for plan, _ in rounds.plans}) == 4
    assert (report.rounds, report.failures) == (4, 0)
    assert [lap.best_lap_s for lap in report.best] == [10.5, 11.0, 12.0]
    assert said[2].endswith(": 1 of 1 lap clean, best 10.50 s, the best lap so far.")
    assert said[3].endswith("best 11.00 s.")
    assert running_evaluations(racer.folder) == []


def test_the_table_goes_on_where_the_last_loop_ended(loop, racer):
    loop(12.0)
    earlier = BestLap("Oval_track", "3.ckpt", 8.0, None, 1, 1, "2026-01-01", "20250101000000")
    racer.bucket.put(TABLE, read_best_laps(racer.bucket, TABLE).with_lap(earlier).encode())

    said = []
    _, report = loop(13.0, 11.0, on_progress=said.append)

    # Nobody recorded whether that lap was clean, so it comes after those that are.
    assert [lap.best_lap_s for lap in report.best] == [11.0, 12.0, 13.0, 8.0]
    assert "the best lap so far" not in said[0]
    assert "the best lap so far" in said[1]  # on this track: that of another one does not count


def test_a_lap_with_a_reset_is_told_as_such_and_never_beats_a_clean_one(loop):
    said = []
    _, report = loop(12.0, -9.0, on_progress=said.append)

    assert "0 of 1 lap clean (1 reset), 1 finished, the fastest in 9.00 s = 7.00 driven" in said[1]
    assert "the best lap so far" not in said[1]
    kept = [(lap.best_lap_s, lap.clean, lap.resets, lap.penalty_s) for lap in report.best]
    assert kept == [(12.0, 1, 0, 0.0), (9.0, 0, 1, 2.0)]


def test_what_an_evaluation_notes_is_reported_once(loop):
    said = []
    loop(12.0, 11.0, on_progress=said.append)

    assert said[0].endswith("the best lap so far. The evaluation has no video.")
    assert said[1].endswith("the best lap so far.")


def test_a_damaged_table_begins_anew(loop, racer):
    racer.bucket.put(TABLE, b'{"laps": 7}')

    _, report = loop(12.0)

    assert [lap.best_lap_s for lap in report.best] == [12.0]


def test_only_the_rounds_of_the_table_and_the_newest_stay_in_the_bucket(loop, racer):
    laps = [30.0 - number / 2 for number in range(MOST_ROWS + 5)]

    rounds, report = loop(*laps, None, None)

    stamps = {lap.stamp for lap in report.best} | {rounds.plans[-1][0].stamp}
    assert len(report.best) == MOST_ROWS
    assert rounds.stamps_of("simtrace") == rounds.stamps_of("video.mp4") == stamps
    assert BestLaps.decode(racer.bucket.get(TABLE)).laps == report.best


def test_a_first_round_that_fails_ends_the_loop(loop):
    with pytest.raises(SettingsError, match="no trained model"):
        loop(SettingsError("model-1 has no trained model.", remedy="Train it."))


def test_later_failures_are_told_and_tried_again_with_growing_pauses(loop):
    gone, told = StorageError("The bucket does not answer.", remedy="Look at it."), []

    rounds, report = loop(12.0, gone, gone, 11.0, on_failure=told.append)

    assert (report.rounds, report.failures) == (2, 2)
    assert told == ["The bucket does not answer. Look at it. The loop goes on."] * 2
    assert rounds.pauses[0] < rounds.pauses[1]


def test_a_round_that_could_only_repeat_the_last_one_waits_for_a_new_checkpoint(loop):
    seen = ["0_Step-0.ckpt", "0_Step-0.ckpt", "1_Step-1.ckpt"]

    rounds, _ = loop(12.0, 12.0, seen=seen)

    assert rounds.pauses == [evaluation_loop.POLL_S] * 2
    assert [plan.checkpoint for plan, _ in rounds.plans] == ["0_Step-0.ckpt", "1_Step-1.ckpt"]


@pytest.mark.parametrize(
    "line",
    [
        "DR_ENABLE_DOMAIN_RANDOMIZATION=True",
        "DR_SIM_IMAGE_NOISE=5",
        "DR_RACE_TYPE=HEAD_TO_BOT",
    ],
)
def test_where_something_is_drawn_the_same_checkpoint_drives_again(racer, line):
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", line)

    assert evaluation_loop.draws_anything(racer.settings())


@pytest.mark.parametrize("lines", [(), ("DR_SIM_IMAGE_NOISE=5", "DR_SIM_EXTRAS_IN=training")])
def test_where_nothing_is_drawn_it_does_not(racer, lines):
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", *lines)

    assert not evaluation_loop.draws_anything(racer.settings())
