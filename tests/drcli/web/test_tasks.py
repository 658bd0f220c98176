"""What was started on the page: its states, refusals and end."""

import threading

import pytest

from drcli.base.errors import SettingsError
from drcli.web.answers import BadRequest
from drcli.web.tasks import MOST_AT_ONCE, MOST_KEPT, MOST_WAITING, Tasks

SOON_S = 20.0


class Board:
    """What a page is shown, and the end of tasks."""

    def __init__(self, kept=None):
        self.shown, self.changed = [], threading.Condition()
        self.tasks = Tasks(self.publish, kept)

    def publish(self, topic, snapshot):
        assert topic == "tasks"
        with self.changed:
            self.shown.append(snapshot)
            self.changed.notify_all()

    def until_ended(self, number):
        with self.changed:
            assert self.changed.wait_for(
                lambda: self.tasks.find(number).ended is not None, timeout=SOON_S
            )
        return self.tasks.find(number)


@pytest.fixture
def board():
    board = Board()
    yield board
    board.tasks.close()


def test_a_task_runs_in_a_thread_says_what_it_does_and_has_a_result(board):
    threads = []

    def work(progress):
        threads.append(threading.current_thread())
        progress("Half of it is done.")
        return {"file": "lap.mp4", "seconds": float("nan")}

    task = board.until_ended(board.tasks.start("video", "model", "Film model", work).id)

    assert (task.state, task.text) == ("done", "Half of it is done.")
    assert task.result == {"file": "lap.mp4", "seconds": None}
    assert task.ended >= task.began
    assert threading.main_thread() not in threads
    assert any('"waiting"' in each.text for each in board.shown)


def test_an_error_of_a_task_is_its_sentence_and_remedy(board):
    def fail(_):
        raise SettingsError("run.env: DR_WORKERS=0 is wrong.", remedy="Write 1.")

    task = board.until_ended(board.tasks.start("start-training", "", "Train", fail).id)

    assert task.state == "failed"
    assert task.text == task.error["message"] == "run.env: DR_WORKERS=0 is wrong."
    assert (task.error["remedy"], task.error["code"]) == ("Write 1.", 3)


def test_a_fault_of_the_program_ends_the_task_and_leads_to_the_log(board, logged):
    task = board.until_ended(board.tasks.start("x", "", "X", lambda _: 1 / 0).id)

    assert task.state == "failed"
    assert "viewer.log" in task.error["remedy"]
    assert "ZeroDivisionError" in logged()


def test_the_same_is_not_started_twice_at_once(board):
    go = threading.Event()
    first = board.tasks.start("evaluate", "model", "Evaluate model", lambda _: go.wait(SOON_S))
    with pytest.raises(BadRequest, match="already under way") as refused:
        board.tasks.start("evaluate", "model", "Evaluate model", lambda _: None)
    other = board.tasks.start("evaluate", "other", "Evaluate other", lambda _: None)
    go.set()

    assert refused.value.status == 409
    board.until_ended(other.id)
    board.until_ended(first.id)
    again = board.tasks.start("evaluate", "model", "Evaluate model", lambda _: None)
    assert board.until_ended(again.id).state == "done"


def test_few_run_at_once_and_too_many_are_refused(board):
    go, running = threading.Event(), []

    def work(_):
        running.append(1)
        go.wait(SOON_S)

    started = [board.tasks.start("x", str(k), "X", work) for k in range(MOST_WAITING)]
    with pytest.raises(BadRequest, match="Too many") as refused:
        board.tasks.start("x", "more", "X", work)
    at_once = len(running)
    go.set()
    for task in started:
        board.until_ended(task.id)

    assert refused.value.status == 429
    assert at_once <= MOST_AT_ONCE
    assert len(running) == MOST_WAITING


def test_the_newest_tasks_are_kept(board):
    for number in range(MOST_KEPT + 20):
        last = board.until_ended(board.tasks.start("x", str(number), "X", lambda _: None).id)

    assert board.tasks.find(last.id).state == "done"
    with pytest.raises(BadRequest, match="no task 1"):
        board.tasks.find(1)
    assert board.tasks.snapshot().text.count('"kind"') <= MOST_KEPT


def test_a_task_is_found_by_its_number(client):
    assert client.get("/api/tasks/1").status_code == 404
    assert client.get("/api/tasks/x").status_code == 404
    assert client.get("/api/tasks/-1").json()["error"]["message"] == "There is no task -1."


def test_the_next_console_tells_which_tasks_the_end_of_one_has_cut_short(tmp_path, logged):
    kept = tmp_path / "tasks.json"
    first = Board(kept)
    ready, end = threading.Semaphore(0), threading.Event()

    def work(_):
        ready.release()
        end.wait(SOON_S)
        raise SettingsError("Its process was ended.", remedy="")

    def drive(_):
        ready.release()
        first.tasks.closing.wait(SOON_S)
        return {"stopped": False}

    first.tasks.start("video", "model", "Film model", work)
    first.tasks.start("evaluate", "model", "Evaluate model", drive, goes_on=True)
    done = first.tasks.start("x", "", "X", lambda _: None)
    first.until_ended(done.id)
    assert ready.acquire(timeout=SOON_S)
    assert ready.acquire(timeout=SOON_S)
    first.tasks.closing.set()
    end.set()
    first.tasks.close()
    with pytest.raises(BadRequest, match="being stopped") as refused:
        first.tasks.start("x", "", "X", lambda _: None)
    assert refused.value.status == 503

    second = Board(kept)
    film, evaluation = second.tasks.find(1), second.tasks.find(2)
    assert (film.title, film.state) == ("Film model", "failed")
    assert film.text == "The console was stopped before this was done."
    assert film.error["remedy"]
    assert "goes on" in evaluation.text
    assert evaluation.ended
    with pytest.raises(BadRequest, match="no task 3"):
        second.tasks.find(3)
    assert "Film model: The console was stopped" in logged()
    second.tasks.close()
    third = Board(kept)
    assert '"tasks":[]' in third.tasks.snapshot().text.replace(" ", "")
    third.tasks.close()


def test_the_end_does_not_wait_long_for_a_task(tmp_path, monkeypatch):
    monkeypatch.setattr("drcli.web.tasks.CLOSING_S", 0.05)
    board, go = Board(tmp_path / "tasks.json"), threading.Event()
    began = threading.Event()

    def work(_):
        began.set()
        go.wait(SOON_S)

    board.tasks.start("x", "", "Long work", work)
    assert began.wait(SOON_S)
    board.tasks.close()
    try:
        assert "Long work" in (tmp_path / "tasks.json").read_text()
    finally:
        go.set()


@pytest.mark.parametrize("content", ["", "{", '{"tasks": 1}', '{"tasks": [{"kind": 1}]}', "[]"])
def test_damaged_notes_of_the_console_before_are_none(tmp_path, content):
    (tmp_path / "tasks.json").write_text(content)

    board = Board(tmp_path / "tasks.json")

    with pytest.raises(BadRequest):
        board.tasks.find(1)
    board.tasks.close()
