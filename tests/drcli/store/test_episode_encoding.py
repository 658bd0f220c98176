"""Episodes survive the way to bytes and back; anything else is refused."""

import json
import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load, save

from drcli.store.bucket import ObjectDamaged
from drcli.store.episode_encoding import Episodes, pack_episodes, unpack_episodes, unpack_together


def played(lengths: list[int], *, first: int = 0, continuous: bool = False) -> Episodes:
    """Episodes of the given lengths with recognisable contents."""
    steps = sum(lengths)
    rng = np.random.default_rng(steps)
    actions = rng.random((steps, 2), np.float32) if continuous else rng.integers(0, 9, steps)
    return Episodes(
        frames=rng.integers(0, 255, (steps, 1, 12, 16), np.uint8),
        actions=actions,
        log_probs=rng.random(steps, np.float32),
        values=rng.random(steps),
        rewards=rng.random(steps),
        episode_numbers=np.arange(first, first + len(lengths)),
        episode_lengths=np.array(lengths),
        extras={"last_values": rng.random(len(lengths), np.float32)},
        notes={"world": "reinvent_base"},
    )


def assert_same(got: Episodes, expected: Episodes) -> None:
    for name in ("frames", "actions", "log_probs", "values", "rewards", "episode_numbers"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
        assert getattr(got, name).dtype == getattr(expected, name).dtype
    np.testing.assert_array_equal(got.episode_lengths, expected.episode_lengths)
    assert set(got.extras) == set(expected.extras)
    for name, column in expected.extras.items():
        np.testing.assert_array_equal(got.extras[name], column)
    assert got.notes == expected.notes


@given(st.lists(st.integers(1, 5), min_size=1, max_size=4), st.booleans())
def test_episodes_come_back_as_they_were(lengths, continuous):
    episodes = played(lengths, continuous=continuous)

    assert_same(unpack_episodes(pack_episodes(episodes)), episodes)


def test_slices_of_a_larger_buffer_are_packed_right():
    episodes = played([4, 4])
    every_other = replace(
        episodes,
        frames=np.repeat(episodes.frames, 2, axis=0)[::2],
        rewards=np.repeat(episodes.rewards, 2)[::2],
    )

    assert_same(unpack_episodes(pack_episodes(every_other)), episodes)


def test_parts_are_joined_in_order():
    parts = [pack_episodes(played([3, 2])), pack_episodes(played([4], first=2))]

    joined = unpack_together(parts, steps=9, where=["one", "other"])

    assert joined.count == 3
    np.testing.assert_array_equal(joined.episode_numbers, [0, 1, 2])
    np.testing.assert_array_equal(joined.episode_lengths, [3, 2, 4])
    np.testing.assert_array_equal(joined.frames[5:], played([4]).frames)
    assert joined.frames.flags.writeable  # torch takes no others without a warning


@pytest.mark.parametrize("end", [0, 4, 100, -1])
def test_truncated_bytes_are_refused(end):
    data = pack_episodes(played([3]))

    with pytest.raises(ObjectDamaged, match="bucket/k holds no episodes"):
        unpack_episodes(data[:end], where="bucket/k")


def test_another_schema_is_refused():
    data = pack_episodes(played([3])).replace(b'"schema":"2"', b'"schema":"9"')

    with pytest.raises(ObjectDamaged, match="schema 9 instead of 2"):
        unpack_episodes(data)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"frames": np.zeros((3, 1, 12, 16), np.float32)}, "frames"),
        ({"actions": np.zeros(3, np.int32)}, "actions"),
        ({"rewards": np.zeros(2, np.float32)}, "rewards has 2 rows"),
        ({"values": np.zeros(3, np.float32)}, "values are float64"),
        ({"log_probs": np.zeros(3)}, "log_probs are float32"),
        ({"episode_lengths": np.array([2])}, "Episodes of 2 steps"),
        ({"episode_numbers": np.array([1, 2])}, "one number and one length"),
        ({"frames": np.zeros((0, 1, 12, 16), np.uint8)}, "without a single step"),
    ],
)
def test_columns_that_do_not_fit_are_refused(change, complaint):
    with pytest.raises(ValueError, match=complaint):
        replace(played([3]), **change)


def test_parts_with_different_columns_cannot_be_joined():
    parts = [pack_episodes(played([3])), pack_episodes(replace(played([3]), extras={}))]

    with pytest.raises(ObjectDamaged, match="holds no episodes"):
        unpack_together(parts, steps=6, where=["one", "other"])


def test_parts_with_frames_of_another_size_cannot_be_joined():
    small = replace(played([3]), frames=np.zeros((3, 1, 6, 8), np.uint8))

    with pytest.raises(ObjectDamaged, match="other holds no episodes: frames of shape"):
        unpack_together(
            [pack_episodes(played([3])), pack_episodes(small)], steps=6, where=["one", "other"]
        )


@pytest.mark.parametrize("steps", [2, 4])
def test_parts_with_more_or_fewer_steps_than_told_are_refused(steps):
    with pytest.raises(ObjectDamaged, match="one holds no episodes"):
        unpack_together([pack_episodes(played([3]))], steps=steps, where=["one"])


def test_some_episodes_can_be_chosen():
    episodes = played([3, 2, 4])

    chosen = episodes.chosen(np.array([0, 2]))

    np.testing.assert_array_equal(chosen.episode_lengths, [3, 4])
    np.testing.assert_array_equal(chosen.frames[3:], episodes.frames[5:])
    np.testing.assert_array_equal(
        chosen.extras["last_values"], episodes.extras["last_values"][[0, 2]]
    )


def forged(**changes: Any) -> bytes:
    """A rollout whose header or columns claim something else than its bytes hold."""
    data = pack_episodes(played([4, 4]))
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])["__metadata__"]
    tensors = load(data)
    tensors |= {name: value for name, value in changes.items() if name in tensors}
    header |= {name: value for name, value in changes.items() if name in header}
    return save(tensors, metadata=header)


BOMB = zstandard.ZstdCompressor().compress(bytes(50 << 20))


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(forged(frames_shape="[1000000000, 1, 12, 16]"), id="a billion rows"),
        pytest.param(forged(frames_shape="[8, 1000, 1000, 1000]"), id="huge frames"),
        pytest.param(forged(frames_shape="[-8, 1, -12, 16]"), id="negative rows"),
        pytest.param(forged(frames_shape="[8, 1, 12]"), id="no frames"),
        pytest.param(forged(frames_shape="8"), id="a number"),
        pytest.param(forged(frames_shape="[" * 100_000), id="brackets"),
        pytest.param(forged(frames=np.frombuffer(BOMB, np.uint8)), id="a bomb"),
        pytest.param(
            forged(
                rewards=np.zeros((10**9, 0), np.float32), frames_shape="[1000000000, 1, 12, 16]"
            ),
            id="a billion rows of nothing",
        ),
        pytest.param(b"\xff" * 7 + b"\x00" + b"{}", id="a header of 2**55 bytes"),
        pytest.param(b"", id="nothing"),
    ],
)
def test_a_rollout_that_claims_more_than_it_holds_is_damage_and_takes_no_memory(data):
    tracemalloc.start()
    try:
        with pytest.raises(ObjectDamaged, match="holds no episodes"):
            unpack_episodes(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert peak < 20 << 20
