"""What worker processes leave behind for whoever started them."""

import os

import pytest

from drcli.exchange.job import LastWords

WORDS = LastWords("The bucket is gone.", "Start it.", 4)


def test_last_words_are_found_until_they_are_forgotten(tmp_path):
    WORDS.leave(tmp_path / "run", "sim-0")

    assert LastWords.find(tmp_path / "run", "sim-0") == WORDS
    assert LastWords.find(tmp_path / "run", "trainer") is None
    LastWords.forget(tmp_path / "run", "sim-0")
    assert LastWords.find(tmp_path / "run", "sim-0") is None


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"message": "half"}'])
def test_words_that_nobody_can_read_are_no_words(tmp_path, content):
    WORDS.leave(tmp_path, "sim-0")
    [path] = tmp_path.iterdir()

    path.write_text(content)

    assert LastWords.find(tmp_path, "sim-0") is None


def test_a_full_disk_keeps_the_failure_itself_from_being_replaced(tmp_path, monkeypatch):
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)

    WORDS.leave(tmp_path, "sim-0")

    assert list(tmp_path.iterdir()) == []
