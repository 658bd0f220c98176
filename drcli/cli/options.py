"""Options that several commands share."""

import re
from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal

import typer

from drcli.base.problems import ProblemsError
from drcli.cli import candidates


def _not_a_digit(delimiter: str | None) -> str | None:
    """Refuse a delimiter that ends in a digit, which would look like part of the number."""
    if delimiter is not None and (not delimiter or delimiter[-1].isdigit()):
        raise typer.BadParameter("-d must end in a character that is not a digit, such as - or _.")
    return delimiter


AsJson = Annotated[
    bool, typer.Option("--json", help="Print a JSON object as the last line of stdout.")
]
Force = Annotated[bool, typer.Option("-f", "--force", "--yes", help="Do not ask; answer yes.")]
DryRun = Annotated[bool, typer.Option("-d", "--dry-run", help="Only print what would be done.")]
Keep = Annotated[
    str | None,
    typer.Option(
        "--keep",
        metavar="RULES",
        help="Keep only these there, such as last-3,best,every-50 (DR_UPLOAD_KEEP).",
    ),
]
MaxMb = Annotated[
    int | None,
    typer.Option(
        "--max-mb",
        metavar="MB",
        min=0,
        help="Delete the oldest there beyond this size (DR_UPLOAD_MAX_MB).",
    ),
]
CustomFiles = Annotated[
    bool, typer.Option("-c", "--custom-files", help="Also copy its three files to custom_files/.")
]
World = Annotated[
    str | None,
    typer.Option(
        "--world",
        metavar="TRACK",
        help="Name this track instead of the model's.",
        autocompletion=candidates.worlds,
    ),
]
Delimiter = Annotated[
    str | None,
    typer.Option(
        "-d",
        "--delimiter",
        metavar="TEXT",
        help="Put before the number, such as - or _.",
        callback=_not_a_digit,
    ),
]


def wipe_option(text: str) -> Any:
    """The option -w with this help."""
    return typer.Option("-w", "--wipe", help=text)


def prefix_option(text: str, *names: str) -> Any:
    """An option, -p if not named otherwise, that takes the prefix of a model."""
    names = names or ("-p", "--prefix")
    complete = candidates.model_prefixes
    return typer.Option(*names, metavar="PREFIX", help=text, autocompletion=complete)


def best_option(verb: str) -> Any:
    """An option that chooses the best checkpoint; `verb` says what the command does with it."""
    return typer.Option("-b", "--best", help=f"{verb} the best checkpoint.")


def checkpoint_option(verb: str) -> Any:
    """An option that chooses a checkpoint by its number."""
    return typer.Option(
        "-c",
        "--checkpoint",
        metavar="N",
        min=0,
        help=f"{verb} checkpoint N.",
        autocompletion=candidates.checkpoints,
    )


def checkpoint_choice(best: bool, number: int | None) -> Literal["best", "last"] | int:
    """The checkpoint that -b or -c chooses: the last one without them.

    Raises:
        BadParameter: Both are given.
    """
    if best and number is not None:
        raise typer.BadParameter("-b and -c both choose a checkpoint; use only one.")
    if number is not None:
        return number
    return "best" if best else "last"


def in_options(
    error: ProblemsError, options: Mapping[str, str], given: Collection[str]
) -> Exception:
    """The error with options instead of settings, if a setting that was given caused it.

    Args:
        error: What is wrong with settings.
        options: The option for each DR_ name.
        given: DR_ names whose values came from the command line.
    """

    def option(match: "re.Match[str]") -> str:
        if match[1] is None:  # a command
            return match[0]
        return options[match[1]] + (" " if match[2] else "")

    ours = [f"{item.message} {item.remedy}" for item in error.errors if item.key in given]
    pattern = rf"`[^`]*`|\b({'|'.join(options)})\b(=?)"
    return typer.BadParameter(re.sub(pattern, option, "\n".join(ours))) if ours else error
