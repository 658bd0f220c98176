"""Which traces a model has, in every layout, and which names are refused."""

import pytest

from drcli.base.errors import SettingsError
from drcli.config.run_config import ModelConfig
from drcli.model import keys
from drcli.model.model_store import ModelStore
from drcli.records.episode_metrics import encode_metrics_file
from drcli.records.iteration import encode_history
from drcli.view.playback.stored_traces import (
    models_with_traces,
    parse_name,
    stored_traces,
    trace_key,
)
from memory_bucket import MemoryBucket
from stored_models import trial

CONFIG = ModelConfig("other", "other/metrics", "progress", 1, "", "")
STAMP = "20260102030405"


def test_traces_of_all_layouts_are_found_with_what_is_known_about_them(make_record):
    bucket = MemoryBucket()
    for key in (
        "m/0/training-simtrace/3-iteration.csv",
        "m/12/training-simtrace/3-iteration.csv",
        "m/training-simtrace/10-iteration.csv",
        "m/sim-trace/training/20250101/training-simtrace/1-iteration.csv",
        f"m/evaluation-{STAMP}/evaluation-simtrace/0-iteration.csv",
        "m/sim-trace/evaluation/20250102/evaluation-simtrace/0-iteration.csv",
        "m/evaluation-simtrace/0-iteration.csv",
        "m/training-simtrace/notes.txt",
        "m-10/training-simtrace/0-iteration.csv",
    ):
        bucket.put(key, b"x")
    bucket.put(keys.history("m"), encode_history([make_record(3)]))
    clean = {"off_track_count": 0, "reset_count": 0}
    trials = [
        trial(1, 12_500),
        trial(2, 15_500, **clean),
        trial(3, 9_000, completion_percentage=40, episode_status="Off track", reset_count=0),
    ]
    bucket.put(keys.evaluation_metrics("m/metrics", STAMP), encode_metrics_file(trials))

    found = stored_traces(ModelStore(bucket, "m"), CONFIG)

    assert [(each.kind, each.worker, each.iteration) for each in found.traces] == [
        ("training", 0, 1),
        ("training", 0, 3),
        ("training", 12, 3),
        ("training", 0, 10),
        ("evaluation", 0, 0),
        ("evaluation", 0, 0),
        ("opponent", 0, 0),
    ]
    assert found.traces[1].mean_reward == make_record(3).mean_reward
    assert found.traces[3].mean_reward is None
    assert [each.stamp for each in found.traces[4:6]] == ["20250102", STAMP]
    by_stamp = {each.stamp: each for each in found.traces if each.kind == "evaluation"}
    newest = by_stamp[STAMP]
    assert (newest.mean_progress, newest.best_lap_s) == (80.0, 15.5)
    assert (newest.full_laps, newest.clean_laps, newest.resets) == (2, 1, 1)
    assert by_stamp["20250102"].mean_progress is None
    assert found.notes == []


def test_traces_of_a_model_inside_of_another_one_are_its_own():
    bucket = MemoryBucket()
    bucket.put("team/training-simtrace/0-iteration.csv", b"x")
    bucket.put("team/1/training-simtrace/5-iteration.csv", b"x")
    bucket.put("team/1/model/model_metadata.json", b"{}")

    names = [each.name for each in stored_traces(ModelStore(bucket, "team"), CONFIG).traces]

    assert names == ["training-simtrace/0-iteration.csv"]
    assert [
        each.iteration for each in stored_traces(ModelStore(bucket, "team/1"), CONFIG).traces
    ] == [5]


def test_folders_with_traces_alone_are_models_too():
    bucket = MemoryBucket()
    for key in (
        "team/training-simtrace/0-iteration.csv",
        "team/1/training-simtrace/5-iteration.csv",
        "team/1/model/model_metadata.json",
        "old/7/training-simtrace/0-iteration.csv",
        "old/evaluation-1/evaluation-simtrace/0-iteration.csv",
        "console/sim-trace/training/training-simtrace/0-iteration.csv",
        "odd name/training-simtrace/0-iteration.csv",
        "rollouts/team/1/0/manifest.json",
    ):
        bucket.put(key, b"x")

    assert models_with_traces(bucket.list("")) == ["console", "old", "team", "team/1"]


def test_damaged_metrics_are_told_and_the_traces_shown():
    bucket = MemoryBucket()
    bucket.put(f"m/evaluation-{STAMP}/evaluation-simtrace/0-iteration.csv", b"x")
    bucket.put(keys.evaluation_metrics("m/metrics", STAMP), b'{"metrics": [{}]}')
    bucket.put(keys.history("m"), b"nonsense")

    found = stored_traces(ModelStore(bucket, "m"), CONFIG)

    assert len(found.traces) == 1
    assert any("history.json" in note for note in found.notes)
    assert any(f"evaluation-{STAMP}.json is damaged" in note for note in found.notes)


@pytest.mark.parametrize(
    ("model", "name"),
    [
        ("m", "../other/training-simtrace/0-iteration.csv"),
        ("m", "training-simtrace/../../x/0-iteration.csv"),
        ("m", "sim-trace/training/../training-simtrace/0-iteration.csv"),
        ("m", "sim-trace/evaluation/../evaluation-simtrace/0-iteration.csv"),
        ("m", "evaluation-../evaluation-simtrace/0-iteration.csv"),
        ("m", "evaluation-a/b/evaluation-simtrace/0-iteration.csv"),
        ("m", "/training-simtrace/0-iteration.csv"),
        ("m", "training-simtrace/0-iteration.csv\n"),
        ("m", "training-simtrace/٣-iteration.csv"),
        ("m", "model/model_metadata.json"),
        ("..", "training-simtrace/0-iteration.csv"),
        ("m/../x", "training-simtrace/0-iteration.csv"),
        ("/etc", "training-simtrace/0-iteration.csv"),
        ("", "training-simtrace/0-iteration.csv"),
    ],
)
def test_only_traces_below_a_model_have_a_key(model, name):
    with pytest.raises(SettingsError, match="is no "):
        trace_key(model, name)


def test_a_key_is_below_the_model():
    name = f"evaluation-{STAMP}/evaluation-simtrace/0-iteration.csv"
    trace = parse_name(name)

    assert trace_key("team/m", name) == f"team/m/{name}"
    assert trace is not None
    assert trace.stamp == STAMP


def test_a_model_that_does_not_exist_is_told():
    with pytest.raises(SettingsError, match="There is no model m in"):
        stored_traces(ModelStore(MemoryBucket(), "m"), CONFIG)
    with pytest.raises(SettingsError, match="no name of a model"):
        stored_traces(ModelStore(MemoryBucket(), "../m"), CONFIG)
