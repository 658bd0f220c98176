"""Episodes are divided by speed, but equally among workers that are about equally fast."""

import pytest

from drcli.train.episode_allocator import divide


@pytest.mark.parametrize(
    ("episodes", "speeds", "most", "expected"),
    [
        (10, [None], 10, [10]),
        (7, [None, None, None], 7, [3, 2, 2]),
        (10, [100.0, 140.0], 10, [5, 5]),
        (20, [200.0, 100.0, 100.0], 20, [10, 5, 5]),
        (10, [100.0, 100.0, 10.0], 10, [5, 5, 0]),
        (20, [100.0, 100.0, None, 20.0], 20, [7, 6, 6, 1]),
        (3, [None] * 5, 3, [1, 1, 1, 0, 0]),
        (10, [300.0, 100.0], 5, [5, 5]),
        (10, [1000.0, 10.0, 10.0], 6, [6, 2, 2]),
        (4, [], 4, []),
    ],
)
def test_the_shares_follow_the_speeds(episodes, speeds, most, expected):
    assert divide(episodes, speeds, most) == expected


def test_all_episodes_are_driven_by_somebody_and_nobody_gets_too_many():
    for episodes in range(1, 41):
        for workers in range(1, 9):
            for slowest in (1.0, 3.0, 50.0):
                speeds = [100.0 / (1.0 if k % 2 else slowest) for k in range(workers)]
                most = -(-episodes // max(1, workers // 2))
                counts = divide(episodes, speeds, most)

                assert sum(counts) == episodes
                assert min(counts) >= 0
                assert max(counts) <= most
