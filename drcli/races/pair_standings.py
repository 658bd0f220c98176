"""State of a race in pairs. Pure functions."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

from drcli.races import pairings
from drcli.races import race_words as words
from drcli.races.lap_ranking import figures_of, milliseconds, sum_s
from drcli.races.race_report import LeaderboardRow, PairEntry, SubmissionState
from drcli.races.race_runs import Runner, cars_of, counted, row_of, run_state
from drcli.races.stored_race import StoredRace, submission_id


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
