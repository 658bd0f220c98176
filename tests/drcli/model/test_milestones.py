"""Which checkpoints are milestones, which stay, and what survives a crash (003-16, 001-09)."""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drcli.bucket.bucket import ObjectDamaged
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore, KeepRules, kept_besides
from drcli.model.history import write_history
from drcli.model.milestones import NO_MILESTONES, Milestones, read_milestones, with_history
from drcli.model.model_store import ModelStore
from drcli.model.reconstruct import readable_milestones
from drcli.model.repair import repair
from drcli.records.checkpoint import CheckpointName
from drcli.records.scores import EvaluationResult, SecondEvaluation
from iterations import iteration_record
from memory_bucket import MemoryBucket

PREFIX = "team/model-1"
KEEP_ALL = KeepRules()


def result(number: int, *lap_s: float, episodes: int = 3) -> EvaluationResult:
    """The evaluation of a checkpoint that completed laps in these times."""
    progress = [100.0] * len(lap_s) + [40.0] * (episodes - len(lap_s))
    return EvaluationResult(
        f"{number}_Step-{number * 100}.ckpt", progress, [1.0] * episodes, [*lap_s]
    )


def train(store: CheckpointStore, *numbers: int, laps: dict[int, tuple[float, ...]] | None = None):
    """Publish checkpoints; the evaluation of each arrives when the next one is there."""
    for number in numbers:
        store.save(number, number * 100, b"weights")
        if number - 1 in (laps or {}):
            store.record_evaluation(result(number - 1, *(laps or {})[number - 1]), "progress")


def numbers(bucket: MemoryBucket) -> list[int]:
    found = {keys.checkpoint_of(PREFIX, i.key) for i in bucket.list(keys.model_folder(PREFIX))}
    return sorted(name.number for name in found if name is not None)


def kept(sizes: dict[int, int], milestones: Milestones, rules: KeepRules, always=()) -> list[int]:
    """Numbers that stay of checkpoints with these sizes."""
    names = {CheckpointName(n, n * 100): size for n, size in sizes.items()}
    newest = max(names)
    found = kept_besides(
        names, [CheckpointName(n, n * 100) for n in always], milestones, rules, newest
    )
    return sorted(name.number for name in found.names)


LAPS = {6: (30.0,), 8: (28.0, 27.0, 29.0), 11: (20.0,), 15: (25.0, 25.0, 25.0)}


def test_first_lap_three_laps_and_fastest_lap_stay_besides_the_newest_four_and_the_best(memory):
    train(CheckpointStore(ModelStore(memory, PREFIX)), *range(25), laps=LAPS)

    found = read_milestones(ModelStore(memory, PREFIX))
    assert found is not None
    assert {kind: each.name.number for kind, each in found.reached()} == {
        "first-lap": 6,
        "three-laps": 8,
        "best-lap": 11,
    }
    assert numbers(memory) == [6, 8, 11, 15, 21, 22, 23, 24]


def test_a_milestone_is_the_checkpoint_that_was_evaluated_also_if_an_older_one_drove(memory):
    driven_ahead = iteration_record(
        4, checkpoint="3_Step-300.ckpt", steps=100, total_steps=500, evaluation_lap_s=[20.0]
    )
    driven_ahead = replace(driven_ahead, evaluation_progress=[100.0])

    found, _ = readable_milestones(ModelStore(memory, PREFIX), [driven_ahead])

    assert found.first_lap is not None
    assert found.first_lap.checkpoint == "4_Step-400.ckpt"


@pytest.mark.parametrize("world", ["evaluation", "both"])
def test_milestones_are_laps_of_the_training_track_whatever_track_decides_about_the_best(
    memory, world
):
    store = CheckpointStore(ModelStore(memory, PREFIX))
    store.save(0, 0, b"weights")
    second = SecondEvaluation([100.0], [1.0], [5.0], "oval")

    store.record_evaluation(replace(result(0, 30.0), second=second), "progress", world)

    found = read_milestones(ModelStore(memory, PREFIX))
    assert found is not None
    assert found.best_lap is not None
    assert found.best_lap.best_lap_s == 30.0


def test_a_faster_lap_frees_the_checkpoint_of_the_one_before(memory):
    store = CheckpointStore(ModelStore(memory, PREFIX))
    train(store, *range(12), laps={2: (30.0,), 5: (20.0,)})
    assert numbers(memory) == [2, 5, 8, 9, 10, 11]

    train(store, *range(12, 20), laps={13: (19.0,)})

    assert numbers(memory) == [2, 13, 16, 17, 18, 19]


def test_milestones_that_are_not_kept_are_still_known(memory):
    train(
        CheckpointStore(ModelStore(memory, PREFIX), KeepRules(milestones=False)),
        *range(20),
        laps=LAPS,
    )

    found = read_milestones(ModelStore(memory, PREFIX))
    assert found is not None
    assert found.first_lap is not None
    assert found.first_lap.name.number == 6
    assert 6 not in numbers(memory)


def test_every_nth_stays_also_after_the_setting_was_changed(memory):
    train(CheckpointStore(ModelStore(memory, PREFIX), KeepRules(every=5)), *range(13))
    assert numbers(memory) == [5, 9, 10, 11, 12]

    train(CheckpointStore(ModelStore(memory, PREFIX), KeepRules(every=0)), *range(13, 20))

    assert {5, 10} <= set(numbers(memory))
    assert 15 not in numbers(memory)


def test_the_size_limit_thins_every_nth_evenly_and_spares_milestones():
    spaced = Milestones(spaced=[f"{n}_Step-{n * 100}.ckpt" for n in range(10, 100, 10)])
    marked = spaced.with_evaluation("33_Step-3300.ckpt", [100.0], [20.0])
    sizes = dict.fromkeys([*range(10, 100, 10), 33, 100], 10)

    left = kept(sizes, marked, KeepRules(max_bytes=50), always=[100])

    assert 33 in left
    assert len(left) == 5
    gaps = [b - a for a, b in pairwise(left)]
    assert max(gaps) <= 40


def test_the_fastest_lap_is_the_last_to_go():
    marked = NO_MILESTONES
    for number, lap_s in ((3, [30.0]), (5, [29.0, 29.0, 29.0]), (9, [20.0])):
        marked = marked.with_evaluation(f"{number}_Step-{number * 100}.ckpt", [100.0] * 3, lap_s)
    sizes = {3: 10, 5: 10, 9: 10, 20: 10}

    by_limit = {
        limit: kept(sizes, marked, KeepRules(max_bytes=limit), always=[20])
        for limit in (30, 20, 10, 5)
    }

    assert by_limit == {30: [3, 5, 9], 20: [5, 9], 10: [9], 5: []}


@given(
    sizes=st.dictionaries(st.integers(0, 200), st.integers(0, 50), min_size=1, max_size=30),
    every=st.integers(0, 12),
    limit=st.integers(0, 300),
)
def test_what_stays_fits_the_limit_and_is_there(sizes, every, limit):
    left = kept(sizes, NO_MILESTONES, KeepRules(every=every, max_bytes=limit))

    assert set(left) <= set(sizes)
    assert not limit or sum(sizes[n] for n in left) <= limit
    if every and not limit:
        assert left == sorted(n for n in sizes if n and n % every == 0)


@given(st.permutations(range(8)))
def test_the_order_in_which_evaluations_arrive_does_not_matter(order):
    results = [result(n, *([20.0 + n % 3] * (n % 4))) for n in range(8)]
    forward = backward = NO_MILESTONES
    for each in results:
        forward = forward.with_evaluation(each.checkpoint, each.progress, each.lap_s)
    for at in order:
        each = results[at]
        backward = backward.with_evaluation(each.checkpoint, each.progress, each.lap_s)

    assert forward == backward


def test_a_trainer_killed_before_it_recorded_a_milestone_finds_it_in_the_learning_curve(
    memory, make_record
):
    train(CheckpointStore(ModelStore(memory, PREFIX)), *range(6))
    lap = make_record(
        4, checkpoint="4_Step-400.ckpt", evaluation_progress=[100.0], evaluation_lap_s=[21.0]
    )

    store = CheckpointStore(ModelStore(memory, PREFIX))
    store.restore_milestones(CheckpointName(5, 500), [lap])
    train(store, *range(6, 12))

    assert 4 in numbers(memory)


@pytest.mark.parametrize("place", ["stage", "world"])
def test_the_fastest_lap_of_a_stage_is_on_its_own_track(memory, make_record, place):
    store = CheckpointStore(ModelStore(memory, PREFIX))
    train(store, *range(5), laps={2: (10.0,)})
    store.begin_stage(4)
    train(store, 5, 6, laps={5: (30.0,)})

    found = read_milestones(ModelStore(memory, PREFIX))
    assert found is not None
    assert [(kind, each.name.number) for kind, each in found.reached()] == [
        ("first-lap", 2),
        ("best-lap", 5),
    ]
    laps = {2: [10.0], 5: [30.0]}
    curve = [
        replace(
            make_record(n),
            checkpoint=f"{n}_Step-{n * 100}.ckpt",
            **{place: "short" if n < 4 else "long"},
            evaluation_progress=[100.0] * len(laps.get(n, [])),
            evaluation_lap_s=laps.get(n, []),
        )
        for n in range(6)
    ]
    worked_out = with_history(NO_MILESTONES, curve)
    assert worked_out.best_lap is not None
    assert worked_out.best_lap.name.number == 5


def test_a_trainer_that_goes_back_forgets_the_milestones_of_later_checkpoints(memory):
    train(CheckpointStore(ModelStore(memory, PREFIX)), *range(8), laps={2: (30.0,), 6: (20.0,)})

    CheckpointStore(ModelStore(memory, PREFIX)).restore_milestones(CheckpointName(5, 500), [])

    found = read_milestones(ModelStore(memory, PREFIX))
    assert found is not None
    assert found.best_lap is not None
    assert found.best_lap.name.number == 2


@pytest.mark.parametrize("damage", [b"", b"{", b'{"first_lap": 3}', None])
def test_a_lost_record_is_reconstructed_and_no_kept_checkpoint_is_lost(memory, make_record, damage):
    train(CheckpointStore(ModelStore(memory, PREFIX), KeepRules(every=3)), *range(14), laps=LAPS)
    before = numbers(memory)
    write_history(
        ModelStore(memory, PREFIX),
        [
            make_record(
                n,
                checkpoint=f"{n}_Step-{n * 100}.ckpt",
                evaluation_progress=result(n, *LAPS.get(n, ())).progress,
                evaluation_lap_s=list(LAPS.get(n, ())),
            )
            for n in range(13)
        ],
    )
    model = ModelStore(memory, PREFIX, keys.metrics_prefix(PREFIX))
    if damage is None:
        memory.delete([keys.milestones(PREFIX)])
    else:
        memory.put(keys.milestones(PREFIX), damage)
        with pytest.raises(ObjectDamaged):
            read_milestones(ModelStore(memory, PREFIX))

    told = repair(model)
    assert any("milestones.json is damaged" in text for text in told) is (damage is not None)
    store = CheckpointStore(ModelStore(memory, PREFIX))
    store.restore_milestones(CheckpointName(13, 1300), [])
    store.save(14, 1400, b"weights")

    found, damaged = readable_milestones(ModelStore(memory, PREFIX), [])
    assert damaged == []
    assert set(before) - {10} <= set(numbers(memory))
    if damage is not None:
        assert found.best_lap is not None
        assert found.best_lap.name.number == 11


def test_a_model_of_version_0_1_0_has_milestones_from_its_learning_curve(memory, make_record):
    record = make_record(
        7, checkpoint="7_Step-700.ckpt", evaluation_progress=[100.0], evaluation_lap_s=[12.5]
    )

    found, damaged = readable_milestones(ModelStore(memory, PREFIX), [record])

    assert damaged == []
    assert found.first_lap is not None
    assert (found.first_lap.name.number, found.first_lap.best_lap_s) == (7, 12.5)


def test_a_new_phase_keeps_the_milestones_of_the_one_before():
    driven = {"evaluation_progress": [100.0], "evaluation_lap_s": [7.0]}
    records = [
        iteration_record(4, phase="distillation", **driven),
        iteration_record(5, phase="ppo", **{**driven, "evaluation_lap_s": [8.0]}),
    ]

    found = dict(with_history(NO_MILESTONES, records).reached())

    assert found["best-lap"].name.number == 4
