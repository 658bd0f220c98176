"""Compares a race's best lap with the track's limit."""

from dataclasses import replace
from pathlib import Path

from drcli.config.value_types import USUAL_CAR
from drcli.exchange.track_limit import limit_of, limit_text
from drcli.races.race_report import RaceReport
from drcli.races.race_settings import shown_settings


def with_limit(report: RaceReport, tracks_folder: Path, directory: Path) -> RaceReport:
    rules = report.rules
    own_car = any(name.startswith("DR_CAR_") for name in shown_settings(rules))
    laps = [row.best_lap_s for row in report.leaderboard if row.best_lap_s is not None]
    if own_car or not laps:
        return report
    car = rules.settings.get("DR_SIM_CAR", USUAL_CAR)
    stored = limit_of(rules.world, tracks_folder, directory, reverse=rules.reverse, car=car)
    return replace(report, limit=limit_text(min(laps), stored))
