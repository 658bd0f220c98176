"""`dr stop-training` as its caller meets it."""

import json
import time

import pytest

from drcli.model.lease import write_lease
from drcli.model.model_store import ModelStore
from drcli.records.run_record import Lease
from memory_bucket import MemoryBucket


def test_a_stop_says_what_it_stopped_and_how_to_go_on(dr, run, make_report, capsys):
    run.looks = [make_report("stopped", 3, exit_code=143)]

    code = dr("stop-training")

    printed = capsys.readouterr()
    assert code == 0
    assert printed.out == (
        "Stopped the training of s3://bucket/model; its last checkpoint is 3_Step-1500.ckpt.\n"
    )
    assert "dr-start-training --resume" in printed.err


def test_what_comes_next_names_the_model_that_was_stopped(
    dr, run, make_report, capsys, monkeypatch
):
    run.looks = [make_report("stopped", 3, exit_code=143, prefix="r0")]

    dr("stop-training")
    assert "DR_LOCAL_S3_MODEL_PREFIX=r0 dr-start-training --resume" in capsys.readouterr().err

    run.running = True
    monkeypatch.setenv("DR_LOCAL_S3_MODEL_PREFIX", "r0")
    dr("stop-training")
    said = capsys.readouterr().err
    assert "    DR_LOCAL_S3_MODEL_PREFIX=r0 dr-evaluate --checkpoint best\n" in said


def test_before_the_first_checkpoint_there_is_nothing_to_go_on_with(dr, run, make_report, capsys):
    run.looks = [make_report("stopped", 0, exit_code=143)]

    dr("stop-training")

    printed = capsys.readouterr()
    assert printed.out == "Stopped the training of s3://bucket/model; it has no checkpoint yet.\n"
    assert "dr-start-training -w" in printed.err
    assert "--resume" not in printed.err


def test_a_bucket_that_does_not_answer_is_not_a_model_without_a_checkpoint(
    dr, run, make_report, capsys
):
    silent = "The local S3 server does not run."
    run.looks = [make_report("stopped", 0, exit_code=143, unreachable=silent)]

    dr("stop-training")

    printed = capsys.readouterr()
    assert printed.out == (
        "Stopped the training of s3://bucket/model; whether it has a checkpoint is unknown: "
        "The local S3 server does not run.\n"
    )
    assert "dr-start-training --resume" in printed.err
    assert "-w" not in printed.err


def test_programs_get_what_was_stopped_as_from_the_other_stops(dr, run, make_report, capsys):
    run.looks = [make_report("stopped", 3, exit_code=143)]

    dr("stop-training", "--json")

    assert json.loads(capsys.readouterr().out) == {
        "stopped": [{"kind": "training", "run_id": 0, "model": "s3://bucket/model", "pid": 4242}],
        "server": False,
        "viewer": False,
    }


def test_stopping_nothing_is_harmless_and_takes_one_line(dr, run, capsys):
    run.running = False

    code = dr("stop-training")

    assert code == 0
    assert capsys.readouterr().out == "No training is running.\n"
    assert run.asked == []


def test_a_training_of_another_folder_is_named_and_not_taken_for_none(dr, run, capsys, monkeypatch):
    run.running = False
    bucket = MemoryBucket()
    lease = Lease("s", "tower", 7, time.time(), machine="another")
    write_lease(ModelStore(bucket, "rl-deepracer-sagemaker"), lease)
    monkeypatch.setattr("drcli.run.seen_in_bucket.open_running_bucket", lambda *_: bucket)
    monkeypatch.setenv("DR_LOCAL_S3_MODEL_PREFIX", "rl-deepracer-sagemaker")

    code = dr("stop-training")

    printed = capsys.readouterr()
    assert (code, printed.out) == (3, "")
    assert "rl-deepracer-sagemaker is being trained by process 7 on tower" in printed.err
    assert "in the folder that started it" in printed.err


@pytest.mark.parametrize("flags", [(), ("--json",)])
def test_a_training_that_is_still_leaving_is_a_failure(dr, run, make_report, capsys, flags):
    run.looks = [make_report("running", 3)]
    run.lingers = True

    code = dr("stop-training", *flags)

    printed = capsys.readouterr()
    assert code == 5
    assert bool(printed.out) is bool(flags)
    assert "(process 4242) is still stopping" in printed.err
    assert "Run `dr-stop-training` again" in printed.err
