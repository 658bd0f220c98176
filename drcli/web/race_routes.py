"""Topics `races` and `race:ID`, and everything that `dr-race` does."""

import time
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from drcli.config.race_types import RaceKind
from drcli.model import race_keys
from drcli.races import queue_process, submissions
from drcli.races.organise import (
    change_rules,
    close_race,
    create_race,
    delete_race,
    open_race,
    options_of,
)
from drcli.races.race_export import csv_of, race_page, videos_of
from drcli.races.race_options import (
    RACE_SENSORS,
    RaceOptions,
    object_settings,
    parse_time,
    rules_of,
)
from drcli.races.race_records import Pairing, Ranking
from drcli.races.race_settings import settings_of_rules, shown_settings
from drcli.races.stored_race import is_race_id, race_id, read_rules
from drcli.tracks.track_list import list_tracks
from drcli.web.answers import BadRequest, Body, Text, accepts, answers
from drcli.web.download_folder import ObjectCopies
from drcli.web.hub import Read
from drcli.web.race_fields import form_of, of_a_form
from drcli.web.race_questions import question
from drcli.web.race_reader import RaceReader, race_of, words_of_rules
from drcli.web.served_folder import ServedFolder

MOST_SENSORS = 20
Amount = Annotated[float, Field(ge=-1e15, le=1e15)]
Whole = Annotated[int, Field(ge=-(10**15), le=10**15)]


class RaceForm(Body):
    """Null or missing: the usual value."""

    name: Text
    world: Text = ""
    reverse: bool = False
    race_type: RaceKind = "TIME_TRIAL"
    ranking: Ranking = "best-lap"
    max_laps: Whole | None = None
    min_laps: Whole | None = None
    average_laps: Whole | None = None
    off_track_penalty_s: Amount | None = None
    collision_penalty_s: Amount | None = None
    max_submissions: Whole | None = None
    opens: Text = ""
    closes: Text = ""
    seed: Whole | None = None
    pairing: Pairing = "round-robin"
    sensors: list[str] = Field(default_factory=list, max_length=MOST_SENSORS)
    obstacles: Whole | None = None
    bots: Whole | None = None

    def options(self, now_s: float) -> RaceOptions:
        """Raises SettingsError if a time or a number of objects is wrong."""
        values = self.model_dump(exclude={"opens", "closes", "obstacles", "bots"})
        return RaceOptions(
            **values
            | {
                "world": self.world.strip() or None,
                "max_laps": 3 if self.max_laps is None else self.max_laps,
                "opens_at": _time("--opens", self.opens, now_s),
                "closes_at": _time("--closes", self.closes, now_s),
                "sensors": tuple(self.sensors),
                "settings": tuple(
                    object_settings(self.race_type, self.obstacles, self.bots).items()
                ),
            }
        )


def _time(option: str, text: str, now_s: float) -> float | None:
    return parse_time(option, text.strip(), now_s) if text.strip() else None


class Submit(Body):
    prefix: Text
    checkpoint: Text = "best"
    racer: Text


class Run(Body):
    video: Literal["", "yes", "no"] = ""


class Of(Body):
    submission: Text


class Move(Of):
    place: Whole


class Open(Body):
    closes: Text = ""


RACES_S = 3.0
RACE_S = 1.0
LOG_BYTES = 20_000


def routes(folder: ServedFolder, clock: Callable[[], float] = time.time) -> Sequence[BaseRoute]:
    reader = RaceReader(folder, clock)

    def of_race(topic: str, race: str) -> Read:
        if not is_race_id(race):
            raise ValueError(topic)
        return lambda: reader.view(race)

    folder.hub.poll("races", RACES_S, lambda _: reader.races)
    folder.hub.poll("race:(.+)", RACE_S, of_race)
    return [*_list_routes(reader), *_race_routes(reader), *_file_routes(reader)]


def _list_routes(reader: RaceReader) -> Sequence[BaseRoute]:
    def form(_: Request) -> Any:
        settings = reader.folder.settings()
        usual = RaceForm(
            name="",
            world=settings.world_name,
            max_laps=3,
            off_track_penalty_s=settings.eval_off_track_penalty,
            collision_penalty_s=settings.eval_collision_penalty,
        )
        return {"fields": _fields(reader, usual.model_dump())}

    def check(_: Request, body: RaceForm) -> Any:
        settings = reader.folder.settings()
        rules = rules_of(settings, body.options(reader.clock()), reader.clock())
        race, words = race_id(rules.name), words_of_rules(rules)
        way = ", opposite direction" if rules.reverse else ""
        kept = f" Settings that the race keeps: {words['conditions']}." * bool(words["conditions"])
        said = [
            f"{rules.name}: {rules.world}{way}, {words['kind']}. {words['decides']} "
            f"{words['penalties']}",
            f"A new race {f'gets the id {race}' if race else 'draws its id'}.{kept}",
        ]
        more = {"words": words, "settings": shown_settings(rules), "said": said}
        return {"race": race, "rules": rules, **more}

    def create(_: Request, body: RaceForm) -> Any:
        now = reader.clock()
        options = body.options(now)
        settings, bucket = reader.open()
        return {"race": create_race(settings, bucket, options, now_s=now).race}

    return [
        Route("/api/races", answers(lambda _: reader.races())),
        Route("/api/races", accepts(of_a_form(create)), methods=["POST"]),
        Route("/api/races/form", answers(form)),
        Route("/api/races/check", accepts(of_a_form(check)), methods=["POST"]),
    ]


def _race_routes(reader: RaceReader) -> Sequence[BaseRoute]:
    def submit(request: Request, body: Submit) -> Any:
        settings, bucket = reader.open()
        taken = submissions.submit(
            settings,
            bucket,
            race_of(request),
            **body.model_dump(),
            now_s=reader.clock(),
        )
        return {"taken": taken, "race": reader.view(taken.race)}

    def changed(change: Callable[[RaceReader, str, Any], None]) -> Any:
        def handle(request: Request, body: Any) -> Any:
            race = race_of(request)
            change(reader, race, body)
            return {"race": reader.view(race)}

        return accepts(of_a_form(handle), change.__annotations__["body"])

    def run(request: Request, body: Run) -> Any:
        race = race_of(request)
        name = read_rules(reader.bucket(), race).name

        def launch(progress: Callable[[str], None]) -> Any:
            settings, bucket = reader.open()
            progress("starts the process that drives it.")
            video = {"yes": True, "no": False}.get(body.video)
            return queue_process.launch_queue(settings, bucket, race, video=video)

        title = f"Start of the queue of {name}"
        return {"task": reader.folder.tasks.start("race-run", race, title, launch).id}

    def delete(request: Request) -> Any:
        return delete_race(reader.open()[1], race_of(request))

    return [
        Route("/api/race/{race}", answers(lambda request: reader.view(race_of(request)))),
        Route("/api/race/{race}", answers(delete), methods=["DELETE"]),
        Route("/api/race/{race}/submit", accepts(of_a_form(submit)), methods=["POST"]),
        Route("/api/race/{race}/run", accepts(run), methods=["POST"]),
        *(
            Route(f"/api/race/{{race}}/{name}", changed(change), methods=["POST"])
            for name, change in _CHANGES.items()
        ),
        Route("/api/race/{race}/rules", answers(lambda request: _rules(reader, request))),
        Route("/api/race/{race}/question", answers(lambda request: question(reader, request))),
    ]


def _withdraw(reader: RaceReader, race: str, body: Of) -> None:
    submissions.withdraw(reader.open()[1], race, body.submission)


def _move(reader: RaceReader, race: str, body: Move) -> None:
    submissions.move(reader.open()[1], race, body.submission, body.place)


def _restart(reader: RaceReader, race: str, body: Of) -> None:
    submissions.restart(reader.open()[1], race, body.submission)


def _stop(reader: RaceReader, race: str, body: Body) -> None:
    queue_process.stop_queue(reader.open()[1], race)


def _open(reader: RaceReader, race: str, body: Open) -> None:
    now = reader.clock()
    open_race(reader.open()[1], race, _time("--closes", body.closes, now), now_s=now)


def _close(reader: RaceReader, race: str, body: Body) -> None:
    close_race(reader.open()[1], race, now_s=reader.clock())


def _change_rules(reader: RaceReader, race: str, body: RaceForm) -> None:
    now = reader.clock()
    settings, bucket = reader.open()
    change_rules(settings, bucket, race, body.options(now), now_s=now)


_CHANGES: dict[str, Callable[[RaceReader, str, Any], None]] = {
    "withdraw": _withdraw,
    "move": _move,
    "restart": _restart,
    "stop": _stop,
    "open": _open,
    "close": _close,
    "rules": _change_rules,
}


def _rules(reader: RaceReader, request: Request) -> Any:
    rules = read_rules(reader.bucket(), race_of(request))
    conditions = settings_of_rules(reader.folder.settings(), rules)
    wish = options_of(rules)
    values = {
        **vars(wish),
        "opens": wish.opens_at,
        "closes": wish.closes_at,
        "obstacles": conditions.oa_number_of_obstacles,
        "bots": conditions.h2b_number_of_bot_cars,
    }
    fields = _fields(reader, values)
    fields[0]["help"] = "The id of the race stays."
    for each in fields:
        if each["only"] and rules.race_type not in each["only"][1] and each["kind"] == "whole":
            each["value"] = None
    return {"fields": fields}


def _fields(reader: RaceReader, values: dict[str, Any]) -> list[dict[str, Any]]:
    settings = reader.folder.settings()
    memory = reader.folder.directory / "data" / "cache" / "tracks.json"
    tracks = [track.name for track in list_tracks(settings.tracks_folder, memory).tracks]
    worlds = tracks if values["world"] in tracks else [values["world"], *tracks]
    more = {
        "world": {"options": worlds},
        "sensors": {"options": [(name, name) for name in RACE_SENSORS]},
        "obstacles": {"placeholder": str(settings.oa_number_of_obstacles)},
        "bots": {"placeholder": str(settings.h2b_number_of_bot_cars)},
    }
    return form_of(values, more)


def _file_routes(reader: RaceReader) -> Sequence[BaseRoute]:
    copies = ObjectCopies(reader.folder.directory / "data" / "viewer" / "race-videos")

    def video(request: Request) -> Any:
        race, name = race_of(request), request.query_params.get("name", "")
        key = race_keys.video(race, name)
        folder, _, rest = key.rpartition("/")
        if not name or f"{folder}/" != f"{race_keys.folder(race)}videos/" or "\\" in rest:
            raise BadRequest("This is not the name of a video of this race.", 404)
        download = "download" in request.query_params
        file = f"{race}-{name}.mp4" if download else ""
        bucket = reader.bucket()
        return copies.answer(bucket, key, media_type="video/mp4", filename=file)

    def table(request: Request) -> Any:
        race = race_of(request)
        return _file(csv_of(reader.report(race)), "text/csv", f"{race}.csv")

    def page(request: Request) -> Any:
        race = race_of(request)
        report = reader.report(race)
        films = {}
        if request.query_params.get("videos") == "1":
            films = videos_of(report, reader.bucket())
        return _file(race_page(report, films), "text/html", f"{race}.html")

    def log(request: Request) -> Any:
        race = race_of(request)
        path = queue_process.queue_log(reader.folder.settings(), race)
        try:
            with path.open("rb") as file:
                size = file.seek(0, 2)
                file.seek(max(0, size - LOG_BYTES))
                text = file.read().decode("utf-8", "replace")
        except OSError:
            return {"path": str(path), "text": None}
        return {"path": str(path), "text": text if size <= LOG_BYTES else text.partition("\n")[2]}

    return [
        Route("/api/race/{race}/video", answers(video)),
        Route("/api/race/{race}/table.csv", answers(table)),
        Route("/api/race/{race}/page.html", answers(page)),
        Route("/api/race/{race}/log", answers(log)),
    ]


def _file(text: str, media_type: str, name: str) -> Response:
    headers = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(text.encode(), media_type=media_type, headers=headers)
