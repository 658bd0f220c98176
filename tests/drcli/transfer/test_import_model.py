"""Models of other systems become models here, or nothing changes."""

import io
import json
import tarfile
import zipfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load as load_arrays_of

from drcli.base.errors import DrError, SettingsError
from drcli.config.loading import load_settings
from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import encode_policy
from drcli.convert.reference_checkpoint import encode_reference_checkpoint, reference_variables
from drcli.learn.actor_critic import ActorCritic
from drcli.learn.algorithms import ALGORITHMS
from drcli.learn.policy import PolicySpec
from drcli.model.checkpoints import CheckpointStore
from drcli.model.files.hyperparameters import Hyperparameters
from drcli.model.files.network_shape import Design
from drcli.model.lease import take
from drcli.model.model_list import list_models
from drcli.model.model_store import ModelStore
from drcli.transfer.download import download, plan_download
from drcli.transfer.find_checkpoint import OwnModel
from drcli.transfer.import_model import ImportOptions, copy_of_own, import_model, plan_import
from droa_models import write_files
from memory_bucket import MemoryBucket
from minio_files import put
from trained_model import put_trained_model

from .conftest import no_bar, put_model

COMPACT = "COMPACT_CONVOLUTIONAL_NETWORK"
DEEP = "DEEP_CONVOLUTIONAL_NETWORK_DEEP"
ACTIONS = [{"steering_angle": angle, "speed": 1.0} for angle in (-30, 0, 30)]
METADATA = {
    "action_space": ACTIONS,
    "sensor": ["FRONT_FACING_CAMERA"],
    "neural_network": COMPACT,
    "training_algorithm": "clipped_ppo",
    "action_space_type": "discrete",
    "version": "5",
}
HYPERPARAMETERS = {"lr": 0.0004, "batch_size": 128}
REWARD = b"import math\n\n\ndef reward_function(params):\n    return math.exp(params['speed'])\n"


@cache
def model_weights(spec):
    torch.manual_seed(2)
    return weights_of(ActorCritic(spec))


SPEC = PolicySpec(3, network=COMPACT)


@cache
def graph(spec=SPEC):
    return encode_policy(model_weights(spec), spec, ["FRONT_FACING_CAMERA"])


@cache
def bundle():
    spec = PolicySpec(3, network=DEEP)
    return encode_reference_checkpoint(
        reference_variables(model_weights(spec), spec, ["FRONT_FACING_CAMERA"])
    )


def described(**changes):
    return json.dumps({**METADATA, **changes}).encode()


def pack(path, files):
    with tarfile.open(path, "w:gz", compresslevel=1) as archive:
        for name, data in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return path


def tensorflow(name="12_Step-7824.ckpt"):
    parts = {f"model/{name}{end}": data for end, data in bundle().items()}
    return {**parts, "model/model_metadata.json": described(neural_network=DEEP)}


class Importer:
    """Imports into a bucket in memory."""

    def __init__(self, folder, monkeypatch):
        self.folder = folder
        self.here = MemoryBucket("bucket")
        self.there = MemoryBucket("uploads")
        monkeypatch.setattr("drcli.transfer.import_model.open_bucket", lambda *_, **__: self.here)
        monkeypatch.setattr(
            "drcli.transfer.find_checkpoint.source_bucket", lambda *_, **__: self.there
        )

    def plan(self, source, prefix="new", **options):
        settings = load_settings(self.folder)
        return plan_import(settings, ImportOptions(str(source), prefix, **options))

    def run(self, source, prefix="new", **options):
        planned = self.plan(source, prefix, **options)
        return import_model(planned, load_settings(self.folder), no_bar)

    def refused(self, source, **options):
        """The reason why an import is refused, which must change nothing."""
        before = self.content()
        with pytest.raises(DrError) as caught:
            self.run(source, **options)
        assert self.content() == before
        assert caught.value.remedy
        assert "\n" not in str(caught.value)
        return str(caught.value)

    def content(self):
        return {info.key: self.here.get(info.key) for info in self.here.list("")}

    def weights(self, prefix="new"):
        found = CheckpointStore(ModelStore(self.here, prefix)).load_latest()
        assert found is not None
        return load_arrays_of(found.tensors)


@pytest.fixture
def importer(working_folder, monkeypatch):
    (working_folder / "run.env").write_text("DR_WORLD_NAME=reinvent_base\n")
    return Importer(working_folder, monkeypatch)


@pytest.fixture
def model(tmp_path):
    return write_files(
        tmp_path / "source", {"model_30.pb": graph(), "model_metadata.json": described()}
    )


def test_a_frozen_graph_becomes_a_model_as_a_training_leaves_it(importer, model):
    report = importer.run(model / "model_30.pb")

    store = CheckpointStore(ModelStore(importer.here, "new"))
    found = store.load_latest()
    assert str(store.pointed()) == store.best_name() == "30_Step-0.ckpt"
    assert found.record.counters.critic_warmup
    expected = model_weights(SPEC)
    weights = importer.weights()
    policy = [name for name in expected if name.startswith(("body.", "policy_head."))]
    assert all(np.array_equal(weights[name], expected[name]) for name in policy)
    assert weights.keys() == expected.keys()
    assert not weights["value_head.weight"].any()
    design = Design.of_model(ModelStore(importer.here, "new"))
    assert design.metadata.neural_network == COMPACT
    assert design.parameters.lr == 3e-4
    assert any("lr=0.0003 instead of 0.001" in text for text in report.warnings)
    assert [entry.prefix for entry in list_models(importer.here).models] == ["new"]
    assert report.shipped == ["hyperparameters.json", "reward_function.py"]
    assert any("critic" in text for text in report.fresh)
    assert "gave the same results" in report.verified[0]
    names = {key.removeprefix("new/") for key in importer.content()}
    assert {"training_params.yaml", "reward_function.py", "metrics/TrainingMetrics.json"} <= names


def test_the_same_import_again_changes_nothing(importer, model):
    importer.run(model / "model_30.pb")
    before = importer.content()

    report = importer.run(model / "model_30.pb")

    assert importer.content() == before
    assert set(report.copied) == {"model/.coach_checkpoint", "model/deepracer_checkpoints.json"}


def test_files_that_are_there_and_right_are_taken_along(importer, tmp_path):
    source = write_files(
        tmp_path / "s",
        {
            **tensorflow(),
            "reward_function.py": REWARD,
            "ip/hyperparameters.json": json.dumps(HYPERPARAMETERS).encode(),
            "training_params.yaml": b"WORLD_NAME: Oval_track\nS3_ENDPOINT_URL: http://x\n",
        },
    )

    report = importer.run(source)

    assert report.checkpoint == "12_Step-7824.ckpt"
    assert report.form == "TensorFlow checkpoint"
    assert report.shipped == []
    assert report.world == "Oval_track"
    assert importer.here.get("new/reward_function.py") == REWARD
    parameters = Design.of_model(ModelStore(importer.here, "new")).parameters
    assert (parameters.lr, parameters.batch_size) == (0.0004, 128)
    text = importer.here.get("new/training_params.yaml").decode()
    assert "'SAGEMAKER_SHARED_S3_PREFIX': 'new'" in text
    assert "S3_ENDPOINT_URL" not in text


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("reward_function.py", b"def reward(params):\n    return 1.0\n", "does not define"),
        ("reward_function.py", b"def reward_function(params:\n", "line 1 is not Python"),
        ("reward_function.py", b"\xff\xfe\x00", "not Python"),
        ("hyperparameters.json", b'{"lr": "fast"}', "lr"),
        ("hyperparameters.json", b'{"exploration_type": "additive_noise"}', "belongs to sac"),
        ("training_params.yaml", b"{[", "not YAML"),
    ],
)
def test_a_file_that_is_wrong_is_replaced_and_said(importer, model, name, data, reason):
    write_files(model, {name: data})

    report = importer.run(model)

    assert any(f"/{name} is not used: " in text and reason in text for text in report.warnings)
    assert name not in report.taken
    Design.of_model(ModelStore(importer.here, "new"))


def test_a_wrong_network_is_corrected_and_said(importer, model):
    write_files(model, {"model_metadata.json": described(neural_network=DEEP)})

    report = importer.run(model)

    assert Design.of_model(ModelStore(importer.here, "new")).metadata.neural_network == COMPACT
    assert f"neural_network={DEEP}" in report.warnings[0]
    assert COMPACT in report.warnings[0]


RANGES = {"steering_angle": {"low": -30, "high": 30}, "speed": {"low": 1, "high": 2}}


@pytest.mark.parametrize(
    ("changes", "theirs", "ours"),
    [
        ({"action_space": ACTIONS[:2]}, "2 discrete actions", "3 discrete actions"),
        (
            {"action_space": RANGES, "action_space_type": "continuous"},
            "2 continuous actions",
            "3 discrete actions",
        ),
        ({"sensor": ["STEREO_CAMERAS"]}, "the sensors STEREO_CAMERAS", "FRONT_FACING_CAMERA"),
        ({"sensor": ["FRONT_FACING_CAMERA", "LIDAR"]}, "FRONT_FACING_CAMERA and LIDAR", "has the"),
    ],
)
def test_metadata_of_another_model_are_refused_with_both_sides(
    importer, model, changes, theirs, ours
):
    write_files(model, {"model_metadata.json": described(**changes)})

    reason = importer.refused(model)

    assert "model_metadata.json has " in reason
    assert theirs in reason
    assert ours in reason


def test_metadata_can_be_given(importer, model, tmp_path):
    (model / "model_metadata.json").unlink()
    other = tmp_path / "mine.json"
    other.write_bytes(described())

    assert "says what the 3 discrete actions" in importer.refused(model)
    assert "cannot be read" in importer.refused(model, metadata=tmp_path / "none.json")
    importer.run(model, metadata=other)

    assert Design.of_model(ModelStore(importer.here, "new")).metadata.action_space.num_actions == 3


@pytest.mark.parametrize("in_folder", [True, False])
def test_metadata_named_after_the_file_count_more(importer, model, in_folder):
    """As `dr-export pb` writes them, so that several files fit in one folder."""
    wrong = described(action_space=[{"steering_angle": 0, "speed": 1}])
    (model / "model_metadata.json").write_bytes(wrong)
    (model / "model_30.model_metadata.json").write_bytes(described())

    importer.run(model if in_folder else model / "model_30.pb")

    assert Design.of_model(ModelStore(importer.here, "new")).metadata.action_space.num_actions == 3


def test_continuous_actions_of_a_graph_begin_with_a_spread_that_is_said(importer, tmp_path):
    spec = PolicySpec(2, True, COMPACT)
    metadata = described(action_space=RANGES, action_space_type="continuous")
    source = write_files(tmp_path / "s", {"model.pb": graph(spec), "model_metadata.json": metadata})

    report = importer.run(source)

    assert np.allclose(np.exp(importer.weights()["log_std"]), 0.25)
    assert any("0.25" in text for text in report.fresh)


def test_a_frame_stack_is_taken_from_the_graph(importer, tmp_path):
    spec = replace(SPEC, stack=2)
    source = write_files(
        tmp_path / "s",
        {
            "model.pb": encode_policy(model_weights(spec), spec, ["FRONT_FACING_CAMERA"]),
            "model_metadata.json": described(),
            "hyperparameters.json": b'{"stack_size": 1}',
        },
    )

    report = importer.run(source)

    assert Design.of_model(ModelStore(importer.here, "new")).parameters.stack_size == 2
    assert any("stack_size=1" in text for text in report.warnings)


CAR = {"agent/model.pb": graph(), "model_metadata.json": described()}


def test_a_car_archive_is_imported_under_the_number_in_its_name(importer, tmp_path):
    archive = pack(tmp_path / "racer-chk17.tar.gz", CAR)

    assert importer.run(archive).checkpoint == "17_Step-0.ckpt"


def test_an_archive_of_a_console_is_imported(importer, tmp_path):
    files = {f"my-model/{name}": data for name, data in tensorflow().items()}

    report = importer.run(pack(tmp_path / "a.tar.gz", files))

    assert report.checkpoint == "12_Step-7824.ckpt"
    assert report.taken == ["my-model/model/model_metadata.json"]


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        ({**CAR, "../evil.pb": b"x"}, "leads out of the archive"),
        ({**CAR, "/etc/evil": b"x"}, "absolute name"),
        ({**CAR, "agent/other.pb": graph()}, "more than one model"),
        ({**CAR, "other/model.pb": graph()}, "several frozen graphs"),
        (
            {
                **CAR,
                "weights.pkl": b"\x80\x04\x95\x0c\x00\x00\x00\x00\x00\x00\x00\x8c\x08builtins\x94.",
            },
            "pickle",
        ),
        ({"model_metadata.json": described()}, "no model of the reference simulator"),
        ({"agent/model.pb": graph()[:999], "model_metadata.json": described()}, "model.pb "),
    ],
)
def test_a_crafted_archive_is_refused(importer, tmp_path, files, reason):
    archive = pack(tmp_path / "a.tar.gz", files)

    assert reason in importer.refused(archive)
    assert not (tmp_path.parent / "evil.pb").exists()


@pytest.mark.parametrize("source", ["model/12_Step-7824.ckpt", "model/12_Step-7824.ckpt.index"])
def test_a_checkpoint_may_be_named_by_any_of_its_files(importer, tmp_path, source):
    write_files(tmp_path / "s", {**tensorflow(), "reward_function.py": REWARD})

    report = importer.run(tmp_path / "s" / source)

    assert report.checkpoint == "12_Step-7824.ckpt"
    assert importer.here.get("new/reward_function.py") == REWARD


def test_damaged_checkpoints_are_refused(importer, tmp_path):
    files = tensorflow()
    stem = "model/12_Step-7824.ckpt"
    source = write_files(tmp_path / "s", files)
    data = source / f"{stem}.data-00000-of-00001"
    whole = data.read_bytes()

    data.write_bytes(whole[:-8])
    assert "12_Step-7824.ckpt" in importer.refused(source)
    data.write_bytes(whole[:4000] + b"?" + whole[4001:])
    assert "12_Step-7824.ckpt" in importer.refused(source)
    data.unlink()
    assert "12_Step-7824.ckpt.data-00000-of-00001 is missing" in importer.refused(source)
    data.write_bytes(whole)
    (source / f"{stem}.index").unlink()
    assert "12_Step-7824.ckpt.index is missing" in importer.refused(source)


def index(best, last):
    entry = {"time_stamp": 1.0, "avg_comp_pct": 50.0}
    scores = {
        "best_checkpoint": {"name": best, **entry},
        "last_checkpoint": {"name": last, **entry},
    }
    return json.dumps(scores).encode()


@pytest.fixture
def several(tmp_path):
    graphs = {f"model/model_{number}.pb": graph() for number in (3, 5, 9)}
    pointers = {
        "model/deepracer_checkpoints.json": index("3_Step-300.ckpt", "5_Step-500.ckpt"),
        "model/.coach_checkpoint": b"5_Step-500.ckpt",
    }
    return write_files(
        tmp_path / "s", {**graphs, **pointers, "model/model_metadata.json": described()}
    )


def test_the_index_says_which_of_several_checkpoints_counts(importer, several):
    assert importer.run(several, "a").checkpoint == "5_Step-500.ckpt"
    assert importer.run(several, "b", wanted="best").checkpoint == "3_Step-300.ckpt"
    assert importer.run(several, "c", wanted=9).checkpoint == "9_Step-0.ckpt"
    assert "no checkpoint 4; there are checkpoints 3, 5, 9" in importer.refused(several, wanted=4)


def test_an_index_that_names_a_missing_checkpoint_is_refused(importer, several):
    (several / "model/model_5.pb").unlink()

    assert "names 5_Step-500.ckpt as its last checkpoint" in importer.refused(several)


def test_without_an_index_the_newest_counts_and_none_is_the_best(importer, several):
    (several / "model/deepracer_checkpoints.json").write_bytes(b"{")
    (several / "model/.coach_checkpoint").unlink()

    assert importer.run(several).checkpoint == "9_Step-0.ckpt"
    assert "which checkpoint is the best" in importer.refused(several, prefix="b", wanted="best")


def test_a_model_folder_in_a_bucket_is_imported(importer):
    for name, data in tensorflow().items():
        importer.there.put(f"team/theirs/{name}", data)

    report = importer.run("s3://uploads/team/theirs")

    assert report.checkpoint == "12_Step-7824.ckpt"
    assert report.source == "s3://uploads/team/theirs/model/12_Step-7824.ckpt"
    assert "There is nothing at s3://uploads/none" in importer.refused("s3://uploads/none")


def test_a_model_of_ours_needs_no_import(importer, tmp_path):
    put_model(importer.there, "team/ours")

    with pytest.raises(SettingsError, match="is a model of drcli already") as caught:
        importer.run("s3://uploads/team/ours")

    assert "`dr-download-model -s s3://uploads/team/ours -t PREFIX`" in caught.value.remedy


def own_files(importer):
    """The files of a model of ours, by name."""
    put_model(importer.there, "team/ours")
    return {
        info.key.removeprefix("team/ours/"): importer.there.get(info.key)
        for info in importer.there.list("team/ours/")
    }


@pytest.mark.parametrize("top", ["", "model-1/"])
def test_an_archive_of_a_model_of_ours_becomes_the_same_model(importer, tmp_path, top, monkeypatch):
    monkeypatch.setattr("drcli.transfer.download.open_bucket", lambda *_, **__: importer.here)
    files = own_files(importer)
    path = pack(tmp_path / "ours.tar.gz", {f"{top}{name}": data for name, data in files.items()})
    settings = load_settings(importer.folder)
    options = ImportOptions(str(path), "mine")
    with pytest.raises(OwnModel):
        plan_import(settings, options)

    download(plan_download(settings, copy_of_own(settings, options)), settings, no_bar)

    pointer = "model/deepracer_checkpoints.json"
    assert importer.here.get(f"mine/{pointer}") == files[pointer]
    assert {key for key in importer.content() if key.startswith("mine/model/")} == {
        f"mine/{name}" for name in files if name.startswith("model/") and ".finished" not in name
    }
    with pytest.raises(SettingsError, match="already contains a model"):
        copy_of_own(settings, options)
    with pytest.raises(SettingsError, match="copied as it is"):
        copy_of_own(settings, replace(options, prefix="other", wanted="best"))


def test_a_model_that_was_packed_on_a_mac_is_imported_as_any_other(importer, tmp_path):
    files = {"m/model_30.pb": graph(), "m/model_metadata.json": described()}
    left = {f"__MACOSX/m/._{name.rpartition('/')[2]}": b"\0\5\x16\7" for name in files}
    with zipfile.ZipFile(tmp_path / "m.zip", "w") as archive:
        for name, data in (files | left | {"m/.DS_Store": b"Bud1"}).items():
            archive.writestr(name, data)
    beside = {name.replace("__MACOSX/", ""): data for name, data in left.items()}
    packed = pack(tmp_path / "m.tar.gz", files | beside)
    folder = write_files(tmp_path / "folder", files | beside)

    for number, source in enumerate((tmp_path / "m.zip", packed, folder / "m")):
        assert importer.run(source, f"new-{number}").checkpoint == "30_Step-0.ckpt"


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("policy.zip", "a ZIP archive, such as Stable-Baselines3"),
        ("policy.pkl", "a Python pickle"),
        ("policy.pth", "PyTorch"),
        ("notes.txt", "not a file of a model"),
    ],
)
def test_other_files_are_refused(importer, tmp_path, name, reason):
    (tmp_path / name).write_bytes(b"data")

    assert reason in importer.refused(tmp_path / name)
    assert "does not exist" in importer.refused(tmp_path / "none.pb")


def test_another_model_at_the_target_needs_w(importer, model):
    put_model(importer.here, "new")
    importer.here.put("rollouts/new/1/0/x.safetensors", b"old")

    assert "already contains a model" in importer.refused(model)
    report = importer.run(model, wipe=True)

    assert report.deleted
    names = set(importer.content())
    assert not any(key.startswith("rollouts/") for key in names)
    assert not any("5_Step" in key for key in names)
    assert CheckpointStore(ModelStore(importer.here, "new")).best_name() == "30_Step-0.ckpt"


@pytest.mark.parametrize(
    ("there", "typed", "imported"),
    [(False, "", True), (True, "", False), (True, "y\n", True)],
)
def test_a_question_is_asked_only_where_something_is_deleted(
    importer, model, dr, monkeypatch, capsys, there, typed, imported
):
    if there:
        put_model(importer.here, "new")
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))

    code = dr("import", str(model), "-t", "new", "--no-drive", *["-w"] * there)

    assert code == (0 if imported else 1)
    assert ("Are you sure?" in capsys.readouterr().err) is there
    assert any("30_Step" in key for key in importer.content()) is imported


def test_a_model_that_is_being_trained_stays(importer, model):
    take(ModelStore(importer.here, "new"), "session")

    assert "is being trained" in importer.refused(model, wipe=True)


def test_a_dry_run_writes_nothing(importer, model):
    report = importer.run(model, dry_run=True)

    assert importer.content() == {}
    assert "model/30_Step-0.ckpt.safetensors" in report.copied


def test_an_interrupted_import_is_no_model_until_it_is_repeated(importer, model):
    class CutError(Exception):
        pass

    class Breaking(MemoryBucket):
        left = 3

        def put(self, key, data, *, watch=None):
            self.left -= 1
            if self.left < 0:
                raise CutError
            super().put(key, data, watch=watch)

    whole, importer.here = importer.here, Breaking("bucket")
    with pytest.raises(CutError):
        importer.run(model)
    assert list_models(importer.here).models == []
    importer.here.left = 1000

    importer.run(model)

    whole_names = [entry.prefix for entry in list_models(importer.here).models]
    assert whole_names == ["new"]
    assert whole.list("") == []


def test_c_writes_the_racers_files(importer, model):
    report = importer.run(model, custom_files=True)

    folder = importer.folder / "custom_files"
    assert json.loads((folder / "model_metadata.json").read_text())["neural_network"] == COMPACT
    assert len(report.custom_files) == 3
    assert all(Path(path).is_file() for path in report.custom_files)


def test_files_of_the_racer_that_would_replace_the_models_are_named(importer, model):
    write_files(importer.folder / "custom_files", {"hyperparameters.json": b"{}"})

    report = importer.run(model)

    assert any("has another hyperparameters.json" in text for text in report.warnings)
    assert report.other_files == ["hyperparameters.json"]
    assert not any("another" in t for t in importer.run(model, "b", custom_files=True).warnings)


def test_what_follows_an_import_begins_with_its_files_if_others_are_there(
    dr, importer, model, capsys
):
    dr("import", str(model), "-t", "a", "--no-drive")
    fitting = capsys.readouterr().err
    write_files(importer.folder / "custom_files", {"hyperparameters.json": b"{}"})
    dr("import", str(model), "-t", "b", "--no-drive")
    other = capsys.readouterr().err

    assert "-cf" not in fitting
    assert f"dr-import {model} -t b -cf --no-drive" in other
    assert other.index("-cf") < other.index("dr-start-training --resume")


def test_a_key_of_another_algorithm_does_not_make_another_file(importer, tmp_path):
    source = write_files(
        tmp_path / "source",
        {
            "model_30.pb": graph(),
            "model_metadata.json": described(),
            "hyperparameters.json": json.dumps({**HYPERPARAMETERS, "sac_alpha": 0.2}).encode(),
        },
    )
    own = (source / "hyperparameters.json").read_bytes()
    write_files(importer.folder / "custom_files", {"hyperparameters.json": own})

    report = importer.run(source)

    assert not any("another" in text for text in report.warnings)


@pytest.mark.parametrize("algorithm", ALGORITHMS.values(), ids=ALGORITHMS)
def test_a_round_trip_is_silent_and_keeps_every_hyperparameter(
    dr, exporter, monkeypatch, algorithm
):
    monkeypatch.setattr("drcli.transfer.download.open_bucket", lambda *_, **__: exporter.here)
    own = Hyperparameters.model_validate(
        {"lr": 0.0004, "sac_alpha": 0.3, "target_kl": 0.02, "exploration_type": algorithm.explores}
    )
    kept = json.loads(own.canonical_json(algorithm.name))
    metadata = {"continuous": algorithm.ranges_only, "training_algorithm": algorithm.name}
    put_trained_model(exporter.here, "m", numbers=(5,), hyperparameters=kept, **metadata)
    every_key = own.model_dump_json(exclude_none=True).encode()
    folder = write_files(exporter.folder, {"custom_files/hyperparameters.json": every_key}) / "out"
    importer = Importer(exporter.folder, monkeypatch)
    importer.here = exporter.here

    if algorithm.in_reference:
        assert dr("export", "tf-checkpoint", "-p", "m", "--out", str(folder)) == 0
        said = importer.run(folder).warnings
    else:  # no other program has such a model, so it travels as it is
        write_files(folder, {key[2:]: data for key, data in importer.content().items()})
        with pytest.raises(OwnModel):
            importer.plan(folder)
        settings = load_settings(importer.folder)
        options = copy_of_own(settings, ImportOptions(str(folder), "new"))
        said = download(plan_download(settings, options), settings, no_bar).custom_files

    assert said == []
    assert json.loads(importer.here.get("new/ip/hyperparameters.json")) == kept


def test_a_model_is_imported_from_the_folder_of_a_minio(importer, tmp_path):
    bucket = tmp_path / "data" / "minio" / "bucket"
    for name, data in tensorflow().items():
        put(bucket / "old" / name, data, inline=len(data) < 1000)
    put(bucket / "old" / "reward_function.py", REWARD, inline=True)

    report = importer.run(bucket / "old")

    assert report.checkpoint == "12_Step-7824.ckpt"
    assert report.form == "TensorFlow checkpoint"
    assert "reward_function.py" in report.taken
