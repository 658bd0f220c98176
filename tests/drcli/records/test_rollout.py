"""Episodes survive the way to bytes and back; anything else is refused."""

import json
import tracemalloc
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load, save

from drcli.base.json_record import RecordError
from drcli.learn.rollout_buffer import Rollout
from drcli.records.rollout import Episodes, decode_episodes, encode_episodes


def played(lengths: list[int], *, first: int = 0, continuous: bool = False) -> Episodes:
    """Episodes of the given lengths with recognisable contents."""
    steps, count = sum(lengths), len(lengths)
    rng = np.random.default_rng(steps)
    actions = rng.random((steps, 2), np.float32) if continuous else rng.integers(0, 9, steps)
    return Episodes(
        Rollout(
            frames=rng.integers(0, 255, (steps, 1, 12, 16), np.uint8),
            actions=actions,
            log_probs=rng.random(steps, np.float32),
            values=rng.random(steps),
            rewards=rng.random(steps),
            lengths=np.array(lengths),
            last_values=rng.random(count),
            cut=rng.random(count) > 0.5,
            scans=rng.random((steps, 3), np.float32),
            states=rng.random((steps, 2), np.float32),
        ),
        numbers=np.arange(first, first + count),
        progress=rng.random(count),
        completed=rng.random(count) > 0.5,
        duration_s=rng.random(count),
    )


def changed(episodes: Episodes, **columns: Any) -> Episodes:
    """The episodes with other columns."""
    own = {name: columns.pop(name) for name in list(columns) if hasattr(episodes, name)}
    return replace(episodes, rollout=replace(episodes.rollout, **columns), **own)


def decoded(data: bytes) -> Episodes:
    """One object by itself, its number of steps taken from its header."""
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]
    return decode_episodes([data], json.loads(header["frames_shape"])[0])


def assert_same(got: Episodes, expected: Episodes) -> None:
    for one, other in ((got.rollout, expected.rollout), (got, expected)):
        for item in fields(one):
            if item.name != "rollout":
                np.testing.assert_array_equal(getattr(one, item.name), getattr(other, item.name))
                assert getattr(one, item.name).dtype == getattr(other, item.name).dtype


@given(st.lists(st.integers(1, 5), min_size=1, max_size=4), st.booleans())
def test_episodes_come_back_as_they_were(lengths, continuous):
    episodes = played(lengths, continuous=continuous)

    assert_same(decoded(encode_episodes(episodes)), episodes)


def test_slices_of_a_larger_buffer_are_packed_right():
    episodes = played([4, 4])
    every_other = changed(
        episodes,
        frames=np.repeat(episodes.rollout.frames, 2, axis=0)[::2],
        rewards=np.repeat(episodes.rollout.rewards, 2)[::2],
    )

    assert_same(decoded(encode_episodes(every_other)), episodes)


def test_episodes_of_a_teacher_travel_without_pictures():
    whole = played([3, 5])
    blind = changed(whole, frames=np.empty((8, 2, 0, 0), np.uint8))

    found = decode_episodes([encode_episodes(blind)] * 2, 16)

    assert found.rollout.frames.shape == (16, 2, 0, 0)
    assert found.rollout.states.tolist() == [*whole.rollout.states.tolist()] * 2
    assert len(encode_episodes(blind)) < len(encode_episodes(whole))


def test_parts_are_joined_in_order():
    parts = [encode_episodes(played([3, 2])), encode_episodes(played([4], first=2))]

    joined = decode_episodes(parts, steps=9)

    assert joined.count == 3
    np.testing.assert_array_equal(joined.numbers, [0, 1, 2])
    np.testing.assert_array_equal(joined.rollout.lengths, [3, 2, 4])
    np.testing.assert_array_equal(joined.rollout.frames[5:], played([4]).rollout.frames)
    assert joined.rollout.frames.flags.writeable  # torch takes no others without a warning


@pytest.mark.parametrize("end", [0, 4, 100, -1])
def test_truncated_bytes_are_refused(end):
    data = encode_episodes(played([3]))

    with pytest.raises(RecordError, match="it does not contain episodes"):
        decode_episodes([data[:end]], 3)


def test_another_schema_is_refused():
    data = encode_episodes(played([3])).replace(b'"schema":"2"', b'"schema":"9"')

    with pytest.raises(RecordError, match="schema 9 instead of 2"):
        decode_episodes([data], 3)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"frames": np.zeros((3, 1, 12, 16), np.float32)}, "frames"),
        ({"actions": np.zeros(3, np.int32)}, "actions"),
        ({"rewards": np.zeros(2, np.float32)}, "rewards has 2 rows"),
        ({"values": np.zeros(3, np.float32)}, "values is float64"),
        ({"log_probs": np.zeros(3)}, "log_probs is float32"),
        ({"lengths": np.array([2])}, "episodes of 2 steps"),
        ({"numbers": np.array([1, 2])}, "numbers has 2 rows for 1 episodes"),
        ({"frames": np.zeros((0, 1, 12, 16), np.uint8)}, "not a single step"),
    ],
)
def test_columns_that_do_not_fit_are_refused(change, complaint):
    with pytest.raises(ValueError, match=complaint):
        changed(played([3]), **change)


def test_an_object_without_one_of_the_columns_is_refused():
    data = encode_episodes(played([3]))
    tensors = load(data)
    del tensors["extra.cut"]
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]

    with pytest.raises(RecordError, match=r"'extra\.cut' is missing"):
        decode_episodes([save(tensors, metadata=header)], 3)


def test_parts_of_different_actions_cannot_be_joined():
    parts = [encode_episodes(played([3])), encode_episodes(played([3], continuous=True))]

    with pytest.raises(RecordError, match="it does not contain episodes"):
        decode_episodes(parts, 6)


def test_parts_with_frames_of_another_size_cannot_be_joined():
    small = changed(played([3]), frames=np.zeros((3, 1, 6, 8), np.uint8))

    with pytest.raises(RecordError, match="frames of shape"):
        decode_episodes([encode_episodes(played([3])), encode_episodes(small)], 6)


@pytest.mark.parametrize("steps", [2, 4])
def test_parts_with_more_or_fewer_steps_than_told_are_refused(steps):
    with pytest.raises(RecordError, match="it does not contain episodes"):
        decode_episodes([encode_episodes(played([3]))], steps)


def test_rewards_of_version_0_1_0_become_doubles():
    data = encode_episodes(played([3]))
    tensors = load(data)
    tensors |= {name: tensors[name].astype(np.float32) for name in ("values", "rewards")}
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]

    rollout = decode_episodes([save(tensors, metadata=header)], 3).rollout

    assert (rollout.values.dtype, rollout.rewards.dtype) == (np.float64, np.float64)


def test_some_episodes_can_be_chosen():
    episodes = played([3, 2, 4])

    chosen = episodes.chosen(np.array([0, 2]))

    np.testing.assert_array_equal(chosen.rollout.lengths, [3, 4])
    np.testing.assert_array_equal(chosen.rollout.frames[3:], episodes.rollout.frames[5:])
    np.testing.assert_array_equal(chosen.progress, episodes.progress[[0, 2]])


def forged(**changes: Any) -> bytes:
    """A rollout whose header or columns claim something else than its bytes hold."""
    data = encode_episodes(played([4, 4]))
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
        with pytest.raises(RecordError, match="it does not contain episodes"):
            decode_episodes([data], 8)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert peak < 20 << 20
