"""Trainings of a bucket: with and without records, running, lost, deleted, copied, damaged."""

import csv
import io
import json
import time
from dataclasses import replace

import pytest

from drcli.base.errors import SettingsError
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.model.training_records import write_training
from drcli.model.training_state import write_outcome
from drcli.records.evaluation_task import RaceRecording
from drcli.records.iteration import encode_history
from drcli.records.stage import FrozenCurriculum
from drcli.records.training_record import RecordedStart, RunOutcome, TrainingRecord
from drcli.transfer import training_list
from drcli.transfer.record_training import on_track, results_of
from drcli.transfer.training_list import (
    ORDERS,
    chosen,
    csv_table,
    entry_of,
    known_trainings,
    ordered,
)
from memory_bucket import MemoryBucket
from past_trainings import training


@pytest.fixture
def bucket():
    return MemoryBucket()


def put_model(bucket, prefix, **start):
    """A model as a training leaves it."""
    name = b'{"name": "3_Step-300.ckpt", "avg_eval_metric": 90.0}'
    scores = b'{"best_checkpoint": %b, "last_checkpoint": %b}' % (name, name)
    bucket.put(keys.deepracer_checkpoints(prefix), scores)
    bucket.put(keys.coach_checkpoint(prefix), b"3_Step-300.ckpt")
    if start:
        bucket.put(keys.training_start(prefix), json.dumps(start).encode())


def trial(lap_ms, status="Lap complete", **counts):
    metrics = [{"episode_status": status, "elapsed_time_in_milliseconds": lap_ms, **counts}]
    return json.dumps({"metrics": metrics}).encode()


def put_evaluation(bucket, prefix, number, world, *lap):
    """A stand-alone evaluation with one trial on a track; an empty one was not recorded."""
    stamp = f"2026010100000{number}"
    bucket.put(keys.evaluation_metrics(f"{prefix}/metrics", stamp), lap[0])
    if world:
        recording = RaceRecording(world, False, "TIME_TRIAL", prefix, "1.ckpt", "anna", "Black")
        bucket.put(keys.recording_of(keys.evaluation_trace(prefix, stamp)), recording.encode())


def test_trainings_are_listed_by_the_time_of_their_first_start(bucket):
    for number in (2, 0, 1):
        write_training(bucket, training(number, f"model-{number}"))

    known = known_trainings(bucket)

    assert [record.prefix for record in known.records] == ["model-0", "model-1", "model-2"]
    assert known.existing == frozenset()


def test_a_model_without_a_record_is_worked_out_from_what_it_has(bucket, make_record):
    settings = {"DR_WORLD_NAME": "Vegas_track", "DR_LOCAL_S3_MODEL_PREFIX": "old"}
    put_model(bucket, "old", seed=1, started_at="2026-11-18T10:00:00+00:00", settings=settings)
    history = [make_record(n, evaluation_lap_s=[20.0 - n]) for n in range(4)]
    bucket.put(keys.history("old"), encode_history(history))
    outcome = RunOutcome("s", "vm", 1.0, 2.0, state="finished", code=0, message="Done.", ended_at=9)
    write_outcome(ModelStore(bucket, "old"), outcome)

    [entry] = known_trainings(bucket).entries()

    assert (entry.model, entry.derived, entry.exists) == ("old", True, True)
    assert (entry.world, entry.state, entry.message) == ("Vegas_track", "finished", "Done.")
    assert (entry.iterations, entry.best_lap_s) == (4, 17.0)
    assert (entry.best_checkpoint, entry.best_score) == ("3_Step-300.ckpt", 90.0)
    assert entry.began_at == "2026-11-18T10:00:00Z"
    assert known_trainings(bucket).records[0].id == entry.id  # it can be named


def test_a_model_whose_start_recorded_the_seed_only_has_its_world_from_the_parameter_file(bucket):
    put_model(bucket, "first", seed=1)
    bucket.put("first/training_params.yaml", b'WORLD_NAME: "Tokyo"\nRACE_TYPE: TIME_TRIAL\n')

    [entry] = known_trainings(bucket).entries()

    assert (entry.world, entry.race_type, entry.state) == ("Tokyo", "TIME_TRIAL", "unknown")


def test_models_that_nobody_trained_here_and_copies_are_no_trainings(bucket):
    put_model(bucket, "imported")
    write_training(bucket, training(1, "team/model"))
    settings = {"DR_LOCAL_S3_MODEL_PREFIX": "team/model"}
    for prefix in ("team/model", "uploads/copy"):
        put_model(bucket, prefix, seed=1, settings=settings, training="00000001")

    known = known_trainings(bucket)

    assert [record.prefix for record in known.records] == ["team/model"]
    assert known.models == {"imported", "team/model", "uploads/copy"}


def test_a_copy_whose_original_is_unknown_here_has_an_id_of_its_own(bucket):
    settings = {"DR_LOCAL_S3_MODEL_PREFIX": "elsewhere"}
    for prefix in ("one", "two"):
        put_model(bucket, prefix, seed=1, settings=settings, training="00000001")

    known = known_trainings(bucket)

    assert len({record.id for record in known.records} | {"00000001"}) == 3


def test_a_training_without_a_lease_does_not_run(bucket):
    write_training(bucket, training(1, "lost", state="running", start={"state": "running"}))
    put_model(bucket, "lost", seed=1)

    [entry] = known_trainings(bucket).entries()

    assert entry.state == "lost"


def test_a_training_that_runs_has_its_newest_results(bucket, make_record):
    write_training(bucket, training(1, "live", state="running", start={"state": "running"}))
    put_model(bucket, "live", seed=1)
    bucket.put(keys.history("live"), encode_history([make_record(0), make_record(1)]))
    lease.take(ModelStore(bucket, "live"), "session-1")

    [entry] = known_trainings(bucket).entries()

    assert (entry.state, entry.iterations) == ("running", 2)


def test_an_end_that_only_the_outcome_knows_is_told(bucket):
    write_training(bucket, training(1, "m", state="running", start={"state": "running"}))
    outcome = RunOutcome("session-1", "vm", 1.0, 2.0, state="failed", code=6, message="NaN.")
    write_outcome(ModelStore(bucket, "m"), outcome)

    [entry] = known_trainings(bucket).entries()

    assert (entry.state, entry.message) == ("failed", "NaN.")


def test_evaluations_after_the_training_count(bucket):
    folder = "team/model/metrics/evaluation/evaluation-2026010100000"
    known_before = {"evaluations": 1, "trials": 1, "best_trial_lap_s": 14.0}
    known_before["clean_trial_lap_s"] = {}
    write_training(bucket, training(1, results=known_before))
    put_model(bucket, "team/model", seed=1)
    bucket.put(f"{folder}0.json", trial(1))  # counted before
    bucket.put(f"{folder}1.json", trial(12_500))
    bucket.put(f"{folder}2.json", trial(3_000, "Off track"))
    bucket.put(f"{folder}3.json", b"{half")

    [record] = known_trainings(bucket).records

    assert (record.results.evaluations, record.results.trials) == (4, 3)
    assert record.results.best_trial_lap_s == 12.5


def test_the_best_lap_is_a_clean_one_on_the_track_that_the_row_names(bucket):
    write_training(bucket, training(1, world="Vegas_track", results={"best_lap_s": 16.0}))
    put_model(bucket, "team/model", seed=1)
    put_evaluation(bucket, "team/model", 1, "reinvent_base", trial(13_200))
    put_evaluation(bucket, "team/model", 2, "Vegas_track", trial(12_800, reset_count=1))
    put_evaluation(bucket, "team/model", 3, "", trial(11_000))

    [entry] = known_trainings(bucket).entries()
    assert entry.best_lap_s == 16.0

    put_evaluation(bucket, "team/model", 4, "Vegas_track", trial(15_500))

    [record] = known_trainings(bucket).records
    assert entry_of(record, exists=True).best_lap_s == 15.5
    assert record.results.best_trial_lap_s == 11.0
    tracks = {"reinvent_base": 13.2, "Vegas_track": 15.5, "": 11.0}
    assert record.results.clean_trial_lap_s == tracks
    assert TrainingRecord.decode(record.encode()) == record


def test_a_record_of_version_0_1_0_counts_its_evaluations_again_while_they_are_there(bucket):
    before = {"evaluations": 2, "trials": 2, "best_lap_s": None, "best_trial_lap_s": 13.2}
    for number, prefix in enumerate(("there", "gone")):
        old = json.loads(training(number, prefix, results=before).encode())
        del old["results"]["clean_trial_lap_s"]
        bucket.put(keys.training_record(prefix, old["id"]), json.dumps(old).encode())
    put_model(bucket, "there", seed=1)
    put_evaluation(bucket, "there", 1, "reinvent_base", trial(13_200, reset_count=2))
    put_evaluation(bucket, "there", 2, "reinvent_base", trial(14_100))

    there, gone = known_trainings(bucket).records

    assert entry_of(there, exists=True).best_lap_s == 14.1
    assert (there.results.evaluations, there.results.trials) == (2, 2)
    assert entry_of(gone, exists=False).best_lap_s is None  # its track is not known
    assert (gone.results.evaluations, gone.results.trials) == (2, 2)


def test_laps_that_a_training_drove_on_another_track_are_not_compared(bucket, make_record):
    starts = tuple(
        RecordedStart(resumes=resumes, settings={"DR_WORLD_NAME": world})
        for resumes, world in ((None, "oval"), ("2_Step-200.ckpt", "Vegas_track"))
    )
    laps = [9.0, 8.5, 16.0, 15.5]
    history = [
        make_record(n, evaluation_progress=[50.0 + n], evaluation_lap_s=[lap_s], best_lap_s=lap_s)
        for n, lap_s in enumerate(laps)
    ]
    resumed = training(1, world="Vegas_track", starts=starts)

    results = results_of(history, None, on_track(resumed, history))
    unknown = replace(resumed, starts=tuple(replace(each, resumes=None) for each in starts))

    assert (results.best_lap_s, results.best_training_lap_s) == (15.5, 15.5)
    assert (results.best_progress, results.evaluated_laps) == (53.0, 4)
    assert on_track(unknown, history) == set()
    named = [replace(record, world="oval") for record in history[:3]] + history[3:]
    assert on_track(resumed, named) == {3}


def test_laps_of_stages_on_other_tracks_are_not_compared(bucket, make_record):
    stages = {"stages": [{"name": "wide", "world": "oval", "goal": {"laps": 3}}]}
    stages["stages"].append({"name": "real"})
    frozen = FrozenCurriculum("curriculum.yaml", json.dumps(stages))
    bucket.put(keys.curriculum("team/model"), frozen.encode())
    history = [
        make_record(0, stage="wide", evaluation_progress=[100.0], evaluation_lap_s=[9.0]),
        make_record(1, stage="real", evaluation_progress=[100.0], evaluation_lap_s=[16.0]),
    ]
    bucket.put(keys.history("team/model"), encode_history(history))
    put_model(bucket, "team/model", seed=1)
    running = training(1, state="running", start={"state": "running"}, stages=2)
    write_training(bucket, running)
    lease.take(ModelStore(bucket, "team/model"), "session-1")

    [entry] = known_trainings(bucket).entries()

    assert entry.best_lap_s == 16.0


def test_a_record_whose_model_is_gone_without_us_says_so(bucket):
    write_training(bucket, training(1, "gone"))
    write_training(bucket, training(2, "there"))
    put_model(bucket, "there", seed=1)

    assert [entry.exists for entry in known_trainings(bucket).entries()] == [False, True]


def test_damaged_records_are_told_and_the_others_listed(bucket):
    write_training(bucket, training(1, "whole"))
    bucket.put(keys.training_record("damaged", "0000000a"), b"{half")
    bucket.put(keys.training_record("newer", "0000000b"), b'{"format": 99}')
    bucket.put(keys.training_record("other", "0000000c"), training(1, "whole").encode())
    bucket.put("training-records/notes.txt", b"mine")

    known = known_trainings(bucket)

    assert [record.prefix for record in known.records] == ["whole"]
    assert len(known.damaged) == 3
    assert any("damaged/0000000a.json is damaged" in text for text in known.damaged)


def test_many_records_are_read_at_the_same_time(bucket):
    get, busy, most = bucket.get, [], []

    def slow(key, **options):
        busy.append(key)
        most.append(len(busy))
        time.sleep(0.002)
        busy.remove(key)
        return get(key, **options)

    for number in range(24):
        write_training(bucket, training(number, f"m-{number}"))
    bucket.get = slow

    assert len(known_trainings(bucket).records) == 24
    assert max(most) > 1


def test_a_list_takes_one_request_a_record_and_reads_only_the_newest_evaluations(
    bucket, monkeypatch
):
    monkeypatch.setattr(training_list, "MOST_EVALUATIONS", 10)
    before = {"evaluations": 1, "clean_trial_lap_s": {}}
    for number in range(5):
        write_training(bucket, training(number, f"m-{number}", results=before))
        put_model(bucket, f"m-{number}", seed=1)
        for day in range(1, 8):
            key = f"m-{number}/metrics/evaluation/evaluation-202601{day:02d}000000.json"
            bucket.put(key, trial(1000 * (20 - number)) if day > 1 else trial(1))
    read, get = [], bucket.get
    bucket.get = lambda key, **options: read.append(key) or get(key, **options)

    known = known_trainings(bucket)

    assert len(read) == 5 + 10 + 10  # a clean lap has the track beside its trace
    assert {key[-19:-11] for key in read if "metrics/evaluation/" in key} == {
        "20260106",
        "20260107",
    }
    assert "20 older results of dr-evaluate were not read" in known.damaged[0]
    assert [record.results.best_trial_lap_s for record in known.records] == [
        20.0 - number for number in range(5)
    ]


@pytest.fixture
def known(bucket):
    """Two trainings of one model and one of another."""
    write_training(bucket, training(0x1AB, gone_at=1.0))
    write_training(bucket, training(0x1AC))
    write_training(bucket, training(0x2FF, "other", hyperparameters={"lr": 0.5}))
    return known_trainings(bucket)


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("000001ab", "000001ab"),
        ("000001AB", "000001ab"),
        ("000002", "000002ff"),
        ("team/model", "000001ac"),
        ("team/model/", "000001ac"),
        ("team/model~0", "000001ac"),
        ("team/model~1", "000001ab"),
        ("other", "000002ff"),
    ],
)
def test_a_training_is_named_by_its_id_or_its_model(known, name, found):
    assert known.find(name).id == found


def test_the_name_of_a_model_comes_before_the_beginning_of_an_id(bucket):
    write_training(bucket, training(0x1AB, "team/model"))
    write_training(bucket, training(2, "0000"))
    known = known_trainings(bucket)

    assert known.find("0000").prefix == "0000"
    assert known.find("000001").prefix == "team/model"


@pytest.mark.parametrize(
    ("name", "message", "remedy"),
    [
        ("000001", "is the beginning of 2 trainings: 000001ab, 000001ac", "Write more digits"),
        ("none", "There is no training none in s3://bucket", "dr-history"),
        ("other~1", "other has one training", "dr-history other"),
        ("other~x", "There is no training other~x", "dr-history"),
    ],
)
def test_a_name_that_means_no_training_is_refused(known, name, message, remedy):
    with pytest.raises(SettingsError, match=message) as error:
        known.find(name)

    assert remedy in error.value.remedy


def test_the_last_ones_are_chosen_and_the_best_come_last(bucket):
    for number, lap in enumerate((None, 12.0, 20.0, 15.0)):
        write_training(bucket, training(number, f"m-{number}", results={"best_lap_s": lap}))

    found = chosen(known_trainings(bucket), [], "lap", limit=3)

    assert [entry.best_lap_s for entry in found.trainings] == [20.0, 15.0, 12.0]
    assert found.total == 4


@pytest.mark.parametrize("sort", ORDERS)
def test_every_order_takes_trainings_of_which_nothing_is_known(sort):
    unknown = training(1, began_at=0.0, hours=None, results={"best_lap_s": None})
    entries = [entry_of(unknown, exists=False), entry_of(training(2), exists=True)]

    assert len(ordered(entries, sort)) == 2


def test_the_table_has_a_row_for_each_training_with_its_settings(known):
    text = csv_table(known, known.entries())

    header = next(csv.reader(io.StringIO(text)))
    cells = list(csv.DictReader(io.StringIO(text)))
    assert [each["id"] for each in cells] == ["000001ab", "000001ac", "000002ff"]
    assert [each["lr"] for each in cells] == ["0.001", "0.001", "0.5"]
    assert "DR_WORLD_NAME" in header
    assert header.count("world") == 1
