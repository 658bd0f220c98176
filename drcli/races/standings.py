"""What a stored race comes to. Pure functions."""

from dataclasses import replace

from drcli.exchange.race_rules import RaceRules
from drcli.races import race_words as words
from drcli.races.lap_ranking import RankingRule, best_of_each, figures_of
from drcli.races.pair_standings import (
    is_undecided,
    meetings_of,
    pair_entries,
    pair_rows,
    pair_state,
)
from drcli.races.race_report import LeaderboardRow, RaceReport, RaceState, SubmissionEntry
from drcli.races.race_runs import (
    NOBODY,
    Runner,
    cars_of,
    counted,
    ids_of,
    moment,
    row_of,
    run_state,
)
from drcli.races.stored_race import StoredRace, submission_id


def queue_of(stored: StoredRace, runner: Runner = NOBODY) -> list[tuple[str, ...]]:
    """Submissions or pairs in order, also those that a killed process began."""
    if not stored.rules.in_pairs:
        runs: list[tuple[str, ...]] = [(name,) for name in counted(stored)]
    else:
        found = (meeting.pair for meeting in meetings_of(stored))
        runs = [pair for pair in found if pair is not None]
    return [run for run in runs if run_state(stored.result(*run), runner) == "queued"]


def report_of(stored: StoredRace, bucket: str, now_s: float, runner: Runner = NOBODY) -> RaceReport:
    queue = queue_of(stored, runner)
    rows = pair_rows(stored) if stored.rules.in_pairs else _lap_rows(stored)
    running = [
        name
        for name, result in stored.results.items()
        if run_state(result, runner) == "running" and stored.result(*name.split("_")) is not None
    ]
    state = state_of(stored.rules, now_s)
    first = rows[0] if rows and rows[0].rank == 1 else None
    unfinished = queue or running or is_undecided(stored)
    if state == "closed" and not unfinished:
        state = "finished"
    return RaceReport(
        bucket=bucket,
        race=stored.race,
        state=state,
        rules=stored.rules,
        leaderboard=rows,
        queue=[ids_of(run) for run in queue],
        running=ids_of(tuple(running[0].split("_"))) if running else "",
        runner=runner.owner,
        submissions=_entries(stored, queue, runner),
        pairs=pair_entries(stored, runner) if stored.rules.in_pairs else [],
        winner=first.racer if state == "finished" and first is not None else None,
        damaged=list(stored.damaged),
    )


def state_of(rules: RaceRules, now_s: float) -> RaceState:
    if rules.closes_at is not None and now_s >= rules.closes_at:
        return "closed"
    if rules.opens_at is not None and now_s < rules.opens_at:
        return "scheduled"
    return "open"


def rule_of(rules: RaceRules) -> RankingRule:
    return RankingRule(rules.ranking, rules.min_laps, rules.max_laps)


def _lap_rows(stored: StoredRace) -> list[LeaderboardRow]:
    cars = {name: driven[0] for name, driven in cars_of(stored).items() if driven}
    length = stored.rules.average_laps
    figures = {name: figures_of(car.laps, length) for name, car in cars.items()}
    racers = {name: stored.submissions[name].racer for name in figures}
    found = []
    for place in best_of_each(figures, racers, rule_of(stored.rules)):
        row = row_of(stored, place.name, place.rank, figures[place.name])
        if row.total_s is not None:
            row = replace(row, total_text=words.time_of(cars[place.name].laps))
        decides = {
            "best-lap": row.best_lap_text,
            "best-average": row.best_average_text,
            "total-time": row.total_text,
        }
        row = replace(
            row,
            score_s=place.score_s,
            score_text=words.NONE if place.score_s is None else decides[stored.rules.ranking],
            gap_s=place.gap_s,
            video=cars[place.name].video,
        )
        found.append(row)
    return found


def _entries(
    stored: StoredRace, queue: list[tuple[str, ...]], runner: Runner
) -> list[SubmissionEntry]:
    there = set(counted(stored))
    waiting = {run[0]: number for number, run in enumerate(queue, start=1) if len(run) == 1}
    found = []
    for name, submission in sorted(stored.submissions.items()):
        entry = SubmissionEntry(
            submission=submission_id(name),
            racer=submission.racer,
            model=submission.model,
            checkpoint=submission.checkpoint,
            submitted_at=moment(submission.submitted_at),
            state="over the limit",
        )
        if name not in there:
            found.append(entry)
            continue
        if stored.rules.in_pairs:
            found.append(replace(entry, state=pair_state(stored, name, runner)))
            continue
        result = stored.result(name)
        entry = replace(entry, state=run_state(result, runner), place=waiting.get(name))
        if result is not None and entry.state in ("done", "failed"):
            entry = replace(
                entry, message=result.message, remedy=result.remedy, notes=list(result.notes)
            )
        if result is not None and entry.state == "done":
            car = result.cars[0]
            entry = replace(
                entry,
                lap_s=[lap.lap_s for lap in car.laps],
                lap_status=[lap.status for lap in car.laps],
                lap_text=[words.lap_of(lap) for lap in car.laps],
                simtrace=car.simtrace,
                metrics=car.metrics,
                video=car.video,
            )
        found.append(entry)
    return found
