"""The check of a reward function that is being written."""

import subprocess
import sys
from threading import Event

import pytest

from drcli.rewards import live_check
from drcli.rewards.live_check import LiveCheck
from drcli.rewards.sandbox.run_sandbox import _Attempt

GOOD = b'def reward_function(params):\n    return float(params["progress"])\n'


@pytest.fixture(scope="session")
def settings(settings_of):
    return settings_of()


@pytest.fixture(scope="module")
def live(settings, course):
    live = LiveCheck()
    live._courses[live_check._key(settings.race, None)] = course  # driven once for all tests
    yield live
    live.close()


def check(live, settings, text, known="", given_up=None, **options):
    return live.check(settings, text, settings.directory, known, given_up or Event(), **options)


def test_the_first_answer_is_the_picture_of_the_whole_check(live, settings):
    first = check(live, settings, GOOD, whole=False)
    whole = check(live, settings, GOOD, known=first.course.key)

    assert first.more
    assert first.picture.curves == []
    assert first.picture.rewards == whole.picture.rewards
    assert not whole.more


def test_one_process_tries_all_texts_and_none_knows_of_the_others(live, settings):
    check(live, settings, b"import math\nmath.calls = 1\n" + GOOD, whole=False)
    server = live._server

    found = check(live, settings, b"import math\nmath.calls += 1\n" + GOOD)

    assert live._server is server
    assert "AttributeError" in found.problems[0].message


def test_a_text_that_ends_its_process_does_not_end_the_next_one(live, settings):
    ends = b"import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n" + GOOD

    assert check(live, settings, ends, whole=False).picture is None
    assert "SIGKILL" in check(live, settings, ends).problems[0].message
    assert check(live, settings, GOOD, whole=False).picture is not None


def test_lines_of_a_server_that_come_together_are_read_one_by_one():
    child = subprocess.Popen([sys.executable, "-c", "print(7); print(3)"], stdout=subprocess.PIPE)
    with child:
        child.wait()
        assert _Attempt(child).wait(5.0) == 3


def test_a_server_that_has_died_is_replaced(live, settings):
    check(live, settings, GOOD, whole=False)
    dead = live._server
    dead._process.kill()
    dead._process.wait()
    dead._tell(b"x")

    assert check(live, settings, GOOD, whole=False).picture is not None
    assert live._server is not dead


def test_another_file_of_a_track_begins_a_new_process(live, settings):
    check(live, settings, GOOD, whole=False)
    before, kept = live._server, live._served
    live._served = ["of the file before"]

    check(live, settings, GOOD, whole=False)

    assert live._server is not before
    assert live._served == kept


def test_a_text_that_is_given_up_ends_at_once(live, settings):
    given_up = Event()
    given_up.set()
    endless = b"def reward_function(params):\n    while True:\n        pass\n"

    assert check(live, settings, endless, given_up=given_up, whole=False) is None
    assert check(live, settings, GOOD, whole=False).picture is not None


def test_the_picture_has_a_reward_for_each_place(live, settings):
    found = check(live, settings, GOOD)

    places = found.course.rows * found.course.columns
    assert len(found.picture.rewards) == places
    assert len(found.course.edges) == places + found.course.columns
    assert found.report.world == "bean"
    assert [curve.name for curve in found.picture.curves] == [
        driver.name for driver in found.report.drivers
    ]
    steady = found.picture.curves[0]
    assert steady.rewards[-1] > steady.rewards[10]
    assert len(steady.rewards) == len(found.picture.progress)


def test_a_course_that_is_known_is_not_sent_again(live, settings):
    key = live_check._key(settings.race, None)

    found = check(live, settings, b"def reward_function(params):\n    return 1.0\n", known=key)

    assert found.course is None
    assert found.picture.course == key


def test_what_is_no_python_is_not_tried(live, settings):
    found = check(live, settings, b"def reward_function(params)\n    return 1.0\n")

    assert found.report is None
    assert [problem.line for problem in found.problems] == [1]


def test_notes_are_shown_too_behind_what_is_worse(live, settings):
    found = check(
        live,
        settings,
        b"""def reward_function(params):
    if params["is_offtrack"] or not params["all_wheels_on_track"]:
        return 0.0
    return params["speed"]
""",
    )

    assert [problem.rule for problem in found.report.notes] == ["cancels-out"]
    assert found.problems[-1] == found.report.notes[0]


def test_a_check_is_given_up(live, settings):
    given_up = Event()
    given_up.set()

    assert check(live, settings, GOOD, given_up=given_up) is None
