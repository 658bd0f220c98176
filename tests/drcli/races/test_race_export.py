"""A race as a table and as a page."""

import csv
import io
import re

import pytest
from rich.console import Console

from drcli.cli.show import drawn
from drcli.model import race_keys
from drcli.races.organise import show_race
from drcli.races.race_export import COLUMNS, csv_of, race_page, videos_of
from drcli.races.race_records import DrivenLap
from drcli.races.race_words import lap_of, lap_time, laps_in_pair
from drcli.races.standings import NOBODY
from drcli.races.stored_race import read_race
from drcli.run.evaluation_report import TrialReport
from drcli.web.race_reader import moments_of
from home_races import COMPLETE

from .conftest import RACE

EVIL = '"><script>alert(1)</script>'


def screen(rendered):
    """What a terminal that is wide enough shows."""
    page = io.StringIO()
    Console(file=page, width=400, color_system=None).print(rendered)
    return page.getvalue()


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

    assert "nobody wins: 2 clean laps in 0:20.000, 2 clean laps in 0:20.000" in page


TOLD = "0:12.800 = 0:07.800 driven + 5.00 penalty, 1 reset"


@pytest.mark.parametrize("ranking", ["best-lap", "best-average", "total-time"])
def test_no_place_shows_a_lap_with_a_reset_as_if_it_were_clean(home, ranking):
    home.race(ranking=ranking, average_laps=2)
    reset = TrialReport(1, 100.0, 12.8, COMPLETE, 1, 0, 1, penalty_s=5.0)
    home.laps = {"ann": [reset, reset], "bob": [10.0, reset]}
    home.submit("ann")
    home.submit("bob")

    report = home.run()
    shown = {row.racer: row for row in report.leaderboard}
    moments = moments_of(read_race(home.bucket, RACE), NOBODY)
    table = screen(drawn(report))
    page = race_page(report, {})

    ann, bob = shown["Ann"], shown["Bob"]
    assert (ann.complete_laps, ann.clean_laps, bob.clean_laps) == (2, 0, 1)
    assert ann.laps_text == "0 of 2 clean, 2 finished, 2 resets"
    assert bob.laps_text == "1 of 2 clean, 2 finished, 1 reset"
    assert (ann.best_lap_text, bob.best_lap_text) == (TOLD, "0:10.000")
    assert ann.total_text == "0:25.600 = 0:15.600 driven + 10.00 penalty, 2 resets"
    decides = {
        "best-lap": TOLD,
        "best-average": TOLD.replace("1 reset", "2 resets"),
        "total-time": ann.total_text,
    }
    assert ann.score_text == decides[ranking]
    assert moments.last.cars[0].text == f"{bob.laps_text}, best 0:10.000"
    assert f"{TOLD}; {TOLD}" in page
    for text in (ann.laps_text, bob.laps_text, ann.score_text):
        assert text in page
        assert text in table


def test_laps_of_races_of_version_0_1_0_tell_their_resets_without_penalties():
    laps = [DrivenLap(12.8, 100.0, COMPLETE, 1, 0, 1), DrivenLap(8.0, 100.0, COMPLETE)]

    assert [lap_of(lap) for lap in laps] == ["0:12.800, 1 reset", "0:08.000"]
    assert laps_in_pair(laps) == "2 laps (1 clean) in 0:20.800, 1 reset"
    assert lap_of(DrivenLap(3.0, 40.0, "Off track", 1)) == "0:03.000, off track"


@pytest.mark.parametrize(
    ("seconds", "text"), [(None, "–"), (13.6, "0:13.600"), (59.9996, "1:00.000"), (125, "2:05.000")]
)
def test_times_are_written_as_the_consoles_write_them(seconds, text):
    assert lap_time(seconds) == text
