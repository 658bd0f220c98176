"""`dr init`: writes a working folder."""

import os
import re
import shlex
from collections.abc import Collection
from pathlib import Path
from typing import Annotated

import typer

from drcli.base.problems import ProblemsError
from drcli.cli import candidates, console, prompts
from drcli.cli.options import AsJson
from drcli.cli.setup_questions import with_answers
from drcli.cli.working_folder import current_folder, working_folder
from drcli.config.new_folder import has_activate_script, plan_experiment, plan_folder
from drcli.config.write_folder import write

OPTIONS = {
    "DR_WORLD_NAME": "--world",
    "DR_RACE_TYPE": "--race-type",
    "DR_LOCAL_S3_MODEL_PREFIX": "--prefix",
    "DR_WORKERS": "--workers",
    "DR_CLOUD": "--cloud",
    "DR_LOCAL_S3_BUCKET": "--bucket",
    "DR_REMOTE_MINIO_URL": "--endpoint",
    "DR_LOCAL_S3_PROFILE": "--profile",
    "DR_EXPERIMENT_NAME": "--experiment",
}
"""The option for each setting that can be given here."""


def init(
    folder: Annotated[
        str | None,
        typer.Argument(metavar="FOLDER", help="The folder; the current one when left out."),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            "--world", metavar="NAME", help="Name of the track.", autocompletion=candidates.worlds
        ),
    ] = None,
    race_type: Annotated[
        str | None,
        typer.Option(
            "--race-type",
            metavar="TYPE",
            help="TIME_TRIAL, OBJECT_AVOIDANCE, HEAD_TO_BOT, or for evaluations HEAD_TO_MODEL.",
            autocompletion=candidates.race_types,
        ),
    ] = None,
    prefix: Annotated[
        str | None, typer.Option("-p", "--prefix", metavar="NAME", help="Name of the model.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", metavar="N", help="Number of simulation workers, 1 to 10."),
    ] = None,
    cloud: Annotated[
        str | None,
        typer.Option(
            "-c",
            "--cloud",
            metavar="WHERE",
            help="Where the bucket is: local, remote, aws or azure.",
            autocompletion=candidates.clouds,
        ),
    ] = None,
    bucket: Annotated[
        str | None, typer.Option("--bucket", metavar="NAME", help="Name of the bucket.")
    ] = None,
    endpoint: Annotated[
        str | None,
        typer.Option("--endpoint", metavar="URL", help="S3 address for remote and azure."),
    ] = None,
    profile: Annotated[
        str | None,
        typer.Option("--profile", metavar="NAME", help="AWS profile that holds the keys."),
    ] = None,
    experiment: Annotated[
        str | None,
        typer.Option(
            "--experiment",
            metavar="NAME",
            help="Create experiments/NAME/ in a working folder instead.",
            autocompletion=candidates.experiments,
        ),
    ] = None,
    force: Annotated[
        bool,
        typer.Option("-f", "--force", "--yes", help="Do not ask; replaced files are kept as .bak."),
    ] = False,
    processor: Annotated[str | None, typer.Option("-a", hidden=True)] = None,
    style: Annotated[str | None, typer.Option("-s", hidden=True)] = None,
    mount: Annotated[bool, typer.Option("-m", hidden=True)] = False,
    as_json: AsJson = False,
) -> None:
    """Create a working folder: settings, the three files of a model, and bin/activate.sh.

    On a terminal it asks for everything that no option gives; elsewhere it uses the shipped values.
    No file is replaced unless you agree.

    Example: dr-init my-racer --world reinvent_base --prefix first-model
    """
    if folder == "":
        raise typer.BadParameter(
            "The name of the folder is empty. Leave it out for the current one."
        )
    if processor or style or mount:
        console.say("-a, -s and -m have no effect: they choose docker images and containers.")
    given = {
        "DR_WORLD_NAME": world,
        "DR_RACE_TYPE": race_type,
        "DR_LOCAL_S3_MODEL_PREFIX": prefix,
        "DR_WORKERS": None if workers is None else str(workers),
        "DR_CLOUD": cloud,
        "DR_LOCAL_S3_BUCKET": bucket,
        "DR_REMOTE_MINIO_URL": endpoint,
        "DR_LOCAL_S3_PROFILE": profile,
    }
    values = {name: value for name, value in given.items() if value is not None}
    try:
        if experiment is not None:
            plan = plan_experiment(Path(folder or working_folder()), experiment, values)
        else:
            if prompts.may_ask() and not force:
                values = with_answers(values, prompts.ask, console.warn)
            plan = plan_folder(Path(folder or current_folder()), values)
    except ProblemsError as error:
        raise _in_options(error, {*values, "DR_EXPERIMENT_NAME"}) from None
    if plan.clashes and not force:
        there = f"{plan.folder} already has {', '.join(plan.clashes)}."
        if not prompts.may_ask():
            raise typer.BadParameter(f"{there} Add --force to replace them; they are kept as .bak.")
        prompts.agree(f"{there} Replace them, and keep the old ones as .bak?", yes=False)
    report = write(plan)
    for warning in report.warnings:
        console.warn(warning)
    if report.backups:
        console.warn(f"The old files are kept as {', '.join(report.backups)}.")
    if as_json:
        console.emit(report, "", as_json=True)
    else:
        console.say(f"{len(report.written)} files written to {report.folder}.")
    sourced = has_activate_script(plan.folder)
    steps = _next(plan.folder, experiment, plan.missing_track, sourced=sourced)
    console.suggest(steps, elsewhere=True)


def _in_options(error: ProblemsError, names: Collection[str]) -> Exception:
    """A failure in the words of the command line, where that is what is wrong.

    Args:
        error: In the words of the settings files, which do not exist yet.
        names: Settings that were given here.
    """
    ours = [item for item in error.errors if item.key in names]
    if not ours:
        return error
    return typer.BadParameter(
        "\n".join(f"{_spelt(item.message)} {_spelt(item.remedy)}" for item in ours)
    )


def _spelt(text: str) -> str:
    """A sentence with options for the settings in it, except in commands that it quotes."""

    def option(match: "re.Match[str]") -> str:
        if match[1] is None:
            return match[0]
        return OPTIONS[match[1]] + (" " if match[2] else "")

    return re.sub(rf"`[^`]*`|\b({'|'.join(OPTIONS)})\b(=?)", option, text)


def _next(
    folder: Path, experiment: str | None, missing_track: str | None, *, sourced: bool
) -> list[tuple[str, str]]:
    """What to type next, from the current folder.

    Args:
        folder: The working folder.
        experiment: The experiment in it that was written.
        missing_track: The track to be fetched first.
        sourced: Whether the folder has a bin/activate.sh of ours.
    """
    steps = [] if folder.samefile(".") else [(f"cd {shlex.quote(str(folder))}", "go to the folder")]
    active = os.environ.get("DR_DIR")
    if experiment is not None and sourced:
        steps.append((f"source bin/activate.sh -e {experiment}", "use the experiment"))
    elif experiment is not None:
        here = f"DR_DIR={shlex.quote(str(folder))}"
        steps.append((f"export {here} DR_EXPERIMENT_NAME={experiment}", "use the experiment"))
    elif active and Path(active).absolute() != folder:
        leave = "unset DR_EXPERIMENT_NAME; source bin/activate.sh"
        steps.append((leave, f"leave {active}"))
    if missing_track is not None:
        steps.append((f"dr-tracks fetch {missing_track}", "fetch the track"))
    return [*steps, ("dr-validate", "check everything"), ("dr-start-training", "train")]
