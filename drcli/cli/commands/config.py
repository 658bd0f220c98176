"""`dr config`: show, check and change the settings."""

from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.errors import SettingsError
from drcli.cli.options import AsJson
from drcli.cli.working_folder import settings, working_folder

if TYPE_CHECKING:
    from drcli.config.fields import FileName

app = typer.Typer(no_args_is_help=True, help="Show, check and change the settings.")

_HYPERPARAMETER = "It is a hyperparameter, which belongs into custom_files/hyperparameters.json."


@app.command()
def show(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Only these settings.")
    ] = None,
    changed: Annotated[
        bool, typer.Option("--changed", help="Only what differs from the defaults.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show the settings, each with the file and line it comes from.

    Otherwise its place is the environment or the default. With names, each one is explained.
    Passwords and keys are not shown.

    Example: dr-config show --changed
    """
    from drcli.cli import console
    from drcli.cli.views import settings_view
    from drcli.config.inspection import inspect_values

    loaded = settings()
    wanted = [_known(name, tuple(loaded.extra)) for name in names or []]
    report = inspect_values(loaded, wanted, changed=changed)
    rendered = settings_view.explained(report) if wanted else settings_view.values(report)
    console.emit(report, rendered, as_json=as_json)


@app.command()
def check(
    settings_only: Annotated[
        bool, typer.Option("--settings", help="Leave the other rules out; takes no time.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check all settings, and once they are right, run all other rules.

    Everything wrong, odd or without effect in the settings is told at once. Then come your three
    files, the bucket and this machine, as with `dr validate`. Exits 3 when something is wrong.

    Example: dr-config check --json
    """
    from drcli.checks.config_check import check_alone, with_rules
    from drcli.cli import console
    from drcli.cli.views import settings_view

    report = check_alone(working_folder())
    if report.valid and not settings_only:
        with console.waiting(f"Checking {report.directory} ..."):
            report = with_rules(report)
    console.emit(report, settings_view.check(report), as_json=as_json)
    if report.errors:
        more = len(report.errors) - 1
        raise SettingsError(
            f"{report.errors[0]}" + (f" And {more} more." if more else ""),
            remedy="Correct that, as with `dr config set NAME=VALUE`, and check again.",
        )
    if not report.valid:
        raise typer.Exit(SettingsError.code)


@app.command("set")
def change(
    values: Annotated[list[str], typer.Argument(metavar="NAME=VALUE...", help="New values.")],
    file: Annotated[
        str | None,
        typer.Option("--file", metavar="FILE", help="run.env or system.env, if not by itself."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Change settings in the files of this folder, or of its experiment.

    A setting is changed where it stands; a new one goes to the file it belongs in. Comments, order
    and quotes stay. Put $NAME into single quotes, or your shell fills it in. Nothing is written
    when a value would be wrong.

    Example: dr-config set DR_WORKERS=2 'DR_LOCAL_S3_MODEL_PREFIX=$DR_WORLD_NAME-1'
    """
    from drcli.cli import console
    from drcli.cli.views import settings_view
    from drcli.config.editing import set_values

    edit = set_values(working_folder(), _wanted(values), file=_file(file))
    console.emit(edit, settings_view.edit(edit), as_json=as_json)
    for warning in edit.warnings:
        console.warn(warning)
    console.say(f"Written in {edit.directory}.")


def _wanted(values: list[str]) -> dict[str, str]:
    wanted = {}
    for pair in values:
        written, equals, value = pair.partition("=")
        if not equals:
            raise typer.BadParameter(f"'{pair}' is not NAME=VALUE.")
        name = _known(written.strip(), _names_in_files())
        if not _is_text(value):
            raise typer.BadParameter(f"The value of {name}, {value!a}, is not UTF-8 text.")
        wanted[name] = value
    return wanted


def _is_text(value: str) -> bool:
    """Whether a word of the command line was text; other bytes arrive as surrogates."""
    return not any("\ud800" <= character <= "\udfff" for character in value)


def _names_in_files() -> tuple[str, ...]:
    """Names of the racer's own that $NAME refers to; none while the files are wrong."""
    try:
        return tuple(settings().extra)
    except SettingsError:
        return ()


def _known(written: str, others: tuple[str, ...]) -> str:
    from drcli.config.inspection import find_name, suggestion

    name = find_name(written, others)
    if name is None:
        from drcli.modelfiles.hyperparameters import (
            KEYS,  # takes long to load, so only where it fails
        )

        hint = _HYPERPARAMETER if written.lower() in KEYS else suggestion(written)
        raise typer.BadParameter(f"'{written}' is not a setting. {hint}")
    return name


def _file(name: str | None) -> "FileName | None":
    if name == "run.env":
        return "run.env"
    if name == "system.env":
        return "system.env"
    if name is not None:
        raise typer.BadParameter(f"--file takes run.env or system.env, not '{name}'.")
    return None
