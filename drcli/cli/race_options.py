"""Options of `dr race create`."""

from typing import Annotated

import typer

from drcli.cli.options import world_option
from drcli.exchange.race_rules import Pairing, RaceKind, Ranking

_WHO = "Who may submit"
_LAPS = "Laps"

World = Annotated[str | None, world_option("Race on this track instead of DR_WORLD_NAME.")]
Reverse = Annotated[bool, typer.Option("--reverse", help="Drive in the opposite direction.")]
RaceType = Annotated[
    RaceKind,
    typer.Option(
        "--type",
        metavar="TYPE",
        help="TIME_TRIAL, OBJECT_AVOIDANCE, HEAD_TO_BOT, HEAD_TO_MODEL.",
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
    from drcli.base.errors import SettingsError
    from drcli.races import race_wish

    try:
        return race_wish.object_settings(race_type, obstacles, bots)
    except SettingsError as error:
        raise typer.BadParameter(str(error)) from None
