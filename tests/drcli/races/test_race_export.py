"""A race as a table and as a page."""

import csv
import re

import pytest

from drcli.races.organise import show_race
from drcli.races.race_export import COLUMNS, csv_of, videos_of
from drcli.races.race_page import race_page
from drcli.races.race_words import lap_time
from drcli.store import race_keys

from .conftest import RACE

EVIL = '"><script>alert(1)</script>'


@pytest.fixture
def report(home):
    home.race()
    home.laps = {"ann": [10.0, 12.5], "bob": [-4.0, -2.0]}
    home.submit("ann", EVIL)
    home.submit("bob", "=SUM(A1)")
    return home.run()


def test_the_table_has_a_row_for_each_racer_and_no_formula(report):
    rows = list(csv.DictReader(csv_of(report).splitlines()))

    assert tuple(rows[0]) == COLUMNS
    assert [row["racer"] for row in rows] == [EVIL, "'=SUM(A1)"]
    assert [(row["rank"], row["best_lap_s"]) for row in rows] == [("1", "10.0"), ("", "")]


def test_the_page_loads_nothing_runs_nothing_and_escapes_names(report):
    page = race_page(report, {})

    assert "<script" not in page
    assert page.count("&lt;script&gt;") >= 2
    assert "default-src 'none'" in page
    assert not re.search(r"(src|href)=\"(?!data:)|https?:|@import|url\(", page)
    assert "not qualified" in page
    assert "0:10.000" in page


def test_videos_are_part_of_the_page_or_named(home, report):
    key = race_keys.video(RACE, "x")
    home.bucket.put(key, b"film")
    from dataclasses import replace

    rows = [
        replace(row, video=key if row.rank == 1 else "races/cup/videos/gone.mp4")
        for row in report.leaderboard
    ]
    report = replace(report, leaderboard=rows)

    films = videos_of(report, home.bucket)
    page = race_page(report, films)

    assert films == {key: b"film"}
    assert 'src="data:video/mp4;base64,ZmlsbQ=="' in page
    assert "s3://bucket/races/cup/videos/gone.mp4" in page


def test_a_race_in_pairs_and_an_empty_one_have_pages_too(home):
    home.race(race_type="HEAD_TO_MODEL")
    assert "Nobody has driven yet." in race_page(show_race(home.bucket, RACE), {})
    home.submit("ann")
    home.submit("bob")

    page = race_page(home.run(), {})

    assert "nobody wins: 2 laps in 0:20.000, 2 laps in 0:20.000" in page


@pytest.mark.parametrize(
    ("seconds", "text"), [(None, "–"), (13.6, "0:13.600"), (59.9996, "1:00.000"), (125, "2:05.000")]
)
def test_times_are_written_as_the_consoles_write_them(seconds, text):
    assert lap_time(seconds) == text
