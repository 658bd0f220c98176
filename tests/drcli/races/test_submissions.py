"""Submitting, withdrawing, moving and restarting."""

import pytest

from drcli.base.errors import SettingsError
from drcli.model import keys, race_keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_list import list_models
from drcli.model.model_store import ModelStore
from drcli.model.traces import models_in
from drcli.races.organise import close_race, show_race
from drcli.races.stored_race import read_race
from drcli.races.submissions import move, restart, submit, withdraw

from .conftest import RACE


def order(home) -> list[str]:
    """Models in the order of the queue."""
    report = show_race(home.bucket, RACE)
    models = {entry.submission: entry.model for entry in report.submissions}
    return [models[name] for name in report.queue]


def test_a_submission_is_a_copy_that_outlives_its_model(home):
    home.race()
    taken = submit(home.settings, home.bucket, RACE)
    home.bucket.delete([info.key for info in home.bucket.list("ann/")])

    report = home.run()

    assert (taken.racer, taken.model, taken.waiting, taken.left) == ("Ann", "ann", 1, None)
    assert report.leaderboard[0].rank == 1
    assert report.leaderboard[0].checkpoint == "5_Step-500.ckpt"
    assert [model.prefix for model in list_models(home.bucket).models] == ["bob", "cem"]


def test_copies_in_a_race_are_no_models_that_commands_list_or_delete(home):
    home.race()
    home.submit("ann")

    listed = home.bucket.list("")

    copies = [info.key for info in listed if info.key.startswith(race_keys.folder("cup"))]
    assert any(key.endswith("/ann/model/.coach_checkpoint") for key in copies)
    assert models_in(listed).keys() == {"ann", "bob", "cem"}
    assert [model.prefix for model in list_models(home.bucket).models] == ["ann", "bob", "cem"]


def test_an_older_checkpoint_can_be_submitted(home):
    CheckpointStore(ModelStore(home.bucket, "ann")).save(6, 600, b"newer")
    home.race()

    home.submit("ann", checkpoint="5")
    home.submit("ann", checkpoint="last")

    entries = show_race(home.bucket, RACE).submissions
    assert [entry.checkpoint for entry in entries] == ["5_Step-500.ckpt", "6_Step-600.ckpt"]


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"prefix": "nobody"}, "No checkpoint file available at s3://bucket/nobody/"),
        ({"prefix": "../ann"}, r"\.\./ann cannot be the prefix of a model"),
        ({"prefix": ""}, "cannot be the prefix"),
        ({"checkpoint": "99"}, "no checkpoint 99"),
        ({"checkpoint": "first-lap"}, "no checkpoint first-lap"),
        ({"checkpoint": "fastest"}, "--checkpoint fastest is neither"),
        ({"racer": "  "}, "The name of the racer"),
        ({"racer": "a\nb\x00"}, "characters that cannot be shown"),
        ({"prefix": "lidar"}, "uses LIDAR, but race cup allows only FRONT_FACING_CAMERA"),
        ({"prefix": "broken"}, "model_metadata.json"),
    ],
)
def test_what_cannot_race_is_refused_in_a_sentence_and_nothing_is_written(home, options, why):
    home.put_model("lidar", sensor="FRONT_FACING_CAMERA LIDAR")
    home.put_model("broken")
    home.bucket.put(keys.model_metadata("broken"), b"{")
    home.race(sensors=("FRONT_FACING_CAMERA",))
    before = home.bucket.list("")

    with pytest.raises(SettingsError, match=why) as refused:
        submit(home.settings, home.bucket, RACE, **options)

    assert refused.value.remedy
    assert home.bucket.list("") == before


def test_other_names_of_the_same_camera_are_allowed(home):
    home.put_model("left", sensor="LEFT_CAMERA")
    home.race(sensors=("FRONT_FACING_CAMERA",))

    assert home.submit("left")


def test_a_race_that_is_not_open_takes_nothing(home):
    home.race(opens_at=100.0, closes_at=200.0)

    with pytest.raises(SettingsError, match="opens at 01 Jan 1970, 00:01 UTC"):
        submit(home.settings, home.bucket, RACE, now_s=50.0)
    submit(home.settings, home.bucket, RACE, now_s=150.0)
    with pytest.raises(SettingsError, match="was closed at"):
        submit(home.settings, home.bucket, RACE, prefix="bob", now_s=250.0)


def test_each_racer_has_so_many_submissions_whatever_the_capitals(home):
    home.race(max_submissions=1)
    first = home.submit("ann", "Ann")

    with pytest.raises(SettingsError, match=f"ANN has submitted {first} to race cup"):
        home.submit("bob", "ANN")
    withdraw(home.bucket, RACE, first)

    assert home.submit("bob", "ANN")


def test_two_at_the_same_moment_are_both_kept_and_the_limit_holds(home, monkeypatch):
    """Neither sees the other's: the rule is applied again when the race is read."""
    home.race(max_submissions=1)
    monkeypatch.setattr("drcli.races.submissions._refuse_too_many", lambda *_: None)
    home.submit("ann", "Ann")
    home.submit("bob", "Ann")

    report = home.run()

    assert [entry.state for entry in report.submissions] == ["done", "over the limit"]
    assert [row.model for row in report.leaderboard] == ["ann"]


def test_the_same_checkpoint_twice_is_refused(home):
    home.race()
    home.submit("ann", "Ann")

    with pytest.raises(SettingsError, match="would drive the same laps"):
        home.submit("ann", "Bob")


def test_the_queue_is_first_come_first_driven_and_can_be_reordered(home):
    home.race()
    names = {model: home.submit(model) for model in ("ann", "bob", "cem")}
    assert order(home) == ["ann", "bob", "cem"]

    move(home.bucket, RACE, names["cem"], 1)
    assert order(home) == ["cem", "ann", "bob"]
    move(home.bucket, RACE, names["cem"][:5], 99)
    assert order(home) == ["ann", "bob", "cem"]
    home.put_model("dan")
    home.submit("dan")
    assert order(home) == ["ann", "bob", "cem", "dan"]
    move(home.bucket, RACE, names["ann"], 3)
    assert order(home) == ["bob", "cem", "ann", "dan"]

    home.run()
    driven = [race_keys.submitted_model(plan.job.config.model.prefix) for plan in home.driven]
    assert driven == ["bob", "cem", "ann", "dan"]


def test_what_does_not_wait_cannot_be_moved_but_restarted(home):
    home.race()
    name = home.submit("ann")
    home.run()

    with pytest.raises(SettingsError, match="does not wait in the queue"):
        move(home.bucket, RACE, name, 1)
    with pytest.raises(SettingsError, match="There is no place 0"):
        move(home.bucket, RACE, name, 0)
    assert restart(home.bucket, RACE, name).queue == [name]
    home.laps["ann"] = [8.0, 9.0]
    assert home.run().leaderboard[0].best_lap_s == 8.0


def test_an_unknown_submission_is_refused_with_those_that_there_are(home):
    home.race()
    name = home.submit("ann")

    for text in ("zz", "", "../x"):
        with pytest.raises(SettingsError, match=f"no submission called .*there are: {name}"):
            withdraw(home.bucket, RACE, text)


def test_withdrawing_leaves_nothing_of_a_submission(home):
    home.race()
    kept, gone = home.submit("ann"), home.submit("bob")
    home.run()

    report = withdraw(home.bucket, RACE, gone)

    assert [row.submission for row in report.leaderboard] == [kept]
    assert not [info.key for info in home.bucket.list(race_keys.folder(RACE)) if gone in info.key]


def test_damaged_records_are_said_and_the_others_are_shown(home):
    home.race()
    home.submit("ann")
    home.submit("bob")
    stored = read_race(home.bucket, RACE)
    first = min(stored.submissions)
    for damage in (b"", b"{", b"[]", b'{"racer": 3}', b"\xff"):
        home.bucket.put(race_keys.submission(RACE, first), damage)

        report = show_race(home.bucket, RACE)

        assert [entry.model for entry in report.submissions] == ["bob"]
        assert first in report.damaged[0]


def test_a_closed_race_has_a_winner_when_everything_was_driven(home):
    home.race()
    home.submit("ann")
    home.laps = {"ann": [9.0, 9.0]}
    assert close_race(home.bucket, RACE).winner is None
    assert show_race(home.bucket, RACE).state == "closed"

    report = home.run()

    assert (report.state, report.winner) == ("finished", "Ann")
