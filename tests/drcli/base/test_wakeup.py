"""One process ends the pause of another."""

import subprocess
import sys
import threading
import time

import pytest

from drcli.base.processes import Wakeup, wake

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="wake-ups are for Linux only")

LONG_S = 60.0


@pytest.fixture
def sleeper(tmp_path):
    wakeup = Wakeup(tmp_path, "trainer")
    yield wakeup
    wakeup.close()


def test_another_process_ends_a_pause(tmp_path, sleeper):
    program = "import sys; from pathlib import Path; from drcli.base.processes import wake; "
    program += "wake(Path(sys.argv[1]), 'sim-0', 'trainer')"
    with subprocess.Popen([sys.executable, "-c", program, tmp_path]) as other:
        began_s = time.monotonic()
        assert sleeper.pause(LONG_S)
        assert time.monotonic() - began_s < LONG_S / 2
    assert other.returncode == 0


def test_a_pause_without_a_wake_up_lasts_as_long_as_it_should(sleeper):
    began_s = time.monotonic()
    assert not sleeper.pause(0.05)
    assert time.monotonic() - began_s >= 0.04


def test_wake_ups_of_before_end_one_pause_only(tmp_path, sleeper):
    for _ in range(5):
        wake(tmp_path, "trainer")
    assert sleeper.pause(LONG_S)
    assert not sleeper.pause(0.0)


def test_more_wake_ups_than_the_queue_holds_block_nobody(tmp_path, sleeper):
    def wake_often():
        for _ in range(2_000):
            wake(tmp_path, "trainer")

    thread = threading.Thread(target=wake_often)
    thread.start()
    thread.join(LONG_S)
    assert not thread.is_alive()
    assert sleeper.pause(LONG_S)


def test_other_names_and_folders_are_left_alone(tmp_path, sleeper):
    wake(tmp_path, "sim-0")
    wake(tmp_path / "other", "trainer")
    assert not sleeper.pause(0.0)


def test_a_name_that_is_taken_leaves_a_pause_that_only_waits(tmp_path, sleeper):
    second = Wakeup(tmp_path, "trainer")
    assert sleeper.works
    assert not second.works
    assert not second.pause(0.0)
    second.close()


def test_a_closed_name_can_be_taken_again(tmp_path):
    Wakeup(tmp_path, "trainer").close()
    again = Wakeup(tmp_path, "trainer")
    assert again.works
    wake(tmp_path, "trainer")
    assert again.pause(LONG_S)
    again.close()
