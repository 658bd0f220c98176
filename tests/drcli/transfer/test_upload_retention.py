"""Which checkpoints and archives stay at the target of uploads."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drcli.base.errors import SettingsError
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore
from drcli.records.checkpoint import CheckpointName
from drcli.transfer.upload import Retention, delete_surplus_archives, surplus
from memory_bucket import MemoryBucket

from .conftest import put_model


def names(*numbers):
    return [CheckpointName(number, 100 * number) for number in numbers]


def kept(numbers, keep="", max_mb=0, best=None, pinned=(), size=1_000_000):
    sizes = dict.fromkeys(names(*numbers), size)
    best_name = names(best)[0] if best is not None else None
    gone = surplus(sizes, Retention.of(keep, max_mb), best_name, names(*pinned))
    return [name.number for name in sizes if name not in gone]


@pytest.mark.parametrize(
    ("keep", "stay"),
    [
        ("", [1, 5, 9, 12, 20, 21]),
        ("last", [21]),
        ("last-3", [12, 20, 21]),
        ("best", [9]),
        ("every-10", [1, 12, 20]),
        ("last,best", [9, 21]),
        ("last best; every-10", [1, 9, 12, 20, 21]),
        ("LAST,Best", [9, 21]),
    ],
)
def test_rules_keep_what_they_name(keep, stay):
    assert kept([1, 5, 9, 12, 20, 21], keep, best=9) == stay


def test_what_the_pointers_name_always_stays():
    assert kept([1, 2, 3, 4], "last", pinned=[2]) == [2, 4]
    assert kept([1, 2, 3, 4], "", max_mb=1, pinned=[1]) == [1]
    assert kept([1, 2], "", max_mb=1, pinned=[1, 2]) == [1, 2]


def test_the_size_limit_takes_the_oldest_first_and_the_best_last():
    assert kept([1, 2, 3, 4], max_mb=2, best=1) == [1, 4]
    assert kept([1, 2, 3, 4], max_mb=1, best=1) == [1]
    assert kept([1, 2, 3, 4], max_mb=4) == [1, 2, 3, 4]


@given(st.lists(st.integers(0, 300), unique=True, min_size=1, max_size=40), st.integers(1, 50))
def test_what_every_nth_keeps_once_it_keeps_always(numbers, n):
    """However often old ones are deleted, each block of n numbers keeps its first."""
    there: list[int] = []
    for number in sorted(numbers):
        there = kept([*there, number], f"every-{n}")
    assert there == kept(sorted(numbers), f"every-{n}")


@given(
    st.dictionaries(st.integers(0, 99), st.integers(1, 9), min_size=1),
    st.sampled_from(["", "last", "best", "every-7", "last-2,best"]),
    st.integers(0, 20),
)
def test_the_newest_and_the_pinned_survive_everything(sizes, keep, max_mb):
    newest = max(sizes)
    by_name = {CheckpointName(n, 0): size * 1_000_000 for n, size in sizes.items()}
    pinned = [CheckpointName(newest, 0)]

    gone = surplus(by_name, Retention.of(keep, max_mb), None, pinned)

    assert pinned[0] not in gone
    left = sum(size for name, size in by_name.items() if name not in gone)
    if max_mb:
        assert left <= max(max_mb * 1_000_000, by_name[pinned[0]])


@pytest.mark.parametrize("keep", ["first", "last-0", "every", "every-", "best-3", "last,,x"])
def test_a_rule_that_is_none_is_refused_with_the_right_ones(keep):
    with pytest.raises(SettingsError, match="not a rule") as refused:
        Retention.of(keep, 0)
    assert "every-50" in refused.value.remedy


@pytest.fixture
def trained(mover):
    """Checkpoints 3 (the best) and 5 of a model."""
    put_model(mover.here, "team/model")
    return mover


def numbers_there(mover, prefix="team/model-1"):
    found = {keys.checkpoint_of(prefix, info.key) for info in mover.there.list(f"{prefix}/model/")}
    return sorted(name.number for name in found if name is not None)


def upload_numbers(mover, *numbers, **options):
    report = None
    for number in numbers:
        store = CheckpointStore(ModelStore(mover.here, "team/model"))
        store.save(number, 100 * number, b"weights %d" % number)
        report = mover.upload(choice=number, **options)
    return report


def test_uploads_by_the_clock_do_not_grow_without_end(trained):
    upload_numbers(trained, 10, 20, 30)
    before = trained.there.list("")
    report = upload_numbers(trained, 40, keep="last-2")

    assert numbers_there(trained) == [30, 40]
    assert any("10_Step" in name for name in report.deleted)
    others = {info.key for info in before if keys.checkpoint_of("team/model-1", info.key) is None}
    there = {info.key for info in trained.there.list("")}
    assert {key for key in others if "model_" not in key} <= there


def test_the_settings_count_if_no_option_is_given(trained):
    trained.run_env(
        "DR_WORLD_NAME=reinvent_base",
        "DR_LOCAL_S3_MODEL_PREFIX=team/model",
        "DR_UPLOAD_S3_PREFIX=team/model-1",
        "DR_UPLOAD_KEEP=last",
    )
    upload_numbers(trained, 10, 20)

    assert numbers_there(trained) == [20]


def test_checkpoints_of_others_are_never_deleted(trained):
    theirs = [f"team/model-1/model/4_Step-400.ckpt{end}" for end in keys.TENSORFLOW_PARTS]
    foreign = [
        "team/model-1/model/6_Step-600.ckpt.safetensors",  # without a record
        "team/model-1/model/7_Step-700.ckpt.json",
        "team/model-1/notes.txt",
        "team/model-10/model/1_Step-100.ckpt.safetensors",
    ]
    for key in [*theirs, *foreign]:
        trained.there.put(key, b"theirs")

    upload_numbers(trained, 10, 20, keep="last")

    there = {info.key for info in trained.there.list("")}
    assert {*theirs, *foreign} <= there


def test_a_dry_run_deletes_nothing_and_says_what_it_would(trained):
    upload_numbers(trained, 10, 20)

    report = trained.upload(choice=20, keep="last", dry_run=True)

    assert numbers_there(trained) == [10, 20]
    assert any("10_Step" in name for name in report.deleted)


def test_archives_follow_the_same_rules_and_others_stay():
    bucket = MemoryBucket()
    numbered = [f"up/model-chk{n}.tar.gz" for n in (3, 7, 12)]
    others = ["up/carfile.tar.gz", "up/model.tar.gz", "up/other-chk1.tar.gz", "up/x-chk2.zip"]
    for key in [*numbered, *others]:
        bucket.put(key, b"archive")

    deleted = delete_surplus_archives(
        ModelStore(bucket, "up"),
        ["model.tar.gz"],
        Retention.of("last,best", 0),
        "3_Step-300.ckpt",
        12,
    )

    assert deleted == ["model-chk7.tar.gz"]
    assert {info.key for info in bucket.list("")} == {*numbered, *others} - {numbered[1]}
