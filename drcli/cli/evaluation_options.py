"""Options of `dr evaluate` that change a setting."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from drcli.base.errors import BadValue, Place, ProblemsError, shown
from drcli.base.installation import lazy_imports
from drcli.cli.options import in_options
from drcli.config.fields import setting_problem

if TYPE_CHECKING:
    from drcli.config.settings import Settings

with lazy_imports():
    from drcli.config import settings as config_settings

OPTIONS = {
    "DR_EVAL_CHECKPOINT": "--checkpoint",
    "DR_EVAL_OPP_CHECKPOINT": "--opp-checkpoint",
    "DR_EVAL_START_OFFSET": "--start",
    "DR_EVAL_START_ANGLE": "--start-angle",
    "DR_EVAL_START_POSITION": "--start-position",
    "DR_EVAL_REVERSE_DIRECTION": "--reverse",
    "DR_EVAL_MAX_LAP_SECONDS": "--max-lap-seconds",
    "DR_EVAL_AVERAGE_LAPS": "--average-laps",
    "DR_EVAL_SAVE_MP4": "--video",
}
MOST_LAPS = 1000
"""Enough to tell 90 from 93 % clean."""

_PANEL = "How to drive"


def _option(name: str, metavar: str, text: str) -> Any:
    return typer.Option(name, metavar=metavar, help=text, rich_help_panel=_PANEL)


Start = Annotated[
    str | None,
    _option(
        "--start",
        "WHERE",
        "Start left, centre, right, or METRES to the left of the centre line.",
    ),
]
StartAngle = Annotated[
    str | None, _option("--start-angle", "DEG", "Turn the car to the left at its start.")
]
StartPosition = Annotated[
    str | None, _option("--start-position", "FRACTION", "Where on the lap to start, 0 to 1.")
]
Reverse = Annotated[
    bool | None,
    typer.Option(
        "--reverse/--no-reverse", help="Drive in the opposite direction.", rich_help_panel=_PANEL
    ),
]
MaxLapSeconds = Annotated[
    str | None, _option("--max-lap-seconds", "S", "Give a lap up after this simulated time.")
]
AverageLaps = Annotated[
    str | None, _option("--average-laps", "N", "Report the best average of N laps in a row.")
]


def _seed(text: str) -> Any:
    return typer.Option(
        "--seed", metavar="S", min=0, max=2**32 - 1, help=text, rich_help_panel=_PANEL
    )


Seed = Annotated[int | None, _seed("Seed, to repeat an evaluation exactly.")]
StartSeed = Annotated[
    int | None,
    _seed(
        "Seed of the starts of --laps, and of all that the settings draw, such as traffic and "
        "disturbances; trials of which nothing is drawn are the same with every seed."
    ),
]
Laps = Annotated[
    int | None,
    typer.Option(
        "--laps",
        metavar="N",
        min=1,
        max=MOST_LAPS,
        help="Drive N laps from fresh starts instead, each to its first violation.",
        rich_help_panel=_PANEL,
    ),
]
Against = Annotated[
    str | None,
    _option(
        "--against",
        "OTHER",
        "With --laps: compare with a CHECKPOINT of this model, the best one of a PREFIX, or "
        "PREFIX:CHECKPOINT.",
    ),
]


def with_options(settings: "Settings", **given: Any) -> "Settings":
    """The settings with those that an option has changed.

    Raises:
        typer.BadParameter: A value does not fit.
    """
    changes: dict[str, Any] = {}
    sources = dict(settings.sources)
    place = Place("flag")
    for name, value in given.items():
        if value is None:
            continue
        setting = config_settings.catalogue()[name]
        try:
            changes[setting.field] = setting.read(str(value))
        except BadValue as error:
            what = f"{name}={shown(str(value))} {error.reason}."
            problem = setting_problem(name, place, what, error.remedy)
            raise in_options(ProblemsError([problem]), OPTIONS, [name]) from None
        sources[name] = place
    return settings.replaced(**changes, sources=sources) if changes else settings


def listed(text: str | None) -> list[str]:
    return [word.strip() for word in (text or "").split(",") if word.strip()]
