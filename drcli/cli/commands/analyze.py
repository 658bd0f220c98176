"""`dr analyze`."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import completion, terminal
from drcli.cli.evaluation_options import with_options
from drcli.cli.options import Replace
from drcli.cli.show import show
from drcli.cli.working_folder import settings_for_files
from drcli.model import keys
from drcli.model.model_store import ModelStore

if TYPE_CHECKING:
    from drcli.analysis.report.graphs import Picture
    from drcli.config.settings import Settings

with lazy_imports():
    from drcli.analysis import analysis as analyses
    from drcli.analysis import explained_model, model_source, outputs, read_run
    from drcli.transfer import transfer_buckets

COMPARE = "compare"


def analyze(
    what: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="WHAT",
            help="A model, s3://bucket/prefix, a folder or an archive; the model of run.env if "
            "left out. After the word compare: two or more of them.",
            autocompletion=completion.model_prefixes,
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(
            "--html", metavar="FILE", help="Write the report, or the comparison, as one HTML file."
        ),
    ] = None,
    png: Annotated[
        Path | None, typer.Option("--png", metavar="FOLDER", help="Write its pictures there.")
    ] = None,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Also show in the report what moves the action: drives an episode of the best "
            "checkpoint.",
        ),
    ] = False,
    local: Annotated[
        bool, typer.Option("-L", "--local", help="s3:// is a bucket of the local server.")
    ] = False,
    force: Replace = False,
) -> None:
    """Show what a training came to: a verdict, curves, laps, and what to change, with evidence.

    Reads models of drcli, DeepRacer-for-Cloud, the DeepRacer console and DeepRacer on AWS, also
    while they are trained, and changes nothing. Archives can be .tar.gz, .tgz, .tar and .zip.
    `compare A B` shows two or more side by side, and whether they differ by more than chance.

    Example: dr-analyze team/model-1 --html report.html
    """
    words = what or []
    if explain and html is None:
        raise typer.BadParameter("--explain adds pictures to the report; name that with --html.")
    if words[:1] == [COMPARE]:
        _compare(words[1:], html, png, local=local, force=force)
        return
    if len(words) > 1:
        raise typer.BadParameter(
            f"There are {len(words)} models; one can be analysed. To compare them: "
            f"dr-analyze {COMPARE} {' '.join(words)}."
        )

    loaded = settings_for_files(words)
    name = words[0] if words else None
    outputs.check_targets(html, png, force=force)
    if explain:
        _refuse_outside_the_bucket(loaded, name)
    with terminal.waiting(f"Reading {name or loaded.model_prefix} ..."):
        analysis = analyses.analyse(read_run.read_run(loaded, name, local=local))
    explained = _explained(loaded, name, analysis.run.world) if explain else ()
    with terminal.waiting("Writing ...") if html or png else terminal.waiting("", only_live=True):
        report = outputs.write_outputs(analysis, html, png, explained, force=force)
    terminal.warn(*report.problems)
    show(report)
    if not terminal.as_json and html is None:
        given = f" {shlex.quote(name)}{' -L' * local}" if name else ""
        terminal.suggest(
            [(f"dr-analyze{given} --html report.html", "graphs, map and each episode")]
        )


def _explained(loaded: "Settings", name: str | None, world: str | None) -> "tuple[Picture, ...]":
    prefix = loaded.model_prefix if name is None else name.strip("/")
    with terminal.waiting("Driving an episode and explaining it ..."):
        bucket = transfer_buckets.bucket_to_look_at(loaded.transfer, upload=False)
        return explained_model.explained_pictures(
            with_options(loaded, DR_WORLD_NAME=world), ModelStore(bucket, prefix)
        )


def _refuse_outside_the_bucket(loaded: "Settings", name: str | None) -> None:
    if name is None:
        return
    prefix = name.strip("/")
    if (
        not keys.is_valid_prefix(prefix)
        or prefix.casefold().startswith("s3:")
        or not model_source.open_model(loaded, name).origin.startswith("s3://")
    ):
        raise typer.BadParameter(
            f"--explain drives a model of the bucket, and {name} is not one. To explain a "
            "policy's file: dr-saliency --model FILE."
        )


def _compare(
    words: list[str],
    html: Path | None,
    png: Path | None,
    *,
    local: bool,
    force: bool,
) -> None:
    if len(words) < 2:
        raise typer.BadParameter(f"Name two or more models after {COMPARE}.")
    if png is not None:
        raise typer.BadParameter(f"--png is for one model; {COMPARE} writes --html and --json.")
    loaded = settings_for_files(words)
    outputs.check_targets(html, None, force=force)
    with terminal.waiting(f"Reading {', '.join(words)} ..."):
        report = outputs.write_comparison_of(read_run.read_runs(loaded, words, local=local), html)
    terminal.warn(*report.problems)
    show(report)
