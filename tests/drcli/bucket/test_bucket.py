"""What every bucket promises, kept in memory and over the wire."""

import pytest

from drcli.base.errors import OwnershipLost, StorageError
from drcli.bucket.bucket import ObjectDamaged, ObjectMissing, ObjectNewer, Watch, read_record
from drcli.records.run_record import TrainingEnd
from memory_bucket import MemoryBucket


@pytest.mark.parametrize("data", [b"", b"x", bytes(range(256)) * 5_000])
def test_what_was_put_is_what_is_got(bucket, data):
    bucket.put("a/b", data)

    assert bucket.get("a/b") == data


def test_a_second_put_replaces_the_first(bucket):
    bucket.put("a/b", b"old")
    bucket.put("a/b", b"new")

    assert bucket.get("a/b") == b"new"


def test_a_missing_object_is_named_with_its_bucket(bucket):
    with pytest.raises(ObjectMissing, match="bucket/a/none") as failure:
        bucket.get("a/none")

    assert isinstance(failure.value, StorageError)
    assert failure.value.remedy


def test_exists_tells_objects_from_folders_and_nothing(bucket):
    bucket.put("a/b", b"x")

    assert [bucket.exists(key) for key in ("a/b", "a/", "a/c")] == [True, False, False]


def test_a_listing_leaves_the_neighbour_with_the_longer_name_out(bucket):
    bucket.put("model-10/x", b"1")
    bucket.put("model-1/y/z", b"22")

    listed = bucket.list("model-1/")

    assert [(info.key, info.size_bytes) for info in listed] == [("model-1/y/z", 2)]
    assert listed[0].etag
    assert listed[0].modified.tzinfo is not None


@pytest.mark.parametrize(
    "placeholder",
    [
        *("m/", "n/", "m/model/", "m", "m/model", "m_$folder$", "m/model_$folder$"),
        *(".keep", "m/.keep", "m/.gitkeep", "m/.bzEmpty", "m/model/.emptyFolderPlaceholder"),
    ],
)
def test_a_listing_leaves_out_what_programs_write_for_a_folder(bucket, placeholder):
    bucket.put("m/model/1.ckpt", b"1")
    bucket.put("m/empty", b"")
    bucket.put(placeholder, b"")

    assert [info.key for info in bucket.list("")] == ["m/empty", "m/model/1.ckpt"]
    assert [info.key for info in bucket.list("m/model/")] == ["m/model/1.ckpt"]
    assert bucket.list("n/") == []
    bucket.delete([placeholder])  # no listing would tell the next test


@pytest.mark.parametrize("key", ["m", "m/.keep", "m_$folder$"])
def test_an_object_with_content_is_not_taken_for_a_placeholder(bucket, key):
    bucket.put("m/model/1.ckpt", b"1")
    bucket.put(key, b"1")

    assert key in [info.key for info in bucket.list("")]


def test_a_listing_without_the_closing_slash_is_refused(bucket):
    with pytest.raises(ValueError, match="slash"):
        bucket.list("model-1")


def test_deleting_forgets_what_is_there_and_ignores_what_is_not(bucket):
    bucket.put("a/b", b"x")
    bucket.put("a/c", b"x")

    bucket.delete(key for key in ("a/b", "a/none"))
    bucket.delete([])

    assert [info.key for info in bucket.list("a/")] == ["a/c"]


def test_a_record_comes_back_as_it_went_on_one_line(bucket):
    end = TrainingEnd("a session", "It is over ü.")
    bucket.put("a.json", end.encode())

    assert read_record(bucket, "a.json", TrainingEnd.decode) == end
    assert b"\n" not in bucket.get("a.json")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"{", "Input data was truncated"),
        (b"{}", "Object missing required field `session`"),
        (b'{"session": "s", "reason": "r", "format": 0}', r"Expected `int` >= 1 - at `\$\.format`"),
    ],
)
def test_an_object_that_is_not_the_record_is_named_with_the_reason(bucket, data, reason):
    bucket.put("a.json", data)

    with pytest.raises(ObjectDamaged, match=rf"bucket/a\.json is damaged: {reason}") as failure:
        read_record(bucket, "a.json", TrainingEnd.decode)

    assert failure.value.remedy == "Restore it from a copy."


class Overwritten(MemoryBucket):
    """Answers first as the embedded server may while an object is overwritten."""

    def __init__(self, *first: bytes | None) -> None:
        super().__init__()
        self.first = list(first)

    def get(self, key: str, *, watch: Watch | None = None) -> bytes:
        if not self.first:
            return super().get(key, watch=watch)
        data = self.first.pop(0)
        if data is None:
            raise ObjectMissing(f"No {key}.", remedy="None.")
        return data


def test_a_record_that_was_cut_while_it_was_overwritten_is_read_again():
    end = TrainingEnd("a session", "It is over.")
    bucket = Overwritten(end.encode()[:-5], None)
    bucket.put("a.json", end.encode())

    def read() -> TrainingEnd:
        decode = TrainingEnd.decode
        return read_record(bucket, "a.json", decode, written=True, pause=pauses.append)

    pauses: list[float] = []
    assert read() == end
    assert len(pauses) == 2


def test_a_record_that_nobody_promised_is_missing_at_once(memory):
    pauses: list[float] = []

    with pytest.raises(ObjectMissing):
        read_record(memory, "a.json", TrainingEnd.decode, pause=pauses.append)

    assert pauses == []


def test_an_object_of_a_newer_version_is_not_called_damaged(bucket):
    bucket.put("a.json", b'{"session": "s", "reason": "r", "format": 2}')

    with pytest.raises(ObjectNewer, match=r"a\.json was written by a newer .* format is 2, not 1"):
        read_record(bucket, "a.json", TrainingEnd.decode)


def test_a_watcher_is_told_every_byte_that_travels(bucket):
    sent: list[int] = []
    read: list[int] = []

    bucket.put("k", b"0123456789", watch=sent.append)
    data = bucket.get("k", watch=read.append)

    assert data == b"0123456789"
    assert sum(sent) == sum(read) == 10


def test_an_object_tells_how_old_it_is(bucket):
    bucket.put("a/b", b"x")

    data, age_s = bucket.get_with_age("a/b")

    assert data == b"x"
    assert 0.0 <= age_s < 60.0


def test_the_age_of_a_missing_object_is_missing_too(bucket):
    with pytest.raises(ObjectMissing):
        bucket.get_with_age("a/none")


def test_a_fenced_bucket_asks_before_everything_that_it_changes(bucket):
    asked = []
    fenced = bucket.fenced(asked.append)
    fenced.put("a/b", b"x")
    fenced.put("a/c", b"x", watch=lambda more: None)
    fenced.delete(["a/b"])

    assert fenced.get("a/c") == b"x"
    assert bucket.exists("a/c")
    assert asked == ["a/b", "a/c", "a/b"]


def test_what_a_fence_says_no_to_does_not_happen(bucket):
    def refuse(key: str) -> None:
        raise OwnershipLost("Theirs.", remedy="Leave it.")

    bucket.put("a/b", b"x")
    fenced = bucket.fenced(refuse)
    for change in (lambda: fenced.put("a/b", b"y"), lambda: fenced.delete(["a/b"])):
        with pytest.raises(OwnershipLost):
            change()

    assert bucket.get("a/b") == b"x"
