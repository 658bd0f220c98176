"""What the page asks before something is done with a model.

The values of a dialog are the body of the request that follows.
"""

from collections.abc import Callable
from difflib import unified_diff
from typing import Any

from starlette.requests import Request

from drcli.base.report import size_text
from drcli.config.editing import raised
from drcli.config.settings import catalogue
from drcli.config.track_names import built_in, own
from drcli.model.checkpoint_choice import NEVER_EVALUATED
from drcli.model.checkpoint_list import CheckpointList, ListedCheckpoint, list_checkpoints
from drcli.model.files.custom_files import FILE_RULES
from drcli.model.model_store import ModelStore
from drcli.races.organise import list_races
from drcli.run.evaluation_report import list_evaluations
from drcli.transfer.model_removal import plan_removal
from drcli.transfer.record_training import files_of
from drcli.transfer.training_list import entry_of
from drcli.transfer.transfer_buckets import UNDEFINED
from drcli.web.answers import BadRequest
from drcli.web.model_reader import ModelReader, prefix_of
from drcli.web.own_files import own_file

Field = dict[str, Any]
OWN_FILES = {
    "reward_function.py": "its reward function",
    "hyperparameters.json": "its hyperparameters",
    "model_metadata.json": "its actions and sensors",
}
DOWNLOADS = {
    "car": "Archive for the physical car (.tar.gz)",
    "onnx": "Policy as ONNX with its metadata (.zip)",
    "model": "Model: checkpoints, files and metrics (.tar.gz)",
    "everything": "Model with traces and videos (.tar.gz)",
    "logs": "Logs (.tar.gz)",
}
MOST_TRIALS = 100
REQUIRED = {"required": True}


def dialog(title: str, action: str, *fields: Field | None, **more: Any) -> dict[str, Any]:
    """As the page draws it.

    `more` is `intro`; `danger`; `confirm`, what must be typed into the field of that name; `diffs`,
    differences of files.
    """
    return {"title": title, "action": action, "fields": [each for each in fields if each], **more}


def field(name: str, label: str, value: Any, kind: str = "", **more: Any) -> Field:
    """A control; without a `kind`, a check box for True or False, a choice with `options`.

    The others are text, lines, whole, number, time, and many, whose value is a list of `options`.
    `more` is `options`, as pairs; `help`; `placeholder`; attributes as `more`; `only`, the name of
    another field and its values with which this one has a meaning.
    """
    usual = "flag" if isinstance(value, bool) else "choice" if "options" in more else "text"
    return {"name": name, "label": label, "value": value, "kind": kind or usual, **more}


def checkpoint_options(listed: CheckpointList) -> list[tuple[str, str]]:
    """With how each drove."""
    newest = listed.checkpoints[::-1]

    def drove(each: ListedCheckpoint) -> str:
        if not each.episodes:
            return NEVER_EVALUATED if each.form == "drcli" else "its evaluation is not known"
        best = "" if each.best_lap_s is None else f", best {each.best_lap_s:.2f} s"
        return f"{each.laps} of {each.episodes} laps clean{best}"

    def chosen(word: str) -> str:
        found = (f": {each.number}, {drove(each)}" for each in newest if word in each.words)
        return next(found, "")

    def marks(each: ListedCheckpoint) -> str:
        return f" ({', '.join(each.words)})" if each.words else ""

    return [
        ("best", f"the best{chosen('best')}"),
        ("last", f"the newest{chosen('last')}"),
        *((str(each.number), f"{each.number}{marks(each)}: {drove(each)}") for each in newest),
    ]


def checkpoint(reader: ModelReader, prefix: str, value: str, help_text: str = "") -> Field:
    settings, bucket = reader.open(prefix)
    listed = list_checkpoints(ModelStore.of(settings.model, bucket, prefix))
    options = checkpoint_options(listed)
    return field("checkpoint", "Checkpoint", value, options=options, help=help_text)


def start(reader: ModelReader, prefix: str, query: dict[str, str]) -> dict[str, Any]:
    minutes = field(
        "max_minutes",
        "Stop after (minutes)",
        "",
        "number",
        more={"type": "number", "min": "1", "step": "any"},
        help="Empty: it runs until it is stopped, or until a goal of run.env is reached.",
    )
    intro = (
        "It goes on with its newest checkpoint, the files of custom_files/ and the settings of "
        "run.env. Everything is checked first."
    )
    return dialog(f"Resume the training of {prefix}", "Start", minutes, intro=intro)


def stop(reader: ModelReader, prefix: str, query: dict[str, str]) -> dict[str, Any]:
    intro = "What was learned so far is kept, and the training can be continued."
    return dialog(f"Stop the training of {prefix}?", "Stop the training", intro=intro, danger=True)


def evaluate(reader: ModelReader, prefix: str, query: dict[str, str]) -> dict[str, Any]:
    settings, record = reader.settings_of(prefix), reader.record(prefix)
    worlds = sorted({*built_in(), *own(settings.tracks_folder)})
    trained_on = "" if record is None else record.world
    kinds = [(each, each.lower().replace("_", " ")) for each in catalogue()["DR_RACE_TYPE"].choices]
    models = [(each.prefix, each.prefix) for each in reader.models()[0].models]
    first = query.get("checkpoint") or str(settings.eval_checkpoint)
    return dialog(
        f"Evaluate {prefix}",
        "Evaluate",
        field(
            "world",
            "Track",
            trained_on if trained_on in worlds else settings.world_name,
            options=[(e, f"{e} (trained on)" if e == trained_on else e) for e in worlds],
        ),
        field(
            "reverse",
            "Direction",
            str(settings.eval_reverse_direction),
            options=[("False", "as the track was built"), ("True", "in reverse")],
        ),
        field("race_type", "Race type", settings.race_type, options=kinds),
        field(
            "opponent",
            "Opponent",
            settings.eval_opp_s3_model_prefix or prefix,
            options=models,
            only=("race_type", ["HEAD_TO_MODEL"]),
        ),
        field(
            "laps",
            "Laps",
            str(settings.eval_number_of_trials),
            "whole",
            more={"type": "number", "min": "1", "max": "1000", **REQUIRED},
        ),
        checkpoint(reader, prefix, first),
        field("video", "Make videos of it, which takes some minutes more", settings.eval_save_mp4),
        intro="All other rules are those of the DR_EVAL_ settings. The model may be training at "
        "the same time.",
    )


def clone(reader: ModelReader, prefix: str, query: dict[str, str]) -> dict[str, Any]:
    settings, bucket = reader.open(prefix)
    record, texts = reader.record(prefix), files_of(ModelStore(bucket, prefix))
    diffs = {}
    for name in FILE_RULES:
        lines = changed_lines(own_file(settings, name).text, texts[name]) if name in texts else []
        if lines:
            diffs[name] = lines
    world = "" if record is None else entry_of(record, exists=True).world
    take_world = world not in ("", settings.world_name)
    tracks = [(world, f"{world}, of this model"), ("", f"{settings.world_name}, as now")]
    taken = [(name, f"Take {OWN_FILES[name]}") for name in diffs]
    return dialog(
        f"Clone {prefix}",
        "Clone",
        field("to", "Name of the new model", raised(prefix, prefix)[1], more=REQUIRED),
        checkpoint(reader, prefix, query.get("checkpoint") or "best"),
        field("take", "The folder's file is kept as .bak", list(diffs), "many", options=taken)
        if diffs
        else None,
        field("world", "Track", world, options=tracks) if take_world else None,
        field(
            "description",
            "What is it for?",
            "",
            more={"maxlength": "250"},
            help="A note that stays with the new model.",
        ),
        intro="The next training starts a new model with these weights. run.env is changed, and a "
        "copy is kept as run.env.bak.",
        diffs=[
            {"summary": f"{name} of the model differs from the folder's", "lines": lines}
            for name, lines in diffs.items()
        ],
    )


def changed_lines(before: str, after: str) -> list[str]:
    """A unified difference without its head; empty where only spaces at ends of lines differ."""
    old, new = ([line.rstrip() for line in text.strip().splitlines()] for text in (before, after))
    return list(unified_diff(old, new, n=2, lineterm=""))[2:]


def submit(reader: ModelReader, prefix: str, query: dict[str, str]) -> dict[str, Any]:
    races = list_races(reader.open(prefix)[1]).races
    taking = [(each.race, each.name) for each in races if each.state == "open"]
    if not taking:
        raise BadRequest(
            "There is no race that takes models now.",
            409,
            "Make one on the page “Races”, or wait until it opens.",
        )
    return dialog(
        f"Submit {prefix} to a race",
        "Submit",
        field("race", "Race", taking[0][0], options=taking),
        field("racer", "Name of the racer", "", more=REQUIRED),
        checkpoint(reader, prefix, query.get("checkpoint") or "best"),
    )


def download(reader: ModelReader, prefix: str, query: dict[str, str]) -> dict[str, Any]:
    about = "For the car and for ONNX; the file is checked against the weights first."
    return dialog(
        f"Download {prefix}",
        "Download",
        field("kind", "What", "car", options=list(DOWNLOADS.items())),
        checkpoint(reader, prefix, query.get("checkpoint") or "best", about),
    )


def upload(reader: ModelReader, prefix: str, query: dict[str, str]) -> dict[str, Any]:
    settings = reader.folder.settings()
    target = settings.upload_s3_bucket.replace(UNDEFINED, "")
    own_prefix = prefix == settings.model_prefix
    to = settings.upload_s3_prefix if own_prefix else prefix
    return dialog(
        f"Upload {prefix}",
        "Upload",
        checkpoint(reader, prefix, "best"),
        field(
            "to", "Name at the target", to if target else raised(prefix, prefix)[1], more=REQUIRED
        ),
        field("local", "Copy to the local bucket instead", not target),
        intro=f"A checkpoint and all files that belong to it are copied to s3://{target}."
        if target
        else "No upload bucket is set (DR_UPLOAD_S3_BUCKET); the local bucket can have a copy.",
    )


def delete(reader: ModelReader, prefix: str, query: dict[str, str]) -> dict[str, Any]:
    planned = plan_removal(reader.folder.settings(), [prefix], dry_run=True).report
    (one,) = planned.models
    intro = (
        f"{one.objects:,} objects ({size_text(one.size_bytes)}) with {one.checkpoints:,} "
        f"checkpoints, and {len(one.files):,} files on this machine. It cannot be undone."
    )
    forget = field("forget", "Delete the records of its trainings, too", False)
    return dialog(
        f"Delete {prefix}?",
        "Delete",
        field("confirm", f"Type {prefix} to confirm", ""),
        forget if planned.records else None,
        intro=f"{intro} Note: {one.warning}." if one.warning else intro,
        danger=True,
        confirm=prefix,
    )


def film(reader: ModelReader, prefix: str, query: dict[str, str]) -> dict[str, Any]:
    settings, bucket = reader.open(prefix)
    evaluations = list_evaluations(settings.model, ModelStore(bucket, prefix)).evaluations
    driven = next((each for each in evaluations if each.stamp == query.get("stamp")), None)
    if driven is None:
        raise BadRequest("There is no such evaluation any more.", 404)
    trials = [(str(k), f"trial {each.trial}") for k, each in enumerate(driven.trials[:MOST_TRIALS])]
    return dialog(
        "Make a video of the evaluation",
        "Make the video",
        field(
            "episode",
            "What",
            "best",
            options=[("best", "the best lap"), ("all", "all laps"), *trials],
        ),
        field("size", "Size", "640x480", options=["640x480", "1280x720"]),
        field("ghosts", "Ghosts of other laps", "0", options=["0", "1", "2", "3", "4"]),
        field("explain", "Show which pixels move the action", False),
        field("download", "Only download it; the stored video stays", False),
        intro="The video is drawn from the stored steps; a minute of driving takes some minutes.",
    )


QUESTIONS: dict[str, Callable[[ModelReader, str, dict[str, str]], dict[str, Any]]] = {
    each.__name__: each
    for each in (start, stop, evaluate, clone, submit, download, upload, delete, film)
}


def question(reader: ModelReader, request: Request) -> dict[str, Any]:
    """`GET /api/model/question?prefix=PREFIX&about=NAME`, maybe with a checkpoint or a stamp."""
    ask = QUESTIONS.get(request.query_params.get("about", ""))
    if ask is None:
        raise BadRequest(f"The questions are about {', '.join(QUESTIONS)}.")
    return ask(reader, prefix_of(request), dict(request.query_params))
