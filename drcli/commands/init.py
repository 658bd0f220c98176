"""`dr init`: writes a working folder."""

from pathlib import Path
from typing import Annotated

import typer

from drcli.commands.folder import working_folder
from drcli.commands.options import AsJson


def init(
    folder: Annotated[
        Path | None, typer.Argument(help="Where; the current folder when left out.")
    ] = None,
    world: Annotated[str | None, typer.Option("--world", help="Track to race on.")] = None,
    race_type: Annotated[
        str | None, typer.Option("--race-type", help="TIME_TRIAL, OBJECT_AVOIDANCE, HEAD_TO_BOT.")
    ] = None,
    prefix: Annotated[
        str | None, typer.Option("-p", "--prefix", help="Name of the model to train.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", min=1, help="Simulation processes.")
    ] = None,
    cloud: Annotated[
        str | None, typer.Option("-c", "--cloud", help="local, remote, aws or azure.")
    ] = None,
    bucket: Annotated[str | None, typer.Option("--bucket", help="Bucket for everything.")] = None,
    endpoint: Annotated[
        str | None, typer.Option("--endpoint", help="S3 address for remote and azure.")
    ] = None,
    profile: Annotated[
        str | None, typer.Option("--profile", help="AWS profile with the keys.")
    ] = None,
    experiment: Annotated[
        str | None,
        typer.Option("--experiment", help="Write experiments/NAME/ in a working folder instead."),
    ] = None,
    force: Annotated[
        bool,
        typer.Option(
            "-f", "--force", "--yes", help="Ask nothing; replaced files stay as .bak copies."
        ),
    ] = False,
    processor: Annotated[str | None, typer.Option("-a", hidden=True)] = None,
    style: Annotated[str | None, typer.Option("-s", hidden=True)] = None,
    mount: Annotated[bool, typer.Option("-m", hidden=True)] = False,
    as_json: AsJson = False,
) -> None:
    """Write a working folder: settings, the three files of a model, and bin/activate.sh.

    On a terminal it asks for what no option says; elsewhere the shipped values are taken. No file
    is overwritten unless you agree.

    Example: dr-init my-racer --world reinvent_base --prefix first-model
    """
    from drcli import console
    from drcli.setup.folder import plan_experiment, plan_folder, write
    from drcli.setup.questions import with_answers

    if processor or style or mount:
        console.say("-a, -s and -m choose images and containers, of which there are none here.")
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
    if experiment is not None:
        plan = plan_experiment(folder or working_folder(), experiment, values)
    else:
        if console.may_ask() and not force:
            values = with_answers(values, console.ask)
        plan = plan_folder(folder or Path.cwd(), values)
    if plan.clashes and not force:
        console.say(f"In {plan.folder} there are already: {', '.join(plan.clashes)}.")
        if not console.may_ask():
            raise typer.BadParameter("Add --force to replace them; copies stay as .bak.")
        console.agree("Replace them? A copy of each stays as .bak.", yes=False)
    report = write(plan)
    for warning in report.warnings:
        console.warn(warning)
    if as_json:
        console.emit(report, "", as_json=True)
    else:
        console.say(f"{len(report.written)} files written in {report.folder}.")
        for copy in report.backups:
            console.say(f"What was there before: {copy}")
    console.suggest(_next(plan.folder, experiment))


def _next(folder: Path, experiment: str | None) -> list[tuple[str, str]]:
    import shlex

    there = [] if folder == Path.cwd() else [(f"cd {shlex.quote(str(folder))}", "go there")]
    if experiment is not None:
        option = f" -e {experiment}"
        there.append((f"source bin/activate.sh{option}", "work in the experiment"))
    return [
        *there,
        ("dr-validate", "check everything"),
        ("dr-start-training", "train"),
    ]
