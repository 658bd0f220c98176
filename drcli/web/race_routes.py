"""Topics `races` and `race:ID`, and everything that `dr-race` does."""

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, get_args

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from drcli.base.errors import SettingsError
from drcli.bucket.connect import open_running_bucket
from drcli.config.race_types import RaceKind
from drcli.model import race_keys
from drcli.model.model_list import list_models
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
from drcli.web.answers import BadRequest, accepts, answers, text_of
from drcli.web.download_folder import ObjectCopies
from drcli.web.hub import Polled, Publish
from drcli.web.race_reader import RaceReader, words_of_rules
from drcli.web.served_folder import ServedFolder
from drcli.web.topics import Snapshot

# Reads forms about races; BadRequest where the page would not send it.


MOST_SENSORS = 20


def options_of_form(body: dict[str, Any], now_s: float) -> RaceOptions:
    """Null or missing: the usual value.

    Raises:
        BadRequest: The page would not send it.
        SettingsError: A time or a number of objects is wrong.
    """
    race_type: RaceKind = one_of_texts(body, "race_type", get_args(RaceKind), "TIME_TRIAL")
    objects = object_settings(
        race_type, whole_number(body, "obstacles"), whole_number(body, "bots")
    )
    laps = whole_number(body, "max_laps")
    opens, closes = text_of(body, "opens", "").strip(), text_of(body, "closes", "").strip()
    return RaceOptions(
        name=text_of(body, "name"),
        world=text_of(body, "world", "").strip() or None,
        reverse=flag(body, "reverse"),
        race_type=race_type,
        ranking=one_of_texts(body, "ranking", get_args(Ranking), "best-lap"),
        max_laps=3 if laps is None else laps,
        min_laps=whole_number(body, "min_laps"),
        average_laps=whole_number(body, "average_laps"),
        off_track_penalty_s=number(body, "off_track_penalty_s"),
        collision_penalty_s=number(body, "collision_penalty_s"),
        max_submissions=whole_number(body, "max_submissions"),
        opens_at=parse_time("--opens", opens, now_s) if opens else None,
        closes_at=parse_time("--closes", closes, now_s) if closes else None,
        seed=whole_number(body, "seed"),
        pairing=one_of_texts(body, "pairing", get_args(Pairing), "round-robin"),
        sensors=tuple(texts(body, "sensors")),
        settings=tuple(objects.items()),
    )


def one_of_texts(body: dict[str, Any], key: str, known: tuple[str, ...], usual: str) -> Any:
    value = text_of(body, key, usual)
    if value not in known:
        raise BadRequest(f"The {key} is one of {', '.join(known)}.")
    return value


def number(body: dict[str, Any], key: str) -> float | None:
    """Null: None."""
    value = body.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadRequest(f"The {key} is not a number.")
    if not math.isfinite(value) or abs(value) > 1e15:
        raise BadRequest(f"The {key} is too large.")
    return value


def whole_number(body: dict[str, Any], key: str) -> int | None:
    """Null: None."""
    value = number(body, key)
    if value is not None and value != int(value):
        raise BadRequest(f"The {key} is not a whole number.")
    return None if value is None else int(value)


def flag(body: dict[str, Any], key: str) -> bool:
    value = body.get(key, False)
    if not isinstance(value, bool):
        raise BadRequest(f"The {key} is true or false.")
    return value


def texts(body: dict[str, Any], key: str) -> list[str]:
    value = body.get(key, [])
    if (
        not isinstance(value, list)
        or len(value) > MOST_SENSORS
        or not all(isinstance(each, str) for each in value)
    ):
        raise BadRequest(f"The {key} is a list of texts.")
    return value


RACES_S = 3.0
RACE_S = 1.0
LOG_BYTES = 20_000


def routes(folder: ServedFolder, clock: Callable[[], float] = time.time) -> Sequence[BaseRoute]:
    reader = RaceReader(folder, clock)

    def open_races(topic: str, publish: Publish) -> Polled:
        if topic != "races":
            raise ValueError(topic)
        return Polled(topic, publish, lambda: Snapshot.of(topic, reader.races()), RACES_S)

    def open_one(topic: str, publish: Publish) -> Polled:
        race = topic.partition(":")[2]
        if not is_race_id(race):
            raise ValueError(topic)
        return Polled(topic, publish, lambda: Snapshot.of(topic, reader.view(race)), RACE_S)

    folder.hub.add_kind("races", open_races)
    folder.hub.add_kind("race", open_one)
    return [*_list_routes(reader), *_race_routes(reader), *_file_routes(reader)]


def _list_routes(reader: RaceReader) -> Sequence[BaseRoute]:
    def form(_: Request) -> Any:
        settings = reader.folder.settings()
        memory = reader.folder.directory / "data" / "cache" / "tracks.json"
        tracks = [track.name for track in list_tracks(settings.tracks_folder, memory).tracks]
        return {
            "folder": str(reader.folder.directory),
            "tracks": tracks,
            "sensors": list(RACE_SENSORS),
            "world": settings.world_name,
            "off_track_penalty_s": settings.eval_off_track_penalty,
            "collision_penalty_s": settings.eval_collision_penalty,
            "obstacles": settings.oa_number_of_obstacles,
            "bots": settings.h2b_number_of_bot_cars,
            "racer": settings.racer_name,
            "model": settings.model_prefix,
        }

    def check(_: Request, body: dict[str, Any]) -> Any:
        settings = reader.folder.settings()
        rules = rules_of(settings, options_of_form(body, reader.clock()), reader.clock())
        return {
            "race": race_id(rules.name),
            "rules": rules,
            "words": words_of_rules(rules),
            "settings": shown_settings(rules),
        }

    def create(_: Request, body: dict[str, Any]) -> Any:
        now = reader.clock()
        options = options_of_form(body, now)
        settings, bucket = reader.open()
        return {"race": create_race(settings, bucket, options, now_s=now).race}

    def models(_: Request) -> Any:
        settings = reader.folder.settings()
        bucket = open_running_bucket(settings.storage)
        return {"models": [] if bucket is None else list_models(bucket).models}

    return [
        Route("/api/races", answers(lambda _: reader.races())),
        Route("/api/races", accepts(create), methods=["POST"]),
        Route("/api/races/form", answers(form)),
        Route("/api/races/check", accepts(check), methods=["POST"]),
        Route("/api/races/models", answers(models)),
    ]


def _race_routes(reader: RaceReader) -> Sequence[BaseRoute]:
    def submit(request: Request, body: dict[str, Any]) -> Any:
        settings, bucket = reader.open()
        taken = submissions.submit(
            settings,
            bucket,
            race_of(request),
            prefix=text_of(body, "prefix"),
            checkpoint=text_of(body, "checkpoint", "best"),
            racer=text_of(body, "racer"),
            now_s=reader.clock(),
        )
        return {"taken": taken, "race": reader.view(taken.race)}

    def changed(change: Callable[[RaceReader, str, dict[str, Any]], None]) -> Any:
        def handle(request: Request, body: dict[str, Any]) -> Any:
            race = race_of(request)
            change(reader, race, body)
            return {"race": reader.view(race)}

        return handle

    def run(request: Request, body: dict[str, Any]) -> Any:
        race = race_of(request)
        video = body.get("video")
        if video not in (None, True, False):
            raise BadRequest("The video is true, false or null.")
        name = read_rules(_bucket_of(reader), race).name

        def launch(progress: Callable[[str], None]) -> Any:
            settings, bucket = reader.open()
            progress("starts the process that drives it.")
            return queue_process.launch_queue(settings, bucket, race, video=video)

        return {"task": reader.folder.tasks.start("race-run", race, f"Queue of {name}", launch).id}

    def delete(request: Request) -> Any:
        _, bucket = reader.open()
        dry_run = "dry_run" in request.query_params
        return delete_race(bucket, race_of(request), dry_run=dry_run)

    return [
        Route("/api/race/{race}", answers(lambda request: reader.view(race_of(request)))),
        Route("/api/race/{race}", answers(delete), methods=["DELETE"]),
        Route("/api/race/{race}/submit", accepts(submit), methods=["POST"]),
        Route("/api/race/{race}/run", accepts(run), methods=["POST"]),
        *(
            Route(f"/api/race/{{race}}/{name}", accepts(changed(change)), methods=["POST"])
            for name, change in _CHANGES.items()
        ),
        Route("/api/race/{race}/rules", answers(lambda request: _rules(reader, request))),
    ]


def _withdraw(reader: RaceReader, race: str, body: dict[str, Any]) -> None:
    submissions.withdraw(reader.open()[1], race, text_of(body, "submission"))


def _move(reader: RaceReader, race: str, body: dict[str, Any]) -> None:
    place = whole_number(body, "place")
    if place is None:
        raise BadRequest("The request needs a place.")
    submissions.move(reader.open()[1], race, text_of(body, "submission"), place)


def _restart(reader: RaceReader, race: str, body: dict[str, Any]) -> None:
    submissions.restart(reader.open()[1], race, text_of(body, "submission"))


def _stop(reader: RaceReader, race: str, _: dict[str, Any]) -> None:
    queue_process.stop_queue(reader.open()[1], race)


def _open(reader: RaceReader, race: str, body: dict[str, Any]) -> None:
    now, closes = reader.clock(), text_of(body, "closes", "").strip()
    until = parse_time("--closes", closes, now) if closes else None
    open_race(reader.open()[1], race, until, now_s=now)


def _close(reader: RaceReader, race: str, _: dict[str, Any]) -> None:
    close_race(reader.open()[1], race, now_s=reader.clock())


def _change_rules(reader: RaceReader, race: str, body: dict[str, Any]) -> None:
    now = reader.clock()
    settings, bucket = reader.open()
    change_rules(settings, bucket, race, options_of_form(body, now), now_s=now)


_CHANGES: dict[str, Callable[[RaceReader, str, dict[str, Any]], None]] = {
    "withdraw": _withdraw,
    "move": _move,
    "restart": _restart,
    "stop": _stop,
    "open": _open,
    "close": _close,
    "rules": _change_rules,
}


def _rules(reader: RaceReader, request: Request) -> Any:
    rules = read_rules(_bucket_of(reader), race_of(request))
    conditions = settings_of_rules(reader.folder.settings(), rules)
    objects = {
        "obstacles": conditions.oa_number_of_obstacles
        if rules.race_type == "OBJECT_AVOIDANCE"
        else None,
        "bots": conditions.h2b_number_of_bot_cars if rules.race_type == "HEAD_TO_BOT" else None,
    }
    return {"wish": options_of(rules), **objects}


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
        bucket = _bucket_of(reader)
        return copies.answer(bucket, key, media_type="video/mp4", filename=file)

    def table(request: Request) -> Any:
        race = race_of(request)
        return _file(csv_of(reader.report(race)), "text/csv", f"{race}.csv")

    def page(request: Request) -> Any:
        race = race_of(request)
        report = reader.report(race)
        films = {}
        if request.query_params.get("videos") == "1":
            films = videos_of(report, _bucket_of(reader))
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


def _bucket_of(reader: RaceReader) -> Any:
    settings = reader.folder.settings()
    found = open_running_bucket(settings.storage)
    if found is None:
        raise SettingsError(
            f"There is no bucket {settings.bucket} yet.",
            remedy="Train a model, or import one, and make a race.",
        )
    return found


def race_of(request: Request) -> str:
    race = request.path_params["race"]
    if not is_race_id(race):
        raise BadRequest("This is not the id of a race.", 404)
    return str(race)
