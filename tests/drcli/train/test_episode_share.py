"""Numbers and starts of episodes stay apart when stages drive different numbers of them."""

from drcli.train.episode_share import Share


def test_no_two_episodes_of_a_training_with_stages_have_the_same_number():
    few, many = Share(0, 1, 4, numbered=6), Share(0, 1, 6, numbered=6)
    numbers = [n for k in range(4) for n in (few if k % 2 else many).numbers(k)]

    assert len(numbers) == len(set(numbers)) == 20
    assert numbers == sorted(numbers)


def test_the_starts_of_a_stage_leave_no_gap():
    share = Share(0, 1, 4, numbered=6)
    places = [share.position(n) for k in range(3) for n in share.numbers(k)]

    assert places == list(range(12))


def test_the_workers_of_a_stage_share_all_starts():
    shares = [Share(k, 2, 5, numbered=7) for k in range(2)]
    places = [s.position(n) for s in shares for k in range(2) for n in s.numbers(k)]

    assert len(places) == len(set(places)) == 10


def test_without_stages_everything_is_numbered_as_ever():
    share = Share(1, 3, 7)

    assert share.numbers(2) == range(4, 6)
    assert share.position(4) == 13
