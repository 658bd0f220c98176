"""The player's process: started when it is asked, replaced when it was killed, ended when idle."""

import os
import signal
import threading
import time

import pytest

from drcli.base.errors import SettingsError
from drcli.view.playback import player_handle
from drcli.view.playback.player_handle import PlayerBusy, PlayerEnded, PlayerHandle, unpack
from played_model import EVALUATION, working_folder

ECHO = """
import json, os, sys, time
for line in sys.stdin.buffer:
    request = json.loads(line)
    if request["do"] == "die":
        os._exit(3)
    if request["do"] == "sleep":
        open("asked", "w").close()
        time.sleep(60)
    head = b'{"lengths":[]}' if request["do"] != "fail" else (
        b'{"error":{"message":"No.","remedy":"Yes.","code":3},"lengths":[]}')
    data = len(head).to_bytes(4, "big") + head
    sys.stdout.buffer.write(len(data).to_bytes(8, "big") + data)
    sys.stdout.buffer.flush()
"""


@pytest.fixture
def echo(tmp_path, monkeypatch):
    """Makes handles of a process that answers at once."""
    (tmp_path / "echo_player.py").write_text(ECHO)
    monkeypatch.setattr(player_handle, "MODULE", "echo_player")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    made = []

    def make(**options):
        made.append(PlayerHandle(tmp_path, **options))
        return made[-1]

    yield make
    for each in made:
        each.close()


def gone(pid):
    """Whether a process of ours has ended and was waited for."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def until(true, within_s=20.0):
    end_s = time.monotonic() + within_s
    while not true() and time.monotonic() < end_s:
        threading.Event().wait(0.01)
    return true()


def test_a_process_is_started_by_the_first_question_and_ended_by_close(echo):
    handle = echo()

    assert handle.pid is None
    handle.ask({"do": "answer"})
    first = handle.pid
    handle.ask({"do": "answer"})
    assert handle.pid == first
    handle.close()

    assert handle.pid is None
    assert gone(first)


def test_a_killed_process_is_told_in_a_sentence_and_started_again(echo):
    handle = echo()
    handle.ask({"do": "answer"})

    with pytest.raises(PlayerEnded, match="exit code 3") as told:
        handle.ask({"do": "die"})
    assert "Try again" in told.value.remedy
    handle.ask({"do": "answer"})
    killed = handle.pid
    os.kill(killed, signal.SIGKILL)
    assert until(lambda: handle.pid is None)
    handle.ask({"do": "answer"})

    assert handle.pid not in (None, killed)


def test_a_process_that_does_not_answer_is_ended(echo):
    handle = echo(patience_s=0.3)

    with pytest.raises(PlayerEnded, match=r"did not answer within 0\.3 s"):
        handle.ask({"do": "sleep"})
    assert handle.pid is None


def test_an_idle_process_ends(echo):
    handle = echo(idle_s=0.05)
    handle.ask({"do": "answer"})

    assert until(lambda: handle.pid is None)
    handle.ask({"do": "answer"})


def test_an_error_of_the_player_is_an_error_here(echo):
    with pytest.raises(SettingsError, match=r"No\.") as told:
        echo().ask({"do": "fail"})
    assert told.value.remedy == "Yes."


def test_too_many_questions_at_once_are_refused(echo, monkeypatch, tmp_path):
    monkeypatch.setattr(player_handle, "MOST_WAITING", 1)
    handle = echo(patience_s=30.0)
    ended = []

    def sleep():
        with pytest.raises(PlayerEnded, match="SIGKILL"):
            handle.ask({"do": "sleep"})
        ended.append(True)

    busy = threading.Thread(target=sleep)
    busy.start()
    assert until((tmp_path / "asked").exists)

    with pytest.raises(PlayerBusy, match="too much to do"):
        handle.ask({"do": "answer"})
    os.kill(handle.pid, signal.SIGKILL)
    busy.join(20.0)
    assert ended


def test_the_real_process_plays_what_is_in_the_bucket_of_the_folder(tmp_path):
    handle = PlayerHandle(working_folder(tmp_path))

    try:
        named = {"model": "team/m", "trace": EVALUATION}
        facts, _ = unpack(handle.ask({"do": "open", **named}))
        _, pictures = unpack(
            handle.ask({"do": "steps", "episode": 0, "first": 0, "count": 2, **named})
        )
        with pytest.raises(SettingsError, match="no trace of a model"):
            handle.ask({"do": "open", "model": "team/m", "trace": "../../system.env"})
    finally:
        handle.close()

    assert facts["world"] == "reinvent_base"
    assert [each[:2] for each in pictures] == [b"\xff\xd8"] * 2
