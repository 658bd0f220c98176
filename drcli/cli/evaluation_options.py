"""Options of `dr evaluate` that change a setting for one evaluation, and how they are read."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from drcli.base.problems import BadValue, Place

if TYPE_CHECKING:
    from drcli.config.settings import Settings

PANEL = "How to drive"

Start = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="WHERE",
        help="Start left, centre, right, or METRES to the left of the centre line.",
        rich_help_panel=PANEL,
    ),
]
StartAngle = Annotated[
    str | None,
    typer.Option(
        "--start-angle",
        metavar="DEG",
        help="Turn the car to the left at its start.",
        rich_help_panel=PANEL,
    ),
]
StartPosition = Annotated[
    str | None,
    typer.Option(
        "--start-position",
        metavar="FRACTION",
        help="Where on the lap to start, 0 to 1.",
        rich_help_panel=PANEL,
    ),
]
Reverse = Annotated[
    bool | None,
    typer.Option(
        "--reverse/--no-reverse", help="Drive in the opposite direction.", rich_help_panel=PANEL
    ),
]
MaxLapSeconds = Annotated[
    str | None,
    typer.Option(
        "--max-lap-seconds",
        metavar="S",
        help="Give a lap up after this simulated time.",
        rich_help_panel=PANEL,
    ),
]
AverageLaps = Annotated[
    str | None,
    typer.Option(
        "--average-laps",
        metavar="N",
        help="Report the best average of N laps in a row.",
        rich_help_panel=PANEL,
    ),
]
Seed = Annotated[
    int | None,
    typer.Option(
        "--seed",
        metavar="S",
        min=0,
        max=2**32 - 1,
        help="Seed, to repeat an evaluation exactly.",
        rich_help_panel=PANEL,
    ),
]


def with_options(settings: "Settings", **given: Any) -> "Settings":
    """The settings with those that an option has changed, by DR_ name; None changes nothing.

    Raises:
        typer.BadParameter: A value does not fit.
    """
    from drcli.config.settings import catalogue

    changes: dict[str, Any] = {}
    sources = dict(settings.sources)
    for name, value in given.items():
        if value is None:
            continue
        setting = catalogue()[name]
        try:
            changes[setting.field] = setting.read(str(value))
        except BadValue as error:
            raise typer.BadParameter(f"{value} {error}. {error.remedy}") from None
        sources[name] = Place("flag")
    return settings.replaced(**changes, sources=sources) if changes else settings


def listed(text: str | None) -> list[str]:
    """The words of a list with commas."""
    return [word.strip() for word in (text or "").split(",") if word.strip()]
