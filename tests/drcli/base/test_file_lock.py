"""A folder or a lock file is used by one command at a time."""

import threading

import pytest

from drcli.base import errors, files
from drcli.base.errors import SettingsError, StorageError
from drcli.base.files import exclusive, only_writer, rewrite


def test_writers_of_one_folder_take_turns(tmp_path):
    path = tmp_path / "run.env"
    path.write_bytes(b"0")

    def count_up() -> None:
        for _ in range(25):
            with only_writer(tmp_path):
                rewrite(path, str(int(path.read_bytes()) + 1).encode())

    threads = [threading.Thread(target=count_up) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert path.read_bytes() == b"100"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("quiet_s", [-1.0, 1.0], ids=["long", "short"])
def test_a_long_wait_says_what_it_waits_for_and_ends(tmp_path, monkeypatch, quiet_s):
    said = []
    monkeypatch.setattr(errors, "show", said.append)
    monkeypatch.setattr(errors, "QUIET_S", quiet_s)
    monkeypatch.setattr(files, "PATIENCE_S", 0.0)

    with (
        only_writer(tmp_path),
        pytest.raises(SettingsError, match="Another command has been using") as refusal,
        only_writer(tmp_path),
    ):
        pass

    assert str(tmp_path) in str(refusal.value)
    waits = f"Waiting for another command that is using the folder {tmp_path} ..."
    assert said == [waits] * (quiet_s < 0.0)


def test_a_folder_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(SettingsError, match="gone: cannot be read"), only_writer(tmp_path / "gone"):
        pass


def test_a_lock_file_is_made_and_held_by_one(tmp_path):
    path = tmp_path / "lock"

    with (
        exclusive(path, patience_s=0.0),
        pytest.raises(StorageError, match="using the local S3 server"),
        exclusive(path, patience_s=0.0),
    ):
        pass
    with exclusive(path, patience_s=0.0):
        pass
