import numpy as np

from drcli.learn.advantages import explained_variance, gae, normalized


def test_gae_equals_three_steps_worked_by_hand():
    # delta = r + 0.5 * next value - value: 1 + 2 - 2 = 1, 0 + 0 - 4 = -4, 2 + 0 - 0 = 2.
    # A = delta + 0.5 * next A, from the end: 2, -3, -0.5.
    got = gae(_f(1, 0, 2), _f(2, 4, 0), np.array([3]), gamma=0.5, lam=1.0)

    np.testing.assert_allclose(got, [-0.5, -3.0, 2.0])


def test_the_critic_stands_for_what_follows_a_step_without_a_known_reward():
    known = np.array([True, False, True])

    got = gae(_f(1, 1e9, 2), _f(2, 4, 0), np.array([3]), gamma=0.5, lam=1.0, learned=known)

    # 1 + 0.5 * 4 - 2 = 1 before it, nothing for itself, 2 + 0 - 0 = 2 after it.
    np.testing.assert_allclose(got, [1.0, 0.0, 2.0])


def test_lambda_zero_leaves_only_the_temporal_difference():
    got = gae(_f(1, 0, 2), _f(2, 4, 0), np.array([3]), gamma=0.5, lam=0.0)

    np.testing.assert_allclose(got, [1.0, -4.0, 2.0])


def test_nothing_leaks_from_one_episode_into_the_one_before():
    alone = gae(_f(1, 2), _f(3, 4), np.array([2]), gamma=0.9, lam=0.95)

    together = gae(_f(1, 2, 50, 60), _f(3, 4, 70, 80), np.array([2, 2]), gamma=0.9, lam=0.95)

    np.testing.assert_array_equal(together[:2], alone)


def test_the_value_after_the_last_step_is_zero():
    got = gae(_f(5), _f(2), np.array([1]), gamma=0.99, lam=0.95)

    np.testing.assert_allclose(got, [3.0])


def test_normalized_advantages_have_mean_0_and_deviation_1_however_small_they_are():
    got = normalized(np.array([1.0, 2.0, 3.0]) * 1e-12)

    np.testing.assert_allclose(got, np.array([-1.0, 0.0, 1.0]) * np.sqrt(1.5))


def test_advantages_that_differ_by_rounding_only_are_0():
    np.testing.assert_array_equal(normalized(np.array([0.1, 0.1 + 1e-17, 0.1])), [0.0, 0.0, 0.0])


def test_explained_variance_is_1_for_a_perfect_critic_and_0_for_one_that_says_the_mean():
    returns = np.array([1.0, 2.0, 6.0])

    assert explained_variance(returns, returns) == 1.0
    assert explained_variance(np.full(3, 3.0), returns) == 0.0
    assert explained_variance(-returns, returns) < 0.0
    assert np.isnan(explained_variance(returns, np.ones(3)))


def _f(*numbers: float) -> np.ndarray:
    return np.array(numbers, dtype=np.float32)


def test_the_rest_of_a_cut_episode_counts_where_it_is_given():
    rewards, values = np.array([1.0, 2.0], np.float32), np.array([0.5, 0.25], np.float32)

    got = gae(rewards, values, np.array([2]), 0.9, 0.5, np.array([4.0], np.float32))

    last = 2.0 + 0.9 * 4.0 - 0.25
    np.testing.assert_allclose(got, [1.0 + 0.9 * 0.25 - 0.5 + 0.45 * last, last], rtol=1e-6)
