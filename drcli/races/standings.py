"""What a stored race comes to. Pure functions."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import combinations

from drcli.races import pairings
from drcli.races import race_words as words
from drcli.races.lap_ranking import (
    LapFigures,
    RankingRule,
    best_of_each,
    figures_of,
    milliseconds,
    same_racer,
    sum_s,
)
from drcli.races.race_records import DrivenCar, RaceResult, RaceRules
from drcli.races.race_report import (
    LeaderboardRow,
    PairEntry,
    RaceReport,
    RaceState,
    SubmissionEntry,
    SubmissionState,
)
from drcli.races.stored_race import StoredRace, submission_id

# The runs of a race that count. Pure functions.


@dataclass(frozen=True)
class Runner:
    """Empty for nobody."""

    session: str = ""
    owner: str = ""


NOBODY = Runner()


def moment(at: float) -> str:
    return datetime.fromtimestamp(at, UTC).isoformat(timespec="seconds")


def date_text(at: float) -> str:
    """For people, in the time that options without a zone are in."""
    return f"{datetime.fromtimestamp(at, UTC):%d %b %Y, %H:%M} UTC"


def counted(stored: StoredRace) -> list[str]:
    """In queue order; the first ones if a racer has too many, as sent at the same time."""
    limit = stored.rules.max_submissions
    given: dict[str, int] = {}
    found = []
    for name, submission in sorted(stored.submissions.items()):
        racer = same_racer(submission.racer)
        given[racer] = given.get(racer, 0) + 1
        if not limit or given[racer] <= limit:
            found.append(name)
    return sorted(found, key=lambda name: (stored.place(name), name))


def run_state(result: RaceResult | None, runner: Runner) -> SubmissionState:
    if result is None:
        return "queued"
    if result.state == "running":
        return "running" if runner.session and result.session == runner.session else "queued"
    return "done" if result.state == "done" else "failed"


def ids_of(run: tuple[str, ...]) -> str:
    return "+".join(map(submission_id, run))


def cars_of(stored: StoredRace) -> dict[str, list[DrivenCar]]:
    found: dict[str, list[DrivenCar]] = {name: [] for name in counted(stored)}
    for name in sorted(stored.results):
        names = name.split("_")
        result = stored.result(*names)
        if result is None or result.state != "done" or not all(each in found for each in names):
            continue
        for car in result.cars:
            if car.submission in names:
                found[car.submission].append(car)
    return found


def row_of(stored: StoredRace, name: str, rank: int | None, figures: LapFigures) -> LeaderboardRow:
    submission = stored.submissions[name]
    return LeaderboardRow(
        rank=rank,
        racer=submission.racer,
        model=submission.model,
        checkpoint=submission.checkpoint,
        submission=submission_id(name),
        best_lap_s=figures.best_lap_s,
        best_average_s=figures.best_average_s,
        total_s=figures.total_s,
        complete_laps=figures.complete,
        laps=figures.driven,
        off_track=figures.off_track,
        crashes=figures.crashes,
        resets=figures.resets,
        clean_laps=figures.clean,
        best_lap_text=words.time_of(figures.best),
        best_average_text=words.time_of(figures.average, len(figures.average)),
        total_text=words.NONE,
        laps_text=words.laps_of(figures),
    )


# State of a race in pairs. Pure functions.


def meetings_of(stored: StoredRace) -> list[pairings.Meeting]:
    if stored.rules.pairing == "round-robin":
        return pairings.round_robin(counted(stored))
    return pairings.bracket(seeds_of(stored), judge_of(stored))


def seeds_of(stored: StoredRace) -> list[str | None]:
    """In the draw's order; None for those withdrawn since."""
    there = counted(stored)
    if stored.draw is None:
        return list(there)
    return [name if name in there else None for name in stored.draw.seeds]


def is_undecided(stored: StoredRace) -> bool:
    """A bracket waits for a failed pair."""
    if not stored.rules.in_pairs or stored.rules.pairing != "bracket":
        return False
    meetings = meetings_of(stored)
    return bool(meetings) and pairings.champion(meetings, judge_of(stored)) is None


def winners_of(stored: StoredRace) -> dict[str, str | None]:
    found: dict[str, str | None] = {}
    for one, other in combinations(sorted(counted(stored)), 2):
        result = stored.result(one, other)
        if result is None or result.state != "done" or len(result.cars) != 2:
            continue
        place = pairings.winner_of([car.laps for car in result.cars])
        found[pairings.pair_name(one, other)] = (
            None if place is None else result.cars[place].submission
        )
    return found


@dataclass(frozen=True)
class Judge:
    """Who goes on from a driven pair. Equal cars: the better seed."""

    winners: Mapping[str, str | None]
    seeds: list[str]

    def __call__(self, one: str, other: str) -> str | None:
        name = pairings.pair_name(one, other)
        if name not in self.winners:
            return None
        return self.winners[name] or min((one, other), key=self.seeds.index)


def judge_of(stored: StoredRace) -> "Judge":
    return Judge(winners_of(stored), [name for name in seeds_of(stored) if name is not None])


def pair_rows(stored: StoredRace) -> list[LeaderboardRow]:
    names, cars, winners = counted(stored), cars_of(stored), winners_of(stored)
    length = stored.rules.average_laps
    in_bracket = stored.rules.pairing == "bracket"
    rounds = (
        pairings.reached(meetings_of(stored), judge_of(stored))
        if in_bracket and stored.draw is not None
        else {}
    )
    found = []
    for each in pairings.tally(names, winners):
        laps = [lap for car in cars[each.name] for lap in car.laps]
        if not laps and rounds.get(each.name, 1) < 2:  # nobody raced it yet
            continue
        figures = figures_of(laps, length)
        averages = [figures_of(car.laps, length).average for car in cars[each.name]]
        average = min(filter(None, averages), key=sum_s, default=())
        row = replace(
            row_of(stored, each.name, 1, figures),
            best_average_s=sum_s(average) / length if average else None,
            best_average_text=words.time_of(average, length),
            points=each.points,
            wins=each.wins,
            draws=each.draws,
            losses=each.losses,
            round=rounds.get(each.name) if in_bracket else None,
            video=next((car.video for car in reversed(cars[each.name]) if car.video), ""),
        )
        violations = row.off_track + row.crashes
        quick = milliseconds(row.best_lap_s)
        key = (-(row.round or 0), -each.points, -row.complete_laps, quick, violations, each.name)
        found.append((key, row))
    found.sort(key=lambda pair: pair[0])
    return [replace(row, rank=rank) for rank, (_, row) in enumerate(found, start=1)]


def pair_entries(stored: StoredRace, runner: Runner) -> list[PairEntry]:
    found, winners = [], winners_of(stored)
    judge = judge_of(stored)
    for meeting in meetings_of(stored):
        first, second = meeting.first or "", meeting.second or ""
        entry = PairEntry(
            meeting.round,
            submission_id(first),
            submission_id(second),
            stored.submissions[first].racer if first else "",
            stored.submissions[second].racer if second else "",
            "waiting",
        )
        pair = meeting.pair
        if pair is None:
            alone = not meeting.waits
            found.append(
                replace(
                    entry,
                    state="alone" if alone else "waiting",
                    winner=submission_id(first or second) if alone else "",
                )
            )
            continue
        result = stored.result(*pair)
        state = run_state(result, runner)
        entry = replace(entry, state="failed" if state == "over the limit" else state)
        if result is not None and state == "failed":
            entry = replace(entry, message=result.message, remedy=result.remedy)
        if result is not None and state == "done":
            by_name = {car.submission: car for car in result.cars}
            won = winners.get(pairings.pair_name(*pair))
            if stored.rules.pairing == "bracket":
                won = judge(*pair)
            laps = [figures_of(by_name[name].laps, 1) for name in pair]
            times = [sum_s([lap for lap in by_name[n].laps if lap.complete]) for n in pair]
            texts = [words.laps_in_pair(by_name[name].laps) for name in pair]
            entry = replace(
                entry,
                winner=submission_id(won or ""),
                first_laps=laps[0].complete,
                second_laps=laps[1].complete,
                first_s=times[0] or None,
                second_s=times[1] or None,
                first_text=texts[0],
                second_text=texts[1],
                videos=[by_name[name].video for name in pair if by_name[name].video],
            )
        found.append(entry)
    return found


def pair_state(stored: StoredRace, name: str, runner: Runner) -> SubmissionState:
    """The least advanced state of its pairs."""
    pairs = [m.pair for m in meetings_of(stored) if m.pair is not None and name in m.pair]
    states = [run_state(stored.result(*pair), runner) for pair in pairs]
    for state in ("running", "failed", "queued"):
        if state in states:
            return state
    return "done" if states else "queued"


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
