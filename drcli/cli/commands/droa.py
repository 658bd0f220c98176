"""`droa-*`."""

from functools import partial
from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from drcli.base.replaceable import refuse_existing
from drcli.cli import console, prompts
from drcli.cli.droa_options import Connection, connected
from drcli.cli.options import (
    AsJson,
    DryRun,
    ReplaceOrYes,
    best_option,
    checkpoint_choice,
    checkpoint_option,
    prefix_option,
)
from drcli.cli.views import droa_view
from drcli.cli.working_folder import settings

_Model = Annotated[
    str, typer.Argument(metavar="MODEL", help="Id of the model, or its name if only one has it.")
]
_Yes = Annotated[bool, typer.Option("-f", "--force", "-y", "--yes", help="Do not ask; answer yes.")]
_Kind = Literal["TRAINING_LOGS", "EVALUATION_LOGS", "PHYSICAL_CAR_MODEL", "VIRTUAL_MODEL", "VIDEOS"]


@connected
def droa_login(connection: Connection, as_json: AsJson = False) -> None:
    """Sign in to DeepRacer on AWS; other commands then need no password for an hour.

    Keeps temporary keys in ~/.droa-cache, never the password. The other commands sign in
    themselves if they must.

    Example: droa-login --username me@example.com
    """
    session = connection.session()
    with console.waiting(f"Signing in to {session.site.place} ..."):
        keys = session.renew()
    report = droa_view.SignedIn(session.site.place, session.username, keys.expires.isoformat())
    console.emit(report, droa_view.signed_in(report), as_json=as_json)


@connected
def droa_logout(connection: Connection, as_json: AsJson = False) -> None:
    """Delete the temporary keys of DeepRacer on AWS from this machine.

    The keys are in ~/.droa-cache; if the site is gone, delete that folder.

    Example: droa-logout
    """
    session = connection.session()
    report = droa_view.SignedOut(session.site.place, session.username, session.forget())
    console.emit(report, droa_view.signed_out(report), as_json=as_json)


@connected
def droa_list_models(connection: Connection, as_json: AsJson = False) -> None:
    """List your models at DeepRacer on AWS, the newest first.

    With --json, each model has the keys of its interface.

    Example: droa-list-models
    """
    droa = connection.droa()
    found = droa.models()
    report = droa_view.RemoteModels(droa.place, [dict(model.values) for model in found])
    console.emit(report, droa_view.models(droa.place, found), as_json=as_json)


@connected
def droa_get_model(
    connection: Connection,
    model: _Model,
    verbose: Annotated[
        bool,
        typer.Option("-v", "--verbose", help="Also show actions, reward function and addresses."),
    ] = False,
    summary: Annotated[
        bool, typer.Option("--summary", help="Also show means of its training metrics.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Show a model at DeepRacer on AWS.

    Example: droa-get-model 2w7R6h2PNexQ9kC --summary
    """
    from drcli.remote.droa_metrics import ModelReport, metrics_summary

    droa = connection.droa()
    found = droa.find(model)
    means = metrics_summary(droa, found) if summary else None
    report = ModelReport.of(droa.place, found, means or [])
    console.emit(report, droa_view.model(found, means, verbose=verbose), as_json=as_json)


@connected
def droa_import_model(
    connection: Connection,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            "--model-dir",
            metavar="PATH",
            help="Folder or archive of the model, as dr-export droa writes it.",
        ),
    ] = None,
    prefix: Annotated[
        str | None,
        prefix_option("Import this model of the bucket; default: yours.", "--model-prefix"),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option("--model-name", metavar="NAME", help="Its name at DeepRacer on AWS."),
    ] = None,
    description: Annotated[
        str, typer.Option("--model-description", metavar="TEXT", help="Its description.")
    ] = "",
    best: Annotated[bool, best_option("Import")] = False,
    number: Annotated[str | None, checkpoint_option("Import")] = None,
    no_wait: Annotated[
        bool, typer.Option("--no-wait", help="Do not wait until the model is checked there.")
    ] = False,
    unchecked: Annotated[
        bool, typer.Option("--unchecked", help="Import even if the check here finds errors.")
    ] = False,
    once: Annotated[
        bool,
        typer.Option("--once", help="Do nothing if the same weights were imported with --once."),
    ] = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Import a model into DeepRacer on AWS, and wait for its verdict.

    Takes a folder or archive on disk, or a model in your bucket, whose checkpoint is converted if
    it was trained here. All rules that are known of DeepRacer on AWS are checked before anything is
    sent. With --once, the description has a fingerprint of the weights.

    Example: droa-import-model --from my-model.tar.gz --model-name my-model
    """
    from drcli.remote import droa_import

    if source is not None and (prefix or best or number is not None):
        raise typer.BadParameter(
            "--from takes a folder or archive as it is; --model-prefix, --best and --checkpoint "
            "choose a model in the bucket. Use only one of both."
        )
    choice = checkpoint_choice(best, number)
    connection.refuse_no_site()
    if source is not None:
        from drcli.remote.droa_package import read_package

        files, found_name = read_package(source), _stem(source)
    else:
        from drcli.remote.droa_bucket_model import read_bucket_model

        loaded = settings()
        chosen = prefix or loaded.model_prefix
        files = read_bucket_model(loaded, chosen, choice)
        found_name = chosen
    if once:
        description = f"{description} {droa_import.fingerprint_of(files)}".strip()
    plan = droa_import.plan_import(
        files, found_name if name is None else name, description, unchecked=unchecked
    )
    droa = connection.droa()
    before = droa_import.find_import(droa, plan) if once else None
    if before is not None:
        report = before
    elif dry_run:
        report = droa_import.planned_report(droa.place, plan)
    else:
        report = droa_import.import_files(
            droa,
            plan,
            progress=partial(console.progress, unit="bytes"),
            waiting=None if no_wait else console.waiting,
        )
    console.emit(report, droa_view.imported(report), as_json=as_json)
    if not dry_run:
        show = (f"droa-get-model {report.model_id}", "show it")
        console.suggest([show, ("droa-list-models", "list your models there")])


@connected
def droa_download_logs(
    connection: Connection,
    model: _Model,
    kind: Annotated[
        _Kind,
        typer.Option(
            "--asset-type",
            metavar="TYPE",
            show_default=False,
            help=f"One of {', '.join(get_args(_Kind))}; the first one if not given.",
        ),
    ] = "TRAINING_LOGS",
    evaluation: Annotated[
        str, typer.Option("--evaluation-id", metavar="ID", help="For EVALUATION_LOGS: which one.")
    ] = "",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="PATH", help="File to write, or folder for it."),
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Also show means of the metrics in the logs.")
    ] = False,
    force: ReplaceOrYes = False,
    as_json: AsJson = False,
) -> None:
    """Download logs of a model, or the model itself, from DeepRacer on AWS.

    VIRTUAL_MODEL is packed first, which may take minutes. PHYSICAL_CAR_MODEL is an archive for the
    car.

    Example: droa-download-logs 2w7R6h2PNexQ9kC -o logs.tar.gz
    """
    from drcli.remote import droa_download
    from drcli.remote.droa_metrics import archive_summary

    if kind == "EVALUATION_LOGS" and not evaluation:
        raise typer.BadParameter("EVALUATION_LOGS needs --evaluation-id.")
    if summary and not kind.endswith("_LOGS"):
        raise typer.BadParameter("--summary needs logs: TRAINING_LOGS or EVALUATION_LOGS.")
    droa = connection.droa()
    model_id = droa.find(model).model_id
    url = droa_download.find_asset(droa, model_id, kind, evaluation, console.waiting)
    file = droa_download.download(
        droa,
        url,
        output or Path(),
        f"{model_id}-{kind.lower()}.tar.gz",
        progress=partial(console.progress, unit="bytes"),
        replaces=partial(refuse_existing, force=force),
    )
    report = droa_download.DownloadedAsset(
        droa.place, model_id, kind, str(file), file.stat().st_size
    )
    means = archive_summary(file) if summary else None
    console.emit(report, droa_view.downloaded(report, means), as_json=as_json)


@connected
def droa_delete_model(
    connection: Connection, model: _Model, force: _Yes = False, as_json: AsJson = False
) -> None:
    """Delete a model at DeepRacer on AWS. It cannot be restored.

    Only models with status READY or ERROR can be deleted. Asks before; the name of the model is a
    yes too.

    Example: droa-delete-model 2w7R6h2PNexQ9kC -f
    """
    from drcli.remote.droa_delete import delete_model, refuse_undeletable

    droa = connection.droa()
    found = droa.find(model)
    refuse_undeletable(found)
    prompts.agree(
        f"Delete the model {found.name} ({found.model_id}, {found.status}) at {droa.place}? It "
        "cannot be restored.",
        yes=force,
        words=[found.name],
    )
    report = delete_model(droa, found)
    console.emit(report, droa_view.deleted(report), as_json=as_json)


def _stem(source: Path) -> str:
    name = source.resolve().name
    for end in (".tar.gz", ".tar.bz2", ".tar.xz", ".tgz", ".tar", ".zip"):
        if source.is_file() and name.casefold().endswith(end):
            return name[: -len(end)]
    return name
