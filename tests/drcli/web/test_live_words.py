"""What the live page says about runs, workers and cars."""

from dataclasses import replace

import pytest

from drcli.live.live_feed import LiveWorker
from drcli.live.live_record import (
    FinishedEpisode,
    LiveCar,
    LiveRacer,
    LiveScene,
    LiveState,
    ShownCar,
)
from drcli.records.reward import RewardCounts, RewardErrorEntry
from drcli.run.seen_in_bucket import DistantRun, DistantWorker
from drcli.run.status import CheckpointLaps
from drcli.web.live_words import (
    cards_here,
    distant_words,
    lines_text,
    others_text,
    run_words,
    scene_words,
    state_words,
)


def words_of(report, own_run=0):
    return run_words(report, report.history, own_run)


def test_a_running_training_says_how_far_it_is_and_when_it_ends(make_report):
    words = words_of(make_report(iterations=3, iterations_left=7, money_left=1.5))

    assert words["sentence"] == (
        "The training of model on reinvent_base runs. 3 iterations are done. "
        "In the newest, 2 of 20 episodes completed a clean lap."
    )
    assert words["hint"] == "It stops by itself after 7 iterations, or 1.50 USD more, or earlier."
    assert dict(words["figures"])["Iterations done"] == "3 of 10"


def test_clean_laps_and_their_median_come_before_everything_else(make_report):
    laps = CheckpointLaps(3, 20, 19, 6.1, 6.0, "")

    words = words_of(make_report(iterations=1, newest_laps=laps))

    assert words["figures"][:2] == [
        ("Clean laps", "95 % (19 of 20)"),
        ("Median clean lap", "6.10 s"),
    ]


def test_a_run_of_another_number_says_how_it_is_resumed(make_report):
    words = words_of(make_report("stopped", iterations=1), own_run=4)

    assert words["hint"] == (
        "All 3 evaluation laps are complete. To resume it, set DR_RUN_ID to 0 on the page "
        "“Settings”; it is 4 there."
    )
    assert not words["own"]


def test_without_a_training_there_are_no_figures(make_report):
    assert words_of(make_report("none"))["figures"] == []
    away = words_of(make_report("none", unreachable="The bucket does not answer."))
    assert "or another machine trains it, is unknown" in away["sentence"]
    assert away["hint"] == "The bucket does not answer."


def test_an_error_of_the_reward_function_names_its_line(make_report):
    counts = RewardCounts(10, 4, 0, [RewardErrorEntry("exception", "KeyError", "KeyError: 'x'", 7)])

    [said] = words_of(make_report(reward_errors=counts))["said"]

    assert said["kind"] == "bad"
    assert said["message"] == (
        "The reward function failed in 4 of 10 calls: reward_function.py, line 7: KeyError: 'x'"
    )


def test_commands_are_named_by_what_does_the_same_in_the_page(make_report):
    words = words_of(make_report("lost", remedy="Continue with `dr-start-training --resume`."))

    assert "Continue with “Resume the training” on the page of the model." in words["hint"]


@pytest.mark.parametrize(
    ("changes", "does", "hint"),
    [
        ({"restarts": 2}, "Drives iteration 0.", "it was started again (2 times by now)"),
        ({}, "Drives iteration 0.", "it is just starting"),
        ({"alive": False}, "Does not run; it is started again.", "It has ended before its time."),
    ],
)
def test_a_worker_without_pictures_says_why(make_report, changes, does, hint):
    report = make_report()
    workers = [replace(worker, **changes) for worker in report.workers]

    [card] = cards_here(replace(report, workers=workers), [], lambda *_: None)

    assert (card["name"], card["place"], card["does"]) == ("sim-0", "here", does)
    assert hint in card["hint"]


def test_workers_that_can_be_watched_have_a_car_and_evaluations_come_with_them(make_report):
    watchable = [LiveWorker(0, "sim-0", 1), LiveWorker(0, "evaluation-1", 1), LiveWorker(3, "x", 1)]

    cards = cards_here(make_report(), watchable, lambda _, worker: 2 if worker == "sim-0" else None)

    assert [(each["name"], each["place"], each["car"], each["world"]) for each in cards] == [
        ("sim-0", "live", 2, "reinvent_base"),
        ("evaluation-1", "live", None, None),
    ]


def test_a_training_on_another_machine_is_told_with_its_workers():
    workers = [DistantWorker(name, "drives", 0.0, "gpu-1") for name in ("trainer", "sim-1")]

    words = distant_words(DistantRun("model", "oval", "gpu-1", 4.0, workers=workers))

    assert words["sentence"] == "The training of model runs on gpu-1, last heard from 4 s ago."
    assert words["others"] == "trainer drives."
    [card] = words["cards"]
    assert (card["name"], card["place"], card["world"]) == ("sim-1", "bucket", "oval")
    assert distant_words(DistantRun("model", "oval")) == {}


def test_workers_that_do_not_drive_say_what_they_do(make_report):
    assert others_text(make_report().workers) == "trainer waits for rollouts of iteration 0."


def test_a_worker_that_waits_says_for_how_long(monkeypatch):
    monkeypatch.setattr("drcli.web.live_words.time.time", lambda: 100.0)

    state = LiveState("sim-0", 1, "waits for checkpoint 4", True, 88.0, hint="Prepared.")

    assert state_words(state) == {"does": "Waits for checkpoint 4, for 12 s.", "hint": "Prepared."}


CAR = LiveCar(1, 0, 3, "training", False, 0, 0, 0, 1.5, 2, -20, 42.25, 1, 30.5, "x", 9, 3.2)
SCENE = LiveScene(
    *("oval", False, "TIME_TRIAL", 3, "3_Step-9.ckpt", [LiveRacer("model-1", "Blue")]),
    *([[30.0, 1.0]], [CAR], ShownCar(1, probabilities=[1.0], value=2.5)),
    [FinishedEpisode(1, 8, "training", 0, "", 3, "", "off_track", 1, 40, 3.2, 5.06, 9, 0, 1)],
)


def test_the_car_that_is_looked_at_has_its_figures_in_words():
    words = scene_words(SCENE, "sim-0")

    assert words == {
        "title": "",
        "legend": "1 car, oval, 3_Step-9.",
        "figures": [
            *("1.50 m/s, asked 2.00", "20° right", "42.2 %", "1.000"),
            *("30.5 in 9 steps", "00:03.200"),
        ],
        "actions": ["30°, 1.0 m/s"],
        "policy": "The critic expects a return of 2.50 from here on.",
        "cars": [
            {
                **{"car": 1, "episode": 3, "laps": 0, "x": 0, "y": 0, "yaw": 0},
                **{"color": "c1", "name": "car 2"},
            }
        ],
        "objects": [],
        "finished": ["Training 8: off track, 1 reset, 40 %, 3.20 s, reward 5.1"],
    }


def test_continuous_actions_are_told_with_their_spread():
    shown = ShownCar(1, mean=[5.0, 1.0], low=[1.0, 0.5], high=[9.0, 1.5])

    text = scene_words(replace(SCENE, actions=[], shown=shown), "sim-0")["policy"]

    assert text == "Steering 5.0° (1.0 to 9.0), speed 1.00 m/s (0.50 to 1.50)."


def test_a_race_is_headed_by_its_models_and_says_their_colours():
    racers = [LiveRacer("a", "Blue", (1, 2, 255)), LiveRacer("b", "Red")]
    other = replace(CAR, car=0, racer=1)

    words = scene_words(replace(SCENE, racers=racers, cars=[other, CAR]), "evaluation-1")

    assert (words["title"], words["legend"]) == ("Race of a and b", "a: Blue, b: Red")
    marks = [(each["car"], each["name"], each["color"]) for each in words["cars"]]
    assert marks == [(1, "a", "rgb(1,2,255)"), (0, "b", "c1")]


def test_lines_say_which_iteration_they_are():
    assert lines_text(3) == "Lines: iteration 3, the newest; green where the lap was completed."
    assert lines_text(None) == "The first iteration has not been finished yet."
