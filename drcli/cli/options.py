"""Options that several commands share."""

import re
from collections.abc import Callable, Collection, Mapping
from typing import Annotated, Any, ParamSpec

import typer

from drcli.base.errors import BadValue, ProblemsError, shown
from drcli.cli import completion
from drcli.config.value_types import CheckpointChoice, CheckpointWord, parse_checkpoint

P = ParamSpec("P")


def _not_a_digit(delimiter: str | None) -> str | None:
    if delimiter is not None and (not delimiter or delimiter[-1].isdigit()):
        raise typer.BadParameter("-d must end in a character that is not a digit, such as - or _.")
    return delimiter


def text_only(command: Callable[P, None]) -> Callable[P, None]:
    """Marks a command that prints no report, and so has no --json."""
    vars(command)["text_only"] = True
    return command


Force = Annotated[bool, typer.Option("-f", "--force", "--yes", help="Do not ask; answer yes.")]
Replace = Annotated[bool, typer.Option("-f", "--force", help="Replace a file that exists.")]
ReplaceOrYes = Annotated[
    bool, typer.Option("-f", "--force", "-y", "--yes", help="Replace a file that exists.")
]
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
KeepModels = Annotated[
    list[str] | None,
    typer.Option(
        "--keep",
        metavar="MODEL",
        help="Leave this model alone: a prefix, or a pattern. Can be given again.",
        autocompletion=completion.model_prefixes,
    ),
]
CustomFiles = Annotated[
    bool, typer.Option("-c", "--custom-files", help="Also copy its three files to custom_files/.")
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


def force_option(text: str) -> Any:
    return typer.Option("-f", "--force", "--yes", help=text)


def models_argument(metavar: str, text: str) -> Any:
    return typer.Argument(metavar=metavar, help=text, autocompletion=completion.model_prefixes)


def wipe_option(text: str) -> Any:
    return typer.Option("-w", "--wipe", help=text)


def prefix_option(text: str, *names: str) -> Any:
    names = names or ("-p", "--prefix")
    complete = completion.model_prefixes
    return typer.Option(*names, metavar="PREFIX", help=text, autocompletion=complete)


def world_option(text: str, *short: str) -> Any:
    names = ("--world", *short)
    return typer.Option(*names, metavar="TRACK", help=text, autocompletion=completion.worlds)


def best_option(verb: str) -> Any:
    return typer.Option("-b", "--best", help=f"{verb} the best checkpoint.")


def checkpoint_option(verb: str, *names: str) -> Any:
    return typer.Option(
        *(names or ("-c", "--checkpoint")),
        metavar="WHICH",
        help=f"{verb} this one: a number, last, best, first-lap, three-laps or best-lap.",
        autocompletion=completion.checkpoints,
    )


World = Annotated[str | None, world_option("Name this track instead of the model's.")]


def parsed_checkpoint(text: str | None, option: str = "--checkpoint") -> "CheckpointChoice | None":
    """The checkpoint of an option.

    Raises:
        BadParameter: It names none.
    """
    if text is None:
        return None
    try:
        return parse_checkpoint(text)
    except BadValue as error:
        raise typer.BadParameter(f"{option} {shown(text)} {error}. {error.remedy}") from error


def checkpoint_choice(
    best: bool, text: str | None, default: "CheckpointWord" = "last"
) -> "CheckpointChoice":
    """The checkpoint that -b or -c chooses.

    By default, commands of DeepRacer-for-Cloud take the last one, ours the best.

    Raises:
        BadParameter: Both are given, or -c names none.
    """
    if best and text is not None:
        raise typer.BadParameter("-b and -c both choose a checkpoint; use only one.")
    chosen = parsed_checkpoint(text)
    if chosen is not None:
        return chosen
    return "best" if best else default


def in_options(
    error: ProblemsError, options: Mapping[str, str], given: Collection[str]
) -> Exception:
    """The error with options instead of settings, where one was `given`."""

    def option(match: "re.Match[str]") -> str:
        if match[1] is None:  # a command
            return match[0]
        return options[match[1]] + (" " if match[2] else "")

    ours = [f"{item.message} {item.remedy}" for item in error.errors if item.key in given]
    pattern = rf"`[^`]*`|\b({'|'.join(options)})\b(=?)"
    return typer.BadParameter(re.sub(pattern, option, "\n".join(ours))) if ours else error
