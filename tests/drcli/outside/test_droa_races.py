"""Races of DeepRacer on AWS: listed, and entered once or again and again."""

import json
from datetime import UTC, datetime, timedelta

import pytest

PAST = (datetime.now(UTC) - timedelta(hours=1)).isoformat()


def reports(capsys):
    lines = capsys.readouterr().out.splitlines()
    return [json.loads(line) for line in lines if line.startswith("{")]


def test_open_races_come_first_with_what_counts(droa, fake, capsys):
    fake.add_race("Autumn", closeTime=PAST)
    fake.add_race("Spring")

    assert droa("droa", "races") == 0

    printed = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in printed[2:]] == ["Spring", "Autumn"]
    assert "reinvent_base counter-clockwise" in printed[2]


def test_a_site_without_races_says_so(droa, capsys):
    assert droa("droa", "races") == 0
    assert "There is no race at" in capsys.readouterr().out


def test_a_model_is_submitted_and_its_time_shown(droa, fake, capsys, pauses):
    fake.add_model("car")
    race = fake.add_race("Spring")

    assert droa("droa", "submit", "car", "Spring") == 0

    printed = capsys.readouterr().out
    assert (
        "Submitted car to Spring (submission 1): 31.250 s, best lap 9.950 s, 3 laps, 1 reset."
        in printed
    )
    assert len(fake.submissions[race]) == 1
    assert set(pauses) == {15.0}


def test_without_waiting_it_is_only_in_the_queue(droa, fake, capsys, pauses):
    fake.add_model("car")
    race = fake.add_race("Spring")

    assert droa("droa", "submit", "car", race, "--no-wait", "--json") == 0

    assert reports(capsys)[0]["status"] == "QUEUED"
    assert pauses == []


@pytest.mark.parametrize(
    ("options", "count", "words"),
    [
        (("--times", "2"), 2, ""),
        ((), 3, "That was the last submission that Spring allows you."),
    ],
)
def test_it_is_submitted_again_and_again(droa, fake, capsys, pauses, options, count, words):
    fake.add_model("car")
    race = fake.add_race("Spring")

    assert droa("droa", "submit", "car", "Spring", "--every", "30", *options) == 0

    assert len(fake.submissions[race]) == count
    assert words in capsys.readouterr().err
    assert [round(wait, -2) for wait in pauses if wait > 60] == [1800.0] * (count - 1)


def test_a_call_that_fails_is_tried_again_at_the_next_time(droa, fake, capsys, monkeypatch):
    fake.add_model("car")
    race = fake.add_race("Spring")

    turns = []

    def pause(seconds):
        if seconds > 60:
            turns.append(seconds)
            fake.faults = [(400, {}, b'{"message": "busy"}')] if len(turns) == 1 else []

    monkeypatch.setattr("drcli.cli.commands.droa.pause", pause)

    assert droa("droa", "submit", "car", "Spring", "--every", "2", "--times", "3") == 0

    assert len(fake.submissions[race]) == 2
    assert "answered 400: busy" in capsys.readouterr().err


def test_it_ends_when_the_race_closes(droa, fake, capsys, monkeypatch):
    fake.add_model("car")
    race = fake.add_race("Spring")

    def pause(seconds):
        if seconds > 60:
            fake.races[race]["closeTime"] = PAST

    monkeypatch.setattr("drcli.cli.commands.droa.pause", pause)

    assert droa("droa", "submit", "car", "Spring", "--every", "5") == 0
    assert "takes no more submissions" in capsys.readouterr().err
    assert len(fake.submissions[race]) == 1


@pytest.mark.parametrize(
    ("prepare", "arguments", "code", "words"),
    [
        (lambda f: None, ("car", "Winter"), 3, "There is no race Winter"),
        (lambda f: f.add_race("Spring"), ("car", "Spring"), 3, "Several races"),
        (
            lambda f: f.races.clear() or f.add_race("Old", closeTime=PAST),
            ("car", "Old"),
            3,
            "takes no submissions now",
        ),
        (
            lambda f: f.races.clear() or f.add_race("None", maxSubmissionsPerUser=0),
            ("car", "None"),
            3,
            "as often as it allows",
        ),
        (
            lambda f: f.add_model("busy", "TRAINING"),
            ("busy", "Spring"),
            3,
            "has the status TRAINING",
        ),
        (lambda f: None, ("other", "Spring"), 3, "There is no model other"),
        (lambda f: None, ("car", "Spring", "--times", "2"), 2, "--times needs --every"),
        (lambda f: None, ("car", "Spring", "--every", "5", "--no-wait"), 2, "waits for each"),
    ],
)
def test_what_cannot_be_submitted_is_refused(droa, fake, capsys, prepare, arguments, code, words):
    fake.add_model("car")
    fake.add_race("Spring")
    prepare(fake)

    assert droa("droa", "submit", *arguments) == code

    assert words in " ".join(capsys.readouterr().err.split())
    assert not any(fake.submissions.values())
