"""What is checked before an evaluation starts."""

import pytest

from drcli.base.errors import NotAvailable, SettingsError
from drcli.convert.build_network import weights_of
from drcli.convert.frozen_graph import encode_policy
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters
from drcli.records.evaluation_task import PolicySource
from drcli.records.iteration import encode_history
from drcli.run.evaluation_plan import prepare_evaluation
from iterations import iteration_record
from small_policies import metadata_json, small_metadata, small_network


@pytest.mark.parametrize("world", ["nowhere", "Oval_track"])
def test_a_track_that_is_not_installed_is_refused_before_anything_is_said(
    trained, monkeypatch, world
):
    monkeypatch.setattr("drcli.run.evaluation_plan.open_bucket", lambda *_, **__: trained.bucket)
    trained.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", f"DR_WORLD_NAME={world}")
    said: list[str] = []

    with pytest.raises(SettingsError, match=f"DR_WORLD_NAME={world} is"):
        prepare_evaluation(trained.settings(), on_progress=said.append)

    assert said == []


@pytest.mark.parametrize(("prefix", "said"), [("races/cup/models/1/model-1", 0), ("copy", 1)])
def test_the_copy_of_a_model_in_a_race_is_not_said_to_lack_a_history(
    racer, monkeypatch, told, prefix, said
):
    monkeypatch.setattr("drcli.run.evaluation_plan.open_bucket", lambda *_, **__: racer.bucket)
    racer.run_env("DR_WORLD_NAME=reinvent_base")
    settings = racer.settings().replaced(model_prefix=prefix, metrics_prefix=f"{prefix}/metrics")
    racer.bucket.put(keys.model_metadata(prefix), metadata_json())
    CheckpointStore(ModelStore(racer.bucket, prefix)).save(
        5, 600, b"weights", counters=Counters(learned=iteration_record(4))
    )

    prepare_evaluation(settings)

    assert len([each for each in told if "history.json is missing" in each]) == said


def test_a_clone_that_is_evaluated_has_the_history_of_its_model(racer, monkeypatch, told):
    monkeypatch.setattr("drcli.run.evaluation_plan.open_bucket", lambda *_, **__: racer.bucket)
    racer.run_env("DR_WORLD_NAME=reinvent_base", "DR_LOCAL_S3_MODEL_PREFIX=model-1")
    racer.bucket.put(keys.model_metadata("model-1"), metadata_json())
    records = [iteration_record(number) for number in range(5)]
    CheckpointStore(ModelStore(racer.bucket, "model-1")).save(
        5, 600, b"weights", counters=Counters(learned=records[-1])
    )
    racer.bucket.put(keys.history("model-1"), encode_history(records))

    prepare_evaluation(racer.settings(), clone=True)

    assert told == []
    copied = racer.bucket.get(keys.history("model-1-E"))
    assert copied == racer.bucket.get(keys.history("model-1"))


@pytest.fixture
def graph_file(tmp_path):
    """A policy's file with its metadata, and no model in the bucket."""
    metadata = small_metadata()
    model = small_network(metadata)
    path = tmp_path / "policy.pb"
    path.write_bytes(encode_policy(weights_of(model), model.spec, metadata.sensor))
    (tmp_path / "model_metadata.json").write_bytes(metadata_json())
    return path


@pytest.fixture
def empty(racer, monkeypatch):
    monkeypatch.setattr("drcli.run.evaluation_plan.open_bucket", lambda *_, **__: racer.bucket)
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_WORLD_NAME=reinvent_base")
    return racer


def test_a_file_drives_where_no_model_is(empty, graph_file):
    plan = prepare_evaluation(empty.settings(), own=PolicySource(None, graph_file))

    assert plan.checkpoints == ["policy.pb"]
    [source] = plan.job.sources
    assert (source.runtime, source.file, len(source.sha256)) == ("pb", graph_file, 64)
    assert plan.simtrace.startswith("model-1/evaluation-")


def test_a_file_that_does_not_fit_is_refused_before_anything_is_written(empty, graph_file):
    (graph_file.parent / "model_metadata.json").write_bytes(metadata_json("continuous"))

    with pytest.raises(SettingsError, match=r"policy\.pb gives .* has 2 continuous actions"):
        prepare_evaluation(empty.settings(), own=PolicySource(None, graph_file))

    assert list(empty.bucket.list("model-1/")) == []


def test_an_engine_that_is_not_installed_is_named_before_anything_is_written(
    empty, graph_file, monkeypatch
):
    monkeypatch.setattr("drcli.base.installation.is_installed", lambda name: False)

    for own in (PolicySource("openvino"), PolicySource("openvino", graph_file)):
        with pytest.raises(NotAvailable, match="openvino"):
            prepare_evaluation(empty.settings(), own=own)

    assert list(empty.bucket.list("model-1/")) == []


def test_each_racer_is_told_the_option_that_chooses_its_own_checkpoint(trained, monkeypatch):
    monkeypatch.setattr("drcli.run.evaluation_plan.open_bucket", lambda *_, **__: trained.bucket)
    trained.run_env(
        "DR_LOCAL_S3_MODEL_PREFIX=model-1",
        "DR_EVAL_OPP_S3_MODEL_PREFIX=model-1",
        "DR_RACE_TYPE=HEAD_TO_MODEL",
        "DR_WORLD_NAME=reinvent_base",
    )
    said = []

    prepare_evaluation(trained.settings(), on_progress=said.append)

    options = [text.split(". ")[1].partition(" takes")[0] for text in said if "Takes" in text]
    assert options == ["--checkpoint best", "--opp-checkpoint best"]


def test_an_opponent_needs_a_race_between_models(empty, graph_file):
    with pytest.raises(SettingsError, match="DR_RACE_TYPE is TIME_TRIAL"):
        prepare_evaluation(empty.settings(), opponent=PolicySource(None, graph_file))
