"""`dr race`."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from drcli.base.errors import SettingsError
from drcli.base.files import refuse_replacing
from drcli.base.installation import lazy_imports
from drcli.bucket.connect import open_running_bucket
from drcli.cli import prompts, terminal
from drcli.cli.fetch_tracks import bring_tracks
from drcli.cli.options import (
    DryRun,
    Force,
    Replace,
    checkpoint_option,
    models_argument,
    prefix_option,
    world_option,
)
from drcli.cli.race_access import Closes, Race, found_race, open_races, print_race
from drcli.cli.show import drawn
from drcli.cli.show import show as present
from drcli.cli.working_folder import settings
from drcli.config.race_types import RACE_TYPES, RaceKind
from drcli.races.race_records import Pairing, Ranking
from drcli.races.race_report import RaceList
from drcli.races.race_settings import settings_of_rules
from drcli.races.stored_race import read_rules

with lazy_imports():
    from drcli.races import (
        organise,
        queue_process,
        race_export,
        race_options,
        race_queue,
        stored_race,
        submissions,
    )


app = typer.Typer(
    no_args_is_help=True,
    help="Race models of the bucket against each other, on a leaderboard or in pairs.\n\n"
    "Somebody makes a race, racers submit checkpoints, and `dr-race run` evaluates them one after "
    "the other. RACE is the id or the name of a race.\n\n"
    'Example: dr-race create "Friday Cup" --laps 3',
)


# Options of `dr race create`.


_WHO = "Who may submit"
_LAPS = "Laps"

World = Annotated[str | None, world_option("Race on this track instead of DR_WORLD_NAME.")]
Reverse = Annotated[bool, typer.Option("--reverse", help="Drive in the opposite direction.")]
RaceType = Annotated[
    RaceKind,
    typer.Option(
        "--type",
        metavar="TYPE",
        help=f"{', '.join(RACE_TYPES)}.",
        case_sensitive=False,
    ),
]
RankingOption = Annotated[
    Ranking, typer.Option("--rank", metavar="BY", help="best-lap, best-average or total-time.")
]
PairingOption = Annotated[
    Pairing, typer.Option("--pairs", metavar="HOW", help="In HEAD_TO_MODEL: round-robin, bracket.")
]
Laps = Annotated[
    int, typer.Option("--laps", metavar="N", help="Laps to drive.", rich_help_panel=_LAPS)
]
MinLaps = Annotated[
    int | None,
    typer.Option(
        "--min-laps", metavar="N", help="Complete laps to be ranked.", rich_help_panel=_LAPS
    ),
]
AverageLaps = Annotated[
    int | None,
    typer.Option(
        "--average-laps",
        metavar="N",
        help="Consecutive laps of the best average; 3 if there are so many.",
        rich_help_panel=_LAPS,
    ),
]
OffTrackPenalty = Annotated[
    float | None,
    typer.Option(
        "--off-track-penalty",
        metavar="S",
        help="Seconds for leaving the track (DR_EVAL_OFF_TRACK_PENALTY).",
        rich_help_panel=_LAPS,
    ),
]
CollisionPenalty = Annotated[
    float | None,
    typer.Option(
        "--collision-penalty",
        metavar="S",
        help="Seconds for a collision (DR_EVAL_COLLISION_PENALTY).",
        rich_help_panel=_LAPS,
    ),
]
Obstacles = Annotated[
    int | None,
    typer.Option(
        "--obstacles", metavar="N", min=0, help="Boxes of OBJECT_AVOIDANCE.", rich_help_panel=_LAPS
    ),
]
Bots = Annotated[
    int | None,
    typer.Option(
        "--bots", metavar="N", min=0, help="Bot cars of HEAD_TO_BOT.", rich_help_panel=_LAPS
    ),
]
Seed = Annotated[
    int | None,
    typer.Option(
        "--seed", metavar="S", help="Seed of all runs; drawn if empty.", rich_help_panel=_LAPS
    ),
]
MaxSubmissions = Annotated[
    int | None,
    typer.Option(
        "--max-submissions",
        metavar="N",
        help="Of each racer; 0 for any number. 1 in HEAD_TO_MODEL, else 0.",
        rich_help_panel=_WHO,
    ),
]
Sensor = Annotated[
    list[str] | None,
    typer.Option(
        "--sensor",
        metavar="NAME",
        help="Allow only this sensor. Can be given again.",
        rich_help_panel=_WHO,
    ),
]
Opens = Annotated[
    str | None,
    typer.Option(
        "--opens",
        metavar="WHEN",
        help="Take submissions from then on: a date in UTC, or 2h from now.",
        rich_help_panel=_WHO,
    ),
]


def object_settings(race_type: RaceKind, obstacles: int | None, bots: int | None) -> dict[str, str]:
    """Settings for the numbers of objects.

    Raises:
        typer.BadParameter: The race has no such objects.
    """
    try:
        return race_options.object_settings(race_type, obstacles, bots)
    except SettingsError as error:
        raise typer.BadParameter(str(error)) from None


# `dr race create` and `dr race edit`.


@app.command()
def create(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What the race is called.")],
    world: World = None,
    reverse: Reverse = False,
    race_type: RaceType = "TIME_TRIAL",
    ranking: RankingOption = "best-lap",
    pairing: PairingOption = "round-robin",
    laps: Laps = 3,
    min_laps: MinLaps = None,
    average_laps: AverageLaps = None,
    off_track_penalty: OffTrackPenalty = None,
    collision_penalty: CollisionPenalty = None,
    max_submissions: MaxSubmissions = None,
    obstacles: Obstacles = None,
    bots: Bots = None,
    sensor: Sensor = None,
    opens: Opens = None,
    closes: Closes = None,
    seed: Seed = None,
) -> None:
    """Make a race.

    What the options do not say comes from run.env now: track, penalties, objects, and the
    disturbances of DR_SIM_. Later changes there do not change the race.

    Example: dr-race create "Friday Cup" --world bean --rank best-average --closes 2h
    """
    now = time.time()
    objects = object_settings(race_type, obstacles, bots)
    wanted = race_options.RaceOptions(
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
        opens_at=None if opens is None else race_options.parse_time("--opens", opens, now),
        closes_at=None if closes is None else race_options.parse_time("--closes", closes, now),
        seed=seed,
        pairing=pairing,
        sensors=tuple(sensor or ()),
        settings=tuple(objects.items()),
    )
    loaded = settings()
    bring_tracks(settings_of_rules(loaded, race_options.rules_of(loaded, wanted, now)))
    report = organise.create_race(loaded, open_races(loaded), wanted, now_s=now)
    print_race(report)
    terminal.suggest(
        [
            (f"dr-race submit {report.race}", "submit the model of run.env"),
            (f"dr-race run {report.race}", "drive what was submitted"),
        ]
    )


@app.command()
def edit(
    race: Race,
    name: Annotated[str | None, typer.Option("--name", metavar="NAME", help="Call it so.")] = None,
    world: World = None,
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
    min_laps: MinLaps = None,
    average_laps: AverageLaps = None,
    off_track_penalty: OffTrackPenalty = None,
    collision_penalty: CollisionPenalty = None,
    max_submissions: MaxSubmissions = None,
    seed: Seed = None,
) -> None:
    """Change the rules of a race in which nobody has driven yet.

    What the options do not say stays. `dr-race open` and `dr-race close` change when it takes
    submissions.

    Example: dr-race edit friday-cup --laps 5 --rank best-average
    """
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
    wanted = replace(organise.options_of(read_rules(bucket, found)), **changes)
    print_race(organise.change_rules(loaded, bucket, found, wanted))


_Submission = Annotated[
    str, typer.Argument(metavar="SUBMISSION", help="Its id, or the beginning of it.")
]
_Video = Annotated[
    bool | None,
    typer.Option(
        "--video/--no-video", help="Film every run; without this option, if the encoder is there."
    ),
]


@app.command("list")
def list_all() -> None:
    """List the races of the bucket, the newest first.

    Example: dr-race list
    """
    loaded = settings()
    bucket = open_running_bucket(loaded.storage)
    found = RaceList(loaded.bucket, []) if bucket is None else organise.list_races(bucket)
    terminal.warn(*found.damaged)
    present(found)


@app.command()
def show(race: Race) -> None:
    """Show leaderboard, queue and submissions of a race.

    Example: dr-race show friday-cup
    """
    bucket, found = found_race(settings(), race)
    print_race(organise.show_race(bucket, found))


@app.command()
def submit(
    race: Race,
    model: Annotated[
        str | None,
        models_argument("MODEL", "Prefix of the model; that of run.env if left out."),
    ] = None,
    prefix: Annotated[str | None, prefix_option("Same as MODEL.")] = None,
    checkpoint: Annotated[str, checkpoint_option("Submit")] = "best",
    racer: Annotated[
        str | None, typer.Option("--racer", metavar="NAME", help="Your name (DR_RACER_NAME).")
    ] = None,
) -> None:
    """Submit a checkpoint of a model to a race.

    The race gets a copy: you can train on, or delete the model. Submits the best checkpoint unless
    --checkpoint chooses another.

    Example: dr-race submit friday-cup team/model-1 --racer Ann
    """
    if model and prefix:
        raise typer.BadParameter("MODEL and --prefix both name the model; use only one.")
    prefix = model or prefix
    loaded = settings()
    bucket, found = found_race(loaded, race)
    taken = submissions.submit(
        loaded, bucket, found, prefix=prefix, checkpoint=checkpoint, racer=racer
    )
    present(taken)
    if not taken.queue:
        terminal.suggest([(f"dr-race run {found}", "drive what was submitted")])


@app.command()
def withdraw(race: Race, submission: _Submission, force: Force = False) -> None:
    """Remove a submission, with all that it drove.

    Example: dr-race withdraw friday-cup 3f9a01c2
    """
    bucket, found = found_race(settings(), race)
    stored = stored_race.read_race(bucket, found)
    entry = stored.submissions[stored.find(submission)]
    question = f"Withdraw {entry.racer}'s {entry.model} and its laps? It cannot be undone."
    prompts.agree(question, yes=force)
    print_race(submissions.withdraw(bucket, found, submission))


@app.command()
def move(
    race: Race,
    submission: _Submission,
    place: Annotated[
        int, typer.Argument(metavar="PLACE", min=1, help="In the queue; 1 is driven next.")
    ],
) -> None:
    """Put a waiting submission at another place of the queue.

    Example: dr-race move friday-cup 3f9a01c2 1
    """
    bucket, found = found_race(settings(), race)
    print_race(submissions.move(bucket, found, submission, place))


@app.command()
def restart(race: Race, submission: _Submission) -> None:
    """Let a submission be driven again, such as one that has failed.

    Example: dr-race restart friday-cup 3f9a01c2
    """
    bucket, found = found_race(settings(), race)
    print_race(submissions.restart(bucket, found, submission))


@app.command()
def run(
    race: Race,
    quiet: Annotated[
        bool, typer.Option("-q", "--quiet", help="Drive in the background, and return at once.")
    ] = False,
    video: _Video = None,
    limit: Annotated[
        int, typer.Option("-n", "--limit", metavar="N", min=0, help="Only the next N; 0 for all.")
    ] = 0,
) -> None:
    """Drive what waits in the queue, and what is submitted meanwhile.

    Every run is an evaluation under the rules of the race, with a video beside the race. Only one
    process at a time drives a queue. If it is killed, run this again: what it was driving is driven
    again, the rest is kept.

    Example: dr-race run friday-cup
    """
    drive(race, quiet=quiet, video=video, limit=limit)


@app.command()
def stop(race: Race) -> None:
    """Stop the process on this machine that drives a queue.

    Example: dr-race stop friday-cup
    """
    bucket, found = found_race(settings(), race)
    present(queue_process.stop_queue(bucket, found))


@app.command("open")
def open_again(race: Race, closes: Closes = None) -> None:
    """Take submissions from now on.

    Example: dr-race open friday-cup --closes 1d
    """
    bucket, found = found_race(settings(), race)
    until = None if closes is None else race_options.parse_time("--closes", closes, time.time())
    print_race(organise.open_race(bucket, found, until))


@app.command()
def close(race: Race) -> None:
    """Take no more submissions; what waits is still driven, and then there is a winner.

    Example: dr-race close friday-cup
    """
    bucket, found = found_race(settings(), race)
    print_race(organise.close_race(bucket, found))


@app.command()
def export(
    race: Race,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Write the leaderboard as CSV.")
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE", help="Write a page; RACE.html without --csv."),
    ] = None,
    videos: Annotated[
        bool, typer.Option("--videos", help="Put the videos of the leaderboard into the page.")
    ] = False,
    force: Replace = False,
) -> None:
    """Write a race as a CSV table, or as one HTML file that needs no network.

    Example: dr-race export friday-cup --html cup.html --videos
    """
    for given in (csv, html):
        if given is not None:
            refuse_replacing(given, force=force)
    bucket, found = found_race(settings(), race)
    report = organise.show_race(bucket, found)
    page = Path(f"{found}.html") if html is None and csv is None else html
    if videos and page is None:
        raise typer.BadParameter("--videos puts videos into a page; add --html FILE.")
    if page is not None:
        refuse_replacing(page, force=force)
    films = race_export.videos_of(report, bucket) if videos else {}
    present(race_export.export_race(report, csv_path=csv, html_path=page, videos=films))


@app.command()
def delete(race: Race, force: Force = False, dry_run: DryRun = False) -> None:
    """Delete a race with submissions, results and videos; the models of the racers stay.

    Example: dr-race delete friday-cup
    """
    bucket, found = found_race(settings(), race)
    planned = organise.delete_race(bucket, found, dry_run=True)
    if not dry_run:
        terminal.err.print(drawn(planned))
        prompts.agree("Delete this race? It cannot be undone.", yes=force)
        planned = organise.delete_race(bucket, found)
    present(planned)


def drive(race: str, *, quiet: bool, video: bool | None, limit: int) -> None:
    """Drive a queue here, or in the background."""
    loaded = settings()
    terminal.say(f"Opening the queue of {race} ...")
    bucket, found = found_race(loaded, race)
    bring_tracks(race_queue.race_conditions(loaded, bucket, found))
    if quiet:
        if limit:
            raise typer.BadParameter("-n limits what is driven here; leave out -q.")
        present(queue_process.launch_queue(loaded, bucket, found, video=video))
        return
    told: list[str] = []

    def progress(text: str) -> None:
        told.append(text)
        terminal.say(text)

    report = race_queue.run_queue(
        loaded, bucket, found, video=video, limit=limit, on_progress=progress
    )
    print_race(report)
    if not told:
        terminal.say(f"Nothing waits in the queue of {found}.")
        terminal.suggest([(f"dr-race submit {found} MODEL", "submit a model")])
