"""What the page asks before something is done with a race.

The values of a dialog are the body of the request that follows.
"""

from collections.abc import Callable
from typing import Any

from starlette.requests import Request

from drcli.base.report import counted, size_text
from drcli.model.checkpoint_list import list_checkpoints
from drcli.model.model_list import list_models
from drcli.model.model_store import ModelStore
from drcli.races.organise import delete_race
from drcli.web.answers import BadRequest
from drcli.web.model_questions import REQUIRED, checkpoint_options, dialog, field
from drcli.web.race_reader import RaceReader, race_of, waiting_text

VIDEOS = [
    ("", "If the video encoder is installed"),
    ("yes", "Yes; refuse without the encoder"),
    ("no", "No, which is faster"),
]


def submit(reader: RaceReader, race: str, query: dict[str, str]) -> dict[str, Any]:
    """With the checkpoints of the model that is chosen."""
    settings, bucket = reader.folder.settings(), reader.bucket()
    prefixes = [each.prefix for each in list_models(bucket).models]
    if not prefixes:
        raise BadRequest(
            "There is no model in this bucket yet.",
            409,
            "Train one on the page “New training”, or import one on the page “Models”.",
        )
    wished = query.get("prefix") or settings.model_prefix
    prefix = wished if wished in prefixes else prefixes[0]
    options = checkpoint_options(list_checkpoints(ModelStore.of(settings.model, bucket, prefix)))
    drove = "How each drove in the evaluations of its training."
    return dialog(
        "Submit a model",
        "Submit",
        field(
            "racer",
            "Racer",
            settings.racer_name,
            help="Each racer has one place on the leaderboard.",
            more=REQUIRED,
        ),
        field("prefix", "Model", prefix, options=prefixes),
        field("checkpoint", "Checkpoint", "best", options=options, help=drove),
        intro="The race gets a copy: you can train on, or delete the model.",
    )


def run(reader: RaceReader, race: str, query: dict[str, str]) -> dict[str, Any]:
    return dialog(
        "Drive the queue",
        "Drive it",
        field("video", "Videos", "", options=VIDEOS),
        intro=f"{waiting_text(reader.report(race))} in the queue. This machine drives one after "
        "the other in the background, also when this page is closed.",
    )


def open(reader: RaceReader, race: str, query: dict[str, str]) -> dict[str, Any]:
    closes = field("closes", "Closes", "", "time", help="Empty: when somebody closes it.")
    return dialog("Take submissions from now on", "Open it", closes)


def close(reader: RaceReader, race: str, query: dict[str, str]) -> dict[str, Any]:
    intro = (
        "What waits in the queue is still driven, and then there is a winner. You can open it "
        "again."
    )
    return dialog("Close this race for submissions?", "Close it", intro=intro, danger=True)


def page(reader: RaceReader, race: str, query: dict[str, str]) -> dict[str, Any]:
    films = sum(bool(row.video) for row in reader.report(race).leaderboard)
    label = f"With {counted(films, 'video')} of the leaderboard (a few MB each)"
    without = "" if films else " There are no videos on the leaderboard."
    return dialog(
        "Save this race as one HTML file",
        "Save",
        field("videos", label, False) if films else None,
        intro=f"It needs no network and has no scripts.{without}",
    )


def withdraw(reader: RaceReader, race: str, query: dict[str, str]) -> dict[str, Any]:
    intro = "Its laps are removed, and it no longer counts. It cannot be undone; the model stays."
    title = f"Withdraw {_named(reader, race, query)}?"
    return dialog(title, "Withdraw it", intro=intro, danger=True)


def restart(reader: RaceReader, race: str, query: dict[str, str]) -> dict[str, Any]:
    title = f"Drive {_named(reader, race, query)} again?"
    intro = "Its present laps no longer count."
    return dialog(title, "Drive it again", intro=intro, danger=True)


def delete(reader: RaceReader, race: str, query: dict[str, str]) -> dict[str, Any]:
    planned = delete_race(reader.open()[1], race, dry_run=True)
    return dialog(
        f"Delete the race {reader.report(race).rules.name}?",
        "Delete this race",
        intro=f"{counted(planned.objects, 'object')} ({size_text(planned.size_bytes)}): its "
        "submissions, laps and videos. The models of the racers stay. It cannot be undone.",
        danger=True,
    )


def _named(reader: RaceReader, race: str, query: dict[str, str]) -> str:
    wanted = query.get("submission")
    for entry in reader.report(race).submissions:
        if entry.submission == wanted:
            return f"{entry.racer}'s {entry.model}"
    raise BadRequest("There is no such submission any more.", 404)


QUESTIONS: dict[str, Callable[[RaceReader, str, dict[str, str]], dict[str, Any]]] = {
    each.__name__: each for each in (submit, run, open, close, page, withdraw, restart, delete)
}


def question(reader: RaceReader, request: Request) -> dict[str, Any]:
    """`GET /api/race/ID/question?about=NAME`, maybe with a submission or a model's prefix."""
    ask = QUESTIONS.get(request.query_params.get("about", ""))
    if ask is None:
        raise BadRequest(f"The questions are about {', '.join(QUESTIONS)}.")
    return ask(reader, race_of(request), dict(request.query_params))
