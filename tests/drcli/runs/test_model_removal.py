"""A model is deleted with all its traces, and nothing else goes (item 15 of the racer's day)."""

import time

import pytest

from drcli.base.errors import SettingsError
from drcli.models.model_list import list_models
from drcli.runs.model_removal import plan_removal, remove_models
from drcli.runs.run_logs import log_file
from drcli.runs.tidy import TidyOptions, checked_rules, find_surplus, read_kinds, tidy
from drcli.store import keys, lease
from memory_bucket import MemoryBucket

OTHERS = ("model-10", "model-1/inner", "model-1-old")


class Killed(Exception):
    """The process ends here."""


class MortalBucket(MemoryBucket):
    """Ends its user at a request to delete."""

    deletes_left = 1_000

    def delete(self, keys):
        if not self.deletes_left:
            raise Killed
        self.deletes_left -= 1
        super().delete(keys)


def put_all(bucket: MemoryBucket, prefix: str, *, iteration: int = 3) -> None:
    """Everything that a model can have."""
    names = (
        "model/0_Step-0.ckpt.safetensors model/0_Step-0.ckpt.json model/model_0.pb "
        "model/.coach_checkpoint model/milestones.json model/model_metadata.json ip/run.json "
        "ip/hyperparameters.json metrics/history.json notes/1.json journal/000001-a.jsonl "
        "logs/sagemaker/trainer.log training-simtrace/0-iteration.csv reward_function.py"
    )
    for name in names.split():
        bucket.put(keys.folder(prefix) + name, b"{}")
    name = b'{"name": "0_Step-0.ckpt"}'
    scores = b'{"best_checkpoint": %b, "last_checkpoint": %b}' % (name, name)
    bucket.put(keys.deepracer_checkpoints(prefix), scores)
    bucket.put(keys.rollout_manifest(prefix, iteration, 0), b"{}")
    bucket.put(keys.outcome(prefix), b"{}")
    bucket.put(keys.evaluation_result(prefix, 0), b"{}")
    bucket.put(keys.damaged(prefix, "x", "20260101000000"), b"?" * 100)


@pytest.fixture
def bucket(working_folder, monkeypatch):
    bucket = MortalBucket()
    for module in ("model_removal", "tidy"):
        monkeypatch.setattr(f"drcli.runs.{module}.open_bucket", lambda *_, **__: bucket)
    (working_folder / "run.env").write_text("DR_LOCAL_S3_MODEL_PREFIX=model-1\n")
    (working_folder / "system.env").write_text("")
    for prefix in ("model-1", *OTHERS):
        put_all(bucket, prefix)
    bucket.put("custom_files/reward_function.py", b"mine")
    return bucket


@pytest.fixture
def settings(bucket, working_folder):
    from drcli.config.loading import load_settings

    return lambda: load_settings(working_folder)


def objects(bucket: MemoryBucket) -> set[str]:
    return {info.key for info in bucket.list("")}


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


def test_metrics_in_another_folder_go_too(bucket, settings, working_folder):
    (working_folder / "run.env").write_text(
        "DR_LOCAL_S3_MODEL_PREFIX=model-1\nDR_LOCAL_S3_METRICS_PREFIX=numbers/one\n"
    )
    bucket.put("numbers/one/TrainingMetrics.json", b"{}")
    bucket.put("numbers/one/TrainingMetrics_1.json", b"{}")
    bucket.put("numbers/one/mine.csv", b"mine")

    remove(settings(), "model-1")

    assert [info.key for info in bucket.list("numbers/")] == ["numbers/one/mine.csv"]


def test_a_model_that_trains_anywhere_stays(bucket, settings):
    lease.take(bucket, "model-1", "session")
    before = objects(bucket)

    with pytest.raises(SettingsError, match="is being trained by"):
        remove(settings(), "model-10", "model-1")

    assert objects(bucket) == before


def test_a_training_that_starts_after_the_question_keeps_its_model(bucket, settings):
    planned = plan_removal(settings(), ["model-1"])
    lease.take(bucket, "model-1", "session")
    before = objects(bucket)

    with pytest.raises(SettingsError, match="is being trained by"):
        remove_models(planned, settings())

    assert objects(bucket) == before


@pytest.mark.parametrize("deletes", [1, 2])
def test_a_deletion_that_is_cut_off_leaves_nothing_that_looks_like_a_model(
    bucket, settings, monkeypatch, deletes
):
    monkeypatch.setattr("drcli.runs.model_removal.BATCH", 3)
    bucket.deletes_left = deletes

    with pytest.raises(Killed):
        remove(settings(), "model-1")

    bucket.deletes_left = 1_000
    assert "model-1" not in [model.prefix for model in list_models(bucket).models]
    assert not any(key.endswith(".ckpt.json") for key in objects(bucket) if "model-1/m" in key)
    lease.release(bucket, "model-1", lease.read_lease(bucket, "model-1").session)
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


def test_tidy_deletes_what_nobody_misses(bucket, settings, monkeypatch):
    bucket.delete(["model-10/model/.coach_checkpoint", "model-10/model/deepracer_checkpoints.json"])
    bucket.put("model-1/model/model_metadata.json", b'{"training_algorithm": "clipped_ppo"}')
    bucket.put("model-1-old/model/model_metadata.json", b'{"training_algorithm": "sac"}')
    young = find_surplus(settings(), TidyOptions(keep=["model-1/inner"]))
    monkeypatch.setattr("drcli.runs.tidy.RECENT_S", -1.0)

    found = find_surplus(settings(), TidyOptions(keep=["model-1/inner"]))
    tidy(found, settings())

    assert [(item.kind, item.model) for item in young.items] == [
        ("damaged", "model-1"),
        ("rollouts", "model-1"),
        ("damaged", "model-1-old"),
    ]
    assert ("remains", "model-10") in [(item.kind, item.model) for item in found.items]
    left = objects(bucket)
    assert not any(key.startswith(("model-10/", "runs/model-10/")) for key in left)
    assert "rollouts/model-1/3/0/manifest.json" not in left
    assert "rollouts/model-1-old/3/0/manifest.json" in left
    assert "model-1/model/.coach_checkpoint" in left
    assert find_surplus(settings(), TidyOptions(keep=["model-1/inner"])).items == []


def test_tidy_leaves_a_model_that_trains_alone(bucket, settings):
    lease.take(bucket, "model-1", "session")

    found = find_surplus(settings(), TidyOptions(models=["model-1"]))

    assert (found.items, found.busy) == ([], ["model-1"])


def test_tidy_thins_checkpoints_but_never_the_best_or_the_last(bucket, settings):
    for number in range(1, 9):
        name = f"{number}_Step-{number}.ckpt"
        for key in (
            keys.checkpoint_tensors("model-1", name),
            keys.checkpoint_record("model-1", name),
        ):
            bucket.put(key, b"{}")
        bucket.put(keys.checkpoint_graph("model-1", number), b"graph")
    last = b'{"name": "8_Step-8.ckpt"}'
    best = b'{"name": "3_Step-3.ckpt"}'
    index = b'{"best_checkpoint": %b, "last_checkpoint": %b}' % (best, last)
    bucket.put(keys.deepracer_checkpoints("model-1"), index)
    options = TidyOptions(["model-1"], kinds=read_kinds(None, "every-5"), checkpoints="every-5")

    tidy(find_surplus(settings(), options), settings())

    found = {keys.checkpoint_of("model-1", key) for key in objects(bucket)} - {None}
    assert sorted(name.number for name in found) == [3, 5, 8]
    assert keys.checkpoint_graph("model-1", 4) not in objects(bucket)


def test_older_than_spares_what_is_new(bucket, settings):
    options = TidyOptions(["model-1"], kinds=("damaged", "traces"), older_than_s=time.time() / 2)

    assert find_surplus(settings(), options).items == []


@pytest.mark.parametrize("text", ["junk", "remains;damaged", "checkpoints"])
def test_kinds_that_do_not_exist_are_refused(text):
    with pytest.raises(SettingsError):
        read_kinds(text, "")


@pytest.mark.parametrize("text", ["last-0", "every", "newest", "best,first"])
def test_rules_that_do_not_exist_are_refused(text):
    with pytest.raises(SettingsError, match="is not a rule for what stays"):
        checked_rules(text)
