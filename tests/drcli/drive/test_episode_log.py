"""One line in the log of a worker for each episode, which log-guru can read past."""

import json
from dataclasses import replace

import pytest

from drcli.base.log import JsonLog
from drcli.drive.driving import log_evaluation, log_training, log_trial
from drcli.records.trace import STEP_S, Episode, Row

ROW = Row(1, 1.0, 2.0, 3.0, 20.0, 1.5, "1", 0.0, False, True, 0.0, 7, "prepare", 0.0, 0.0)


def episode(number=4, status="off_track", progress=45.24):
    end = {"done": True, "status": status, "progress": progress, "reward": 12.5}
    rows = [ROW, replace(ROW, steps=2, time_s=2.5, closest_waypoint=31, crashes=1, **end)]
    return Episode(number, "training", rows)


def test_each_kind_of_episode_has_its_sentence(logged):
    log_training(episode(), iteration=3, worker=1)
    log_evaluation(episode(0, "lap_complete", 100.0), checkpoint=3, worker=0)
    log_trial(episode(0, "lap_complete", 100.0), "team/model")

    assert [line.partition(" INFO ")[2] for line in logged().splitlines()] == [
        "Episode 4 of iteration 3: off track at 45.2 % after 1 steps (2.500 s), reward 12.50.",
        "Evaluation episode 0 of checkpoint 3: lap complete at 100.0 % after 1 steps (2.500 s), "
        "reward 12.50.",
        "Trial 1 of team/model: lap complete at 100.0 % after 1 steps (2.50 s), reward 12.50.",
    ]


def test_a_trial_with_resets_says_so_and_what_they_cost(logged):
    driven = episode(0, "lap_complete", 100.0)
    driven.rows[1:1] = [
        replace(ROW, steps=2, status="off_track", time_s=STEP_S),
        *(replace(ROW, steps=step, status="pause", time_s=step * STEP_S) for step in range(2, 17)),
    ]

    log_trial(driven, "team/model")

    assert "(2.50 s = 1.50 driven + 1.00 penalty, 1 reset), reward" in logged()


@pytest.mark.parametrize("status", ["off_track", "discarded", "immobilized"])
def test_programs_get_the_numbers(tmp_path, status):
    lines = JsonLog(tmp_path / "sim-1.jsonl", 1 << 20, "sim-1")
    log_training(episode(status=status), iteration=3, worker=1)
    lines.end()

    record = json.loads((tmp_path / "sim-1.jsonl").read_text())
    assert record["event"] == "episode"
    assert record["status"] == status
    assert (record["iteration"], record["episode"], record["worker"]) == (3, 4, 1)
    assert (record["progress"], record["steps"], record["duration_s"]) == (45.24, 1, 2.5)
    assert (record["start_waypoint"], record["end_waypoint"], record["crashes"]) == (7, 31, 1)
