"""The queue: what it drives, what it survives, and who may drive it."""

import os
import signal

import pytest

from drcli.base.errors import NotAvailable, OwnershipLost, SettingsError, StorageError, WorkerDied
from drcli.base.processes import Stopped
from drcli.model import race_keys
from drcli.races import queue_lease
from drcli.races.organise import close_race, delete_race, show_race
from drcli.races.race_records import RaceResult
from drcli.races.stored_race import put, read_race
from drcli.races.submissions import restart, withdraw

from .conftest import RACE


def test_every_submission_is_evaluated_under_the_rules_of_the_race(home):
    home.race(reverse=True, off_track_penalty_s=1.5, seed=77, max_laps=4)
    home.submit("ann")
    (home.folder / "run.env").write_text(
        "DR_WORLD_NAME=willow\nDR_EVAL_OFF_TRACK_PENALTY=9\nDR_EVAL_IS_CONTINUOUS=False\n"
        "DR_EVAL_DEBUG_REWARD=True\nDR_EVAL_CHECKPOINT=3\n"
    )

    home.run()

    (plan,) = home.driven
    race, rules = plan.job.config.race(), plan.job.config.evaluation
    assert (race.world_name, race.racer_name, plan.job.seed) == ("bean", "Ann", 77)
    assert rules.eval_reverse_direction
    assert rules.eval_is_continuous
    assert not rules.eval_debug_reward
    assert (rules.eval_off_track_penalty, rules.eval_number_of_trials) == (1.5, 4)
    assert plan.checkpoints == ["5_Step-500.ckpt"]


def test_a_queue_says_what_it_does_before_it_takes_long(home):
    home.race(max_laps=4)
    for model in ("ann", "bob"):
        home.submit(model)
    said = []

    home.run(on_progress=said.append)

    waits, ann, driven, bob, _ = [text for text in said if "video" not in text]
    assert waits == "2 runs wait."
    assert ann.startswith("Driving Ann (")
    assert "4 laps on bean" in ann
    assert driven.startswith("Ann (")
    assert bob.startswith("Driving Bob (")


def test_the_leaderboard_after_a_race(home):
    home.race(average_laps=2)
    home.laps = {"ann": [10.0, 12.0], "bob": [9.5, -3.0], "cem": [-1.0, -2.0]}
    for model in home.laps:
        home.submit(model)

    report = home.run()

    assert [
        (row.rank, row.racer, row.score_s, row.gap_s, row.best_average_s, row.off_track)
        for row in report.leaderboard
    ] == [
        (1, "Bob", 9.5, 0.0, None, 1),
        (2, "Ann", 10.0, 0.5, 11.0, 0),
        (None, "Cem", None, None, None, 2),
    ]
    assert report.queue == []
    assert report.submissions[1].lap_status == ["Lap complete", "Off track"]


def test_what_was_killed_is_driven_again_and_what_was_driven_is_kept(home):
    home.race()
    home.submit("ann")
    home.submit("bob")

    class Killed(BaseException):
        pass

    def kill(model):
        if model == "bob":
            raise Killed

    home.before = kill
    with pytest.raises(Killed):
        home.run()
    report = show_race(home.bucket, RACE)
    assert [entry.state for entry in report.submissions] == ["done", "queued"]

    home.before = lambda model: None
    report = home.run()

    assert [entry.state for entry in report.submissions] == ["done", "done"]
    driven = [race_keys.submitted_model(plan.job.config.model.prefix) for plan in home.driven]
    assert driven == ["ann", "bob", "bob"]


def test_sigterm_stops_the_queue_and_lets_others_drive_it_at_once(home):
    home.race()
    home.submit("ann")
    home.before = lambda model: os.kill(os.getpid(), signal.SIGTERM)

    with pytest.raises(Stopped, match="what was driven is kept"):
        home.run()
    home.before = lambda model: None

    assert home.run().leaderboard[0].racer == "Ann"


def test_a_failed_run_is_noted_and_the_next_one_follows(home):
    home.race()
    broken, _ = home.submit("ann"), home.submit("bob")
    home.laps = {"ann": WorkerDied("The worker ended.", remedy="Read its log.")}

    report = home.run()

    assert [entry.state for entry in report.submissions] == ["failed", "done"]
    assert report.submissions[0].message == "The worker ended."
    assert report.submissions[0].remedy == "Read its log."
    assert home.run().queue == []
    del home.laps["ann"]
    restart(home.bucket, RACE, broken)
    assert [entry.state for entry in home.run().submissions] == ["done", "done"]


def test_a_bucket_that_is_away_ends_the_queue_and_fails_nobody(home):
    home.race()
    home.submit("ann")
    home.laps = {"ann": StorageError("No answer.", remedy="Wait.")}

    with pytest.raises(StorageError):
        home.run()

    assert [entry.state for entry in show_race(home.bucket, RACE).submissions] == ["queued"]


def test_what_comes_while_the_queue_is_driven_is_driven_too(home):
    home.race()
    home.submit("ann")
    home.before = lambda model: home.submit("bob") if model == "ann" else None

    assert len(home.run().leaderboard) == 2


def test_what_is_withdrawn_while_it_drives_leaves_nothing(home):
    home.race()
    name = home.submit("ann")
    home.before = lambda model: withdraw(home.bucket, RACE, name)

    report = home.run()

    assert report.leaderboard == []
    assert not [info.key for info in home.bucket.list(race_keys.folder(RACE)) if name in info.key]


def test_a_limit_leaves_the_rest_in_the_queue(home):
    home.race()
    home.submit("ann")
    waiting = home.submit("bob")

    assert home.run(limit=1).queue == [waiting]


def test_one_process_at_a_time_drives_a_queue(home):
    home.race()
    home.submit("ann")

    with queue_lease.held(home.bucket, RACE) as lease:
        assert show_race(home.bucket, RACE).runner.startswith(f"process {os.getpid()} on")
        with pytest.raises(SettingsError, match="is being driven by process"):
            home.run()
        with pytest.raises(SettingsError, match="is being driven by process"):
            delete_race(home.bucket, RACE)
        lease.renew()

    assert show_race(home.bucket, RACE).runner == ""
    assert home.run().queue == []


def test_a_lost_lease_ends_the_queue_before_it_writes_anything_more(home):
    home.race()
    name = home.submit("ann")

    def lose(model):
        key = race_keys.lease(RACE)
        lease = queue_lease.read_queue_lease(home.bucket, RACE)
        home.bucket.put(key, type(lease)("other", "there", 1, 1.0, "m", term=9).encode())

    home.before = lose

    with pytest.raises(OwnershipLost, match="process 1 on there"):
        home.run()

    (result,) = read_race(home.bucket, RACE).results.values()
    assert result.state == "running"
    assert queue_lease.read_queue_lease(home.bucket, RACE).session == "other"
    assert show_race(home.bucket, RACE).queue == [name]


def test_an_expired_lease_and_one_of_a_dead_process_are_free(home):
    home.race()
    lease = queue_lease.Lease("s", "here", 2**22 + 5, 1.0, queue_lease.this_machine(), 1.0, 3)
    put(home.bucket, race_keys.lease(RACE), lease)

    with queue_lease.held(home.bucket, RACE):
        assert queue_lease.read_queue_lease(home.bucket, RACE).term == 4


def test_a_track_that_is_not_here_is_refused_before_anything_is_driven(home):
    home.race()
    home.submit("ann")
    key = race_keys.rules(RACE)
    home.bucket.put(key, home.bucket.get(key).replace(b'"bean"', b'"nowhere"'))

    with pytest.raises(SettingsError, match="DR_WORLD_NAME=nowhere"):
        home.run()

    assert [entry.state for entry in show_race(home.bucket, RACE).submissions] == ["queued"]


def test_without_the_encoder_laps_are_driven_and_the_race_says_why_it_has_no_videos(
    home, monkeypatch
):
    def missing():
        raise NotAvailable("An MP4 needs av.", remedy="Install drcli[video].")

    monkeypatch.setattr("drcli.races.race_queue.require_encoder", missing)
    home.race()
    home.submit("ann")
    with pytest.raises(NotAvailable):
        home.run(video=True)

    report = home.run(video=None)

    assert report.leaderboard[0].video == ""
    assert report.submissions[0].notes == [
        "There are no videos of this race. An MP4 needs av. Install drcli[video]."
    ]


def test_a_film_is_put_beside_the_race_and_a_film_that_fails_costs_no_laps(home, monkeypatch):
    def film(plan, bucket, report, path):
        if race_keys.submitted_model(report.prefix) == "bob":
            raise SettingsError("No such track.", remedy="Look.")
        path.write_bytes(b"film of " + report.prefix.encode())
        return []

    monkeypatch.setattr("drcli.races.race_queue._film", film)
    monkeypatch.setattr("drcli.races.race_queue.require_encoder", lambda: None)
    home.race()
    home.submit("ann")
    home.submit("bob")

    ann, bob = home.run(video=None).leaderboard

    assert home.bucket.get(ann.video).startswith(b"film of races/cup/models/")
    assert ann.video.startswith("races/cup/videos/")
    assert bob.video == ""
    assert (
        "has no video: No such track. Look." in show_race(home.bucket, RACE).submissions[1].notes[0]
    )


def test_a_round_robin_drives_every_pair_once(home):
    home.race(race_type="HEAD_TO_MODEL")
    home.laps = {"ann": [9.0, 9.0], "bob": [10.0, 10.0], "cem": [10.0, -1.0]}
    for model in home.laps:
        home.submit(model)

    report = home.run()

    assert len(home.driven) == 3
    assert {plan.job.config.race().race_type for plan in home.driven} == {"HEAD_TO_MODEL"}
    assert [(row.racer, row.points, row.wins) for row in report.leaderboard] == [
        ("Ann", 2.0, 2),
        ("Bob", 1.0, 1),
        ("Cem", 0.0, 0),
    ]
    assert {pair.state for pair in report.pairs} == {"done"}
    assert home.run().queue == []
    assert close_race(home.bucket, RACE).winner == "Ann"


def test_a_bracket_drives_the_winners_on_and_nobody_joins_it_later(home):
    home.put_model("dan")
    home.race(race_type="HEAD_TO_MODEL", pairing="bracket")
    home.laps = {"ann": [9.0], "bob": [10.0], "cem": [8.0], "dan": [9.0]}
    for model in home.laps:
        home.submit(model)

    report = home.run(limit=1)
    assert [(pair.first_racer, pair.second_racer, pair.state) for pair in report.pairs] == [
        ("Ann", "Dan", "done"),
        ("Bob", "Cem", "queued"),
        ("Ann", "", "waiting"),
    ]
    home.put_model("eve")
    with pytest.raises(SettingsError, match="is drawn, so nobody can join it"):
        home.submit("eve")
    report = home.run()

    # Ann and Dan were equal: the better seed goes on.
    assert [(row.rank, row.racer, row.round) for row in report.leaderboard] == [
        (1, "Cem", 3),
        (2, "Ann", 2),
        (3, "Dan", 1),
        (4, "Bob", 1),
    ]
    assert close_race(home.bucket, RACE).winner == "Cem"


def test_a_withdrawal_from_a_bracket_lets_the_opponent_go_on(home):
    home.race(race_type="HEAD_TO_MODEL", pairing="bracket")
    names = {model: home.submit(model) for model in ("ann", "bob", "cem")}
    home.laps = {"bob": WorkerDied("Broken.", remedy="Look.")}
    report = home.run()
    assert [pair.state for pair in report.pairs] == ["alone", "failed", "waiting"]
    close_race(home.bucket, RACE)
    assert show_race(home.bucket, RACE).winner is None

    withdraw(home.bucket, RACE, names["bob"])
    report = home.run()

    assert [pair.state for pair in report.pairs] == ["alone", "alone", "done"]
    assert report.winner == "Ann"


def test_a_result_about_other_cars_counts_as_none(home):
    home.race()
    home.submit("ann")
    home.run()
    (name,) = read_race(home.bucket, RACE).results
    key = race_keys.result(RACE, name)
    result = RaceResult.decode(home.bucket.get(key))
    data = home.bucket.get(key).replace(result.cars[0].submission.encode(), b"x", 1)
    home.bucket.put(key, data)

    assert len(show_race(home.bucket, RACE).queue) == 1
