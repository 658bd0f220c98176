"""Reward functions that are checked while they are typed."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drcli.base.errors import WorkerDied
from drcli.config.new_folder import plan_folder, write
from drcli.web import reward_routes
from drcli.web.reward_routes import RewardChecks

WRONG = "def reward_function(params):\n    return 1.0 +\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("racer")
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name in os.environ if name.startswith("DR_")]:
            patch.delenv(name)
        write(plan_folder(folder, {}))
        yield folder


@pytest.fixture(scope="module")
def checks(folder: Path) -> Iterator[RewardChecks]:
    checks = RewardChecks(folder)
    yield checks
    checks.close()


def in_thread(call: Callable[[], Any], results: list[Any]) -> threading.Thread:
    thread = threading.Thread(target=lambda: results.append(call()), daemon=True)
    thread.start()
    return thread


def test_a_line_that_is_no_python_is_told_with_its_number(checks):
    found = checks.check("a", WRONG, "")["problems"]

    assert [(each["line"], each["severity"]) for each in found] == [(2, "error")]
    assert found[0]["file"] == "custom_files/reward_function.py"


def test_only_the_newest_request_of_a_page_counts(checks):
    results: list[tuple[str, Any]] = []

    def checked(page):
        return page, checks.check(page, WRONG, "")

    checks._is_checking = True
    threads = []
    for page in ("b", *["a"] * (reward_routes.MOST_WAITING + 2)):
        asked = len(threads)
        threads.append(in_thread(partial(checked, page), results))
        # Only the newest of each page waits: the others are answered at once.
        until(lambda asked=asked: checks._waiting + len(results) > asked)
    until(lambda: checks._waiting == 2)
    with checks._turns:
        checks._is_checking = False
        checks._turns.notify_all()
    for thread in threads:
        thread.join()

    answered = [page for page, answer in results if "problems" in answer]
    assert sorted(answered) == ["a", "b"]
    assert len(results) == len(threads)


def test_too_many_requests_are_refused(checks, monkeypatch):
    monkeypatch.setattr(reward_routes, "MOST_WAITING", 0)

    with pytest.raises(Exception, match="Too many checks wait"):
        checks.check("a", WRONG, "")


def test_after_its_end_the_process_is_started_again(checks):
    checks.check("a", WRONG, "")
    process = checks._process
    process.kill()
    process.wait()

    assert checks.check("a", WRONG, "")["problems"]
    assert checks._process.pid != process.pid


def test_a_process_that_does_not_answer_is_ended(folder, monkeypatch):
    monkeypatch.setattr(reward_routes, "PATIENCE_S", 0.01)
    checks = RewardChecks(folder)

    with pytest.raises(WorkerDied, match="did not end"):
        checks.check("a", WRONG, "")

    assert checks._process is None


def test_a_check_that_waits_when_the_console_ends_starts_no_process(folder):
    checks = RewardChecks(folder)
    checks._is_checking = True
    errors: list[Any] = []
    waiting = in_thread(partial(pytest.raises, WorkerDied, checks.check, "a", WRONG, ""), errors)
    until(lambda: checks._waiting == 1)

    checks.close()
    with checks._turns:
        checks._is_checking = False
        checks._turns.notify_all()
    waiting.join()

    assert "console has ended" in str(errors[0].value)
    assert checks._process is None


def test_settings_that_are_wrong_are_told(checks, folder):
    path = folder / "run.env"
    before = path.read_text()
    path.write_text(before + "DR_RACE_TYPE=SLALOM\n")
    try:
        answer = checks.check("a", WRONG, "")
    finally:
        path.write_text(before)

    assert "DR_RACE_TYPE=SLALOM" in answer["error"]["message"]


def until(holds: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 20.0
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.005)
