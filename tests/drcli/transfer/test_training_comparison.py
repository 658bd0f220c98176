"""Two trainings side by side, and the family of a training."""

import hashlib
from dataclasses import replace

import pytest

from drcli.transfer.family_tree import family_tree
from drcli.transfer.training_details import Compared, compare
from drcli.transfer.training_list import KnownTrainings, entry_of
from past_trainings import child, training


def known(*records, models=()):
    ordered = sorted(records, key=lambda record: record.began_at)
    existing = frozenset(record.id for record in records)
    return KnownTrainings("bucket", tuple(ordered), existing, frozenset(models))


def side(record, **texts):
    return Compared(record, entry_of(record, exists=True), texts)


def sha256(text):
    return hashlib.sha256(text.encode()).hexdigest()


def pairs(found):
    return {each.name: (each.before, each.after) for each in found}


def test_equal_trainings_differ_in_nothing():
    found = compare(side(training(1)), side(replace(training(1), id="00000002")))

    assert not any(
        [found.settings, found.hyperparameters, found.model, found.versions, found.machine]
    )
    assert found.files == []


def test_everything_that_differs_is_named_with_defaults_filled_in():
    one = training(1)
    settings = {"DR_WORLD_NAME": "Vegas_track", "DR_TRAIN_MIN_EVAL_TRIALS": 9, "DR_RUN_ID": 3}
    start = {
        "settings": settings,
        "worker_settings": [{"DR_WORLD_NAME": "oval"}],
        "machine": {"processor": "EPYC", "cores": 2},
        "versions": {"python": "3.12.1", "drcli": "0.2.0"},
        "git": {},
    }
    other = training(
        2, hyperparameters={"lr": 0.5, "batch_size": 64}, action_space="continuous", start=start
    )

    found = compare(side(one), side(other))

    assert pairs(found.settings) == {
        "DR_WORLD_NAME": ("reinvent_base", "Vegas_track"),
        "DR_TRAIN_MIN_EVAL_TRIALS": (20, 9),
    }
    assert pairs(found.worker_settings) == {"worker-2.env DR_WORLD_NAME": (None, "oval")}
    assert pairs(found.hyperparameters) == {"lr": (0.001, 0.5)}
    assert pairs(found.model) == {"action_space": ("discrete, 7", "continuous")}
    assert pairs(found.machine) == {"processor": ("Xeon", "EPYC")}
    assert pairs(found.versions) == {
        "python": ("3.11.7", "3.12.1"),
        "git working folder": ("0123456789ab + changes", None),
    }
    assert pairs(found.start)["seed"] == (1, 2)
    assert pairs(found.results)["hours"] == (2.0, 3.0)


def test_files_that_differ_are_shown_as_a_diff_if_their_texts_were_kept():
    texts = ["a = 1\nb = 2\n", "a = 1\nb = 3\n"]
    one, other = (
        training(k, start={"files": {"reward_function.py": sha256(text), "x.json": str(k)}})
        for k, text in enumerate(texts)
    )

    found = compare(
        side(one, **{"reward_function.py": texts[0]}),
        side(other, **{"reward_function.py": texts[1]}),
    )

    reward, unknown = found.files
    assert (reward.name, unknown.name) == ("reward_function.py", "x.json")
    assert reward.diff[-2:] == ["-b = 2", "+b = 3"]
    assert unknown.diff == []


def test_nothing_is_said_about_settings_that_are_not_known():
    old = training(1, start={"settings": None})

    assert compare(side(old), side(training(2))).settings == []


def outline(tree):
    return [(member.depth, member.model) for member in tree.members]


@pytest.fixture
def family():
    """A first model with two children, one of which has a child; and a stranger."""
    first = training(1, "first")
    left = child(2, "left", first, hyperparameters={"lr": 0.5, "batch_size": 64})
    right = child(3, "right", first, start={"files": {"reward_function.py": "another"}})
    return first, left, right, child(4, "deep", left), training(5, "stranger")


def test_children_stand_below_the_training_whose_weights_they_began_with(family):
    tree = family_tree(known(*family))

    assert outline(tree) == [
        (0, "first"),
        (1, "left"),
        (2, "deep"),
        (1, "right"),
        (0, "stranger"),
    ]
    changes = {member.model: member.changes for member in tree.members}
    assert changes["left"] == ["lr 0.001 -> 0.5"]
    assert changes["right"] == ["reward_function.py"]
    assert [member.weights for member in tree.members][1] == "5_Step-500.ckpt"


def test_the_family_of_one_training_leaves_strangers_out(family):
    tree = family_tree(known(*family), family[3])

    assert outline(tree) == [(0, "first"), (1, "left"), (2, "deep"), (1, "right")]
    assert [member.model for member in tree.members if member.asked] == ["deep"]


def test_parents_that_no_training_here_has_made_are_shown(family):
    left = family[1]

    tree = family_tree(known(left, models=["first"]))
    alone = family_tree(known(left, family[4]), left)

    assert outline(tree) == [(0, "first"), (1, "left")]
    assert (tree.members[0].training, tree.members[0].exists) == (None, True)
    assert outline(alone) == [(0, "first"), (1, "left")]
    assert not alone.members[0].exists


def test_a_parent_that_was_begun_anew_since_is_not_taken_for_the_old_one(family):
    first, left, *_ = family
    anew = training(9, "first")

    assert outline(family_tree(known(first, left, anew))) == [
        (0, "first"),
        (1, "left"),
        (0, "first"),
    ]


def test_without_the_name_of_the_training_the_newest_before_is_the_parent():
    one, two, three = (training(k, "first") for k in (1, 2, 9))
    old = replace(child(4, "child", one), parent_training="")

    tree = family_tree(known(one, two, three, old))

    assert [(m.depth, m.training.id) for m in tree.members if m.training] == [
        (0, "00000001"),
        (0, "00000002"),
        (1, "00000004"),
        (0, "00000009"),
    ]


def test_records_that_name_each_other_as_parents_are_still_shown():
    one = child(1, "a", training(2, "b"))
    other = child(2, "b", one)

    tree = family_tree(known(one, other))

    assert {member.model for member in tree.members} == {"a", "b"}
    assert len(family_tree(known(one, other), one).members) == 2


def test_a_chain_of_a_thousand_clones_is_a_tree():
    chain = [training(0, "m-0")]
    for number in range(1, 1200):
        chain.append(child(number, f"m-{number}", chain[-1]))

    assert outline(family_tree(known(*chain)))[-1] == (1199, "m-1199")
