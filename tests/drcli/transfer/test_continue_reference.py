"""A training that goes on from a model of DeepRacer-for-Cloud, which stays as it is."""

import json

import pytest
from safetensors.numpy import load

from drcli.base.errors import SettingsError
from drcli.convert.stored_checkpoint import load_checkpoint
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_list import list_models
from drcli.model.model_prefix import ModelListing
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import Counters
from drcli.transfer.continue_reference import plan_conversion
from evaluations import evaluated
from reference_model import BEST, HYPERPARAMETERS, LAST, METADATA, NEWEST, reference_model

MODEL = "model-1"
REWRITTEN = {
    "training_params.yaml",
    "reward_function.py",
    "ip/hyperparameters.json",
    "model/model_metadata.json",
    "model/.coach_checkpoint",
    "model/deepracer_checkpoints.json",
}
"""What a training writes anew; everything else stays byte for byte."""


@pytest.fixture
def theirs(racer):
    """A racer whose model DeepRacer-for-Cloud has trained, with the same actions."""
    for name, data in reference_model().items():
        racer.bucket.put(f"{MODEL}/{name}", data)
    racer.model_metadata(**METADATA)
    return racer


def content(bucket, prefix=MODEL):
    return {
        info.key.removeprefix(f"{prefix}/"): bucket.get(info.key)
        for info in bucket.list(f"{prefix}/")
    }


def kept(before, after):
    return {name: data for name, data in before.items() if after.get(name) != data}.keys()


def test_the_newest_checkpoint_becomes_one_of_ours_beside_everything_that_lies_there(theirs):
    before = content(theirs.bucket)
    expected = load(load_checkpoint(ModelStore(theirs.bucket, MODEL), NEWEST).tensors)

    plan = theirs.start(resume=True)

    assert plan.resumes == NEWEST
    assert [text for text in plan.warnings if NEWEST in text and BEST in text]
    assert kept(before, content(theirs.bucket)) <= REWRITTEN
    found = theirs.store(MODEL).load_latest()
    assert found is not None
    assert found.record.name == NEWEST
    assert {name: array.tolist() for name, array in load(found.tensors).items()} == {
        name: array.tolist() for name, array in expected.items()
    }
    assert theirs.store(MODEL).best_name() == NEWEST  # nobody has evaluated it here yet


def test_no_later_checkpoint_takes_the_place_of_the_files_of_the_reference(theirs):
    before = content(theirs.bucket)
    theirs.start(resume=True)
    store = theirs.store(MODEL)

    for number in range(5, 12):
        name = store.save(number, 10_000 + number, b"weights").name
        store.record_evaluation(evaluated(name, 50.0), "progress")
    store.drop_newer(store.pointed())

    after = content(theirs.bucket)
    assert kept(before, after) <= REWRITTEN
    assert f"model/{NEWEST}.safetensors" not in after  # ours went in its turn
    assert load_checkpoint(ModelStore(theirs.bucket, MODEL), NEWEST).record.name == NEWEST


def test_a_second_start_goes_on_from_our_own_checkpoint(theirs):
    theirs.start(resume=True)
    theirs.store(MODEL).save(5, 10_000, b"weights", counters=Counters(episodes=20))

    assert theirs.start(resume=True).resumes == "5_Step-10000.ckpt"


def test_what_deepracer_for_cloud_has_trained_on_since_then_is_continued(theirs):
    theirs.start(resume=True)
    theirs.store(MODEL).save(5, 10_000, b"weights")
    for end in (".index", ".meta", ".data-00000-of-00001"):
        data = theirs.bucket.get(f"{MODEL}/model/{LAST}{end}")
        theirs.bucket.put(f"{MODEL}/model/6_Step-400.ckpt{end}", data)
    theirs.bucket.put(keys.coach_checkpoint(MODEL), b"6_Step-400.ckpt")

    assert theirs.start(resume=True).resumes == "6_Step-400.ckpt"


def test_a_conversion_that_was_cut_off_is_made_again(theirs):
    theirs.bucket.put(keys.checkpoint_tensors(MODEL, NEWEST), b"a part of the weights")

    assert theirs.start(resume=True).resumes == NEWEST

    found = theirs.store(MODEL).load_latest()
    assert found is not None
    assert found.record.name == NEWEST
    assert not found.damaged


def test_without_a_usable_pointer_the_highest_number_counts(theirs):
    theirs.bucket.put(keys.coach_checkpoint(MODEL), b"9_Step-99999.ckpt")

    assert theirs.start(resume=True).resumes == NEWEST


def test_a_damaged_checkpoint_is_named_and_nothing_is_changed(theirs):
    key = f"{MODEL}/model/{NEWEST}.index"
    theirs.bucket.put(key, theirs.bucket.get(key)[:-20])
    before = content(theirs.bucket)

    with pytest.raises(SettingsError, match=NEWEST) as caught:
        theirs.start(resume=True)

    assert content(theirs.bucket) == before
    assert "delet" not in f"{caught.value} {caught.value.remedy}"


def test_values_that_the_reference_ignores_do_not_stop_a_start(theirs):
    key = keys.hyperparameters(MODEL)
    theirs.bucket.put(key, json.dumps({**HYPERPARAMETERS, "stack_size": 4}).encode())
    for file in ("hyperparameters.json", "model_metadata.json"):
        (theirs.folder / "custom_files" / file).unlink()

    assert theirs.start(resume=True).resumes == NEWEST
    assert json.loads(theirs.bucket.get(key))["stack_size"] == 1


def test_other_actions_are_refused_before_anything_is_written(theirs):
    theirs.model_metadata(action_space=METADATA["action_space"][:2])
    before = content(theirs.bucket)

    with pytest.raises(SettingsError, match="trained with 3 discrete actions"):
        theirs.start(resume=True)

    assert content(theirs.bucket) == before


def test_a_new_training_over_it_is_refused_with_the_command_that_continues_it(theirs):
    with pytest.raises(SettingsError, match="a model of DeepRacer-for-Cloud") as caught:
        theirs.start()

    assert "`dr-start-training --resume`" in caught.value.remedy


@pytest.mark.parametrize(("choice", "name"), [("last", LAST), ("best", BEST), ("4", NEWEST)])
def test_another_model_begins_with_its_weights(theirs, choice, name):
    theirs.run_env(
        "DR_LOCAL_S3_MODEL_PREFIX=model-2",
        "DR_LOCAL_S3_PRETRAINED=True",
        f"DR_LOCAL_S3_PRETRAINED_PREFIX={MODEL}",
        f"DR_LOCAL_S3_PRETRAINED_CHECKPOINT={choice}",
    )
    before = content(theirs.bucket)

    plan = theirs.start()

    assert plan.pretrained is not None
    assert plan.pretrained.name == name
    assert content(theirs.bucket) == before
    first = theirs.store("model-2").load_latest()
    assert first is not None
    assert first.tensors == load_checkpoint(ModelStore(theirs.bucket, MODEL), name).tensors


def test_a_model_of_ours_is_not_converted(racer):
    CheckpointStore(ModelStore(racer.bucket, MODEL)).save(3, 300, b"weights")

    assert plan_conversion(ModelListing(ModelStore(racer.bucket, MODEL))) is None
    assert plan_conversion(ModelListing(ModelStore(racer.bucket, "nothing"))) is None


def test_lists_tell_its_kind(theirs):
    assert [model.kind for model in list_models(theirs.bucket).models] == ["tensorflow"]
    theirs.start(resume=True)
    assert [model.kind for model in list_models(theirs.bucket).models] == ["drcli"]
    assert json.loads(theirs.bucket.get(keys.deepracer_checkpoints(MODEL)))["best_checkpoint"]
