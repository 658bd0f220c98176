"""`dr race create` and `dr race edit`."""

from typing import Annotated, Any

import typer

from drcli.cli import console
from drcli.cli import race_options as rules
from drcli.cli.options import AsJson
from drcli.cli.race_access import Closes, Race, found_race, open_races, print_race
from drcli.cli.working_folder import settings
from drcli.exchange.race_rules import Pairing, Ranking


def create(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What the race is called.")],
    world: rules.World = None,
    reverse: rules.Reverse = False,
    race_type: rules.RaceType = "TIME_TRIAL",
    ranking: rules.RankingOption = "best-lap",
    pairing: rules.PairingOption = "round-robin",
    laps: rules.Laps = 3,
    min_laps: rules.MinLaps = None,
    average_laps: rules.AverageLaps = None,
    off_track_penalty: rules.OffTrackPenalty = None,
    collision_penalty: rules.CollisionPenalty = None,
    max_submissions: rules.MaxSubmissions = None,
    obstacles: rules.Obstacles = None,
    bots: rules.Bots = None,
    sensor: rules.Sensor = None,
    opens: rules.Opens = None,
    closes: Closes = None,
    seed: rules.Seed = None,
    as_json: AsJson = False,
) -> None:
    """Make a race.

    What the options do not say comes from run.env now: track, penalties, objects, and the
    disturbances of DR_SIM_. Later changes there do not change the race.

    Example: dr-race create "Friday Cup" --world bean --rank best-average --closes 2h
    """
    import time

    from drcli.cli.fetch_tracks import bring_tracks
    from drcli.races.organise import create_race
    from drcli.races.race_settings import settings_of_rules
    from drcli.races.race_times import parse_time
    from drcli.races.race_wish import RaceWish, rules_of

    now = time.time()
    objects = rules.object_settings(race_type, obstacles, bots)
    wish = RaceWish(
        name=name,
        world=world,
        reverse=reverse,
        race_type=race_type,
        ranking=ranking,
        max_laps=laps,
        min_laps=min_laps,
        average_laps=average_laps,
        off_track_penalty_s=off_track_penalty,
        collision_penalty_s=collision_penalty,
        max_submissions=max_submissions,
        opens_at=None if opens is None else parse_time("--opens", opens, now),
        closes_at=None if closes is None else parse_time("--closes", closes, now),
        seed=seed,
        pairing=pairing,
        sensors=tuple(sensor or ()),
        settings=tuple(objects.items()),
    )
    loaded = settings()
    bring_tracks(settings_of_rules(loaded, rules_of(loaded, wish, now)))
    report = create_race(loaded, open_races(loaded), wish, now_s=now)
    print_race(report, as_json=as_json)
    console.suggest(
        [
            (f"dr-race submit {report.race}", "submit the model of run.env"),
            (f"dr-race run {report.race}", "drive what was submitted"),
        ]
    )


def edit(
    race: Race,
    name: Annotated[str | None, typer.Option("--name", metavar="NAME", help="Call it so.")] = None,
    world: rules.World = None,
    reverse: Annotated[
        bool | None, typer.Option("--reverse/--forwards", help="Direction of the laps.")
    ] = None,
    ranking: Annotated[
        Ranking | None,
        typer.Option("--rank", metavar="BY", help="best-lap, best-average or total-time."),
    ] = None,
    pairing: Annotated[
        Pairing | None,
        typer.Option("--pairs", metavar="HOW", help="In HEAD_TO_MODEL: round-robin, bracket."),
    ] = None,
    laps: Annotated[int | None, typer.Option("--laps", metavar="N", help="Laps to drive.")] = None,
    min_laps: rules.MinLaps = None,
    average_laps: rules.AverageLaps = None,
    off_track_penalty: rules.OffTrackPenalty = None,
    collision_penalty: rules.CollisionPenalty = None,
    max_submissions: rules.MaxSubmissions = None,
    seed: rules.Seed = None,
    as_json: AsJson = False,
) -> None:
    """Change the rules of a race in which nobody has driven yet.

    What the options do not say stays. `dr-race open` and `dr-race close` change when it takes
    submissions.

    Example: dr-race edit friday-cup --laps 5 --rank best-average
    """
    from dataclasses import replace

    from drcli.races.rules_change import change_rules, wish_of
    from drcli.races.stored_race import read_rules

    given = {
        "name": name,
        "world": world,
        "reverse": reverse,
        "ranking": ranking,
        "pairing": pairing,
        "max_laps": laps,
        "min_laps": min_laps,
        "average_laps": average_laps,
        "off_track_penalty_s": off_track_penalty,
        "collision_penalty_s": collision_penalty,
        "max_submissions": max_submissions,
        "seed": seed,
    }
    changes: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
    if not changes:
        raise typer.BadParameter("Say what to change, such as --laps 5.")
    loaded = settings()
    bucket, found = found_race(loaded, race)
    wish = replace(wish_of(read_rules(bucket, found)), **changes)
    print_race(change_rules(loaded, bucket, found, wish), as_json=as_json)
