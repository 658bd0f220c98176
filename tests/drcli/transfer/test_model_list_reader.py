"""Lists of models that are read again and again."""

from drcli.model import keys
from drcli.model.model_list import ModelListReader, list_models
from memory_bucket import MemoryBucket
from removable_models import put_all


class CountingBucket(MemoryBucket):
    """Remembers what was read."""

    def __init__(self):
        super().__init__()
        self.read: list[str] = []

    def get(self, key, **options):
        self.read.append(key)
        return super().get(key, **options)


def test_only_models_that_have_changed_are_read_again():
    bucket, reader = CountingBucket(), ModelListReader()
    for prefix in ("one", "two"):
        put_all(bucket, prefix)
    reader.read(bucket)
    bucket.read.clear()

    assert reader.read(bucket) == list_models(bucket)
    bucket.read.clear()
    bucket.put(keys.note("two", "000-description"), b"{}")
    bucket.delete([info.key for info in bucket.list("one/")])
    found = reader.read(bucket)

    assert [model.prefix for model in found.models] == ["two"]
    assert all(key.removeprefix("runs/").startswith("two/") for key in bucket.read)
    assert found == list_models(bucket)


def test_a_pattern_chooses_models_of_a_known_list():
    bucket, reader = CountingBucket(), ModelListReader()
    for prefix in ("one", "two"):
        put_all(bucket, prefix)
    reader.read(bucket)

    assert [model.prefix for model in reader.read(bucket, "tw").models] == ["two"]
