"""Live pictures take their share of the time, and no more: rates fall first."""

import pytest

from drcli.live import live_server
from drcli.live.live_server import BUDGET_SHARE, FASTEST_S, SAVED_S, SLOWEST_S, Pace, WorkTime


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def spent(costs, seconds, worked=1.0):
    """Processor time that views of these costs take, and how often each is shown."""
    clock = Clock()
    pace = Pace(lambda: worked * clock.now_s, clock)
    counts, total_s = dict.fromkeys(costs, 0), 0.0
    for _ in range(round(seconds / 0.01)):
        clock.now_s += 0.01
        for view in [view for view, pause_s in pace.pauses_s(costs).items() if not pause_s]:
            counts[view] += 1
            total_s += costs[view]
            pace.spend(costs[view])
            pace.shown([view])
    return total_s, counts


def test_cheap_views_come_ten_times_a_second():
    _, counts = spent({"camera": 0.0004, "scene": 0.0006}, 60.0)

    assert counts == {"camera": pytest.approx(600, abs=60), "scene": pytest.approx(600, abs=60)}


@pytest.mark.parametrize("chase_s", [0.005, 0.02, 0.1])
def test_expensive_views_take_no_more_than_the_budget(chase_s):
    total_s, counts = spent({"camera": 0.0005, "scene": 0.001, "chase": chase_s}, 200.0)

    assert total_s <= BUDGET_SHARE * (200.0 + SAVED_S) + 2 * chase_s
    assert counts["chase"] * chase_s >= 0.2 * total_s
    assert counts["camera"] > counts["chase"]


def test_a_worker_that_gets_less_of_the_processor_shows_less():
    alone_s, _ = spent({"chase": 0.02}, 200.0)
    beside_others_s, _ = spent({"chase": 0.02}, 200.0, worked=0.5)

    assert beside_others_s < 0.7 * alone_s


def test_time_in_which_nothing_drove_is_saved_but_not_for_ever():
    clock = Clock()
    pace = Pace(clock, clock)
    pace.spend(1e6)
    assert pace.interval_s("chase") == SLOWEST_S["chase"]

    clock.now_s += 1e7
    pace.pauses_s(["chase"])

    assert pace.interval_s("chase") == FASTEST_S
    pace.spend(BUDGET_SHARE * SAVED_S)
    assert pace.interval_s("chase") == SLOWEST_S["chase"]


def test_waiting_counts_as_wall_time_and_driving_as_processor_time(monkeypatch):
    times = {"wall": 0.0, "processor": 0.0}
    monkeypatch.setattr(live_server, "monotonic", lambda: times["wall"])
    monkeypatch.setattr(live_server, "process_time", lambda: times["processor"])
    waits = False
    work = WorkTime(lambda: waits)

    times |= {"wall": 10.0, "processor": 4.0}
    assert work() == 4.0
    times |= {"wall": 20.0, "processor": 24.0}  # on two cores
    assert work() == 14.0
    waits = True
    times |= {"wall": 30.0, "processor": 24.0}
    assert work() == 24.0
