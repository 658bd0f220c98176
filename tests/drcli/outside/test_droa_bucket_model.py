"""A model of the bucket, as it arrives at DeepRacer on AWS."""

import json
from types import SimpleNamespace

import pytest
import yaml

from drcli.transfer.export_forms import TrainingCheckpoint
from droa_models import accepted_model, write_files
from droa_server import PASSWORD
from memory_bucket import MemoryBucket
from trained_model import put_trained_model

PARAMETERS = (
    "---\n'WORLD_NAME': '{world}'\n'REVERSE_DIR': 'False'\n'BODY_SHELL_TYPE': 'deepracer'\n"
    "'CAR_COLOR': 'Red'\n'RACE_TYPE': 'TIME_TRIAL'\n'CHANGE_START_POSITION': 'True'\n"
)


@pytest.fixture
def bucket(working_folder):
    """Lays a model of the reference with checkpoints 12 (the best) and 30 (the last)."""

    def lay(prefix="rl-deepracer-1", world="reInvent2019_wide_cw"):
        files = accepted_model()
        metadata = files.pop("model_metadata.json")
        entries = {
            f"{kind}_checkpoint": {"name": name, "time_stamp": 1.0, "avg_eval_metric": 90.0}
            for kind, name in (("best", "12_Step-4000.ckpt"), ("last", "30_Step-9000.ckpt"))
        }
        for end in (".index", ".meta", ".data-00000-of-00001"):
            files[f"model/12_Step-4000.ckpt{end}"] = b"best"
        files |= {
            "model/model_metadata.json": metadata,
            "model/deepracer_checkpoints.json": json.dumps(entries).encode(),
            "model/model_12.pb": b"graph of 12",
            "metrics/TrainingMetrics.json": b'{"metrics": []}',
            "training_params.yaml": PARAMETERS.format(world=world).encode(),
        }
        del files["metrics/training/training-20261122.json"]
        folder = working_folder / "data" / "s3" / "bucket" / prefix
        return write_files(folder, files)

    return lay


def sent(fake):
    return {key.split("/", 3)[3]: data for key, data in fake.objects.items()}


@pytest.mark.parametrize(
    ("options", "number", "name"),
    [
        ((), 30, "30_Step-9000.ckpt"),
        (("--best",), 12, "12_Step-4000.ckpt"),
        (("--checkpoint", "12"), 12, "12_Step-4000.ckpt"),
    ],
)
def test_a_model_of_the_reference_is_imported_with_one_checkpoint(
    droa, fake, bucket, options, number, name
):
    bucket()

    code = droa("droa-import-model", "--model-prefix", "rl-deepracer-1", *options)

    files = sent(fake)
    parameters = yaml.safe_load(files["training_params.yaml"])
    (model,) = fake.models.values()
    assert code == 0
    assert model["status"] == "READY"
    assert model["name"] == "rl-deepracer-1"
    assert files["model/.coach_checkpoint"].decode().strip() == name
    assert {each for each in files if ".ckpt" in each and each.startswith("model/1")} == (
        {f"model/{name}{end}" for end in (".index", ".meta", ".data-00000-of-00001")}
        if number == 12
        else set()
    )
    assert f"model/model_{number}.pb" in files
    assert f"metrics/training/training-{number}.json" in files
    assert parameters["WORLD_NAME"] == "reInvent2019_wide"
    assert parameters["TRACK_DIRECTION_CLOCKWISE"] is True
    assert parameters["CHANGE_START_POSITION"] is True


def test_the_model_of_the_settings_is_the_default(droa, fake, bucket):
    bucket("model")

    assert droa("droa-import-model", "--model-name", "my-car") == 0
    assert [model["name"] for model in fake.models.values()] == ["my-car"]


@pytest.mark.parametrize(
    ("direction", "clockwise"), [("clockwise", True), ("counterclockwise", False)]
)
def test_the_route_says_the_direction_where_the_name_does_not(
    droa, fake, bucket, monkeypatch, direction, clockwise
):
    facts = SimpleNamespace(name="reInvent2019_wide", direction=direction)
    monkeypatch.setattr(
        "drcli.tracks.track_list.list_tracks", lambda *_: SimpleNamespace(tracks=[facts])
    )
    bucket(world="reInvent2019_wide")

    assert droa("droa-import-model", "--model-prefix", "rl-deepracer-1") == 0
    parameters = yaml.safe_load(sent(fake)["training_params.yaml"])
    assert parameters["TRACK_DIRECTION_CLOCKWISE"] is clockwise


def test_a_direction_that_nobody_knows_is_asked_for(droa, fake, bucket, monkeypatch, capsys):
    monkeypatch.setattr(
        "drcli.tracks.track_list.list_tracks", lambda *_: SimpleNamespace(tracks=[])
    )
    bucket(world="arctic_open")

    assert droa("droa-import-model", "--model-prefix", "rl-deepracer-1") == 3
    assert "does not say in which direction" in capsys.readouterr().err
    assert fake.calls == []


def test_a_prefix_that_is_no_name_asks_for_one(droa, fake, bucket, capsys):
    bucket("team/car_1")

    assert droa("droa-import-model", "--model-prefix", "team/car_1") == 3
    assert "Give --model-name team-car-1" in capsys.readouterr().err
    assert fake.sign_ins == 0


@pytest.fixture
def own(working_folder, monkeypatch):
    """A model that was trained here, in the bucket of the working folder, with small weights."""
    parts = {end: end.encode() for end in (".index", ".data-00000-of-00001", ".meta")}
    small = TrainingCheckpoint(parts, b"graph", 22, ["A note."])
    monkeypatch.setattr("drcli.transfer.export_forms.encode_training_checkpoint", lambda *_: small)
    kept = MemoryBucket()
    put_trained_model(kept, "model")
    kept.put("model/training_params.yaml", PARAMETERS.format(world="reinvent_base").encode())
    for info in kept.list(""):
        path = working_folder / "data" / "s3" / "bucket" / info.key
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(kept.get(info.key))


def test_a_model_that_was_trained_here_is_converted_and_imported(droa, fake, own):
    assert droa("droa-import-model", "--best") == 0

    files = sent(fake)
    (model,) = fake.models.values()
    assert model["status"] == "READY"
    assert files["model/.coach_checkpoint"].decode().strip() == "3_Step-300.ckpt"
    ends = (".index", ".meta", ".data-00000-of-00001")
    assert {f"model/3_Step-300.ckpt{end}" for end in ends} <= files.keys()
    assert not [name for name in files if name.endswith(".safetensors")]


def test_without_an_address_nothing_is_converted(dr, home, own, monkeypatch, capsys):
    def never(*_):
        raise AssertionError("the model is converted for nobody")

    monkeypatch.setattr("drcli.cli.commands.droa.read_bucket_model", never)

    assert dr("droa-import-model") == 3
    assert "DR_DROA_URL is not set" in capsys.readouterr().err


def test_the_same_weights_are_imported_once(droa, fake, own, capsys):
    assert droa("droa-import-model", "--once", "--best") == 0
    assert droa("droa-import-model", "--once", "--best", "--json") == 0

    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert report["existed"]
    assert list(fake.models) == [report["model_id"]]

    assert droa("droa-import-model", "--once") == 0  # another checkpoint
    assert len(fake.models) == 2


def test_a_refused_import_is_tried_again(droa, fake, own):
    assert droa("droa-import-model", "--once") == 0
    for model in fake.models.values():
        model["status"] = "ERROR"

    assert droa("droa-import-model", "--once") == 0
    assert len(fake.models) == 2


def test_a_password_in_the_environment_needs_nobody(droa, fake, own, monkeypatch):
    def nobody(question, remedy):
        raise AssertionError("nobody is there to be asked")

    monkeypatch.setattr("drcli.cli.prompts.secret", nobody)
    monkeypatch.setenv("DR_DROA_PASSWORD", PASSWORD)

    assert droa("droa-import-model") == 0
    assert fake.sign_ins == 1


def test_a_model_that_does_not_exist_is_said(droa, fake, capsys, bucket):
    bucket()

    assert droa("droa-import-model", "--model-prefix", "nothing") == 3
    assert "There is no model at s3://bucket/nothing" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ("--from", "x", "--best"),
        ("--from", "x", "--model-prefix", "y"),
        ("--best", "--checkpoint", "3"),
        ("--checkpoint", "-1"),
    ],
)
def test_options_that_contradict_each_other_are_a_wrong_command_line(droa, words):
    assert droa("droa-import-model", *words) == 2
