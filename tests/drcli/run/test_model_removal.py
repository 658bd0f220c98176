"""A model is deleted with all its traces, and nothing else goes (item 15 of the racer's day)."""

import inspect
import os
from dataclasses import replace

import pytest

from drcli.base.errors import SettingsError, StorageError
from drcli.base.processes import started_s
from drcli.model import keys, lease
from drcli.model.model_list import list_models
from drcli.model.model_store import ModelStore
from drcli.model.training_records import read_files, read_trainings, write_training
from drcli.records.run_record import EvaluationRecord, RunRecord, claim, log_file, run_folder
from drcli.records.training_record import TrainingStart
from drcli.transfer.model_removal import plan_removal, remove_models
from drcli.transfer.tidy import TidyOptions, find_surplus
from memory_bucket import MemoryBucket
from past_trainings import training
from removable_models import OTHERS, Killed, objects, put_all


def remove(settings, *names: str, **options):
    return remove_models(plan_removal(settings, names, **options), settings)


def test_all_traces_go_and_nothing_of_models_with_similar_names(bucket, settings):
    expected = MemoryBucket()
    for prefix in OTHERS:
        put_all(expected, prefix)

    report = remove(settings(), "model-1")

    assert objects(bucket) == objects(expected) | {"custom_files/reward_function.py"}
    assert [model.objects for model in report.models] == [19]


def test_logs_and_records_on_this_machine_go_too_but_not_those_of_inner_models(
    bucket, settings, working_folder
):
    for prefix in ("model-1", "model-1/inner", "model-10"):
        path = log_file(working_folder, prefix, "trainer")
        path.parent.mkdir(parents=True)
        path.write_text("log")

    remove(settings(), "model-1")

    assert not log_file(working_folder, "model-1", "trainer").exists()
    assert log_file(working_folder, "model-1/inner", "trainer").exists()
    assert log_file(working_folder, "model-10", "trainer").exists()


def test_event_files_go_too_but_not_those_of_inner_models(bucket, settings, working_folder):
    top = working_folder / "data" / "tensorboard"
    for prefix in ("model-1", "model-1/inner", "model-10"):
        (top / prefix).mkdir(parents=True)
        (top / prefix / "events.out.tfevents.1.host").write_bytes(b"figures")

    report = remove(settings(), "model-10", "model-1")

    assert [each.name for each in top.rglob("*") if each.is_dir()] == ["model-1", "inner"]
    assert not list((top / "model-1").glob("events*"))
    assert [len(model.files) for model in report.models] == [1, 1]
    remove(settings(), "model-1/inner")
    assert list(top.iterdir()) == []


def test_its_report_goes_too_but_no_other_file_that_the_racer_has_made(
    bucket, settings, working_folder
):
    top = working_folder / "data" / "analysis"
    (top / "model-1").mkdir(parents=True)
    for name in ("model-1", "model-1/inner", "model-10"):
        (top / f"{name}.html").write_text("report")
    for name in ("model-1.html", "model-1.mp4", "data/analysis/model-1.png"):
        (working_folder / name).write_text("of the racer")

    report = remove(settings(), "model-1")

    assert [model.files for model in report.models] == [[str(top / "model-1.html")]]
    left = {path.relative_to(top).as_posix() for path in top.rglob("*") if path.is_file()}
    assert left == {"model-1/inner.html", "model-10.html", "model-1.png"}
    assert (working_folder / "model-1.html").exists()
    assert (working_folder / "model-1.mp4").exists()
    remove(settings(), "model-1/inner", "model-10")
    assert [path.name for path in top.iterdir()] == ["model-1.png"]


def test_metrics_in_another_folder_go_too(bucket, settings, working_folder):
    (working_folder / "run.env").write_text(
        "DR_LOCAL_S3_MODEL_PREFIX=model-1\nDR_LOCAL_S3_METRICS_PREFIX=numbers/one\n"
    )
    names = [name for name in vars(keys) if below_metrics(name)]
    assert len(names) >= 5
    for name in names:
        takes_stamp = "stamp" in inspect.signature(getattr(keys, name)).parameters
        arguments = ["20260101000000"] if takes_stamp else []
        bucket.put(getattr(keys, name)("numbers/one", *arguments), b"{}")
    bucket.put(keys.training_metrics("numbers/one", 1), b"{}")
    bucket.put(keys.part(keys.training_metrics("numbers/one"), 1), b"{}")
    bucket.put("numbers/one/mine.csv", b"mine")

    remove(settings(), "model-1")

    assert [info.key for info in bucket.list("numbers/")] == ["numbers/one/mine.csv"]


def below_metrics(name: str) -> bool:
    """Whether a function of `keys` names an object in the folder of metrics."""
    function = getattr(keys, name)
    return inspect.isfunction(function) and "metrics" in inspect.signature(function).parameters


def test_a_model_that_trains_anywhere_stays(bucket, settings):
    lease.take(ModelStore(bucket, "model-1"), "session")
    before = objects(bucket)

    with pytest.raises(SettingsError, match="is being trained by"):
        remove(settings(), "model-10", "model-1")

    assert objects(bucket) == before


@pytest.mark.parametrize("others", [[], ["model-10", "model-1"]], ids=["alone", "of several"])
def test_a_model_that_is_evaluated_here_stays(bucket, settings, working_folder, others):
    folder = claim(working_folder, 0, "20260101000000")
    EvaluationRecord(
        run_id=0,
        stamp="20260101000000",
        bucket="bucket",
        prefix=others[0] if others else "model-1",
        world="reinvent_base",
        checkpoint="0_Step-0.ckpt",
        pid=os.getpid(),
        pid_started=started_s(os.getpid()),
        worker_pid=1,
        started_at=1.0,
        others=others[1:],
    ).write(folder)

    with pytest.raises(SettingsError, match="model-1 is being evaluated"):
        plan_removal(settings(), ["model-1"])
    assert find_surplus(settings(), TidyOptions(models=["model-1"])).busy == ["model-1"]


def test_a_training_that_starts_after_the_question_keeps_its_model(bucket, settings):
    planned = plan_removal(settings(), ["model-1"])
    lease.take(ModelStore(bucket, "model-1"), "session")
    before = objects(bucket)

    with pytest.raises(SettingsError, match="is being trained by"):
        remove_models(planned, settings())

    assert objects(bucket) == before


@pytest.mark.parametrize("deletes", [1, 2])
def test_a_deletion_that_is_cut_off_leaves_nothing_that_looks_like_a_model(
    bucket, settings, monkeypatch, deletes
):
    monkeypatch.setattr("drcli.transfer.model_removal.BATCH", 3)
    bucket.deletes_left = deletes

    with pytest.raises(Killed):
        remove(settings(), "model-1")

    bucket.deletes_left = 1_000
    assert "model-1" not in [model.prefix for model in list_models(bucket).models]
    assert not any(key.endswith(".ckpt.json") for key in objects(bucket) if "model-1/m" in key)
    lease.release(
        ModelStore(bucket, "model-1"), lease.read_lease(ModelStore(bucket, "model-1")).session
    )
    remove(settings(), "model-1")
    assert not any(key.startswith(("model-1/m", "runs/model-1/l")) for key in objects(bucket))


def test_patterns_choose_and_keep_spares(bucket, settings):
    report = plan_removal(settings(), ["model-1*"], ["*inner", "model-10"]).report

    assert [model.prefix for model in report.models] == ["model-1", "model-1-old"]


@pytest.mark.parametrize("name", ["nothing", "custom_files", "../model-1", "", "mod"])
def test_what_is_no_model_is_refused(bucket, settings, name):
    with pytest.raises(SettingsError):
        plan_removal(settings(), [name])


def test_a_folder_of_models_is_refused_with_their_names(bucket, settings):
    put_all(bucket, "team/1")

    with pytest.raises(SettingsError, match="is no model, but a folder with 1: team/1"):
        plan_removal(settings(), ["team"])


def test_a_deletion_that_is_cut_off_anywhere_is_completed_by_the_same_command(
    bucket, settings, monkeypatch, working_folder
):
    """Also of metrics in another folder, which only a record of the model names."""
    monkeypatch.setattr("drcli.transfer.model_removal.BATCH", 1)
    (working_folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=other\n")
    log = log_file(working_folder, "model-1", "trainer")

    for deletes in range(1, 30, 4):
        log.parent.mkdir(parents=True, exist_ok=True)
        put_all(bucket, "model-1")
        start = TrainingStart(seed=1, settings={"DR_LOCAL_S3_METRICS_PREFIX": "numbers"})
        bucket.put(keys.training_start("model-1"), start.encode())
        bucket.put("numbers/TrainingMetrics.json", b"{}")
        log.write_text("log")
        bucket.deletes_left = deletes
        try:
            remove(settings(), "model-1")
        except Killed:
            done = False
        else:
            done = True
        bucket.deletes_left = 1_000
        if not done:
            if left := lease.read_lease(ModelStore(bucket, "model-1")):
                lease.release(ModelStore(bucket, "model-1"), left.session)
            remove(settings(), "model-1")

        assert not any(
            key.startswith(("model-1/m", "runs/model-1/l", "numbers/")) for key in objects(bucket)
        )
        assert not log.exists()
        if done:
            return
    pytest.fail("It never ended.")


def test_logs_that_are_left_after_the_objects_are_gone_can_be_deleted(
    bucket, settings, working_folder
):
    log = log_file(working_folder, "gone", "trainer")
    log.parent.mkdir(parents=True)
    log.write_text("log")

    report = remove(settings(), "gone")

    assert [model.files for model in report.models] == [[str(log)]]
    assert not log.parent.exists()


@pytest.mark.parametrize("inside", ["../../../mine", "{folder}/mine", "a/../../../../mine"])
def test_a_model_with_an_impossible_name_has_no_files_here(
    bucket, settings, working_folder, inside
):
    """Keys in a bucket can be anything; `..` in one must not reach files of the racer."""
    mine = working_folder / "mine" / "file"
    mine.parent.mkdir()
    mine.write_text("mine")
    (working_folder / "data" / "logs" / "sagemaker" / "a").mkdir(parents=True)
    prefix = inside.format(folder=working_folder)
    bucket.put(f"{prefix}/model/.coach_checkpoint", b"{}")
    assert prefix in [model.prefix for model in plan_removal(settings(), ["*"]).report.models]

    remove(settings(), "*")

    assert mine.read_text() == "mine"
    assert not any(key.startswith(prefix) for key in objects(bucket))


def test_a_name_with_brackets_is_found_as_it_is(bucket, settings):
    bucket.put("odd [1]/model/.coach_checkpoint", b"{}")

    remove(settings(), "odd [1]")

    assert "odd [1]/model/.coach_checkpoint" not in objects(bucket)


@pytest.mark.parametrize("metrics", ["model-10", "model-10/metrics", "model-1-old/numbers/deep"])
def test_metrics_in_the_folder_of_another_model_stay(bucket, settings, working_folder, metrics):
    (working_folder / "run.env").write_text(
        f"DR_LOCAL_S3_MODEL_PREFIX=model-1\nDR_LOCAL_S3_METRICS_PREFIX={metrics}\n"
    )
    bucket.put(f"{metrics}/TrainingMetrics.json", b"{}")

    remove(settings(), "model-1")

    assert f"{metrics}/TrainingMetrics.json" in objects(bucket)


def test_metrics_in_a_folder_that_another_model_shares_stay(bucket, settings, working_folder):
    (working_folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=other\n")
    start = TrainingStart(seed=1, settings={"DR_LOCAL_S3_METRICS_PREFIX": "numbers"})
    for prefix in ("model-1", "model-10"):
        bucket.put(keys.training_start(prefix), start.encode())
    bucket.put("numbers/TrainingMetrics.json", b"{}")

    remove(settings(), "model-1")
    assert "numbers/TrainingMetrics.json" in objects(bucket)

    remove(settings(), "model-10")
    assert "numbers/TrainingMetrics.json" not in objects(bucket)


def test_logs_of_a_model_of_the_same_name_in_another_bucket_stay(bucket, settings, working_folder):
    log = log_file(working_folder, "model-1", "trainer")
    log.parent.mkdir(parents=True)
    log.write_text("log")
    RunRecord(
        run_id=0,
        session="a",
        bucket="elsewhere",
        prefix="model-1",
        world="reinvent_base",
        state="finished",
        pid=1,
        pid_started=1.0,
        started_at=1.0,
    ).write(run_folder(working_folder, 0))

    remove(settings(), "model-1")

    assert log.exists()
    assert RunRecord.read(run_folder(working_folder, 0)) is not None


def trained(bucket, prefix: str = "model-1") -> None:
    """Let the model have been trained, with a record of its training."""
    start = TrainingStart(seed=1, settings={"DR_LOCAL_S3_MODEL_PREFIX": prefix})
    bucket.put(keys.training_start(prefix), replace(start, training="00000001").encode())
    write_training(bucket, training(1, prefix))


def test_the_record_of_the_training_stays_and_says_that_the_model_is_gone(bucket, settings):
    trained(bucket)
    trained(bucket, "model-10")

    report = remove(settings(), "model-1")

    [record] = read_trainings(bucket, "model-1")[0]
    assert report.records == 1
    assert record.gone_at is not None
    assert read_trainings(bucket, "model-10")[0][0].gone_at is None


def test_a_model_without_a_record_gets_one_when_it_is_deleted(bucket, settings):
    start = TrainingStart(seed=1, settings={"DR_LOCAL_S3_MODEL_PREFIX": "model-1"})
    bucket.put(keys.training_start("model-1"), start.encode())

    remove(settings(), "model-1")

    [record] = read_trainings(bucket, "model-1")[0]
    assert (record.derived, record.gone_at is None) == (True, False)
    assert read_files(ModelStore(bucket, "model-1"), record.id)


def test_records_go_too_on_request(bucket, settings):
    trained(bucket)
    trained(bucket, "model-10")

    remove(settings(), "model-1", forget=True)

    assert read_trainings(bucket, "model-1")[0] == []
    assert len(read_trainings(bucket, "model-10")[0]) == 1


def test_a_record_that_cannot_be_written_keeps_no_model_from_being_deleted(
    bucket, settings, told, monkeypatch
):
    trained(bucket)
    put = bucket.put

    def refuse(key, data, **options):
        if key.startswith("training-records/"):
            raise StorageError("May not write.", remedy="Allow it.")
        put(key, data, **options)

    monkeypatch.setattr(bucket, "put", refuse)

    remove(settings(), "model-1")

    assert not bucket.exists(keys.coach_checkpoint("model-1"))
    assert told == ["The record of model-1 could not be completed: May not write."]
