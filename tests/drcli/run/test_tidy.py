"""What is left over is found and deleted, and nothing else goes (item 15 of the racer's day)."""

import time
from dataclasses import replace
from datetime import timedelta

import pytest

from drcli.base.errors import SettingsError
from drcli.model import keys, lease
from drcli.model.model_store import ModelStore
from drcli.records.run_record import log_file
from drcli.transfer.tidy import TidyOptions, checked_rules, find_surplus, read_kinds, tidy
from removable_models import objects, put_all, put_checkpoints


def test_tidy_deletes_what_nobody_misses(bucket, settings, monkeypatch):
    bucket.delete(["model-10/model/.coach_checkpoint", "model-10/model/deepracer_checkpoints.json"])
    bucket.put("model-1/model/model_metadata.json", b'{"training_algorithm": "clipped_ppo"}')
    bucket.put("model-1-old/model/model_metadata.json", b'{"training_algorithm": "sac"}')
    young = find_surplus(settings(), TidyOptions(keep=["model-1/inner"]))
    monkeypatch.setattr("drcli.transfer.tidy.RECENT_S", -1.0)

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


def test_tidy_leaves_models_of_other_systems_without_a_pointer_alone(bucket, settings, monkeypatch):
    monkeypatch.setattr("drcli.transfer.tidy.RECENT_S", -1.0)
    theirs = [
        "console/model/model_metadata.json",
        "console/model/30_Step-9000.ckpt.index",
        "console/model/30_Step-9000.ckpt.data-00000-of-00001",
        "graph/model/model_metadata.json",
        "graph/model/model_30.pb",
        "traces/ip/hyperparameters.json",
        "traces/training-simtrace/0-iteration.csv",
    ]
    for key in theirs:
        bucket.put(key, b"theirs")

    found = find_surplus(settings(), TidyOptions())

    assert not {item.model for item in found.items} & {"console", "graph", "traces"}


def test_tidy_leaves_a_model_that_trains_alone(bucket, settings):
    lease.take(ModelStore(bucket, "model-1"), "session")

    found = find_surplus(settings(), TidyOptions(models=["model-1"]))

    assert (found.items, found.busy) == ([], ["model-1"])


def test_tidy_thins_checkpoints_but_never_the_best_or_the_last(bucket, settings):
    put_checkpoints(bucket, 8)
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


def test_tidy_finds_logs_of_models_that_are_gone_without_a_trace(bucket, settings, working_folder):
    logs = [log_file(working_folder, prefix, "sim-0") for prefix in ("gone", "a/gone", "model-1")]
    for log in logs:
        log.parent.mkdir(parents=True)
        log.write_text("log")

    found = find_surplus(settings(), TidyOptions(kinds=("logs",)))
    tidy(found, settings())

    assert [item.model for item in found.items] == ["a/gone", "gone"]
    assert [log.exists() for log in logs] == [False, False, True]


def test_tidy_takes_a_checkpoint_whole_or_not_at_all(bucket, settings, monkeypatch):
    """A repair may have written one of its files again."""
    put_checkpoints(bucket, 3)
    written = keys.checkpoint_record("model-1", "1_Step-1.ckpt")
    ages = {True: timedelta(), False: timedelta(days=-1)}
    listed = bucket.list
    monkeypatch.setattr(
        bucket,
        "list",
        lambda folder: [
            replace(info, modified=info.modified + ages[info.key == written])
            for info in listed(folder)
        ],
    )
    options = TidyOptions(
        ["model-1"], kinds=("checkpoints",), checkpoints="last", older_than_s=3600.0
    )

    (item,) = find_surplus(settings(), options).items

    numbers = {name.number for key in item.names if (name := keys.checkpoint_of("model-1", key))}
    assert numbers == {2}


def test_tidy_keeps_what_either_pointer_names(bucket, settings):
    """A training that was killed between its two pointers."""
    put_checkpoints(bucket, 3)
    bucket.put(keys.coach_checkpoint("model-1"), b"2_Step-2.ckpt")
    options = TidyOptions(["model-1"], kinds=("checkpoints",), checkpoints="best")

    (item,) = find_surplus(settings(), options).items

    numbers = {name.number for key in item.names if (name := keys.checkpoint_of("model-1", key))}
    assert numbers == {1, 3}


def test_tidy_leaves_the_traces_of_a_model_whose_name_is_a_number(bucket, settings):
    """`model-1/1` is not the second worker of `model-1`."""
    put_all(bucket, "model-1/1")
    bucket.put(keys.training_trace("model-1", 0, worker=2, workers=3), b"")
    options = TidyOptions(["model-1"], kinds=("traces",))

    (item,) = find_surplus(settings(), options).items

    assert item.names == [
        keys.training_trace("model-1", 0, worker=2, workers=3),
        keys.training_trace("model-1", 0),
    ]


def test_tidy_leaves_a_model_that_is_called_damaged(bucket, settings):
    """Its records are where the damaged objects of `model-1` would be."""
    put_all(bucket, "model-1/damaged")

    assert find_surplus(settings(), TidyOptions(["model-1"], kinds=("damaged",))).items == []
