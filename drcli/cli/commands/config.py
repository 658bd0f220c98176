"""`dr config`."""

from typing import Annotated, Literal

import typer

from drcli.base.errors import SettingsError
from drcli.base.installation import lazy_imports
from drcli.cli import completion, terminal
from drcli.cli.show import show as present
from drcli.cli.working_folder import settings, working_folder

with lazy_imports():
    from drcli.checks import config_check
    from drcli.config import editing, presets, settings_report
    from drcli.model.files import hyperparameters


app = typer.Typer(no_args_is_help=True, help="Show, check and change the settings.")

_HYPERPARAMETER = "It is a hyperparameter; set it in custom_files/hyperparameters.json."


@app.command()
def show(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            help="Only these settings.",
            autocompletion=completion.setting_names,
        ),
    ] = None,
    changed: Annotated[
        bool, typer.Option("--changed", help="Only settings that differ from their defaults.")
    ] = False,
) -> None:
    """Show each setting, and the file and line it comes from.

    A setting that no file holds comes from the environment or is the default. With names, each
    setting is explained. Passwords and keys are not shown.

    Example: dr-config show --changed
    """
    loaded = settings()
    wanted = [_known(name, tuple(loaded.extra)) for name in names or []]
    report = settings_report.inspect_values(loaded, wanted, changed=changed)
    present(report, explained=bool(wanted))


@app.command()
def check(
    settings_only: Annotated[
        bool, typer.Option("--settings", help="Check the settings only, which is faster.")
    ] = False,
) -> None:
    """Check all settings; when they are right, check everything else too.

    Lists every error, warning and setting without effect. Your three files, the bucket and this
    machine are checked next, as with `dr validate`. Exits 3 when something is wrong.

    Example: dr-config check --json
    """
    report = config_check.check_alone(working_folder())
    if report.valid and not settings_only:
        with terminal.waiting(f"Checking {report.directory} ..."):
            report = config_check.with_rules(report)
    present(report)
    if report.errors and not terminal.on_screen():
        more = len(report.errors) - 1
        raise SettingsError(
            f"{report.errors[0]}" + (f" And {more} more." if more else ""),
            remedy=report.errors[0].remedy,
        )
    if not report.valid:
        raise typer.Exit(SettingsError.code)


@app.command("set")
def change(
    values: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME=VALUE", help="New values.", autocompletion=completion.assignments
        ),
    ],
    file: Annotated[
        Literal["run.env", "system.env"] | None,
        typer.Option(
            "--file",
            metavar="FILE",
            help="run.env or system.env; chosen for you if left out.",
        ),
    ] = None,
) -> None:
    """Change settings in the files of this folder, or of its experiment.

    A setting is changed in the file that holds it; a new one is added to the file it belongs to.
    Comments, order and quotes are kept. Put $NAME in single quotes, or your shell replaces it.
    Nothing is written when a value is wrong.

    Example: dr-config set DR_WORKERS=2 'DR_LOCAL_S3_MODEL_PREFIX=$DR_WORLD_NAME-1'
    """
    edit = editing.set_values(working_folder(), _wanted(values), file=file)
    present(edit)
    terminal.warn(*edit.warnings)
    terminal.say(f"Written in {edit.directory}.")


@app.command()
def preset(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME", help="Only these presets.", autocompletion=completion.presets
        ),
    ] = None,
) -> None:
    """Explain the presets of `dr init --preset`: their settings, what for, and yours beside them.

    Example: dr-config preset physical
    """
    try:
        loaded = settings()
    except SettingsError:  # presets can be read before there is a working folder
        loaded = None
    present(presets.explain(names or [], loaded), in_full=bool(names))


def _wanted(values: list[str]) -> dict[str, str]:
    wanted = {}
    for pair in values:
        written, equals, value = pair.partition("=")
        if not equals:
            raise typer.BadParameter(f"'{pair}' is not of the form NAME=VALUE.")
        name = _known(written.strip(), _names_in_files())
        if not _is_text(value):
            raise typer.BadParameter(f"The value of {name}, {value!a}, is not UTF-8 text.")
        wanted[name] = value
    return wanted


def _is_text(value: str) -> bool:
    """Other bytes arrive as surrogates."""
    return not any("\ud800" <= character <= "\udfff" for character in value)


def _names_in_files() -> tuple[str, ...]:
    try:
        return tuple(settings().extra)
    except SettingsError:
        return ()


def _known(written: str, others: tuple[str, ...]) -> str:
    name = settings_report.find_name(written, others)
    if name is None:
        hint = (
            _HYPERPARAMETER
            if written.lower() in hyperparameters.KEYS
            else settings_report.suggestion(written)
        )
        raise typer.BadParameter(f"'{written}' is not a setting. {hint}")
    return name
