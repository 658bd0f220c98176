"""Making, opening, closing and deleting races, and what is refused."""

import pytest

from drcli.base.errors import SettingsError, StorageError
from drcli.base.json_record import RecordError
from drcli.model import race_keys
from drcli.races.organise import (
    close_race,
    create_race,
    delete_race,
    list_races,
    only_tournament,
    open_race,
    show_race,
)
from drcli.races.race_options import RaceOptions, rules_of
from drcli.races.race_records import RaceRules
from drcli.races.race_settings import settings_of_rules, shown_settings
from drcli.races.stored_race import find_race

from .conftest import RACE


def test_a_race_takes_what_its_options_do_not_say_from_the_settings_once(home):
    run_env = home.folder / "run.env"
    run_env.write_text(
        run_env.read_text() + "DR_EVAL_OFF_TRACK_PENALTY=2\nDR_SIM_LATENCY=0.05\n"
        "DR_EVAL_START_POSITION=0.5\nDR_EVAL_MAX_LAP_SECONDS=90\n"
        "DR_EVAL_MAX_MINUTES=30\n"
    )
    report = create_race(home.settings, home.bucket, RaceOptions(" Friday   Cup ", max_laps=5))
    run_env.write_text("DR_WORLD_NAME=willow\n")

    rules = show_race(home.bucket, report.race).rules
    driven = settings_of_rules(home.settings, rules)

    assert (report.race, rules.name) == ("friday-cup", "Friday Cup")
    assert (rules.world, rules.min_laps, rules.average_laps) == ("bean", 1, 3)
    assert (driven.world_name, driven.eval_number_of_trials) == ("bean", 5)
    assert (driven.eval_off_track_penalty, driven.sim_latency) == (2.0, 0.05)
    assert (driven.eval_start_position, driven.eval_max_lap_seconds) == (0.5, 90.0)
    assert driven.eval_max_minutes == 30.0
    assert shown_settings(rules) == {
        "DR_EVAL_MAX_LAP_SECONDS": "90.0",
        "DR_EVAL_MAX_MINUTES": "30.0",
        "DR_EVAL_START_POSITION": "0.5",
        "DR_SIM_LATENCY": "0.05",
    }


def test_objects_are_frozen_for_races_that_have_them(home):
    objects = {"OBJECT_AVOIDANCE": "DR_OA_", "HEAD_TO_BOT": "DR_H2B_", "TIME_TRIAL": "none"}
    for kind, start in objects.items():
        rules = rules_of(home.settings, RaceOptions(kind, race_type=kind), 0.0)

        frozen = {name.split("_")[1] for name in rules.settings} & {"OA", "H2B"}
        assert frozen == {start.split("_")[1]} if "_" in start else not frozen


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"name": " "}, "The name of the race, ' ', is empty"),
        ({"name": "x" * 65}, "is too long"),
        ({"name": "a\x1bb"}, "has characters that cannot be shown"),
        ({"world": "nowhere"}, "DR_WORLD_NAME=nowhere is not a known track"),
        ({"world": "../../etc/passwd"}, "is not a known track"),
        ({"max_laps": 0}, "--laps 0 is not from 1 to 100"),
        ({"min_laps": 4}, "--min-laps 4 is not from 1 to 3"),
        ({"average_laps": 9}, "--average-laps 9 is not from 1 to 3"),
        ({"ranking": "best-average", "min_laps": 1}, "less than the 3 laps in a row"),
        ({"ranking": "total-time", "min_laps": 2}, "needs all 3 laps"),
        ({"off_track_penalty_s": -1.0}, "--off-track-penalty -1 is not from 0"),
        ({"collision_penalty_s": float("nan")}, "--collision-penalty nan is not from 0"),
        ({"max_submissions": -1}, "--max-submissions -1"),
        ({"closes_at": 5.0}, "would close at 01 Jan 1970, 00:00 UTC"),
        ({"opens_at": 90.0, "closes_at": 80.0}, "before it opens"),
        ({"sensors": ("EYES",)}, "--sensor EYES is not a sensor"),
        ({"seed": -1}, "--seed -1"),
        (
            {
                "race_type": "OBJECT_AVOIDANCE",
                "settings": (("DR_OA_NUMBER_OF_OBSTACLES", "30"),),
            },
            "30 objects at least 2 m apart are too many for bean",
        ),
        ({"settings": (("DR_OA_NUMBER_OF_OBSTACLES", "many"),)}, "DR_OA_NUMBER_OF_OBSTACLES=many"),
    ],
)
def test_wrong_rules_are_refused_in_a_sentence_and_nothing_is_written(home, options, why):
    with pytest.raises(SettingsError) as refused:
        create_race(
            home.settings, home.bucket, RaceOptions(**{"name": "Cup", **options}), now_s=10.0
        )

    assert why in str(refused.value)
    assert refused.value.remedy
    assert home.bucket.list(race_keys.folder()) == []


def test_rules_that_were_changed_by_hand_are_refused_when_they_are_read():
    rules = RaceRules("Cup", 1.0, "bean")
    assert RaceRules.decode(rules.encode()) == rules

    for old, new in (("3,", "0,"), ('"Cup"', '" "'), ("5.0", "-1"), ("best-lap", "luck")):
        with pytest.raises(RecordError):
            RaceRules.decode(rules.encode().replace(old.encode(), new.encode()))


def test_a_race_is_found_by_id_and_by_name(home):
    home.race()
    named = create_race(home.settings, home.bucket, RaceOptions("Гонка")).race

    assert find_race(home.bucket, "cup") == find_race(home.bucket, " CUP ") == RACE
    assert find_race(home.bucket, "Гонка") == named
    for unknown in ("cap", "../cup", "", "cup/../../x"):
        with pytest.raises(SettingsError, match="There is no race"):
            find_race(home.bucket, unknown)
        with pytest.raises(SettingsError, match="There is no race"):
            show_race(home.bucket, unknown)


def test_the_same_name_twice_is_refused(home):
    home.race()

    with pytest.raises(SettingsError, match="There is a race cup in s3://bucket already"):
        home.race()


def test_open_close_and_the_times_between(home):
    home.race(opens_at=100.0, closes_at=200.0)

    states = [show_race(home.bucket, RACE, now_s=now).state for now in (99, 100, 199, 200)]
    assert states == ["scheduled", "open", "open", "finished"]
    assert open_race(home.bucket, RACE, 300.0, now_s=250.0).state == "open"
    assert close_race(home.bucket, RACE, now_s=260.0).state == "finished"
    with pytest.raises(SettingsError, match="was closed at 01 Jan 1970, 00:04 UTC"):
        close_race(home.bucket, RACE, now_s=270.0)
    with pytest.raises(SettingsError, match="which has passed"):
        open_race(home.bucket, RACE, 1.0, now_s=270.0)
    assert show_race(home.bucket, RACE, now_s=270.0).rules.changes == 2


def test_a_deleted_race_leaves_nothing_but_the_models(home):
    home.race()
    home.submit("ann")
    home.run()
    models = {info.key for info in home.bucket.list("ann/")}

    assert delete_race(home.bucket, RACE, dry_run=True).objects > 5
    assert show_race(home.bucket, RACE).leaderboard
    delete_race(home.bucket, RACE)

    assert home.bucket.list(race_keys.folder()) == []
    assert {info.key for info in home.bucket.list("ann/")} == models
    with pytest.raises(SettingsError, match="There is no race cup"):
        delete_race(home.bucket, RACE)


def test_the_list_shows_the_leader_and_survives_damage(home):
    home.race()
    home.submit("ann")
    home.run()
    home.bucket.put(race_keys.rules("old"), b"{")

    found = list_races(home.bucket)

    (entry,) = found.races
    assert (entry.race, entry.leader, entry.leader_s, entry.queued) == (RACE, "Ann", 10.0, 0)
    assert "races/old/race.json is damaged" in found.damaged[0]


def test_rules_of_a_newer_version_are_left_alone(home):
    home.race()
    key = race_keys.rules(RACE)
    home.bucket.put(key, home.bucket.get(key).replace(b"{", b'{"format": 9, ', 1))

    with pytest.raises(StorageError, match="newer version"):
        show_race(home.bucket, RACE)


def test_a_tournament_without_a_name_is_the_only_race_in_pairs(home):
    with pytest.raises(SettingsError, match="no race in pairs"):
        only_tournament(home.bucket)
    home.race()
    create_race(home.settings, home.bucket, RaceOptions("Duel", race_type="HEAD_TO_MODEL"))
    assert only_tournament(home.bucket) == "duel"
    create_race(home.settings, home.bucket, RaceOptions("Duel 2", race_type="HEAD_TO_MODEL"))

    with pytest.raises(SettingsError, match="several races in pairs: duel"):
        only_tournament(home.bucket)
