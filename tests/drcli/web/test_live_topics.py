"""Live workers on the WebSocket: pictures, scenes, the choice of a car, and their end."""

import json

import pytest

from drcli.live.live_record import LiveMessage
from drcli.web import live_topics
from drcli.web.live_topics import LiveText
from live_worker import SmallDrive, shown, until

TOPICS = [f"live:0:sim-0:{view}" for view in ("camera", "scene", "state")]


def picture_of(data):
    """Header and JPEG of a binary message."""
    length = int.from_bytes(data[:2], "big")
    return json.loads(data[2 : 2 + length]), data[2 + length :]


@pytest.fixture
def drive():
    drive = SmallDrive()
    yield drive
    drive.close()


def test_a_page_gets_pictures_scenes_and_states_and_hears_of_the_end(served, drive):
    with served.watching(*TOPICS, "workers") as page:
        assert page.next("workers")["workers"] == []
        with shown(served.folder) as (show, _):
            worker = page.next("workers", lambda found: found["workers"])["workers"][0]
            assert worker == {"run_id": 0, "worker": "sim-0", "car": None}
            state = page.next("live:0:sim-0:state", lambda data: "state" in data)
            assert state["state"]["worker"] == "sim-0"
            until(lambda: show.wanted)
            found, scenes = {}, []
            while "live:0:sim-0:camera" not in found or not scenes:
                drive.episodes(show)
                data = page.connection.recv(timeout=20.0)
                if isinstance(data, bytes):
                    header, jpeg = picture_of(data)
                    found[header["topic"]] = header, jpeg
                elif json.loads(data)["topic"] == "live:0:sim-0:scene":
                    scenes.append(json.loads(data)["data"])
            header, jpeg = found["live:0:sim-0:camera"]
            assert jpeg.startswith(b"\xff\xd8")
            assert (header["width"], header["height"]) == (160, 120)
            assert header["step_s"] > 0
            assert scenes[0]["scene"]["world"] == "reinvent_base"
            assert scenes[0]["car"] == scenes[0]["scene"]["shown"]["car"]
            page.watch("live:0:sim-0:state", "workers")
            until(lambda: not show.wanted)
        page.watch("workers", "live:0:sim-0:state")
        assert page.next("live:0:sim-0:state", lambda data: data.get("gone"))
        assert page.next("workers", lambda found: not found["workers"])


def test_two_pages_cost_one_connection_and_a_car_is_chosen_for_both(served, drive):
    import urllib.request

    with (
        shown(served.folder) as (show, _),
        served.watching("live:0:sim-0:scene", "workers") as page,
        served.watching("live:0:sim-0:scene") as other,
    ):
        until(lambda: show.wanted)
        body = json.dumps({"run_id": 0, "worker": "sim-0", "car": 1}).encode()
        headers = {"Origin": served.url, "Content-Type": "application/json"}
        request = urllib.request.Request(f"{served.url}/api/live/car", body, headers)
        with urllib.request.urlopen(request, timeout=20.0) as answer:
            assert json.load(answer) == {"run_id": 0, "worker": "sim-0", "car": 1}
        assert page.next("workers", lambda found: found["workers"][0]["car"] == 1)
        [viewer] = show._server.viewers
        until(lambda: viewer.request.car == 1)
        for _ in range(3):
            drive.episodes(show)
        assert other.next("live:0:sim-0:scene", lambda data: data["car"] == 1)


@pytest.mark.parametrize(
    "topic",
    [
        "live",
        "live:0:sim-0",
        "live:0:sim-0:video",
        "live:100:sim-0:scene",
        "live:0:../x:scene",
        "live:-1:sim-0:scene",
        "workers:0",
        "log:0:passwd",
        "log:0:../../x",
        "episodes",
        "laps:0",
        "elsewhere:x",
    ],
)
def test_wrong_topics_are_refused(served, topic):
    with served.watching(topic) as page:
        assert "no such topic" in page.next(topic)["error"]["message"]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ({}, "run_id"),
        ({"run_id": True, "worker": "sim-0"}, "run_id"),
        ({"run_id": 0, "worker": "../x"}, 'worker="../x" should match'),
        ({"run_id": 0, "worker": "sim-0", "car": -1}, "car=-1 should be"),
        ({"run_id": 0, "worker": "sim-0", "car": "1"}, "should be a valid integer"),
        ({"run_id": 0, "worker": "sim-0", "car": 1}, "does not run now"),
    ],
)
def test_a_wrong_choice_of_a_car_is_a_sentence(client, body, said):
    answer = client.post("/api/live/car", json=body)

    assert answer.status_code in (400, 404)
    assert said in answer.json()["error"]["message"]


def test_runs_of_the_folder_are_listed_with_their_states(served, make_run_record):
    make_run_record(3, "finished")
    with served.watching("workers") as page:
        [run] = page.next("workers", lambda found: found["runs"])["runs"]

    assert (run["run_id"], run["prefix"], run["state"], run["alive"]) == (
        3,
        "model-3",
        "finished",
        False,
    )


@pytest.fixture
def make_run_record(served):
    from drcli.records.run_record import RunRecord, run_folder

    def make(run_id, state):
        folder = run_folder(served.folder, run_id)
        folder.mkdir(parents=True)
        RunRecord(
            run_id=run_id,
            session="s",
            bucket="bucket",
            prefix=f"model-{run_id}",
            world="reinvent_base",
            state=state,
            pid=1,
            pid_started=0.0,
            started_at=1.0,
            ended_at=2.0,
        ).write(folder)

    return make


def test_a_damaged_scene_is_no_message():
    damaged = LiveText("live:0:sim-0:scene", "sim-0", LiveMessage("scene", 1.0, b"{"))

    assert damaged.message(None)[0] is None
    assert live_topics.WORKER_NAME.fullmatch("evaluation-20260102030405")
