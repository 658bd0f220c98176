"""`dr history`."""

import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Group, RenderableType
from rich.text import Text

from drcli.base.errors import Absent
from drcli.base.files import refuse_replacing, rewrite
from drcli.base.installation import lazy_imports
from drcli.cli import completion, console, prompts
from drcli.cli.options import DryRun, Force, Replace
from drcli.cli.views.layout import Rows, counted, fitted, indented
from drcli.cli.working_folder import settings

if TYPE_CHECKING:
    from drcli.bucket.bucket import Bucket
    from drcli.records.training_record import RecordedStart
    from drcli.transfer.family_tree import FamilyMember, FamilyTree
    from drcli.transfer.training_details import (
        Difference,
        ForgottenTrainings,
        TrainingComparison,
        TrainingDetails,
    )
    from drcli.transfer.training_list import Condition, KnownTrainings, TrainingList

with lazy_imports():
    from drcli.bucket import connect
    from drcli.config import settings as config_settings
    from drcli.model import model_list
    from drcli.model.files import hyperparameters
    from drcli.transfer import family_tree, training_details, training_list


# Shows the history of trainings.


_STYLES = {
    "running": "green",
    "finished": "",
    "failed": "red",
    "lost": "red",
    "interrupted": "yellow",
    "stopped": "",
    "unknown": "dim",
}

_WIDE = 110
_RESULT_NAMES = {
    "world": "track",
    "elapsed_s": "time",
    "hours": "machine hours",
    "usd": "cost",
    "best_lap_s": "best clean lap",
    "best_training_lap_s": "best training lap",
}
_MINUTE = 16
_MOST_INDENT = 16
_MOST_DIFF = 60


@fitted
def show_trainings(columns: int, found: "TrainingList") -> RenderableType:
    if not found.trainings:
        if not found.total:
            return Text(f"There is no training in s3://{found.bucket} yet.")
        return Text(
            f"No training in s3://{found.bucket} fits; it has {found.total}. "
            "The subcommands are show, compare, tree and forget."
        )
    names = ["id", "model", "began", "track", "iters", "progress", "best lap", "ended"]
    left = ["id", "model", "began", "track", "ended"]
    wide = columns >= _WIDE
    if wide:
        names[-1:] = ["hours", "cost", "ended"]
    rows = []
    for each in found.trainings:
        gone = ("", "") if each.exists else (" (gone)", "dim")
        row: list[str | Text] = [
            each.id,
            Text.assemble(_printable(each.model), gone),
            _when(each.began_at, wide=wide),
            _printable(each.world) or "-",
            str(each.iterations),
            "-" if each.best_progress is None else f"{each.best_progress:.0f} %",
            _seconds(each.best_lap_s),
        ]
        if wide:
            row += [_hours(each.hours), _money(each.usd)]
        rows.append([*row, Text(each.state, style=_STYLES.get(each.state, ""))])
    title = Text(f"s3://{found.bucket}", style="bold")
    shown, total = len(found.trainings), found.total
    end = counted(total, "training") if shown == total else f"{shown} of {total:,} trainings"
    return Group(title, Rows(names, rows, left=left), Text(f"{end}."))


def details(found: "TrainingDetails") -> RenderableType:
    each, record = found.training, found.record
    where = "" if each.exists else ", its model is gone"
    parts: list[RenderableType] = [
        Text.assemble(
            (f"Training {each.id} of {_printable(each.model)}", "bold"),
            (f" ({each.state}{where})", _STYLES.get(each.state, "")),
        )
    ]
    if each.derived:
        parts.append(Text("Nobody wrote a record; this was worked out from the model.", "dim"))
    weights = "fresh weights"
    if each.parent:
        weights = f"{_printable(each.parent)}, {each.parent_checkpoint}"
        weights += f" (training {each.parent_training})" if each.parent_training else ""
    results = record.results
    lines = [
        ("description", _printable(each.description)),
        ("began", _when(each.began_at, wide=True)),
        ("ended", " ".join(filter(None, (_when(each.ended_at, wide=True), each.message)))),
        ("track", " ".join(filter(None, (_printable(each.world), each.race_type)))),
        ("model", ", ".join(filter(None, (each.algorithm, each.action_space, record.network)))),
        ("sensors", ", ".join(record.sensors)),
        ("began with", weights),
        (
            "learned",
            f"{counted(each.iterations, 'iteration')}, {counted(each.episodes, 'episode')}, "
            f"{counted(each.steps, 'step')} in {_duration(each.elapsed_s)}",
        ),
        ("best", _best(found)),
        ("fastest clean lap", _laps(found)),
        ("evaluations", _evaluations(results.evaluations, results.trials)),
        ("machine hours", "" if each.hours is None else _hours(each.hours)),
        ("cost", "" if each.usd is None else _money(each.usd)),
    ]
    parts += _pairs(lines)
    changed = record.newest.settings
    if changed:
        parts.append(Text("Settings that differ from their defaults", style="bold"))
        parts += _pairs([(name, _value(changed[name])) for name in sorted(changed)])
    for number, own in enumerate(record.newest.worker_settings, start=2):
        if own:
            parts.append(Text(f"worker-{number}.env", style="bold"))
            parts += _pairs([(name, _value(own[name])) for name in sorted(own)])
    if record.hyperparameters:
        parts.append(Text("Hyperparameters", style="bold"))
        found_values = sorted(record.hyperparameters.items())
        parts.append(indented(", ".join(f"{name} {_value(value)}" for name, value in found_values)))
    if record.starts:
        parts.append(Text(counted(each.starts, "start").capitalize(), style="bold"))
        parts += [indented(_start(start)) for start in record.starts]
    if found.files:
        parts.append(Text(f"Files: {', '.join(found.files)} (--save FOLDER writes them)."))
    parts += [Text(f"Wrote {path}") for path in found.saved]
    return Group(*parts)


def comparison(found: "TrainingComparison") -> RenderableType:
    one, other = found.before, found.after
    titles = [f"{_printable(each.model)} {each.id}" for each in (one, other)]
    rows = [
        (
            _RESULT_NAMES.get(each.name, each.name.replace("_", " ")),
            _result(each.name, each.before, one.metric),
            _result(each.name, each.after, other.metric),
        )
        for each in found.results
    ]
    parts: list[RenderableType] = [Rows(("", *titles), rows, left=("", *titles))]
    sections = [
        ("Settings", found.settings),
        ("Settings of other workers", found.worker_settings),
        ("Hyperparameters", found.hyperparameters),
        ("Model", found.model),
        ("Weights and seed", found.start),
        ("Versions", found.versions),
        ("Machine", found.machine),
    ]
    for title, changed in sections:
        if changed:
            parts.append(Text(title, style="bold"))
            parts += [indented(_difference(each)) for each in changed]
    for file in found.files:
        parts.append(Text(file.name, style="bold"))
        if not file.diff:
            parts.append(indented("It differs; a text was not kept."))
        parts += [indented(_diff_line(line)) for line in file.diff[:_MOST_DIFF]]
        if (more := len(file.diff) - _MOST_DIFF) > 0:
            parts.append(indented(Text(f"and {more:,} more lines; --json has them", "dim")))
    if len(parts) == 1:
        parts.append(Text("Settings, hyperparameters, files, versions and machine are equal."))
    return Group(*parts)


def show_tree(found: "FamilyTree") -> RenderableType:
    if not found.members:
        return Text(f"There is no training in s3://{found.bucket} yet.")
    parts: list[RenderableType] = [Text(f"s3://{found.bucket}", style="bold")]
    for member in found.members:
        indent = min(2 * member.depth, _MOST_INDENT)
        parts.append(indented(_member(member), indent) if indent else _member(member))
        if member.changes:
            parts.append(indented(Text(_printable("; ".join(member.changes)), "dim"), indent + 4))
    return Group(*parts)


def forgotten(found: "ForgottenTrainings") -> RenderableType:
    rows = [
        (each.id, _printable(each.model), _when(each.began_at, wide=True), each.state)
        for each in found.trainings
    ]
    names = ("id", "model", "began", "ended")
    return Group(Text(f"s3://{found.bucket}", style="bold"), Rows(names, rows, left=names))


def _member(member: "FamilyMember") -> Text:
    name = Text(_printable(member.model), style="bold" if member.asked else "")
    if member.training is None:
        what = "no training here has made it" if member.exists else "not in this bucket"
        return name.append(f" ({what})", "dim")
    each = member.training
    words = [each.id, _when(each.began_at, wide=False), _printable(each.world)]
    words.append(f"best lap {each.best_lap_s:.2f} s" if each.best_lap_s is not None else "")
    if not words[-1] and each.best_progress is not None:
        words[-1] = f"progress {each.best_progress:.0f} %"
    words += [each.state, "" if member.exists else "gone"]
    if member.weights:
        words.append(f"from checkpoint {member.weights.partition('_')[0]}")
    return name.append(f"  {', '.join(word for word in words if word)}", "dim")


def _start(start: "RecordedStart") -> str:
    machine = start.machine
    where = ", ".join(
        str(word)
        for word in (
            start.host,
            machine.get("processor"),
            f"{machine['cores']} cores" if machine.get("cores") else "",
            f"drcli {start.versions['drcli']}" if start.versions.get("drcli") else "",
        )
        if word
    )
    begins = f"resumes {start.resumes}" if start.resumes else "begins"
    end = f"{start.state}: {start.message}" if start.message else start.state
    text = f"{_unix(start.started_at)} {begins} on {where or 'an unknown machine'}; {end}"
    return _printable(text)


def _best(found: "TrainingDetails") -> str:
    each = found.training
    if not each.best_checkpoint:
        return ""
    score = model_list.score_text(found.record.metric, each.best_score)
    return f"{each.best_checkpoint}, {score}" if score else each.best_checkpoint


def _laps(found: "TrainingDetails") -> str:
    results, world = found.record.results, found.record.world
    trials = dict(results.clean_trial_lap_s or {})
    known = (
        ("in evaluations of the training", results.best_lap_s),
        ("in stand-alone evaluations", trials.pop(world, None)),
        ("in training episodes", results.best_training_lap_s),
        *(
            (f"on {_printable(name) or 'an unknown track'}", trials[name])
            for name in sorted(trials)
        ),
    )
    return ", ".join(f"{lap:.3f} s {where}" for where, lap in known if lap is not None)


def _evaluations(evaluations: int, trials: int) -> str:
    if not evaluations:
        return ""
    return f"{counted(evaluations, 'evaluation')} with {counted(trials, 'trial')}"


def _pairs(lines: Iterable[tuple[str, str]]) -> list[RenderableType]:
    return [indented(Text.assemble((f"{name} ", "dim"), value)) for name, value in lines if value]


def _difference(each: "Difference") -> Text:
    before, after = _value(each.before), _value(each.after)
    return Text.assemble((f"{each.name} ", "dim"), f"{before} -> {after}")


def _diff_line(line: str) -> Text:
    style = {"+": "green", "-": "red", "@": "cyan"}.get(line[:1], "")
    return Text(_printable(line), style=style)


def _value(value: Any) -> str:
    if value is None or value == "":
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    return _printable(str(value))


def _result(name: str, value: Any, metric: str) -> str:
    if value is None:
        return "-"
    if name == "elapsed_s":
        return _duration(value)
    if name.endswith("lap_s"):
        return _seconds(value)
    if name.endswith("progress"):
        return f"{value:.1f} %"
    if name in ("hours", "usd"):
        return _hours(value) if name == "hours" else _money(value)
    if name == "best_score":
        return model_list.score_text(metric, value)
    return f"{value:,}" if isinstance(value, int) else _value(value)


def _when(moment: str, *, wide: bool) -> str:
    return moment[:_MINUTE].replace("T", " ") if wide else moment[:10] or "-"


def _unix(at: float) -> str:
    with suppress(ValueError, OverflowError, OSError):
        if at:
            return time.strftime("%Y-%m-%d %H:%M", time.gmtime(at))
    return "?"


def _seconds(lap_s: float | None) -> str:
    return "-" if lap_s is None else f"{lap_s:.2f} s"


def _hours(hours: float | None) -> str:
    return "-" if hours is None else f"{hours:.2f} h"


def _money(usd: float | None) -> str:
    return "-" if usd is None else f"{usd:.2f} USD"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in text)


app = typer.Typer(
    help="List, compare and export all trainings, also those of deleted models.\n\n"
    "Every training leaves a record in the bucket. `dr-history` alone lists them. A training is "
    "named by its id or the beginning of it, or by its model: MODEL is its newest training, "
    "MODEL~1 the one before.\n\nExample: dr-history --world reinvent_base --sort lap",
)

Order = Literal["began", "lap", "progress", "score", "iterations", "hours", "cost", "model"]

_Training = Annotated[
    str,
    typer.Argument(
        metavar="TRAINING",
        help="Id of a training, or MODEL, or MODEL~1 for the one before.",
        autocompletion=completion.model_prefixes,
    ),
]
_Since = Annotated[
    str | None,
    typer.Option("--since", metavar="WHEN", help="Begun since a date, or an age such as 7d."),
]
_Until = Annotated[
    str | None,
    typer.Option("--until", metavar="WHEN", help="Begun before a date, or an age such as 12h."),
]


@app.command("list")
def list_trainings(
    pattern: Annotated[
        str,
        typer.Argument(
            metavar="PATTERN",
            help="Part of a model's name, or a whole name with * and ?.",
            autocompletion=completion.model_prefixes,
        ),
    ] = "",
    world: Annotated[
        str | None,
        typer.Option(
            "--world",
            metavar="TRACK",
            help="Only on this track; * and ? are allowed.",
            autocompletion=completion.worlds,
        ),
    ] = None,
    state: Annotated[
        str | None,
        typer.Option(
            "--state", metavar="STATES", help="Only these, such as finished or failed,lost."
        ),
    ] = None,
    since: _Since = None,
    until: _Until = None,
    where: Annotated[
        list[str] | None,
        typer.Option(
            "--where",
            metavar="TEST",
            help="Only if a value passes a test, such as 'lr<0.001' or DR_RACE_TYPE=TIME_TRIAL.",
        ),
    ] = None,
    sort: Annotated[
        Order,
        typer.Option("--sort", help="Order; the newest, the largest and the best come last."),
    ] = "began",
    limit: Annotated[
        int, typer.Option("-n", "--limit", min=0, metavar="N", help="Only the last N; 0 for all.")
    ] = 0,
    csv: Annotated[
        Path | None,
        typer.Option("--csv", metavar="FILE", help="Write a CSV table; - for standard output."),
    ] = None,
    force: Replace = False,
) -> None:
    """List trainings, the newest last.

    Example: dr-history list --world reinvent_base --where "best_lap_s<12" --sort lap
    """
    if csv is not None and str(csv) != "-":
        refuse_replacing(csv, force=force)
    now = datetime.now(UTC)
    conditions: list[Condition] = []
    if pattern:
        conditions.append(training_list.of_model(pattern))
    if state is not None:
        conditions.append(training_list.in_state(state))
    if since is not None:
        conditions.append(training_list.began("--since", since, now, after=True))
    if until is not None:
        conditions.append(training_list.began("--until", until, now, after=False))
    _, known = _known()
    if world is not None:
        conditions.append(training_list.where(f"world={world}", ["world"]))
    if where:
        names = _names(known)
        conditions += [training_list.where(text, names) for text in where]
    found = training_list.chosen(known, conditions, sort, limit)
    if csv is not None:
        _write(csv, training_list.csv_table(known, found.trainings))
        if str(csv) == "-":
            return
    console.emit(found, show_trainings(found))


@app.command()
def show(
    training: _Training,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="FOLDER", help="Write the files of the training there."),
    ] = None,
    force: Replace = False,
) -> None:
    """Show all that was recorded of a training.

    Example: dr-history show team/model-1 --save old-files
    """
    bucket, known = _known()
    found = training_details.details_of(bucket, known, training, save=save, force=force)
    console.emit(found, details(found))


@app.command()
def compare(
    before: _Training,
    after: Annotated[
        str,
        typer.Argument(
            metavar="OTHER",
            help="The training to compare with it.",
            autocompletion=completion.model_prefixes,
        ),
    ],
) -> None:
    """Compare two trainings: settings, files, machine, and what they came to.

    Example: dr-history compare team/model-1 team/model-2
    """
    bucket, known = _known()
    one, other = (training_details.compared(bucket, known, name) for name in (before, after))
    found = training_details.compare(one, other)
    console.emit(found, comparison(found))


@app.command()
def tree(
    training: Annotated[
        str | None,
        typer.Argument(
            metavar="TRAINING",
            help="Only the family of this training: an id, or a model.",
            autocompletion=completion.model_prefixes,
        ),
    ] = None,
) -> None:
    """Show which training began with whose weights, and what each has changed.

    Example: dr-history tree team/model-2
    """
    _, known = _known()
    found = family_tree.family_tree(known, None if training is None else known.find(training))
    console.emit(found, show_tree(found))


@app.command()
def forget(
    trainings: Annotated[
        list[str], typer.Argument(metavar="TRAINING...", help="Ids of trainings, or models.")
    ],
    force: Force = False,
    dry_run: DryRun = False,
) -> None:
    """Delete the records of trainings, with the copies of their files; models stay.

    Example: dr-history forget 3f9a01c2
    """
    bucket = connect.open_bucket(settings().storage, patience_s=connect.COMMAND_PATIENCE_S)
    known = _read(bucket)
    records = training_details.plan_forgetting(known, trainings)
    entries = [
        training_list.entry_of(record, exists=record.id in known.existing) for record in records
    ]
    found = training_details.ForgottenTrainings(bucket.name, entries, dry_run)
    if not dry_run:
        console.err.print(forgotten(found))
        prompts.agree("Delete these records? It cannot be undone.", yes=force)
        training_details.forget(bucket, records)
    console.emit(found, forgotten(found))


def _known() -> "tuple[Bucket, KnownTrainings]":
    loaded = settings()
    bucket = connect.open_running_bucket(loaded.storage)
    if bucket is None:
        raise Absent(
            f"s3://{loaded.bucket} has no trainings yet, or its local server does not run.",
            remedy="Start a training with `dr-start-training`.",
        )
    return bucket, _read(bucket)


def _read(bucket: "Bucket") -> "KnownTrainings":
    with console.waiting(f"Reading s3://{bucket.name} ...", only_live=True):
        known = training_list.known_trainings(bucket)
    console.warn(*known.damaged)
    return known


def _names(known: "KnownTrainings") -> list[str]:
    named = {name for record in known.records for name in record.hyperparameters}
    return [
        *(each.name for each in fields(training_list.TrainingEntry)),
        *sorted({*named, *hyperparameters.KEYS}),
        *config_settings.catalogue(),
    ]


def _write(target: Path, text: str) -> None:
    if str(target) == "-":
        console.write(text)
        return
    rewrite(target, text.encode())
    console.say(f"Wrote {target}.")
