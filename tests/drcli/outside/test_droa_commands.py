"""The droa commands from the command line to a fake DeepRacer on AWS and back."""

import gzip
import io
import json
import tarfile
from pathlib import Path

import pytest

from droa_models import accepted_model
from droa_server import BUCKET, CLIENT, IDENTITIES, PASSWORD, POOL, REGION, STAGE, USER


def printed_json(capsys):
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def one_error(capsys):
    """The sentence and the remedy of a failed command, which prints nothing else."""
    printed = capsys.readouterr()
    lines = [line for line in printed.err.splitlines() if "Signing in" not in line]
    assert printed.out == ""
    error, remedy = lines[-2:]
    assert error.startswith("Error: ")
    assert remedy.startswith("  Try: ")
    return error.removeprefix("Error: "), remedy.removeprefix("  Try: ")


# Lists and single models.


def test_a_list_shows_all_pages_and_the_newest_model_first(droa, fake, capsys):
    for name in ("first", "second", "third", "fourth", "fifth"):
        fake.add_model(name)

    code = droa("droa-list-models")

    printed = capsys.readouterr().out.splitlines()
    names = [line.split()[0] for line in printed[2:]]
    assert code == 0
    assert names == ["fifth", "fourth", "third", "second", "first"]
    assert len(fake.calls) == 3


def test_a_list_in_json_has_the_keys_of_the_interface(droa, fake, capsys):
    model_id = fake.add_model("car")

    code = droa("droa-list-models", "--json")

    report = printed_json(capsys)
    assert code == 0
    assert report["site"] == fake.url
    assert report["models"] == [fake.models[model_id]]


def test_an_empty_account_is_said_to_be_empty(droa, capsys):
    assert droa("droa-list-models") == 0
    assert "There is no model" in capsys.readouterr().out


def test_a_model_is_shown_with_its_settings(droa, fake, capsys):
    model_id = fake.add_model(
        "car",
        "ERROR",
        importErrorMessage="Model validation failed",
        carCustomization={"carShell": "DEEPRACER", "carColor": "RED"},
        trainingConfig={"trackConfig": {"trackId": "reinvent_base"}, "maxTimeInMinutes": 60},
        metadata={
            "agentAlgorithm": "PPO",
            "hyperparameters": {"lr": 0.0003},
            "actionSpace": {"discrete": [{"speed": 1.5, "steeringAngle": -30}]},
            "rewardFunction": "def reward_function(params): return 1.0",
        },
    )

    assert droa("droa-get-model", model_id) == 0
    short = capsys.readouterr().out
    assert droa("droa-get-model", model_id, "--verbose") == 0
    long = capsys.readouterr().out

    for word in ("Model validation failed", "RED", "reinvent_base", "60 min", "PPO", "0.0003"):
        assert word in short
    assert "-30 degrees, 1.5 m/s" in long
    assert "def reward_function" in long
    assert "def reward_function" not in short


def test_a_model_in_json_has_all_that_the_interface_gives(droa, fake, capsys):
    model_id = fake.add_model("car", metadata={"agentAlgorithm": "SAC"})

    assert droa("droa-get-model", "car", "--json") == 0

    report = printed_json(capsys)
    assert report["values"] == fake.models[model_id]
    assert (report["model_id"], report["status"], report["means"]) == (model_id, "READY", [])


def test_a_name_that_two_models_have_is_not_guessed(droa, fake, capsys):
    ids = [fake.add_model("car"), fake.add_model("car")]

    code = droa("droa-get-model", "car")

    error, _ = one_error(capsys)
    assert code == 3
    assert all(model_id in error for model_id in ids)


@pytest.mark.parametrize("wanted", ["abcdefghijklmno", "no-such-model", "../users", "ä"])
def test_a_model_that_does_not_exist_is_said_to_be_missing(droa, fake, capsys, wanted):
    fake.add_model("car")

    code = droa("droa-get-model", wanted)

    error, remedy = one_error(capsys)
    assert code == 3
    assert "no model" in error
    assert "droa-list-models" in remedy


METRICS = {
    "metrics": [
        {
            "phase": phase,
            "reward_score": reward,
            "completion_percentage": progress,
            "elapsed_time_in_milliseconds": 12_500,
        }
        for phase, reward, progress in [
            ("training", 10, 50),
            ("training", 30, 100),
            ("evaluation", 7, 20),
        ]
    ]
}


def test_a_summary_has_the_means_of_each_phase(droa, fake, capsys):
    url = fake.add_file("/files/metrics.json", json.dumps(METRICS).encode())
    model_id = fake.add_model("car", trainingMetricsUrl=url)

    assert droa("droa-get-model", model_id, "--summary", "--json") == 0

    training, evaluation = printed_json(capsys)["means"]
    assert training == {
        "phase": "training",
        "episodes": 2,
        "mean_reward": 20.0,
        "mean_progress": 75.0,
        "full_laps": 1,
        "best_lap_s": 12.5,
        "clean_laps": 1,
    }
    assert evaluation["full_laps"] == 0
    assert evaluation["best_lap_s"] is None


def test_a_model_without_metrics_has_no_summary(droa, fake, capsys):
    fake.add_model("car", trainingMetricsUrl="")

    assert droa("droa-get-model", "car", "--summary") == 3
    assert "no training metrics" in one_error(capsys)[0]


# Imports.


def test_a_folder_is_imported_and_becomes_ready(droa, fake, laid, model, pauses, capsys):
    model |= {
        "output/model.tar.gz": b"not wanted",
        "old.ZIP": b"not wanted",
        ".DS_Store": b"not wanted",
        "model/Thumbs.db": b"not wanted",
    }

    code = droa("droa-import-model", "--from", str(laid(model)), "--json")

    report = printed_json(capsys)
    imported = fake.models[report["model_id"]]
    sent = {key.split("/", 3)[3]: data for key, data in fake.objects.items()}
    assert code == 0
    assert report["status"] == "READY"
    assert imported["name"] == "my-model"
    assert sent == accepted_model()
    assert all(key.startswith(f"{report['folder']}/") for key in fake.objects)
    assert report["uploaded_bytes"] == sum(map(len, sent.values()))
    assert pauses == [5.0] * fake.import_polls


def test_the_smallest_file_goes_first_and_types_are_named(droa, fake, laid, model):
    assert droa("droa-import-model", "--model-dir", str(laid(model)), "--no-wait") == 0

    first = next(iter(fake.objects.values()))
    assert len(first) == min(map(len, model.values()))
    kinds = {key.rpartition("/")[2]: kind for key, kind in fake.types.items()}
    assert kinds["model_metadata.json"] == "application/json"
    assert kinds["model_30.pb"] == "application/octet-stream"


def test_a_large_file_is_sent_in_parts(droa, fake, laid, model):
    weights = bytes(range(256)) * (9 << 12)  # 9 MB
    model["model/30_Step-9000.ckpt.data-00000-of-00001"] = weights

    assert droa("droa-import-model", "--from", str(laid(model)), "--no-wait") == 0
    assert weights in fake.objects.values()


def test_an_archive_with_one_folder_inside_is_imported(droa, fake, tmp_path, model, capsys):
    archive = tmp_path / "fast-car.tar.gz"
    with tarfile.open(archive, "w:gz") as tar:
        for name, data in model.items():
            member = tarfile.TarInfo(f"2w7R6h2PNexQ9kC/{name}")
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))

    code = droa("droa-import-model", "--from", str(archive), "--model-description", "my car 1")

    (imported,) = fake.models.values()
    assert code == 0
    assert (imported["name"], imported["description"]) == ("fast-car", "my car 1")
    assert imported["status"] == "READY"
    assert "It is ready" in capsys.readouterr().out


def test_a_refusal_after_the_import_shows_the_reason(droa, fake, laid, model, capsys):
    del model["model/30_Step-9000.ckpt.index"]

    code = droa("droa-import-model", "--from", str(laid(model)), "--unchecked")

    error, remedy = one_error(capsys)
    (imported,) = fake.models.values()
    assert code == 3
    assert imported["status"] == "ERROR"
    assert imported["importErrorMessage"] in error
    assert f"droa-delete-model {imported['modelId']}" in remedy


def test_a_refusal_at_once_leaves_nothing_in_the_bucket(droa, fake, laid, capsys):
    folder = laid(accepted_model(CAR_COLOR="Yellow"))

    code = droa("droa-import-model", "--from", str(folder), "--unchecked")

    error, _ = one_error(capsys)
    assert code == 4
    assert "not available in color YELLOW" in error
    assert fake.models == fake.objects == {}


def test_files_that_the_server_cannot_read_end_in_its_error(droa, fake, laid, model, capsys):
    del model["ip/hyperparameters.json"]

    code = droa("droa-import-model", "--from", str(laid(model)), "--unchecked")

    assert code == 4
    assert "answered 500: The service ran into an error" in one_error(capsys)[0]
    assert fake.models == fake.objects == {}


def test_what_is_refused_here_asks_nobody(droa, fake, laid, model, capsys):
    del model["ip/hyperparameters.json"]

    code = droa("droa-import-model", "--from", str(laid(model)))

    assert code == 3
    assert "ip/hyperparameters.json is missing" in one_error(capsys)[0]
    assert fake.calls == []
    assert fake.sign_ins == 0


@pytest.mark.parametrize(
    "options",
    [
        ("--model-name", "team/car_1"),
        ("--model-name", ""),
        ("--model-name", "a" * 65),
        ("--model-name", "grüße"),
        ("--model-description", "fast!"),
        ("--model-description", "a" * 256),
        ("--model-description", "two\nlines"),
    ],
)
def test_names_and_descriptions_are_checked_before_anything_is_sent(
    droa, fake, laid, model, options
):
    assert droa("droa-import-model", "--from", str(laid(model)), *options) == 3
    assert fake.sign_ins == 0


def test_a_name_that_is_not_allowed_comes_with_one_that_is(droa, laid, model, capsys):
    droa("droa-import-model", "--from", str(laid(model)), "--model-name", "team/car_1")

    assert "--model-name team-car-1" in one_error(capsys)[1]


def test_a_dry_run_checks_and_sends_nothing(droa, fake, laid, model, capsys):
    code = droa("droa-import-model", "--from", str(laid(model)), "-d", "--json")

    report = printed_json(capsys)
    assert code == 0
    assert report["dry_run"]
    assert report["files"] == len(model)
    assert fake.sign_ins == 0
    assert fake.calls == []


def test_who_may_not_write_sends_one_small_file_only(droa, fake, laid, model, capsys):
    fake.writable = False

    code = droa("droa-import-model", "--from", str(laid(model)))

    assert code == 4
    assert "may not write to s3://upload-bucket/uploads/models/" in one_error(capsys)[0]
    assert fake.objects == {}
    assert fake.calls == []


def test_an_upload_that_is_interrupted_is_removed(droa, fake, laid, model, monkeypatch):
    from drcli.outside.droa import droa_import

    put, done = droa_import._put, []

    def interrupted(*arguments):
        if len(done) == 3:
            assert len(fake.objects) == 3
            raise KeyboardInterrupt
        done.append(put(*arguments))

    monkeypatch.setattr(droa_import, "_put", interrupted)

    assert droa("droa-import-model", "--from", str(laid(model))) == 130
    assert fake.objects == {}
    assert fake.calls == []


def test_a_bucket_that_cannot_be_named_so_is_one_sentence(droa, fake, laid, model, capsys):
    options = ("--from", str(laid(model)), "--upload-bucket", "not/a bucket")

    assert droa("droa-import-model", *options) == 4
    assert "Cannot upload" in one_error(capsys)[0]


def test_an_import_without_end_is_given_up_after_half_an_hour(
    droa, fake, laid, model, pauses, capsys
):
    fake.import_polls = 10_000

    code = droa("droa-import-model", "--from", str(laid(model)))

    assert code == 4
    assert sum(pauses) == 1800
    assert "droa-get-model" in one_error(capsys)[1]


def test_an_import_needs_no_answer_when_nobody_waits(droa, fake, laid, model, pauses, capsys):
    assert droa("droa-import-model", "--from", str(laid(model)), "--no-wait", "--json") == 0

    assert printed_json(capsys)["status"] == "IMPORTING"
    assert pauses == []


# Downloads.


def test_logs_arrive_under_their_own_name(droa, fake, capsys):
    model_id = fake.add_model("car")

    code = droa("droa-download-logs", model_id, "--json")

    report = printed_json(capsys)
    data = Path("training_logs-car.tar.gz").read_bytes()
    assert code == 0
    assert report["file"] == "training_logs-car.tar.gz"
    assert report["asset_type"] == "TRAINING_LOGS"
    assert data == fake.files["/files/training_logs-car.tar.gz"]
    assert report["file_bytes"] == len(data)


def test_logs_of_an_evaluation_need_its_id(droa, fake):
    fake.add_model("car")

    assert droa("droa-download-logs", "car", "--asset-type", "EVALUATION_LOGS") == 2
    options = ("--asset-type", "EVALUATION_LOGS", "--evaluation-id", "abcdefghijklmno")
    assert droa("droa-download-logs", "car", *options, "-o", "there.tar.gz") == 0
    assert any("evaluationId=abcdefghijklmno" in path for _, path in fake.calls)
    assert Path("there.tar.gz").exists()


def test_a_model_that_is_being_packed_is_waited_for(droa, fake, pauses):
    fake.add_model("car")

    code = droa("droa-download-logs", "car", "--asset-type", "VIRTUAL_MODEL")

    assert code == 0
    assert pauses == [5.0, 5.0]
    assert Path("virtualmodel-car.tar.gz").exists()


def test_packing_without_end_is_given_up_after_five_minutes(droa, fake, pauses, capsys):
    fake.add_model("car")
    fake.pack_polls = 10_000

    code = droa("droa-download-logs", "car", "--asset-type", "VIRTUAL_MODEL")

    assert code == 4
    assert sum(pauses) == 300
    assert "still packing" in one_error(capsys)[0]


@pytest.mark.parametrize(
    ("kind", "code", "words"),
    [
        ("VIDEOS", 4, "This asset type is not supported"),
        ("PHYSICAL_CAR_MODEL", 3, "Unable to find physical model artifact"),
    ],
)
def test_what_the_server_does_not_give_is_said_in_its_words(droa, fake, capsys, kind, code, words):
    fake.add_model("car")

    assert droa("droa-download-logs", "car", "--asset-type", kind) == code
    assert words in one_error(capsys)[0]


def test_logs_of_an_unfinished_training_are_not_there_yet(droa, fake, capsys):
    fake.add_model("car", "TRAINING")
    fake.logs_finished = False

    assert droa("droa-download-logs", "car") == 4
    assert "not available until job is complete" in one_error(capsys)[0]


def test_a_download_that_breaks_off_begins_again(droa, fake, pauses):
    fake.add_model("car")
    fake.broken_downloads = 2

    assert droa("droa-download-logs", "car", "-o", "logs.tar.gz") == 0
    assert Path("logs.tar.gz").read_bytes() == fake.files["/files/training_logs-car.tar.gz"]
    assert len(pauses) == 2


def test_half_a_download_leaves_no_file(droa, fake, capsys):
    fake.add_model("car")
    fake.broken_downloads = 100
    before = set(Path().iterdir())

    code = droa("droa-download-logs", "car", "-o", "logs.tar.gz")

    error, _ = one_error(capsys)
    assert code == 4
    assert "too early" in error
    assert "secret" not in error
    assert set(Path().iterdir()) == before


def test_a_file_is_not_replaced_without_force(droa, fake, capsys):
    fake.add_model("car")
    Path("logs.tar.gz").write_text("mine")

    assert droa("droa-download-logs", "car", "-o", "logs.tar.gz") == 3
    assert "-f (--force)" in capsys.readouterr().err
    assert Path("logs.tar.gz").read_text() == "mine"
    assert droa("droa-download-logs", "car", "-o", "logs.tar.gz", "-f") == 0
    assert Path("logs.tar.gz").read_bytes() == fake.files["/files/training_logs-car.tar.gz"]


def test_a_folder_takes_the_file_and_a_missing_one_is_named(droa, fake, capsys):
    fake.add_model("car")
    Path("logs").mkdir()

    assert droa("droa-download-logs", "car", "-o", "logs") == 0
    assert Path("logs/training_logs-car.tar.gz").exists()
    capsys.readouterr()
    assert droa("droa-download-logs", "car", "-o", "nowhere/logs.tar.gz") == 3
    assert "nowhere/logs.tar.gz cannot be written" in one_error(capsys)[0]


def test_a_summary_of_logs_finds_the_metrics_in_the_archive(droa, fake, capsys):
    fake.add_model("car")
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as tar:
        data = json.dumps(METRICS).encode()
        member = tarfile.TarInfo("id/metrics/training/training-1.json")
        member.size = len(data)
        tar.addfile(member, io.BytesIO(data))
    fake.files["/files/training_logs-car.tar.gz"] = packed.getvalue()

    assert droa("droa-download-logs", "car", "--summary") == 0
    assert "75.0 %" in capsys.readouterr().out


def test_a_summary_of_something_else_keeps_the_file(droa, fake, capsys):
    fake.add_model("car")
    fake.files["/files/training_logs-car.tar.gz"] = gzip.compress(b"no archive")

    assert droa("droa-download-logs", "car", "--summary") == 3
    assert "is not an archive of logs" in one_error(capsys)[0]
    assert Path("training_logs-car.tar.gz").exists()


# Deleting.


@pytest.mark.parametrize("flag", ["-f", "--force", "-y", "--yes"])
def test_a_model_is_deleted(droa, fake, capsys, flag):
    model_id = fake.add_model("car", "ERROR")

    code = droa("droa-delete-model", model_id, flag, "--json")

    assert code == 0
    assert printed_json(capsys)["status"] == "DELETING"
    assert fake.models[model_id]["status"] == "DELETING"


@pytest.mark.parametrize(("answer", "code"), [("n", 1), ("", 1), ("y", 0), ("car", 0)])
def test_deleting_asks_before(droa, fake, monkeypatch, answer, code):
    model_id = fake.add_model("car")
    monkeypatch.setattr("sys.stdin", io.StringIO(f"{answer}\n"))

    assert droa("droa-delete-model", model_id) == code
    assert (fake.models[model_id]["status"] == "DELETING") == (code == 0)


@pytest.mark.parametrize("status", ["TRAINING", "IMPORTING", "QUEUED", "DELETING", "EVALUATING"])
def test_a_busy_model_is_not_deleted(droa, fake, capsys, status):
    fake.import_polls = 10
    model_id = fake.add_model("car", status)
    fake._waiting[model_id] = 10

    assert droa("droa-delete-model", model_id, "-f") == 3
    assert f"has the status {status}" in one_error(capsys)[0]
    assert not [call for call in fake.calls if call[0] == "DELETE"]


def test_a_model_that_became_busy_is_refused_by_the_server(droa, fake, capsys):
    model_id = fake.add_model("car")
    body = json.dumps({"model": dict(fake.models[model_id])}).encode()
    fake.faults = [(200, {}, body)]
    fake.models[model_id]["status"] = "EVALUATING"

    assert droa("droa-delete-model", model_id, "-f") == 4
    assert "cannot be deleted at this time" in one_error(capsys)[0]


# Options that replace settings.


def test_options_replace_settings_and_env_js(dr, fake, home, pauses, working_folder, monkeypatch):
    monkeypatch.setenv("DR_DROA_AWS_ENDPOINT_URL", fake.url)
    fake.env_js = "nothing of use"
    options = {
        "--username": USER,
        "--password": PASSWORD,
        "--region": REGION,
        "--user-pool-id": POOL,
        "--user-pool-client-id": CLIENT,
        "--identity-pool-id": IDENTITIES,
        "--api-endpoint": f"{fake.url}{STAGE}",
        "--upload-bucket": BUCKET,
    }

    words = [word for pair in options.items() for word in pair]

    assert dr("droa-list-models", *words) == 0
    assert fake.sign_ins == 1


def test_debug_prints_requests_without_secrets(droa, fake, capsys, monkeypatch):
    monkeypatch.setenv("DR_DROA_DEBUG", "True")
    fake.add_model("car")

    droa("droa-download-logs", "car")

    printed = capsys.readouterr().err
    assert f"GET {fake.url}{STAGE}/models: 200" in printed
    assert "/files/training_logs-car.tar.gz" in printed
    secrets = [PASSWORD, "Signature=secret"]
    secrets += [each for keys in fake.issued.values() for each in (keys.secret, keys.token)]
    assert not any(secret in printed for secret in secrets)
