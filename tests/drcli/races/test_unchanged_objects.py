"""Looking at races again and again costs one listing as long as nothing changes."""

import pytest

from drcli.bucket.bucket import ObjectMissing
from drcli.model import race_keys
from drcli.races.organise import list_races, show_race
from drcli.races.standings import NOBODY, Runner
from drcli.races.stored_race import RaceObjects, read_race
from drcli.web.race_reader import moments_of

from .conftest import RACE


@pytest.fixture
def asked(home, monkeypatch):
    """What is asked of the bucket, in order."""
    found = []
    for name in ("get", "get_with_age", "list"):
        ask = getattr(home.bucket, name)
        monkeypatch.setattr(
            home.bucket, name, lambda key, n=name, f=ask: (found.append((n, key)), f(key))[1]
        )
    return found


def test_a_second_list_reads_only_what_has_changed(home, asked):
    home.race()
    for name in ("ann", "bob"):
        home.submit(name)
    home.run()
    objects = RaceObjects()
    first = list_races(home.bucket, objects=objects, now_s=5.0)
    asked.clear()

    assert list_races(home.bucket, objects=objects, now_s=5.0) == first
    assert asked == [("list", "races/")]

    home.submit("cem")
    asked.clear()
    found = list_races(home.bucket, objects=objects, now_s=5.0)
    assert found.races[0].submissions == 3
    assert [name for name, _ in asked] == ["list", "get_with_age"]


def test_a_race_that_is_gone_is_forgotten_and_one_of_the_same_name_is_new(home):
    home.race()
    objects = RaceObjects()
    assert list_races(home.bucket, objects=objects).races[0].world == "bean"
    home.bucket.delete([info.key for info in home.bucket.list("races/")])
    assert not list_races(home.bucket, objects=objects).races
    home.race(reverse=True)
    seen = objects.look(home.bucket, race_keys.folder(RACE))
    assert show_race(seen, RACE).rules.reverse


def test_what_looked_damaged_is_read_anew(home):
    home.race()
    key = race_keys.rules(RACE)
    objects = RaceObjects()
    good = home.bucket.get(key)
    home.bucket.put(key, b"{" + good[1:-1] + b" ")  # as it looks while it is overwritten
    look = objects.look(home.bucket, race_keys.folder(RACE))
    look.get(key)
    home.bucket.put(key, good)
    assert look.get(key) == good


def test_ages_grow_and_other_objects_are_read_through(home, monkeypatch):
    home.race()
    home.bucket.put(race_keys.lease(RACE), b"{}")
    objects = RaceObjects()
    ages = []
    for now in (10.0, 25.0):
        monkeypatch.setattr("drcli.races.stored_race.time.monotonic", lambda now=now: now)
        seen = objects.look(home.bucket, race_keys.folder(RACE))
        ages.append(seen.get_with_age(race_keys.lease(RACE))[1])
    assert ages[1] - ages[0] == pytest.approx(15.0, abs=1.0)
    assert seen.exists("ann/model/model_metadata.json")
    assert seen.list("ann/")
    with pytest.raises(ObjectMissing):
        seen.get(race_keys.draw(RACE))


def test_moments_are_the_run_that_drives_and_the_one_that_ended_last(home):
    home.race()
    for name in ("ann", "bob"):
        home.submit(name)
    seen = []

    def look(_):
        stored = read_race(home.bucket, RACE)
        session = next(iter(stored.results.values())).session
        seen.append((moments_of(stored, Runner(session)), moments_of(stored, NOBODY)))

    home.before = look
    home.laps = {"ann": [9.0, -3.0]}
    home.run()
    after = moments_of(read_race(home.bucket, RACE), NOBODY)

    (first, _), (second, orphan) = seen
    assert (first.driving.cars[0].racer, first.last) == ("Ann", None)
    assert (second.driving.cars[0].racer, second.last.cars[0].racer) == ("Bob", "Ann")
    assert orphan.driving is None  # its process was killed
    ann = second.last.cars[0]
    assert (ann.complete, ann.laps, ann.best_lap_s, ann.total_s) == (1, 2, 9.0, 9.0)
    assert (after.driving, after.last.cars[0].racer) == (None, "Bob")
