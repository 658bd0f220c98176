"""A reader gets a whole checkpoint or a clear reason, whatever the trainer died of."""

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drcli.base.errors import StorageError
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing
from drcli.model import keys
from drcli.model.best_checkpoint import forget_scores, is_better, is_hopeful, score_of
from drcli.model.checkpoints import KEEP, CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName, Counters
from drcli.records.scores import EvaluationEpisodes, EvaluationResult, Score, Scores, encode_single
from evaluations import evaluated
from memory_bucket import MemoryBucket

PREFIX = "team/model-1"


class TrainerKilledError(Exception):
    """Raised in the place of a write that never happens."""


class MortalBucket(MemoryBucket):
    """Lets its writer die before one of the next writes."""

    writes_left = 1_000

    def put(self, key: str, data: bytes) -> None:
        if not self.writes_left:
            raise TrainerKilledError
        self.writes_left -= 1
        super().put(key, data)


@pytest.fixture
def store(memory: MemoryBucket) -> CheckpointStore:
    return CheckpointStore(ModelStore(memory, PREFIX))


def names(bucket: MemoryBucket) -> list[str]:
    found = {
        keys.checkpoint_of(PREFIX, info.key) for info in bucket.list(keys.model_folder(PREFIX))
    }
    return [str(name) for name in sorted(name for name in found if name is not None)]


def test_a_checkpoint_comes_back_with_its_counters_and_optimizer(store):
    store.save(
        7, 4200, b"weights", optimizer=b"moments", sim_time_s=63.5, counters=Counters(episodes=9)
    )

    found = store.load_latest(with_optimizer=True)

    assert found is not None
    assert (found.tensors, found.optimizer, found.damaged) == (b"weights", b"moments", ())
    assert (found.record.number, found.record.steps) == (7, 4200)
    assert found.record.counters == Counters(episodes=9)
    assert found.record.sim_time_s == 63.5


def test_the_optimizer_is_read_only_when_asked_for(store):
    store.save(0, 0, b"weights", optimizer=b"moments")

    assert store.load("0_Step-0.ckpt").optimizer is None


def test_a_model_without_checkpoints_has_no_latest(store):
    assert store.pointed() is None
    assert store.load_latest() is None
    assert store.best_name() is None


def test_the_pointer_is_the_plain_name_and_the_scores_are_one_line(store, memory):
    store.save(0, 0, b"a", sim_time_s=0.0)
    store.save(1, 2210, b"b", sim_time_s=147.25)

    pointer = memory.get(f"{PREFIX}/model/.coach_checkpoint")
    scores = memory.get(f"{PREFIX}/model/deepracer_checkpoints.json")

    assert pointer == b"1_Step-2210.ckpt"
    assert scores == (
        b'{"best_checkpoint": {"name": "1_Step-2210.ckpt", "avg_eval_metric": null, '
        b'"time_stamp": 147.25}, "last_checkpoint": {"name": "1_Step-2210.ckpt", '
        b'"avg_eval_metric": null, "time_stamp": 147.25}}'
    )


@pytest.mark.parametrize("writes", range(3))
def test_a_trainer_killed_before_the_pointer_leaves_the_checkpoint_before(writes):
    bucket = MortalBucket()
    store = CheckpointStore(ModelStore(bucket, PREFIX))
    store.save(8, 100, b"before", optimizer=b"m")
    bucket.writes_left = writes

    with pytest.raises(TrainerKilledError):
        store.save(9, 200, b"after", optimizer=b"m")

    found = store.load_latest(with_optimizer=True)
    assert found is not None
    assert (found.tensors, found.damaged) == (b"before", ())


def test_an_unpublished_checkpoint_is_swept_when_its_place_is_taken(store, memory):
    store.save(8, 100, b"before")
    memory.put(keys.checkpoint_tensors(PREFIX, "9_Step-150.ckpt"), b"unpublished")

    store.save(9, 200, b"after")

    assert names(memory) == ["8_Step-100.ckpt", "9_Step-200.ckpt"]


@pytest.mark.parametrize("content", [b"wei", b"weightz", b""])
def test_a_damaged_checkpoint_is_passed_over_and_named(store, memory, content):
    store.save(9, 100, b"good one")
    store.save(10, 200, b"weights")
    memory.put(keys.checkpoint_tensors(PREFIX, "10_Step-200.ckpt"), content)

    found = store.load_latest()

    assert found is not None
    assert found.tensors == b"good one"
    assert len(found.damaged) == 1
    assert "10_Step-200.ckpt.safetensors is damaged" in found.damaged[0]


def test_a_checkpoint_without_its_record_is_passed_over(store, memory):
    for number in (9, 10):
        store.save(number, 100, b"weights %d" % number)
    memory.delete([keys.checkpoint_record(PREFIX, "10_Step-100.ckpt")])

    found = store.load_latest()

    assert found is not None
    assert found.tensors == b"weights 9"
    assert [text.partition(":")[0] for text in found.damaged] == ["10_Step-100.ckpt"]


def test_whole_weights_go_on_without_a_damaged_optimizer(store, memory):
    store.save(10, 100, b"weights", optimizer=b"moments")
    memory.put(keys.checkpoint_optimizer(PREFIX, "10_Step-100.ckpt"), b"moment")

    found = store.load_latest(with_optimizer=True)

    assert found is not None
    assert (found.tensors, found.optimizer, found.damaged) == (b"weights", None, ())


def test_an_optimizer_that_follows_belongs_to_its_checkpoint_and_replaces_older_ones(store, memory):
    older = store.save(8, 50, b"older")
    store.attach_optimizer(older, b"oldest moments")
    before = store.save(9, 100, b"before")
    store.attach_optimizer(before, b"old moments")
    after = store.save(10, 200, b"after")

    store.attach_optimizer(after, b"moments")

    found = store.load_latest(with_optimizer=True)
    assert found is not None
    assert (found.tensors, found.optimizer) == (b"after", b"moments")
    assert not memory.exists(keys.checkpoint_optimizer(PREFIX, "8_Step-50.ckpt"))


def test_whoever_falls_back_on_the_checkpoint_before_has_its_optimizer_too(store, memory):
    store.attach_optimizer(store.save(9, 100, b"before"), b"old moments")
    store.attach_optimizer(store.save(10, 200, b"after"), b"moments")
    memory.put(keys.checkpoint_tensors(PREFIX, "10_Step-200.ckpt"), b"damaged")

    found = store.load_latest(with_optimizer=True)

    assert found is not None
    assert (found.tensors, found.optimizer) == (b"before", b"old moments")


@pytest.mark.parametrize("record", [b"{", b"[]", b'{"name": 1}', b'{"tensors": {}}'])
def test_an_unreadable_record_counts_as_damage(store, memory, record):
    store.save(0, 0, b"weights")
    memory.put(keys.checkpoint_record(PREFIX, "0_Step-0.ckpt"), record)

    with pytest.raises(ObjectDamaged, match=r"0_Step-0\.ckpt\.json"):
        store.load("0_Step-0.ckpt")


def test_when_no_checkpoint_is_whole_each_is_named(store, memory):
    store.save(0, 0, b"a")
    store.save(1, 5, b"b")
    for name in ("0_Step-0.ckpt", "1_Step-5.ckpt"):
        memory.put(keys.checkpoint_tensors(PREFIX, name), b"?!")

    with pytest.raises(StorageError, match=r"1_Step-5.*0_Step-0"):
        store.load_latest()


@pytest.mark.parametrize("pointer", [None, b"", b"{}"])
def test_a_lost_pointer_loses_no_checkpoint(store, memory, pointer):
    store.save(9, 100, b"older")
    store.save(10, 200, b"newest")
    if pointer is None:
        memory.delete([keys.coach_checkpoint(PREFIX)])
    else:
        memory.put(keys.coach_checkpoint(PREFIX), pointer)

    found = store.load_latest()

    assert found is not None
    assert found.tensors == b"newest"


def test_a_trainer_that_fell_back_points_everybody_to_the_older_checkpoint(store, memory):
    store.save(9, 100, b"good")
    store.save(10, 200, b"weights")
    memory.put(keys.checkpoint_tensors(PREFIX, "10_Step-200.ckpt"), b"broken")
    found = store.load_latest()
    assert found is not None

    store.point_to(found.record)
    store.save(10, 180, b"again")

    assert str(store.pointed()) == "10_Step-180.ckpt"
    assert names(memory) == ["9_Step-100.ckpt", "10_Step-180.ckpt"]


def test_only_the_newest_checkpoints_and_the_best_are_kept(store, memory):
    for number in range(8):
        store.save(number, 100 * number, b"weights", optimizer=b"moments")
        memory.put(keys.checkpoint_graph(PREFIX, number), b"graph")
        if number == 1:
            store.record_evaluation(evaluated("1_Step-100.ckpt", 50.0), "progress")
    memory.put(f"{PREFIX}/model/model_metadata.json", b"{}")

    store.save(8, 800, b"weights")

    kept = ["1_Step-100.ckpt", *(f"{n}_Step-{n}00.ckpt" for n in range(9 - KEEP, 9))]
    assert names(memory) == kept
    assert store.load("1_Step-100.ckpt", with_optimizer=True).optimizer == b"moments"
    assert not memory.exists(keys.checkpoint_graph(PREFIX, 2))
    assert memory.exists(keys.checkpoint_graph(PREFIX, 7))
    assert memory.exists(f"{PREFIX}/model/model_metadata.json")


def test_the_graph_of_a_lost_checkpoint_does_not_outlive_the_next_of_its_number(store, memory):
    store.save(4, 400, b"weights")
    store.attach_graph(4, b"its graph")
    memory.put(keys.checkpoint_graph(PREFIX, 99), b"of somebody else")

    store.save(5, 500, b"lost weights")
    store.attach_graph(5, b"graph of the lost weights")
    store.save(5, 480, b"weights after going back")

    assert memory.get(keys.checkpoint_graph(PREFIX, 4)) == b"its graph"
    assert not memory.exists(keys.checkpoint_graph(PREFIX, 5))
    assert memory.exists(keys.checkpoint_graph(PREFIX, 99))


def test_a_neighbour_with_a_longer_name_is_never_pruned(memory):
    CheckpointStore(ModelStore(memory, "model-10")).save(0, 0, b"theirs")

    for number in range(6):
        CheckpointStore(ModelStore(memory, "model-1")).save(number, 0, b"ours")

    assert memory.exists("model-10/model/0_Step-0.ckpt.safetensors")


def test_the_best_is_the_highest_mean_and_a_tie_goes_to_the_newer(store):
    for number in range(4):
        store.save(number, number, b"weights")

    became_best = [
        store.record_evaluation(evaluated(f"{number}_Step-{number}.ckpt", mean), "progress")
        for number, mean in enumerate([40.0, 60.0, 50.0, 60.0])
    ]

    assert became_best == [True, True, False, True]
    assert store.best_name() == "3_Step-3.ckpt"


def drove(clean: int, of: int, lap_s: float = 8.0, **changes: float) -> EvaluationEpisodes:
    progress, reward = changes.get("progress", 50.0), changes.get("reward", 1.0)
    return EvaluationEpisodes(
        [100.0] * clean + [progress] * (of - clean), [reward] * of, [lap_s] * clean
    )


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        (drove(10, 20, 12.0), drove(9, 20, 8.0)),  # reliable before fast
        (drove(38, 40), drove(19, 20)),  # the same share, known better
        (drove(58, 60, 7.9), drove(60, 60, 8.0)),  # reliable enough, so the faster one
        (drove(0, 20, progress=70.0), drove(0, 20, progress=60.0)),
        (drove(1, 20, progress=1.0), drove(0, 20, progress=90.0)),
    ],
)
@pytest.mark.parametrize("metric", ["progress", "laptime"])
def test_the_best_is_surely_clean_most_often_and_then_fast(better, worse, metric):
    before, after = (
        score_of(f"{n}_Step-{n}.ckpt", e, metric, 0.0) for n, e in ((0, worse), (1, better))
    )

    assert is_better(after, before, metric)
    assert not is_better(before, after, metric)
    assert is_better(before, before, metric)  # of equal ones, the later


def test_a_checkpoint_that_reaches_a_goal_is_the_best_whatever_others_drove(store):
    for number in range(2):
        store.save(number, number, b"weights")
    fast = EvaluationResult("0_Step-0.ckpt", [100.0] * 60, [1.0] * 60, [6.0] * 60)
    few = EvaluationResult("1_Step-1.ckpt", [100.0] * 5, [1.0] * 5, [8.0] * 5)
    store.record_evaluation(fast, "progress")

    assert not store.record_evaluation(few, "progress")
    assert store.record_evaluation(few, "progress", reaches_goal=True)


def test_a_best_of_which_only_a_mean_is_known_may_have_been_lucky():
    best = Score("0_Step-0.ckpt", 100.0)

    def beats(clean: int, of: int, metric: str = "progress") -> bool:
        return is_better(score_of("1_Step-1.ckpt", drove(clean, of), metric, 0.0), best, metric)

    assert beats(59, 60)
    assert beats(5, 5)
    assert not beats(12, 20)
    assert not beats(59, 60, "reward")


def test_the_reward_decides_where_it_shall_and_laps_between_equal_ones():
    def score(*args, **changes) -> Score:
        return score_of("1_Step-1.ckpt", drove(*args, **changes), "reward", 0.0)

    assert is_better(score(0, 5, reward=2.0), score(5, 5, reward=1.0), "reward")
    assert is_better(score(5, 5, reward=1.0), score(0, 5, reward=1.0), "reward")
    assert not is_better(score(0, 5, reward=1.0), score(5, 5, reward=1.0), "reward")


@pytest.mark.parametrize(
    ("metric", "metric_of_best", "better", "worse"),
    [("progress", 80.0, 80.0, 79.0), ("laptime", 9000.0, 9000.0, 9500.0)],
)
def test_a_best_of_version_0_1_0_has_only_its_mean(metric, metric_of_best, better, worse):
    best = Score("0_Step-0.ckpt", metric_of_best)

    assert is_better(Score("1_Step-1.ckpt", better), best, metric)
    assert not is_better(Score("1_Step-1.ckpt", worse), best, metric)


def test_a_checkpoint_is_hopeful_if_it_would_be_the_best_after_driving_as_well_again():
    best = score_of("0_Step-0.ckpt", drove(38, 40, 8.0), "progress", 0.0)
    scores = Scores(best, best)

    def hopeful(*args) -> bool:
        episodes = drove(*args)
        lists = episodes.progress, episodes.reward, episodes.lap_s
        return is_hopeful(scores, EvaluationResult("1_Step-1.ckpt", *lists), "progress")

    assert hopeful(19, 20, 8.0)
    assert not hopeful(19, 20, 8.1)
    assert hopeful(20, 20, 9.0)
    assert not hopeful(18, 20, 7.0)
    assert not hopeful(0, 20)


def test_the_laps_of_the_best_are_still_known_to_the_next_trainer_and_stand_behind_all_else(
    store, memory
):
    store.save(0, 0, b"weights")
    store.record_evaluation(evaluated("0_Step-0.ckpt", 100.0, 14_000.0), "progress")

    store.save(1, 1, b"weights")

    assert not store.record_evaluation(evaluated("1_Step-1.ckpt", 100.0, 15_000.0), "progress")
    written = json.loads(memory.get(keys.deepracer_checkpoints(PREFIX)))
    assert list(written) == ["best_checkpoint", "last_checkpoint", "best_episodes"]
    fields = ["name", "avg_eval_metric", "time_stamp"]
    assert list(written["best_checkpoint"]) == list(written["last_checkpoint"]) == fields


def test_minus_one_in_a_file_of_older_tools_is_no_evaluation():
    name = "3_Step-30.ckpt"
    theirs = encode_single(Score(name, -1.0))

    read = Scores.decode(theirs)

    assert (read.best_checkpoint, read.last_checkpoint) == (Score(name), Score(name))
    # A mean reward of our own, whose episodes are known, may have that value.
    own = Score(name, -1.0, episodes=EvaluationEpisodes([50.0], [-1.0], []))
    assert Scores.decode(Scores(own, Score(name, -0.5)).encode()) == Scores(own, Score(name, -0.5))


def test_what_a_checkpoint_drove_again_counts_with_its_evaluation(store, memory):
    store.save(0, 0, b"weights")
    lucky = EvaluationResult("0_Step-0.ckpt", [100.0] * 2, [1.0] * 2, [8.0] * 2)

    store.record_evaluation(replace(lucky, confirmation=drove(0, 2)), "progress")

    best = Scores.decode(memory.get(keys.deepracer_checkpoints(PREFIX))).best_checkpoint
    assert best.avg_eval_metric == 75.0
    assert best.episodes is not None
    assert str(best.episodes.laps) == "2 of 4 laps clean, median 8.00 s, slowest 8.00 s"


def test_the_newest_is_the_best_until_one_is_evaluated(store):
    for number in range(3):
        store.save(number, number, b"weights")
    before = store.best_name()

    store.record_evaluation(evaluated("1_Step-1.ckpt", 1.0), "progress")
    store.save(3, 3, b"weights")

    assert before == "2_Step-2.ckpt"
    assert store.best_name() == "1_Step-1.ckpt"


def test_a_best_that_is_to_be_evaluated_again_stays_the_best(store, memory):
    store.save(0, 0, b"weights")
    store.save(1, 1, b"weights")
    store.record_evaluation(evaluated("0_Step-0.ckpt", 99.0), "progress")
    forget_scores(ModelStore(memory, PREFIX))

    store.save(2, 2, b"weights")

    assert store.best_name() == "0_Step-0.ckpt"


def test_forgotten_scores_are_beaten_by_the_next_evaluation(store, memory):
    store.save(0, 0, b"weights")
    store.save(1, 1, b"weights")
    store.record_evaluation(evaluated("0_Step-0.ckpt", 99.0, 1.0), "progress")

    forget_scores(ModelStore(memory, PREFIX))

    assert store.best_name() == "0_Step-0.ckpt"
    assert store.record_evaluation(evaluated("1_Step-1.ckpt", 1.0, 2.0), "progress")


@given(
    st.lists(st.tuples(st.integers(0, 5), st.sampled_from([None, 10.0, 50.0, 100.0])), max_size=12)
)
def test_whatever_is_evaluated_when_the_last_and_the_best_can_always_be_loaded(evaluations):
    bucket = MemoryBucket()
    store = CheckpointStore(ModelStore(bucket, PREFIX))
    means: dict[str, float] = {}

    for number, (age, mean) in enumerate(evaluations):
        last = store.save(number, number, b"weights").name
        driven = f"{number - age}_Step-{number - age}.ckpt"
        present = driven in names(bucket)
        if mean is not None and driven not in means and age <= number:
            store.record_evaluation(evaluated(driven, mean), "progress")
            means |= {driven: mean} if present else {}

        best = store.best_name()
        assert {best, last} <= set(names(bucket))
        assert len(names(bucket)) <= KEEP + 1
        assert means.get(best or "", 0.0) == max(means.values(), default=0.0)


def test_the_best_lap_time_is_the_lowest(store):
    store.save(0, 0, b"weights")
    store.save(1, 1, b"weights")

    store.record_evaluation(evaluated("0_Step-0.ckpt", 100.0, 14_000.0), "laptime")

    assert not store.record_evaluation(evaluated("1_Step-1.ckpt", 100.0, 15_000.0), "laptime")
    assert store.best_name() == "0_Step-0.ckpt"


def test_the_evaluation_of_the_last_checkpoint_shows_in_its_line(store, memory):
    store.save(0, 0, b"weights", sim_time_s=1.5)

    store.record_evaluation(evaluated("0_Step-0.ckpt", 64.3), "progress")

    line = json.loads(memory.get(keys.deepracer_checkpoints(PREFIX)))["last_checkpoint"]
    assert line == {"name": "0_Step-0.ckpt", "avg_eval_metric": 64.3, "time_stamp": 1.5}


def test_a_late_evaluation_of_a_pruned_checkpoint_changes_nothing(store):
    for number in range(6):
        store.save(number, 0, b"weights")

    assert not store.record_evaluation(evaluated("1_Step-0.ckpt", 100.0), "progress")
    assert store.best_name() == "5_Step-0.ckpt"


def test_unreadable_scores_do_not_end_a_training(store, memory):
    store.save(0, 0, b"weights")
    memory.put(keys.deepracer_checkpoints(PREFIX), b"[]")

    store.save(1, 5, b"weights")

    assert store.best_name() == "1_Step-5.ckpt"


def test_scores_keep_what_is_known_of_a_checkpoint_that_is_pointed_to_again():
    best = Score("1_Step-1.ckpt", 70.0, 2.0)
    scores = Scores(best, Score("2_Step-2.ckpt", None, 3.0))

    assert scores.metric_of("1_Step-1.ckpt") == 70.0
    assert scores.metric_of("2_Step-2.ckpt") is None


def test_loading_a_checkpoint_that_does_not_exist_names_it(store):
    with pytest.raises(ObjectMissing, match=r"5_Step-5\.ckpt"):
        store.load("5_Step-5.ckpt")


@pytest.mark.parametrize("lost", [None, b"", b"{}", b"0_Step-0.ckpt"])
def test_a_trainer_mends_a_pointer_that_its_workers_cannot_follow(store, memory, lost):
    store.save(0, 0, b"weights")
    newest = CheckpointName.parse(store.save(1, 100, b"weights").name)
    key = keys.coach_checkpoint(PREFIX)
    memory.delete([key])
    if lost is not None:
        memory.put(key, lost)

    assert store.repair_pointer(newest)
    assert str(store.pointed()) == str(newest)
    assert not store.repair_pointer(newest)


def test_a_pointer_that_somebody_else_has_moved_on_is_left_alone(store):
    old = CheckpointName.parse(store.save(0, 0, b"weights").name)
    newest = store.save(1, 100, b"weights")

    assert not store.repair_pointer(old)
    assert str(store.pointed()) == newest.name


def test_rollouts_come_from_the_newest_checkpoint_or_one_of_those_before(memory):
    store = CheckpointStore(ModelStore(memory, "model"))
    for number in range(3):
        store.save(number, 100 * number, b"weights")

    assert store.behaviour_checkpoints(CheckpointName(0, 0), -1) == ["0_Step-0.ckpt"]
    two = ["1_Step-100.ckpt", "2_Step-200.ckpt"]
    assert store.behaviour_checkpoints(CheckpointName(2, 200), 1) == two
    assert store.behaviour_checkpoints(CheckpointName(2, 200), 2) == ["2_Step-200.ckpt"]
    assert store.behaviour_checkpoints(CheckpointName(9, 900), 8) == ["9_Step-900.ckpt"]


def test_more_of_the_newest_checkpoints_stay_where_more_may_have_driven(memory):
    store = CheckpointStore(ModelStore(memory, "model"), keep=KEEP + 2)
    for number in range(12):
        store.save(number, 100 * number, b"weights")

    drivers = store.behaviour_checkpoints(CheckpointName(11, 1100), 0)
    assert drivers[-KEEP - 2 :] == [f"{n}_Step-{n}00.ckpt" for n in range(12 - KEEP - 2, 12)]


def test_a_first_checkpoint_that_was_only_begun_is_none(memory):
    """Its trainer was killed between weights and record; the next one begins anew."""
    memory.put(keys.checkpoint_tensors("model", "0_Step-0.ckpt"), b"weights")

    assert CheckpointStore(ModelStore(memory, "model")).load_latest() is None


def test_a_best_checkpoint_whose_weights_are_damaged_is_forgotten(bucket):
    store = CheckpointStore(ModelStore(bucket, PREFIX))
    store.save(1, 100, b"first")
    store.record_evaluation(evaluated("1_Step-100.ckpt", 90.0), "progress")
    store.save(2, 200, b"second")
    assert store.forget_damaged_best() is None
    bucket.put(keys.checkpoint_tensors(PREFIX, "1_Step-100.ckpt"), b"fir")

    damage = store.forget_damaged_best()

    assert damage is not None
    assert "1_Step-100.ckpt.safetensors is damaged" in damage
    assert store.best_name() == "2_Step-200.ckpt"
