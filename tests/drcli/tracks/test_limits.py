"""The shipped limits: no clean lap that was ever recorded here is faster."""

import json
from pathlib import Path

import pytest

from drcli.records.episode_metrics import decode_metrics
from drcli.tracks.limit_store import SHIPPED, SOLVER_VERSION, WITHIN, StoredLimit, read_limits
from drcli.tracks.track_limit import TrackLimit, limit_of

ROOT = Path(__file__).resolve().parents[3]
SHARED = ROOT.parent / "shared"
TRACKS = SHARED / "tracks"

DRIVEN_S = {
    "reinvent_base": 5.6,
    "reInvent2019_track": 6.6,
    "Spain_track": 17.6,
    "2022_summit_speedway": 7.1,
    "Monaco": 16.5,
    "2022_reinvent_champ_cw": 11.1,
}
"""Fastest laps of policies that were trained on the state of the simulation."""

CARDS = sorted((ROOT / "defaults" / "models").glob("*/card.json"))


def shipped(world: str, *, reverse: bool = False, car: str = "release-6") -> StoredLimit | None:
    return limit_of(world, TRACKS, ROOT / "no such folder", reverse=reverse, car=car)


def test_the_shipped_limits_are_small_and_of_this_version():
    limits = read_limits(SHIPPED)

    assert limits
    assert SHIPPED.stat().st_size < 1_000_000
    assert {limit.version for limit in limits.values()} == {SOLVER_VERSION}


def test_a_limit_was_driven_within_3_percent_and_never_beaten():
    for limit in read_limits(SHIPPED).values():
        shown = TrackLimit.of(limit)
        if shown.name == "the limit":
            assert limit.computed_s <= limit.driven_s <= WITHIN * limit.computed_s, limit.world
            assert limit.standing_s is None or limit.standing_s >= shown.lap_s, limit.world
        elif limit.driven_s is not None:
            assert shown.lap_s == limit.driven_s


@pytest.mark.skipif(not TRACKS.is_dir(), reason="no route files of the community in ../shared")
@pytest.mark.parametrize(("world", "lap_s"), DRIVEN_S.items())
def test_no_trained_policy_was_faster(world, lap_s):
    limit = shipped(world)

    assert limit is not None
    assert limit.validated
    assert TrackLimit.of(limit).lap_s <= lap_s


@pytest.mark.parametrize("card", CARDS, ids=lambda card: card.parent.name)
def test_no_ready_made_model_was_faster(card):
    compared = 0
    for driven in json.loads(card.read_text("utf-8"))["laps"]:
        limit = limit_of(driven["world"], ROOT, ROOT, reverse=driven["reverse"], car="release-6")
        if limit is not None:
            assert TrackLimit.of(limit).lap_s <= min(driven["lap_s"]), driven["world"]
            compared += 1

    assert compared


@pytest.mark.parametrize(
    ("run", "world", "car"),
    [
        ("drfc-time-trial/metrics", "reinvent_base", "2022"),
        ("simapp6-continuous", "reInvent2019_wide_cw", "release-6"),
    ],
)
def test_no_recorded_lap_of_the_reference_was_faster(run, world, car):
    file = SHARED / "reference-runs" / run / "TrainingMetrics.json"
    if not file.is_file():
        pytest.skip("no recorded trainings in ../shared")
    limit = shipped(world, car=car) or shipped(world)
    laps = [
        record.elapsed_time_in_milliseconds / 1000
        for record in decode_metrics(file.read_bytes())
        if record.completion_percentage >= 100
    ]

    assert limit is not None
    assert laps
    assert TrackLimit.of(limit).lap_s <= min(laps)
