"""Races as the page asks for them: the same functions as `dr-race`, with the same refusals."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.testclient import TestClient

from drcli.model import race_keys
from drcli.races.race_records import DrivenCar, RaceResult
from drcli.races.stored_race import put, read_race
from drcli.web.race_reader import RaceRun, RunCar, films_of
from drcli.web.race_routes import RaceForm
from home_races import RACE, Home, lap

BASE = "http://127.0.0.1:8100"


@pytest.fixture
def folder(home: Home) -> Path:
    return home.folder


def post(client: TestClient, path: str, **body: Any) -> Any:
    answer = client.post(f"/api/{path}", json=body)
    assert answer.status_code == 200, answer.text
    return answer.json()


def refusal(answer: Any, status: int = 422) -> str:
    assert answer.status_code == status, answer.text
    error = answer.json()["error"]
    return f"{error['message']} {error['remedy']}"


def test_a_race_from_its_form_to_its_end(home, client):
    assert client.get("/api/races").json() == {"bucket": "bucket", "races": [], "damaged": []}
    checked = post(client, "races/check", name="Cup", max_laps=2, ranking="total-time")
    assert checked["race"] == RACE
    assert checked["words"]["decides"] == "Total time of 2 laps, all complete."
    assert not home.bucket.list("races/")

    made = post(client, "races", name="Cup", max_laps=2, off_track_penalty_s=1.5)
    assert made == {"race": RACE}
    taken = post(client, "race/cup/submit", prefix="ann", racer="Ann", checkpoint="5")["taken"]
    assert (taken["racer"], taken["checkpoint"]) == ("Ann", "5_Step-500.ckpt")
    home.submit("bob")  # a command in another shell
    home.laps = {"ann": [9.0, 8.5], "bob": [7.0, 7.5]}
    waiting = client.get("/api/race/cup").json()
    assert waiting["rules"]["off_track_penalty_s"] == 1.5
    assert waiting["changeable"]
    home.run()
    closed = post(client, "race/cup/close")["race"]

    assert [row["racer"] for row in closed["leaderboard"]] == ["Bob", "Ann"]
    assert (closed["winner"], closed["state"]) == ("Bob", "finished")
    assert closed["words"]["standing"] == "Winner: Bob."
    last = closed["moments"]["last"]
    assert (last["cars"][0]["racer"], last["cars"][0]["best_lap_s"]) == ("Bob", 7.0)
    assert (closed["moments"]["driving"], closed["changeable"]) == (None, False)
    listed = client.get("/api/races").json()["races"][0]
    assert (listed["leader"], listed["leader_s"]) == ("Bob", 7.0)


@pytest.mark.parametrize(
    ("form", "why"),
    [
        ({"name": ""}, "is empty"),
        ({"max_laps": 0}, "“Laps” 0 is not from 1 to 100"),
        ({"min_laps": 9}, "“Complete laps needed” 9 is not from 1 to 3"),
        ({"closes": "yesterday"}, "“Closes” yesterday is neither"),
        ({"opens": "2h", "closes": "1h"}, "before it opens"),
        ({"sensors": ["EYES"]}, "EYES is not a sensor"),
        ({"obstacles": 2}, "“Obstacles” needs “Kind of race” OBJECT_AVOIDANCE"),
        ({"race_type": "OBJECT_AVOIDANCE", "obstacles": -1}, "“Obstacles”=-1"),
    ],
)
def test_a_rule_that_is_wrong_is_said_before_anything_is_written(home, client, form, why):
    for path in ("races/check", "races"):
        assert why in refusal(client.post(f"/api/{path}", json={"name": "Cup", **form}))
    assert not home.bucket.list("races/")


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("races", {"name": 5}),
        ("races", {"name": "Cup", "max_laps": "3"}),
        ("races", {"name": "Cup", "max_laps": 2.5}),
        ("races", {"name": "Cup", "max_laps": 1e300}),
        ("races", {"name": "Cup", "reverse": 1}),
        ("races", {"name": "Cup", "sensors": "LIDAR"}),
        ("races", {"name": "Cup", "ranking": "beauty"}),
        ("race/cup/move", {"submission": "1"}),
        ("race/cup/withdraw", {}),
        ("race/cup/run", {"video": "maybe"}),
    ],
)
def test_requests_that_the_page_would_not_send_are_refused(home, client, path, body):
    home.race()
    assert client.post(f"/api/{path}", json=body).status_code == 400


def test_a_race_that_does_not_exist_is_one_sentence(client):
    assert "There is no race nothing" in refusal(client.get("/api/race/nothing"))
    for path in ("race/NOT%20an%20id", "race/..%2f..%2fann", "race/x/video?name=..%2f..%2fann"):
        assert client.get(f"/api/{path}").status_code in (404, 422)


def test_the_queue_is_reordered_and_submissions_come_and_go(home, client):
    home.race()
    ids = [home.submit(name) for name in ("ann", "bob", "cem")]

    moved = post(client, "race/cup/move", submission=ids[2], place=1)["race"]
    left = post(client, "race/cup/withdraw", submission=ids[0])["race"]
    home.run()
    again = post(client, "race/cup/restart", submission=ids[1])["race"]

    assert moved["queue"] == [ids[2], ids[0], ids[1]]
    assert left["queue"] == [ids[2], ids[1]]
    assert again["queue"] == [ids[1]]
    why = refusal(client.post("/api/race/cup/move", json={"submission": ids[2], "place": 1}))
    assert "does not wait" in why


def test_rules_can_be_changed_until_somebody_has_driven(home, client):
    home.race()
    home.submit("ann")
    before = read_race(home.bucket, RACE).rules
    fields = client.get("/api/race/cup/rules").json()["fields"]

    form = {each["name"]: each["value"] for each in fields}
    form = {**form, "max_laps": 5, "opens": "", "closes": ""}
    changed = post(client, "race/cup/rules", **form)["race"]["rules"]
    assert (changed["max_laps"], changed["average_laps"], changed["changes"]) == (5, 3, 1)
    assert changed["seed"] == before.seed == 1
    assert changed["created_at"] == before.created_at
    assert changed["settings"] == before.settings
    restricted = client.post("/api/race/cup/rules", json={**form, "sensors": ["LIDAR"]})
    assert "has submissions" in refusal(restricted)
    home.laps = {"ann": [9.0] * 5}
    home.run()
    assert "its rules are fixed" in refusal(client.post("/api/race/cup/rules", json=form))


def test_a_race_is_opened_again_until_a_time(home, client):
    home.race()
    post(client, "race/cup/close")
    assert "was closed" in refusal(client.post("/api/race/cup/close", json={}))
    assert post(client, "race/cup/open", closes="2h")["race"]["state"] == "open"
    assert "has passed" in refusal(
        client.post("/api/race/cup/open", json={"closes": "2020-01-01T00:00:00Z"})
    )


def test_videos_are_served_in_ranges_and_only_those_of_the_race(home, client):
    home.race()
    name = home.submit("ann")
    stored = read_race(home.bucket, RACE)
    video = stored.find(name)
    home.bucket.put(race_keys.video(RACE, video), bytes(range(200)))
    home.bucket.put("races/other/videos/secret.mp4", b"secret")

    part = client.get(f"/api/race/cup/video?name={video}", headers={"range": "bytes=10-19"})
    whole = client.get(f"/api/race/cup/video?name={video}&download")

    assert (part.status_code, part.content) == (206, bytes(range(10, 20)))
    assert part.headers["content-range"] == "bytes 10-19/200"
    assert whole.content == bytes(range(200))
    assert whole.headers["content-disposition"].startswith("attachment")
    for wrong in ("", "x", "../../other/videos/secret", "..%2f..%2fother%2fvideos%2fsecret"):
        assert client.get(f"/api/race/cup/video?name={wrong}").status_code == 404


def test_exports_are_files_to_keep(home, client):
    home.race()
    home.submit("ann", "=HYPERLINK(1)")
    home.run()
    table = client.get("/api/race/cup/table.csv")
    page = client.get("/api/race/cup/page.html?videos=1")

    assert table.headers["content-disposition"] == 'attachment; filename="cup.csv"'
    assert "'=HYPERLINK(1)" in table.text
    assert page.headers["content-disposition"] == 'attachment; filename="cup.html"'
    assert page.text.startswith("<!doctype html>")


def test_a_race_is_deleted_after_the_page_has_said_what_goes(home, client):
    home.race()
    home.submit("ann")
    planned = client.get("/api/race/cup/question?about=delete").json()
    assert home.bucket.list("races/")
    assert planned["danger"]
    objects = client.delete("/api/race/cup").json()["objects"]
    assert planned["intro"].startswith(f"{objects} objects (")
    assert not home.bucket.list("races/")
    assert "There is no race" in refusal(client.delete("/api/race/cup"))


def test_the_queue_is_driven_as_a_task_and_what_it_writes_appears(home, client, monkeypatch):
    home.race()
    home.submit("ann")
    asked = []

    def launch(settings: Any, bucket: Any, race: str, *, video: bool | None) -> dict[str, str]:
        asked.append((settings.directory, race, video))
        (name,) = read_race(bucket, race).submissions
        result = RaceResult("done", "s", 0, 1.0, 2.0, [DrivenCar(name, [lap(9.0)])])
        put(bucket, race_keys.result(race, name), result)
        return {"race": race}

    monkeypatch.setattr("drcli.races.queue_process.launch_queue", launch)
    monkeypatch.setattr("drcli.web.race_routes.RACE_S", 0.05)
    with client.websocket_connect("ws://127.0.0.1:8100/ws", headers={"origin": BASE}) as socket:
        socket.send_text(json.dumps({"watch": ["race:cup", "race:NO", "race:other"]}))
        number = post(client, "race/cup/run", video="no")["task"]
        seen: dict[str, Any] = {}
        for _ in range(20):  # at most; a value comes only when it has changed
            message = json.loads(socket.receive_text())
            seen[message["topic"]] = message["data"]
            if seen.get("race:cup", {}).get("leaderboard") and len(seen) == 3:
                break

    assert asked == [(home.folder, "cup", False)]
    assert seen["race:cup"]["leaderboard"][0]["racer"] == "Ann"
    assert "no such topic" in seen["race:NO"]["error"]["message"]
    message = seen["race:other"]["error"]["message"]
    assert "There is no race other in s3://bucket. It has cup." in message
    assert client.get(f"/api/tasks/{number}").json()["subject"] == "cup"
    assert "No process drives" in refusal(client.post("/api/race/cup/stop", json={}), 500)


def test_what_a_submission_may_be_made_of(home, client, monkeypatch):
    tracks = SimpleNamespace(tracks=[SimpleNamespace(name="bean")])  # measuring takes seconds
    monkeypatch.setattr("drcli.web.race_routes.list_tracks", lambda *_: tracks)
    home.race()
    query = {"about": "submit", "prefix": "bob"}
    asked = client.get("/api/race/cup/question", params=query).json()["fields"]
    racer, prefix, checkpoint = (each | {"more": None} for each in asked)
    assert (racer["value"], prefix["value"]) == ("Ann", "bob")
    assert prefix["options"] == ["ann", "bob", "cem"]
    assert checkpoint["options"][0] == ["best", "the best: 5, not evaluated by its training"]
    form = client.get("/api/races/form").json()
    fields = {each["name"]: each for each in form["fields"]}
    assert (fields["world"]["value"], fields["world"]["options"]) == ("bean", ["bean"])
    assert fields["bots"]["only"] == ["race_type", ["HEAD_TO_BOT"]]
    assert set(fields) == set(RaceForm.model_fields)


def test_what_the_page_asks_about_a_race_is_said_here(home, client):
    home.race()
    home.submit("ann")

    run, taking, page = (
        client.get(f"/api/race/cup/question?about={about}").json()
        for about in ("run", "open", "page")
    )

    assert run["intro"].startswith("1 run waits in the queue.")
    assert [each["name"] for each in run["fields"] + taking["fields"]] == ["video", "closes"]
    assert (page["fields"], "no videos" in page["intro"]) == ([], True)
    assert client.get("/api/race/cup/question?about=sale").status_code == 400


def test_the_log_of_the_queue_is_shown_from_its_end(home, client):
    home.race()
    assert client.get("/api/race/cup/log").json()["text"] is None
    path = home.folder / "data" / "logs" / "races" / "cup.log"
    path.parent.mkdir(parents=True)
    path.write_text("".join(f"line {number}\n" for number in range(5000)))
    text = client.get("/api/race/cup/log").json()["text"]
    assert text.startswith("line ")
    assert text.endswith("line 4999\n")
    assert len(text) <= 20_000


def test_a_damaged_record_is_said_and_the_race_is_shown(home, client):
    home.race()
    home.submit("ann")
    name = race_keys.result(RACE, "000000000000000001-0000abcd")
    home.bucket.put(name, b"{")
    shown = client.get("/api/race/cup").json()
    assert len(shown["submissions"]) == 1
    assert "is damaged" in shown["damaged"][0]


def test_a_race_in_pairs_has_its_bracket(home, client):
    home.race(race_type="HEAD_TO_MODEL", pairing="bracket")
    for name in ("ann", "bob", "cem"):
        home.submit(name)
    before = client.get("/api/race/cup").json()
    home.laps = {"ann": [9.0, 9.0], "bob": [7.0, 7.0], "cem": [8.0, 8.0]}
    home.run()
    after = client.get("/api/race/cup").json()

    assert [pair["state"] for pair in before["pairs"]] == ["alone", "queued", "waiting"]
    assert not before["drawn"]
    assert after["drawn"]
    assert after["leaderboard"][0]["racer"] == "Bob"
    assert len(after["moments"]["last"]["cars"]) == 2


def test_names_of_racers_are_data(home, client):
    home.race()
    name = home.submit("ann", "<img src=x>")
    stored = read_race(home.bucket, RACE)
    put(
        home.bucket,
        race_keys.submission(RACE, stored.find(name)),
        stored.submissions[stored.find(name)],
    )
    answer = client.get("/api/race/cup")
    assert answer.headers["content-type"] == "application/json"
    assert answer.json()["submissions"][0]["racer"] == "<img src=x>"


def test_both_cars_of_a_pair_are_filmed():
    pair = SimpleNamespace(first="a", second="b", videos=["1", "2"])
    report: Any = SimpleNamespace(submissions=[], pairs=[pair])
    run = RaceRun("a+b-0-x", "done", 1.0, 2.0, [RunCar("a", "Ann", "x"), RunCar("b", "Bob", "y")])

    assert films_of(report, run) == ["1", "2"]
    assert films_of(report, None) == films_of(report, replace(run, state="failed")) == []
