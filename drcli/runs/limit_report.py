"""How far an evaluation's best lap is from the track's limit, and where it loses time."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from drcli.base.errors import StorageError
from drcli.config.run_config import RunConfig
from drcli.exchange.trace_rows import read_rows
from drcli.exchange.track_limit import (
    LapRow,
    LostPlace,
    limit_of_race,
    limit_text,
    lost_places,
)
from drcli.runs.evaluation_report import EvaluationReport, TrialReport
from drcli.store.bucket import Bucket
from drcli.store.connect import open_bucket
from drcli.tracks.limit_store import StoredLimit


def with_limit(config: RunConfig, report: EvaluationReport) -> EvaluationReport:
    reverse = config.evaluation.eval_reverse_direction
    stored = limit_of_race(config.race(), reverse=reverse)
    text = limit_text(report.best_lap_s, stored)
    if stored is None or not text:
        return report
    places: list[LostPlace] = []
    with suppress(StorageError):  # the trace has the places only; the result stands without it
        bucket = open_bucket(config.storage)
        places = places_lost(bucket, report.simtrace, report.trials, stored)
    return replace(report, limit=text, lost=[str(place) for place in places])


def places_lost(
    bucket: Bucket, simtrace: str, trials: Sequence[TrialReport], line: StoredLimit
) -> list[LostPlace]:
    best = min((trial for trial in trials if trial.clean), key=lambda trial: trial.lap_s)
    # The laps of a continuous race begin where the first one did, which alone has its start.
    starts = (best.start_position, trials[0].start_position)
    start = next((start for start in starts if start is not None), None)
    if start is None:
        return []
    rows = read_rows(bucket.get(simtrace)).rows
    lap = [
        LapRow(row.progress, row.closest_waypoint)
        for row in rows
        if row.episode == best.trial - 1 and row.status != "pause"
    ]
    return lost_places(lap, start, line) if len(lap) > 1 else []
