"""What the console answers about models, and what it refuses."""

import json
from statistics import mean

import pytest

from drcli.model import keys
from drcli.records.episode_metrics import EpisodeMetrics, encode_metrics
from drcli.records.iteration import share_interval
from drcli.transfer.report_place import report_file
from drcli.web.page_words import for_page
from stored_models import STAMP, StoredModels

PREFIX = "team/model-1"

FOREIGN = (
    "..",
    "../..",
    "/etc",
    "team/../..",
    "team//model",
    "",
    "a\0b",
    "team/model-1/..",
    "*",
    "team/model-1/model/../../x",
    "s3://bucket/team",
    "x" * 600,
    "team/model-1\n",
    "%2e%2e",
)

NO_VIDEOS = (
    "reward_function.py",
    "../other/video.mp4",
    "evaluation-1/video.mp4",
    "",
    "/etc/passwd",
    f"evaluation-{STAMP}/../video.mp4",
    "mp4/camera-pip/../../x.mp4",
    "model/model_0.pb",
    "mp4/camera-pip/0-video.mp4",
)


@pytest.fixture
def models(working_folder):
    stored = StoredModels(working_folder)
    stored.model(PREFIX)
    stored.evaluation(PREFIX)
    return stored


FIRST_FIGURES = ["Best clean lap", "Best checkpoint", "Last checkpoint"]


def about(client, part="", **query):
    path = f"/api/model/{part}" if part else "/api/model"
    return client.get(path, params={"prefix": PREFIX, **query})


def test_the_list_has_every_model_with_its_checkpoints_and_training(client, models):
    models.model("other")

    found = client.get("/api/models").json()

    assert [each["model"]["prefix"] for each in found["models"]] == ["other", PREFIX]
    model = found["models"][1]["model"]
    assert (model["checkpoints"], model["best"]["metric"], model["training"]) == (2, 42.0, False)
    assert found["models"][1]["training"]["best_lap_s"] == 12.5  # 12.345 is not clean
    assert found["models"][1]["laps"] == 2
    assert found["models"][1]["badges"] == []


def test_an_empty_bucket_has_an_empty_list(client, working_folder):
    StoredModels(working_folder)

    assert client.get("/api/models").json()["models"] == []


def test_broken_settings_are_one_sentence_with_a_remedy(client, working_folder):
    (working_folder / "run.env").write_text("DR_WORKERS=many\n")

    answer = client.get("/api/models")

    assert answer.status_code == 422
    assert "DR_WORKERS" in answer.json()["error"]["message"]
    assert answer.json()["error"]["remedy"]


@pytest.mark.usefixtures("models")
def test_a_model_is_described_with_the_name_of_its_next_clone(client):
    found = about(client).json()
    query = {"prefix": PREFIX, "about": "clone"}
    asked = client.get("/api/model/question", params=query).json()

    assert found["model"]["prefix"] == PREFIX
    assert asked["fields"][0]["value"] == "team/model-2"
    assert found["training"]["iterations"] == 2
    assert ["Best clean lap", "00:12.500"] in found["figures"]
    assert [name for name, _ in found["figures"]][:3] == FIRST_FIGURES


@pytest.mark.usefixtures("models")
def test_checkpoints_are_those_of_the_command(client, dr, capsys):
    found = about(client, "checkpoints").json()

    dr("list-checkpoints", PREFIX, "--json")
    options = dict(found.pop("options"))
    assert list(options)[:2] == ["best", "last"]
    assert found.pop("actions")[0] == ["evaluate", "Evaluate"]
    assert found.pop("marks")["0"][0] == ["best", "Checkpoint the best"]
    assert found == for_page(json.loads(capsys.readouterr().out))


def test_the_reward_graph_has_episodes_means_and_the_best_checkpoint(client, models):
    episodes = [
        EpisodeMetrics(10.0 + n, 0, 0, 1000, n, n, phase, 20 * n, "Off track", 0)
        for n, phase in ((1, "training"), (2, "evaluation"))
    ]
    models.put(f"{PREFIX}/metrics/TrainingMetrics.json", encode_metrics(episodes, "progress"))

    found = about(client, "curve").json()

    first, second = found["iterations"]
    assert (first["mean_reward"], second["mean_reward"]) == (10.0, 11.0)
    assert mean(first["evaluation_progress"]) == 75.0
    assert first["clean_share"] == [100 * each for each in (0.5, *share_interval(1, 2))]
    assert found["episodes"] == [[0, 0, 11.0, 20], [0, 1, 12.0, 40]]
    assert found["best"].startswith("0_")


def test_a_damaged_learning_curve_is_reported_and_the_rest_shown(client, models):
    models.put(keys.history(PREFIX), b'{"iterations": [{')

    found = about(client, "curve").json()

    assert found["iterations"] == []
    assert "damaged" in found["damaged"][0]


@pytest.mark.usefixtures("models")
def test_an_evaluation_has_trials_penalties_and_its_video(client):
    found = about(client, "evaluations").json()

    one = found["evaluations"][0]
    assert (one["stamp"], one["world"], one["best_finished_s"]) == (STAMP, "reinvent_base", 12.345)
    assert (one["clean_laps"], one["best_lap_s"]) == (0, None)
    assert one["label"].endswith("reinvent_base · checkpoint 0 · 0 of 1 lap clean")
    assert one["rows"][0][3] == "Finished"
    assert ["Best clean lap", "–", None] in one["figures"]
    assert one["summary"].endswith("the fastest in 12.35 s, 1 reset")
    assert one["trials"][0]["off_track"] == 1
    assert (one["off_track_penalty_s"], one["collision_penalty_s"]) == (5.0, 3.0)
    assert (one["video"], one["trace"]) == (True, False)
    assert found["videos"] == [f"evaluation-{STAMP}/video.mp4"]


def test_a_damaged_evaluation_says_so_and_others_are_shown(client, models):
    models.put(keys.evaluation_metrics(f"{PREFIX}/metrics", "20260102030406"), b"{")

    damaged, whole = about(client, "evaluations").json()["evaluations"]

    assert "damaged" in damaged["problem"]
    assert whole["problem"] == ""


def test_files_are_compared_with_another_model(client, models):
    models.model("parent")
    models.put(keys.hyperparameters("parent"), {"lr": 0.01})

    found = about(client, "difference", other="parent").json()

    lr = next(row for row in found["sections"]["Hyperparameters"] if row[0] == "lr")
    assert lr[1] == "0.01"
    assert found["results"][0][0] == "track"
    assert about(client, "files").json()["files"]["reward_function.py"].startswith("def reward")


def test_a_video_is_sent_in_parts(client, models):
    name = f"evaluation-{STAMP}/video.mp4"

    part = client.get(
        "/api/model/video", params={"prefix": PREFIX, "name": name}, headers={"range": "bytes=3-6"}
    )
    assert (part.status_code, part.content) == (206, bytes(range(3, 7)))
    assert part.headers["content-range"] == "bytes 3-6/256"

    models.put(f"{PREFIX}/{name}", b"another video")
    assert about(client, "video", name=name).content == b"another video"


@pytest.mark.usefixtures("models")
def test_only_videos_of_the_model_are_sent(client):
    for name in NO_VIDEOS:
        assert about(client, "video", name=name).status_code == 404, name


@pytest.mark.usefixtures("models")
def test_what_is_no_model_is_refused(client):
    for part in ("", "checkpoints", "files", "report"):
        for prefix in FOREIGN:
            path = f"/api/model/{part}".rstrip("/")
            answer = client.get(path, params={"prefix": prefix})

            assert answer.status_code in (400, 404), (part, prefix)
            assert answer.json()["error"]["message"]


def test_a_folder_of_the_bucket_that_is_no_model_is_not_read(client, models):
    for prefix in ("custom_files", "runs", "training-records", "team", "model/x"):
        models.put(f"{prefix}/reward_function.py", "secret")

        answer = client.get("/api/model/files", params={"prefix": prefix})

        assert answer.status_code == 404, prefix
        assert "secret" not in answer.text


@pytest.mark.usefixtures("models")
def test_the_report_is_shown_in_a_sandbox(client, working_folder):
    assert about(client, "report").status_code == 404
    path = report_file(working_folder, PREFIX)
    path.parent.mkdir(parents=True)
    path.write_text("<!doctype html><script>alert(1)</script>")

    answer = about(client, "report")

    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts; default-src 'none'")
    assert "allow-same-origin" not in policy
    assert about(client, "report/about").json()["written"] == path.stat().st_mtime


@pytest.mark.usefixtures("models")
def test_a_report_that_is_a_link_out_of_its_folder_is_not_sent(client, working_folder):
    path = report_file(working_folder, PREFIX)
    path.parent.mkdir(parents=True)
    path.symlink_to(working_folder / "system.env")

    assert about(client, "report").status_code == 404


@pytest.mark.usefixtures("models")
def test_a_change_of_a_model_changes_the_signature_of_its_part(served, working_folder):
    with served.watching(f"model:{PREFIX}") as page:
        before = page.next(f"model:{PREFIX}")
        StoredModels(working_folder).evaluation(PREFIX, "20260102030407")
        after = page.next(f"model:{PREFIX}")

    assert (before["exists"], before["training"]) == (True, False)
    assert before["parts"]["evaluations"] != after["parts"]["evaluations"]
    assert before["parts"]["checkpoints"] == after["parts"]["checkpoints"]
