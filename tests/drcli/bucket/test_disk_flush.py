"""What is written into a bucket on this machine is flushed to its disk."""

import errno
import os
from pathlib import Path

import pytest

from drcli.base.errors import DiskFull, StorageError
from drcli.bucket.connect import open_bucket
from drcli.bucket.s3_bucket import DiskFlush
from drcli.bucket.server import server
from drcli.config.run_config import StorageConfig
from drcli.model import keys
from drcli.model.checkpoints import CheckpointStore
from drcli.model.model_store import ModelStore


@pytest.fixture
def flushed(monkeypatch):
    """Files and folders that were flushed, in order."""
    paths = []
    fsync = os.fsync

    def note(descriptor):
        paths.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", note)
    return paths


@pytest.fixture
def local(tmp_path):
    config = StorageConfig("local", "races", tmp_path / "s3")
    yield open_bucket(config)
    server.stop(config)


def test_a_checkpoint_is_on_the_disk_before_the_pointer_names_it(local, tmp_path, flushed):
    folder = tmp_path / "s3" / "races" / "model-1" / "model"
    before = []

    CheckpointStore(ModelStore(local, "model-1")).save(
        1, 10, b"weights", optimizer=b"moments", on_pointed=lambda: before.extend(flushed)
    )
    local.flush()

    parts = (".safetensors", ".optimizer.safetensors", ".json")
    names = [f"{folder}/1_Step-10.ckpt{part}" for part in parts]
    assert [path for path in before if path in names] == names
    above = [folder, *list(folder.parents)[:3]]
    assert set(map(str, above)) <= set(before)
    assert str(folder / ".coach_checkpoint") in flushed


def test_rollouts_and_activities_are_not_flushed(local, flushed):
    local.put(keys.rollout_part("model-1", 0, 0, "s", 0), b"frames")
    local.put(keys.status("model-1", "trainer"), b"{}")

    local.flush()

    assert not flushed


@pytest.mark.parametrize(("code", "kind"), [(errno.EIO, StorageError), (errno.ENOSPC, DiskFull)])
def test_a_checkpoint_that_the_disk_refuses_is_not_pointed_to(local, monkeypatch, code, kind):
    store = CheckpointStore(ModelStore(local, "model-1"))
    store.save(1, 10, b"weights")
    local.flush()

    def refuse(descriptor):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(kind, match="was written, but"):
        store.save(2, 20, b"weights")

    assert store.pointed().number == 1


def test_a_file_that_is_deleted_meanwhile_and_a_disk_that_cannot_flush_are_no_failures(
    tmp_path, monkeypatch
):
    disk = DiskFlush(tmp_path)
    disk.note("model-1/gone")
    disk.flush()

    def cannot(descriptor):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    (tmp_path / "model-1").mkdir()
    (tmp_path / "model-1" / "there").write_bytes(b"")
    monkeypatch.setattr(os, "fsync", cannot)
    disk.note("model-1/there")
    disk.flush()
