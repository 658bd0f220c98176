from dataclasses import replace

import numpy as np
import pytest
import torch

from drcli.learn.policy import PolicySpec
from drcli.learn.replay_buffer import ReplayBuffer, Transitions
from drcli.learn.rollout_buffer import Rollout

SPEC = PolicySpec(2, continuous=True)


def test_each_step_is_drawn_with_what_was_seen_before_and_after_it():
    replay = ReplayBuffer(SPEC, 10)
    replay.add(_rollout([3, 2]))

    drawn = _drawn(replay)

    assert drawn == {(0, 1, 1.0), (1, 2, 1.0), (2, 2, 0.0), (3, 4, 1.0), (4, 4, 0.0)}


def test_actions_and_rewards_belong_to_the_frame_they_were_recorded_with():
    replay = ReplayBuffer(SPEC, 10)
    replay.add(_rollout([3, 2]))

    batch = _sample(replay)

    numbers = _numbers(batch.before.frames)
    np.testing.assert_allclose(batch.returns, numbers / 10.0)
    np.testing.assert_allclose(batch.actions, np.stack([numbers, -numbers], axis=1) / 100.0)


def test_the_last_step_of_an_episode_that_was_cut_is_seen_but_not_learned_from():
    replay = ReplayBuffer(SPEC, 10)
    replay.add(_rollout([3, 2], cut=[True, False]))

    drawn = _drawn(replay)

    assert drawn == {(0, 1, 1.0), (1, 2, 1.0), (3, 4, 1.0), (4, 4, 0.0)}
    assert (replay.steps, replay.transitions) == (5, 4)


def test_whole_episodes_make_room_for_new_ones_and_the_ring_closes():
    replay = ReplayBuffer(SPEC, 7)
    replay.add(_rollout([3, 2]))
    replay.add(_rollout([4], first=5))

    drawn = _drawn(replay)

    # The first three steps would have been six too many; the new episode lies over the ring's end.
    assert drawn == {
        (3, 4, 1.0),
        (4, 4, 0.0),
        (5, 6, 1.0),
        (6, 7, 1.0),
        (7, 8, 1.0),
        (8, 8, 0.0),
    }
    assert replay.steps == 6


def test_of_an_episode_longer_than_the_replay_the_end_is_kept():
    replay = ReplayBuffer(SPEC, 3)
    replay.add(_rollout([2, 5]))

    assert _drawn(replay) == {(4, 5, 1.0), (5, 6, 1.0), (6, 6, 0.0)}


def test_stacked_frames_begin_anew_with_each_episode_also_across_the_rings_end():
    replay = ReplayBuffer(PolicySpec(2, continuous=True, stack=3), 5)
    replay.add(_rollout([3]))
    replay.add(_rollout([4], first=3))

    batch = _sample(replay)

    stacks = {tuple(row) for row in batch.before.frames[:, :, 0, 0].tolist()}
    assert stacks == {(3, 3, 3), (3, 3, 4), (3, 4, 5), (4, 5, 6)}
    following = batch.discounts > 0.0
    np.testing.assert_array_equal(
        batch.after.frames[following, :2], batch.before.frames[following, 1:]
    )


def test_both_eyes_the_lidar_and_the_state_come_with_the_step():
    replay = ReplayBuffer(PolicySpec(2, continuous=True, eyes=2, scan_dims=3, state_dims=4), 10)
    replay.add(_rollout([6], eyes=2, scan_dims=3, state_dims=4))

    batch = _sample(replay)

    numbers = _numbers(batch.before.frames)
    np.testing.assert_array_equal(batch.before.frames[:, 1, 0, 0], numbers + 100)
    np.testing.assert_array_equal(batch.before.scan, numbers[:, None].repeat(3, axis=1))
    np.testing.assert_array_equal(batch.before.state, numbers[:, None].repeat(4, axis=1))


def test_returns_of_three_steps_are_worked_by_hand():
    replay = ReplayBuffer(SPEC, 10, discount_factor=0.5, n_step=3)
    replay.add(_rollout([3, 5], first=1))

    # Step k is rewarded with k / 10. The first episode ends by its rules after three steps, so from
    # its start all of them count and nothing follows.
    assert _returns(replay) == {
        1: (pytest.approx(0.1 + 0.5 * 0.2 + 0.25 * 0.3), None, 0.0),
        2: (pytest.approx(0.2 + 0.5 * 0.3), None, 0.0),
        3: (pytest.approx(0.3), None, 0.0),
        4: (pytest.approx(0.4 + 0.5 * 0.5 + 0.25 * 0.6), 7, 0.125),
        5: (pytest.approx(0.5 + 0.5 * 0.6 + 0.25 * 0.7), 8, 0.125),
        6: (pytest.approx(0.6 + 0.5 * 0.7 + 0.25 * 0.8), None, 0.0),
        7: (pytest.approx(0.7 + 0.5 * 0.8), None, 0.0),
        8: (pytest.approx(0.8), None, 0.0),
    }


def test_returns_before_a_cut_count_fewer_steps_and_go_on_from_the_last_observation():
    replay = ReplayBuffer(SPEC, 10, discount_factor=0.5, n_step=3)
    replay.add(_rollout([4], first=1, cut=[True]))

    assert _returns(replay) == {
        1: (pytest.approx(0.1 + 0.5 * 0.2 + 0.25 * 0.3), 4, 0.125),
        2: (pytest.approx(0.2 + 0.5 * 0.3), 4, 0.25),
        3: (pytest.approx(0.3), 4, 0.5),
    }


def test_returns_cross_the_end_of_the_ring_but_not_the_end_of_an_episode():
    replay = ReplayBuffer(SPEC, 6, discount_factor=0.5, n_step=2)
    replay.add(_rollout([4], first=1))
    replay.add(_rollout([4], first=5))

    assert _returns(replay) == {
        5: (pytest.approx(0.5 + 0.5 * 0.6), 7, 0.25),
        6: (pytest.approx(0.6 + 0.5 * 0.7), 8, 0.25),
        7: (pytest.approx(0.7 + 0.5 * 0.8), None, 0.0),
        8: (pytest.approx(0.8), None, 0.0),
    }


def test_all_steps_have_the_same_chance():
    replay = ReplayBuffer(SPEC, 8)
    replay.add(_rollout([5, 3]))

    counts = np.bincount(_numbers(_sample(replay, 4_000).before.frames))

    np.testing.assert_allclose(counts, np.full(8, 500), atol=100)


def test_equal_seeds_draw_equal_steps():
    replay = ReplayBuffer(SPEC, 8)
    replay.add(_rollout([5, 3]))

    first, second, other = (_numbers(_sample(replay, 20, seed).before.frames) for seed in (1, 1, 2))

    np.testing.assert_array_equal(first, second)
    assert first.tolist() != other.tolist()


def test_a_step_without_a_known_reward_is_neither_drawn_nor_counted():
    rollout = _rollout([6])
    replay = ReplayBuffer(SPEC, 10, discount_factor=0.5, n_step=3)
    known = np.array([True, True, True, False, True, True])

    replay.add(replace(rollout, rewards=np.where(known, rollout.rewards, 1e9), learned=known))

    # Rewards are a tenth of a step's number: 0.1 * 0.5 + 0.2 * 0.25 for the first, and so on.
    assert _returns(replay) == {
        0: (pytest.approx(0.1), 3, 0.125),
        1: (pytest.approx(0.2), 3, 0.25),
        2: (pytest.approx(0.2), 3, 0.5),
        4: (pytest.approx(0.65), None, 0.0),
        5: (pytest.approx(0.5), None, 0.0),
    }


def _rollout(
    lengths: list[int],
    first: int = 0,
    cut: list[bool] | None = None,
    eyes: int = 1,
    scan_dims: int = 0,
    state_dims: int = 0,
) -> Rollout:
    """Steps numbered from `first`; all pixels of a frame are its number, 100 more in the right."""
    n = sum(lengths)
    numbers = np.arange(first, first + n)
    frames = np.empty((n, eyes, 120, 160), np.uint8)
    for eye in range(eyes):
        frames[:, eye] = (numbers + 100 * eye)[:, None, None]
    return Rollout(
        frames,
        np.stack([numbers, -numbers], axis=1).astype(np.float32) / 100.0,
        np.zeros(n, np.float32),
        np.zeros(n, np.float32),
        numbers.astype(np.float32) / 10.0,
        np.array(lengths),
        last_values=np.zeros(len(lengths), np.float32),
        cut=np.array([False] * len(lengths) if cut is None else cut),
        scans=np.tile(numbers[:, None], scan_dims).astype(np.float32),
        states=np.tile(numbers[:, None], state_dims).astype(np.float32),
    )


def _sample(replay: ReplayBuffer, count: int = 100, seed: int = 0) -> Transitions:
    return replay.sample(count, torch.Generator().manual_seed(seed))


def _returns(replay: ReplayBuffer) -> dict[int, tuple[float, int | None, float]]:
    """Return, number of the observation after it (None if none) and its weight, by step."""
    batch = _sample(replay)
    before, after = _numbers(batch.before.frames), _numbers(batch.after.frames)
    rows = zip(before, batch.returns.tolist(), after, batch.discounts.tolist(), strict=True)
    return {
        int(step): (total, int(then) if weight else None, weight)
        for step, total, then, weight in rows
    }


def _numbers(frames: torch.Tensor) -> np.ndarray:
    return frames[:, 0, 0, 0].numpy().astype(np.int64)


def _drawn(replay: ReplayBuffer) -> set[tuple[int, int, float]]:
    """Number of the step, of the one after it, and the weight of its value, of all drawn."""
    batch = _sample(replay)
    before, after = _numbers(batch.before.frames), _numbers(batch.after.frames)
    return set(zip(before.tolist(), after.tolist(), batch.discounts.tolist(), strict=True))
