"""The list of tracks is remembered as long as their files stay as they are."""

import sys

import numpy as np
import pytest

from drcli.tracks.track_list import list_tracks
from drsim.track.worlds import known_worlds


@pytest.fixture
def track_file(tmp_path):
    """A round track of the racer's own."""
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    path = tmp_path / "tracks" / "ring.npy"
    path.parent.mkdir()
    np.save(path, np.hstack([3.0 * ring, 2.6 * ring, 3.4 * ring]))
    return path


def test_all_tracks_are_listed_with_their_facts(track_file, tmp_path):
    found = list_tracks(track_file.parent, tmp_path / "memory.json")

    names = [facts.name for facts in found.tracks]
    assert set(names) == {*known_worlds(None), "ring"}
    ring = found.tracks[names.index("ring")]
    assert ring.length_m == pytest.approx(6.0 * np.pi, rel=0.01)


def test_a_second_look_reads_no_track(track_file, tmp_path, monkeypatch):
    memory = tmp_path / "memory.json"
    first = list_tracks(track_file.parent, memory)
    monkeypatch.setitem(sys.modules, "drcli.tracks.tracks_folder", None)

    second = list_tracks(track_file.parent, memory)

    assert second == first


def test_a_changed_file_is_read_again(track_file, tmp_path):
    memory = tmp_path / "memory.json"
    list_tracks(track_file.parent, memory)
    np.save(track_file, 2.0 * np.load(track_file)[:-1:2])

    found = list_tracks(track_file.parent, memory)

    ring = next(facts for facts in found.tracks if facts.name == "ring")
    assert ring.waypoints < 60


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b'{"state": 1, "tracks": 2}'])
def test_a_memory_that_is_damaged_is_made_anew(track_file, tmp_path, content):
    memory = tmp_path / "memory.json"
    memory.write_bytes(content)

    found = list_tracks(track_file.parent, memory)

    assert "ring" in [facts.name for facts in found.tracks]


def test_a_folder_that_may_only_be_read_is_no_failure(track_file, tmp_path):
    (tmp_path / "file").write_text("in the way of a folder")

    found = list_tracks(track_file.parent, tmp_path / "file" / "memory.json")

    assert found.tracks
