"""The note from which a training can be repeated."""

import json
import subprocess

import pytest

from drcli.model import keys
from drcli.model.run_metadata import chosen_settings
from evaluations import evaluated


def test_a_start_records_seed_settings_versions_and_machine(racer):
    racer.run_env(
        "DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_TRAIN_SEED=7", "DR_WORLD_NAME=reinvent_base"
    )

    racer.start()

    note = racer.note("model-1")
    assert note["seed"] == 7
    assert note["settings"] == {"DR_LOCAL_S3_MODEL_PREFIX": "model-1", "DR_TRAIN_SEED": 7}
    assert note["cars"] == ["release-6"]
    assert note["versions"].keys() == {"python", "drcli", "torch", "mujoco", "numpy", "numba"}
    assert all(note["versions"].values())
    assert note["machine"]["cores"] >= 1
    assert note["machine"]["processor"]
    assert note["earlier"] == []


def test_a_start_records_the_car_of_every_worker_that_has_a_race_of_its_own(racer):
    lines = ["DR_SIM_CAR=low-grip", "DR_TRAIN_MULTI_CONFIG=True", "DR_WORKERS=2"]
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", *lines)
    (racer.folder / "worker-2.env").write_text("DR_SIM_CAR=2022\n")

    racer.start()

    assert racer.note("model-1")["cars"] == ["low-grip", "2022"]


def test_a_start_records_what_other_workers_change_for_an_export_that_drives(racer):
    lines = ["DR_WORLD_NAME=bean", "DR_TRAIN_MULTI_CONFIG=True", "DR_WORKERS=3"]
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", *lines)
    (racer.folder / "worker-2.env").write_text("DR_WORLD_NAME=willow\n")
    (racer.folder / "worker-3.env").write_text("DR_TRAIN_REVERSE_DIRECTION=True\n")

    racer.start()

    assert racer.note("model-1")["workers"] == [
        {"DR_WORLD_NAME": "willow"},
        {"DR_TRAIN_REVERSE_DIRECTION": True},
    ]


def test_a_resumed_start_keeps_the_seed_and_the_earlier_records(racer):
    racer.start()
    racer.store("model-1").save(0, 0, b"weights")
    first = racer.note("model-1")
    racer.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", "DR_TRAIN_MIN_EVAL_TRIALS=2")
    racer.start(resume=True)

    racer.start(resume=True)

    note = racer.note("model-1")
    assert note["seed"] == first["seed"]
    assert [earlier["settings"] for earlier in note["earlier"]] == [
        {"DR_LOCAL_S3_MODEL_PREFIX": "model-1"},
        {"DR_LOCAL_S3_MODEL_PREFIX": "model-1", "DR_TRAIN_MIN_EVAL_TRIALS": 2},
    ]


def test_a_record_with_only_a_seed_can_be_resumed(racer):
    racer.start()
    racer.store("model-1").save(0, 0, b"weights")
    racer.bucket.put(keys.training_start("model-1"), b'{"seed": 11}')

    plan = racer.start(resume=True)

    assert plan.job.seed == 11
    assert racer.note("model-1")["seed"] == 11


def test_names_passwords_and_signatures_in_addresses_are_not_recorded(racer):
    racer.run_env(
        "DR_REMOTE_MINIO_URL=http://me:secret@minio:9000",
        "DR_TRACKS_URL=https://tracks/all?signature=secret",
        "DR_DROA_USERNAME=me",
        "AWS_SECRET_ACCESS_KEY=secret",
    )

    noted = chosen_settings(racer.settings())

    assert noted == {
        "DR_REMOTE_MINIO_URL": "http://(hidden)@minio:9000",
        "DR_TRACKS_URL": "https://tracks/all?(hidden)",
    }


def test_outside_git_no_state_is_recorded(racer, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(racer.folder.parent))

    racer.start()

    assert racer.note("model-1")["git"]["working_folder"] is None


@pytest.mark.parametrize("change", [None, "def reward_function(p): return 1.0"])
def test_the_commit_of_the_working_folder_is_recorded_and_whether_files_differ_from_it(
    racer, change
):
    _git(racer.folder, "init", "--quiet")
    _git(racer.folder, "add", "custom_files")
    _git(racer.folder, "commit", "--quiet", "-m", "first")
    commit = _git(racer.folder, "rev-parse", "HEAD")
    if change:
        (racer.folder / "custom_files" / "reward_function.py").write_text(change)

    racer.start()

    state = racer.note("model-1")["git"]["working_folder"]
    assert state == {"commit": commit, "dirty": change is not None}


def test_a_machine_without_git_starts_all_the_same(racer, monkeypatch):
    monkeypatch.setenv("PATH", "")

    racer.start()

    assert racer.note("model-1")["git"] == {"working_folder": None, "package": None}


@pytest.mark.parametrize(
    ("setting", "before"),
    [("DR_TRAIN_BEST_MODEL_METRIC=laptime", "progress"), ("DR_WORLD_NAME=bean", "reinvent_base")],
)
def test_scores_of_another_metric_or_track_are_forgotten_on_resume(trained, setting, before):
    trained.run_env("DR_LOCAL_S3_MODEL_PREFIX=model-1", setting)

    plan = trained.start(resume=True)

    store = trained.store("model-1")
    assert store.best_name() == "3_Step-300.ckpt"
    name = setting.partition("=")[0]
    assert any(f"{name} was {before} until now" in w for w in plan.warnings)
    assert store.record_evaluation(evaluated("5_Step-500.ckpt", 100.0, 14_000.0), "laptime")
    scores = json.loads(trained.bucket.get(keys.deepracer_checkpoints("model-1")))
    assert scores["best_checkpoint"]["avg_eval_metric"] == 14_000.0


def _git(folder, *arguments):
    identity = ("-c", "user.name=racer", "-c", "user.email=racer@example.org")
    done = subprocess.run(
        ["git", "-C", str(folder), *identity, *arguments],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()
