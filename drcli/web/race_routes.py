"""Topics `races` and `race:ID`, and everything that `dr-race` does."""

import time
from collections.abc import Callable, Sequence
from typing import Any

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from drcli.base.errors import SettingsError
from drcli.models.checkpoint_choice import best_and_last
from drcli.models.model_list import list_models
from drcli.races import queue_process, submissions
from drcli.races.organise import close_race, create_race, delete_race, open_race
from drcli.races.race_export import csv_of, videos_of
from drcli.races.race_page import race_page
from drcli.races.race_settings import settings_of_rules, shown_settings
from drcli.races.race_times import parse_time
from drcli.races.race_wish import SENSORS, rules_of
from drcli.races.rules_change import change_rules, wish_of
from drcli.races.stored_race import is_race_id, race_id, read_rules
from drcli.store import keys, race_keys
from drcli.store.repair import Model
from drcli.tracks.track_list import list_tracks
from drcli.web.answers import BadRequest, accepts, answers, text_of
from drcli.web.hub import Polled, Publish
from drcli.web.object_range import ObjectCopies
from drcli.web.race_forms import whole_number, wish_of_form
from drcli.web.race_reader import RaceReader, words_of_rules
from drcli.web.served_folder import ServedFolder
from drcli.web.topics import Snapshot

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
            "tracks": tracks,
            "sensors": list(SENSORS),
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
        rules = rules_of(settings, wish_of_form(body, reader.clock()), reader.clock())
        return {
            "race": race_id(rules.name),
            "rules": rules,
            "words": words_of_rules(rules),
            "settings": shown_settings(rules),
        }

    def create(_: Request, body: dict[str, Any]) -> Any:
        now = reader.clock()
        wish = wish_of_form(body, now)
        settings, bucket = reader.open()
        return {"race": create_race(settings, bucket, wish, now_s=now).race}

    def models(_: Request) -> Any:
        settings = reader.folder.settings()
        bucket = reader.to_look_at(settings)
        return {"models": [] if bucket is None else list_models(bucket).models}

    def checkpoints(request: Request) -> Any:
        prefix = request.query_params.get("prefix", "")
        if not keys.is_valid_prefix(prefix):
            raise BadRequest("This is not the name of a model.")
        bucket = reader.to_look_at(reader.folder.settings())
        listed = [] if bucket is None else bucket.list(keys.model_folder(prefix))
        names = {keys.checkpoint_of(prefix, info.key) for info in listed}
        numbers = sorted({name.number for name in names if name is not None}, reverse=True)
        about = ""
        if bucket is not None:
            about = best_and_last(Model(bucket, prefix, keys.metrics_prefix(prefix)))
        return {"checkpoints": numbers, "about": about}

    return [
        Route("/api/races", answers(lambda _: reader.races())),
        Route("/api/races", accepts(create), methods=["POST"]),
        Route("/api/races/form", answers(form)),
        Route("/api/races/check", accepts(check), methods=["POST"]),
        Route("/api/races/models", answers(models)),
        Route("/api/races/checkpoints", answers(checkpoints)),
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
    change_rules(settings, bucket, race, wish_of_form(body, now), now_s=now)


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
    return {"wish": wish_of(rules), **objects}


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
    found = reader.to_look_at(settings)
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
