"""Which checkpoint a word or number chooses, and what is said without one (001-46, 003-16)."""

import pytest

from drcli.base.errors import SettingsError
from drcli.config.run_config import ModelConfig
from drcli.model import keys
from drcli.model.best_checkpoint import write_evaluation
from drcli.model.checkpoint_choice import CheckpointGone, ModelCheckpoints, take_choice
from drcli.model.checkpoint_list import list_checkpoints
from drcli.model.checkpoints import KEEP_ALL_MARKED, CheckpointStore, KeepRules
from drcli.model.history import History
from drcli.model.model_store import ModelStore
from drcli.records.scores import EvaluationResult
from iterations import iteration_record
from memory_bucket import MemoryBucket

PREFIX = "team/model"
CONFIG = ModelConfig(PREFIX, f"{PREFIX}/metrics", "progress", 1, "reward.py", "params.yaml")


def trained(rules: KeepRules = KEEP_ALL_MARKED, *, laps: bool = True) -> ModelStore:
    """A model with checkpoints 0 to 20: 5 made a lap first, 11 the fastest, 14 is the best."""
    bucket = MemoryBucket("bucket")
    store = CheckpointStore(ModelStore(bucket, PREFIX), rules)
    times = {5: [30.0], 11: [20.0, 21.0], 14: [25.0, 25.0, 25.0]} if laps else {}
    for number in range(21):
        store.save(number, number * 100, b"weights %d" % number)
        done = times.get(number, [])
        progress = [100.0] * len(done) + [40.0] * (3 - len(done))
        name = f"{number}_Step-{number * 100}.ckpt"
        store.record_evaluation(EvaluationResult(name, progress, [1.0] * 3, done), "progress")
    return ModelStore(bucket, PREFIX, keys.metrics_prefix(PREFIX))


@pytest.mark.parametrize(
    ("choice", "number"),
    [
        ("last", 20),
        ("best", 14),
        ("first-lap", 5),
        ("three-laps", 14),
        ("best-lap", 11),
        (18, 18),
        (5, 5),
    ],
)
def test_each_word_and_number_finds_its_checkpoint(choice, number):
    assert (
        ModelCheckpoints.read(trained()).choose(choice).name == f"{number}_Step-{number * 100}.ckpt"
    )


@pytest.fixture
def shown(monkeypatch):
    said = []
    monkeypatch.setattr("drcli.base.errors.show", said.append)
    return said


@pytest.mark.parametrize(
    ("choice", "sentence"),
    [
        (
            "best",
            "Takes checkpoint 14 of team/model, the best: 3 of 3 laps clean, median 25.00 s, "
            "slowest 25.00 s. --checkpoint last takes 20: 0 of 3 laps clean.",
        ),
        (
            "last",
            "Takes checkpoint 20 of team/model, the last: 0 of 3 laps clean. --checkpoint best "
            "takes 14: 3 of 3 laps clean, median 25.00 s, slowest 25.00 s.",
        ),
        (5, "Takes checkpoint 5 of team/model: 1 of 3 laps clean, 30.00 s."),
    ],
)
def test_a_command_says_which_checkpoint_it_takes_and_how_that_drove(choice, sentence, shown):
    model = trained()
    for number, lap_s in {5: [30.0], 14: [25.0] * 3, 20: []}.items():
        name = f"{number}_Step-{number * 100}.ckpt"
        result = EvaluationResult(name, [50.0] * 3, [1.0] * 3, lap_s)
        write_evaluation(ModelStore(model.bucket, PREFIX), number, result)

    take_choice(model, choice)

    assert shown == [sentence]


def test_a_checkpoint_that_was_never_evaluated_is_said_to_be_so(shown):
    take_choice(trained(), 19)

    assert shown == ["Takes checkpoint 19 of team/model: not evaluated by its training."]


@pytest.mark.parametrize("choice", [3, 99, "first-lap"])
def test_the_sentence_lists_what_there_is(choice):
    model = trained(KeepRules(milestones=False))

    with pytest.raises(CheckpointGone) as caught:
        ModelCheckpoints.read(model).choose(choice)

    said = str(caught.value)
    why = {
        3: "3 was deleted",
        99: "no checkpoint 99: the newest is 20",
        "first-lap": "Checkpoint 5",
    }
    assert why[choice] in said
    assert said.startswith(model.url)  # and is one message, without another one before it
    assert said.endswith("It has 14 (best, three-laps), 17, 18, 19, 20 (last).")
    assert "three-laps" in caught.value.remedy


def test_a_milestone_that_was_never_reached_is_said():
    with pytest.raises(CheckpointGone, match="no evaluation during its training has completed a"):
        ModelCheckpoints.read(trained(laps=False)).choose("best-lap")


@pytest.mark.parametrize("choice", [19, "last", "first-lap"])
def test_a_checkpoint_that_lacks_a_file_is_said_and_not_offered(choice):
    model = trained()
    name = ModelCheckpoints.read(model).choose(choice).name
    model.bucket.delete([keys.checkpoint_tensors(PREFIX, name)])

    with pytest.raises(CheckpointGone) as caught:
        ModelCheckpoints.read(model).choose(choice)

    assert f"{name}.safetensors is missing." in str(caught.value)
    assert f" {name.partition('_')[0]} " not in str(caught.value).partition("It has")[2]


def test_a_model_without_checkpoints_is_said():
    model = ModelStore(MemoryBucket("bucket"), PREFIX, keys.metrics_prefix(PREFIX))

    for choice in ("last", "first-lap", 3):
        with pytest.raises(SettingsError, match="checkpoint"):
            ModelCheckpoints.read(model).choose(choice)


@pytest.mark.parametrize("damage", [b"", b"{}", b'{"best_lap": [1]}'])
def test_a_damaged_record_costs_no_milestone_of_the_evaluations_that_are_left(damage):
    model = trained()
    model.bucket.put(keys.milestones(PREFIX), damage)

    found = list_checkpoints(ModelStore.of(CONFIG, model.bucket, PREFIX))

    assert len(found.damaged) == (damage != b"{}")
    assert [each.number for each in found.checkpoints] == [5, 11, 14, 17, 18, 19, 20]


def test_the_list_has_the_numbers_of_the_evaluations():
    model = trained()
    model.bucket.put(keys.checkpoint_tensors(PREFIX, "17_Step-1700.ckpt"), b"weights ??")

    found = list_checkpoints(ModelStore.of(CONFIG, model.bucket, PREFIX), check=True)

    eleven = next(each for each in found.checkpoints if each.number == 11)
    assert (eleven.laps, eleven.episodes, eleven.best_lap_s) == (2, 3, 20.0)
    assert eleven.words == ["best-lap"]
    assert [each.number for each in found.checkpoints if each.problem] == [17]
    assert [(each.word, each.kept) for each in found.milestones] == [
        ("first-lap", True),
        ("three-laps", True),
        ("best-lap", True),
    ]
    assert found.not_reached == []


def test_the_evaluation_of_another_checkpoint_with_that_number_is_not_told(shown):
    model = trained()  # a training that went back makes its checkpoints again
    other = EvaluationResult("20_Step-1999.ckpt", [100.0], [1.0], [5.0])
    write_evaluation(ModelStore(model.bucket, PREFIX), 20, other)

    take_choice(model, "last")

    assert "checkpoint 20 of team/model, the last: score 40.0 in its evaluation." in shown[0]


def test_checkpoints_in_which_only_a_teacher_has_learned_are_marked_and_are_not_the_best(shown):
    bucket = MemoryBucket("bucket")
    store, history = (
        CheckpointStore(ModelStore(bucket, PREFIX), KEEP_ALL_MARKED),
        History(ModelStore(bucket, PREFIX)),
    )
    for number, phase in enumerate(("teacher", "teacher", "distillation")):
        store.save(number, number * 100, b"weights %d" % number)
        history.add(iteration_record(number, phase=phase))
    store.save(3, 300, b"weights 3")
    model = ModelStore(bucket, PREFIX, keys.metrics_prefix(PREFIX))

    found = list_checkpoints(ModelStore.of(CONFIG, bucket, PREFIX))
    take_choice(model, "last")
    take_choice(model, "best")
    take_choice(model, 2)

    assert [(each.number, each.untaught, each.words) for each in found.checkpoints] == [
        (0, True, []),
        (1, True, []),
        (2, True, []),
        (3, False, ["last", "best"]),
    ]
    assert shown == [
        f"Takes checkpoint 3 of {PREFIX}, the last: not evaluated by its training.",
        f"Takes checkpoint 3 of {PREFIX}, the last, because none has been evaluated.",
        f"Takes checkpoint 2 of {PREFIX}: never evaluated, because only its teacher has learned "
        "until there.",
    ]
