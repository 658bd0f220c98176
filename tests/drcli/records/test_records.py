"""Every record comes back from its bytes, keeps its format, and refuses everything else."""

import json
import math
from dataclasses import replace
from typing import Any

import pytest

from drcli.base.json_record import Fingerprint, RecordError
from drcli.records.checkpoint import CheckpointName, CheckpointRecord, Counters, decode_pointer
from drcli.records.episode_metrics import (
    EpisodeMetrics,
    EvaluationTrials,
    TrialMetrics,
    decode_metrics,
    encode_metrics,
)
from drcli.records.iteration import decode_history, encode_history
from drcli.records.rollout import Driving, Manifest, Part
from drcli.records.run_record import ActivityRecord, Lease, TrainingEnd
from drcli.records.scores import EvaluationEpisodes, EvaluationResult, Score, Scores
from drcli.records.training_record import GitState, Pretrained, TrainingStart
from iterations import iteration_record

ITERATION = iteration_record(3, elapsed_s=9.0)
CHECKPOINT = CheckpointRecord(
    "4_Step-400.ckpt",
    Fingerprint(8, "ab"),
    counters=Counters(12, 60.0, "fp32", ITERATION, 7, {"hyperparameters.json": "{}"}),
)
START = TrainingStart(7, "2026-01-01T00:00:00+00:00", {"DR_TRAIN_SEED": 7})
EVALUATION = EvaluationEpisodes([50.0, 100.0], [1.0, 2.0], [12.5])
RECORDS = [
    CHECKPOINT,
    ITERATION,
    EvaluationResult("4_Step-400.ckpt", [50.0, 100.0], [1.0, 2.0], [12.5], confirmation=EVALUATION),
    Scores(Score("3_Step-300.ckpt", 80.0, 1.0, EVALUATION), Score("4_Step-400.ckpt")),
    Lease("session", "host", 7, 1.0e9, "machine", 3.0, 2, released=True),
    Manifest(3, 1, "3_Step-300.ckpt", "s-7-1", (Part("k", Fingerprint(999, "ab"), 1, 5),)),
    Manifest(3, 1, "3_Step-300.ckpt", "s-7-1", (), Driving(2.5, 3)),
    ActivityRecord("learns", 1.0e9, 7, "host"),
    TrainingEnd("session", "It is over."),
    EpisodeMetrics(6, 2200, 2000, 200, 5, 5, "training", 100, "Lap complete", 3),
    TrialMetrics(100, 2200, 2000, 200, "Lap complete", 0, 0, 0, 0, 0, 1),
    TrialMetrics(100, 2200, 2000, 200, "Lap complete", 0, 0, 1, 0, 1, 1, 2000, 0.5, 0.1, 2.5, 7),
    replace(
        START,
        git={"working_folder": None, "package": GitState("abc", dirty=False)},
        pretrained=Pretrained("other", "best", "1_Step-9.ckpt", None, "ab"),
        earlier=[START],
    ),
]

every_record = pytest.mark.parametrize("record", RECORDS, ids=lambda r: type(r).__name__)


@every_record
def test_a_record_comes_back_from_its_bytes(record: Any):
    assert type(record).decode(record.encode()) == record
    assert b"\n" not in record.encode()


@every_record
@pytest.mark.parametrize("data", [b"", b"null", b"[]", b"7", b"{}", b"{", b"\xff", b"{" * 3_000])
def test_other_bytes_are_refused_with_a_reason(record: Any, data: bytes):
    with pytest.raises(RecordError, match=r"\w+ `?\w+"):
        type(record).decode(data)


@every_record
def test_a_record_with_a_value_of_another_type_is_refused_and_its_key_named(record: Any):
    fields = json.loads(record.encode())
    key = next(iter(fields))

    with pytest.raises(RecordError, match=rf"at `\$\.{key}"):
        type(record).decode(json.dumps({**fields, key: [[]]}).encode())


@every_record
def test_keys_of_a_later_version_are_passed_over(record: Any):
    fields = json.loads(record.encode())

    assert type(record).decode(json.dumps({**fields, "added later": 1}).encode()) == record


def test_lists_of_records_come_back_from_their_files():
    metrics, trial = RECORDS[9], RECORDS[10]
    unknown = replace(ITERATION, kl=math.nan)

    assert decode_history(encode_history([ITERATION])) == [ITERATION]
    assert math.isnan(decode_history(encode_history([unknown]))[0].kl)
    assert decode_metrics(encode_metrics([metrics], "progress")) == [metrics]
    result = EvaluationTrials([[trial], [trial]], ["moved"])
    assert EvaluationTrials.decode(result.encode()) == result


@pytest.mark.parametrize("data", [b"", b"{}", b"[7]", b"[[7]]", b'{"metrics": 7}'])
def test_files_that_list_something_else_are_refused(data):
    for decode in (decode_history, decode_metrics, EvaluationTrials.decode):
        with pytest.raises(RecordError):
            decode(data)


@pytest.mark.parametrize("version", [3.0, "3", None])
def test_metrics_of_another_version_are_read_if_their_records_fit(version):
    file = json.loads(encode_metrics([RECORDS[9]], "progress"))
    later = {**file, "version": version}

    assert file["version"] == 2.0
    assert decode_metrics(json.dumps(later).encode()) == [RECORDS[9]]
    with pytest.raises(RecordError, match="missing required field `reward_score`"):
        decode_metrics(json.dumps({**later, "metrics": [{"episode": 1}]}).encode())


def test_metrics_of_other_tools_are_read_with_fractions_and_unknown_keys():
    file = json.loads(encode_metrics([RECORDS[9]], "progress"))
    changed = {
        "reward_score": 12.75,
        "metric_time": 3000.5,
        "start_time": 1000.25,
        "elapsed_time_in_milliseconds": 2000.25,
        "completion_percentage": 37.5,
    }
    [record] = file["metrics"]
    data = {**file, "metrics": [{**record, **changed, "their own": [1]}]}

    [read] = decode_metrics(json.dumps(data).encode())

    assert {name: getattr(read, name) for name in changed} == changed


def test_whole_numbers_are_written_as_such_again():
    for record in (RECORDS[9], RECORDS[10]):
        data = record.encode()

        assert b"." not in data
        assert type(record).decode(data).encode() == data


def test_a_checkpoint_record_has_the_format_of_version_0_1_0():
    written = json.loads(CHECKPOINT.encode())

    assert list(written) == ["name", "tensors", "optimizer", "sim_time_s", "counters"]
    assert written["tensors"] == {"size_bytes": 8, "sha256": "ab"}
    assert set(written["counters"]) == {
        *("episodes", "elapsed_s", "number_format", "learned", "seed", "inputs"),
    }
    assert written["counters"]["learned"]["checkpoint"] == "3_Step-300.ckpt"


def test_a_checkpoint_record_of_strict_json_keeps_what_is_unknown():
    unknown = replace(ITERATION, entropy=math.nan)
    record = replace(CHECKPOINT, counters=Counters(learned=unknown))

    data = record.encode()

    assert b"NaN" not in data
    assert math.isnan(CheckpointRecord.decode(data).counters.learned.entropy)


def test_a_record_of_another_checkpoint_is_refused():
    with pytest.raises(RecordError, match=r"it describes 4_Step-400\.ckpt"):
        CheckpointRecord.decode_of("5_Step-500.ckpt", CHECKPOINT.encode())


def test_a_pointer_names_a_checkpoint_and_nothing_else():
    name = CheckpointName(12, 7824)

    assert str(name) == "12_Step-7824.ckpt"
    assert decode_pointer(b"12_Step-7824.ckpt\n") == name
    for data in (b"", b"\xff\xff", b"12", b"model"):
        with pytest.raises(RecordError, match="is not the name of a checkpoint"):
            decode_pointer(data)


def test_a_manifest_has_the_format_of_version_0_1_0_and_counts():
    written = json.loads(RECORDS[5].encode())
    later = written.pop("rollbacks"), written["notes"].pop("reward_errors")
    assert (*later, written["notes"].pop("discarded")) == (0, 0, 0)
    assert written == {
        "iteration": 3,
        "worker": 1,
        "checkpoint": "3_Step-300.ckpt",
        "session": "s-7-1",
        "parts": [
            {
                "key": "k",
                "fingerprint": {"size_bytes": 999, "sha256": "ab"},
                "episodes": 1,
                "steps": 5,
            }
        ],
        "notes": {"drive_s": 0.0, "evaluates": None},
    }


def test_the_age_of_a_lease_is_not_written():
    assert "age_s" not in json.loads(RECORDS[4].encode())
