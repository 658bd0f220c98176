"""Work in a process of its own when the console ends: it cleans up, or goes on to its end."""

import threading
import time
from pathlib import Path

import pytest

from drcli.base.clock import wait_until
from drcli.base.errors import WorkerDied
from drcli.web import subprocess_work

SOON_S = 30.0


def work(progress, folder: Path):
    """Wait until a file says that it may go on; leaves a file at its end, and none half-way."""
    half = folder / "half"
    half.write_text("")
    try:
        progress("It has begun.")
        assert wait_until((folder / "go").exists, patience_s=SOON_S, last_s=0.05)
        (folder / "whole").write_text("")
    finally:
        half.unlink()
    return {"ended": time.time()}


def started(folder, *, heavy):
    """The work in a thread; gives the thread and its outcome, once it has begun."""
    outcome, begun = [], threading.Event()

    def run():
        try:
            outcome.append(
                subprocess_work.in_subprocess(lambda _: begun.set(), work, folder, heavy=heavy)
            )
        except WorkerDied as error:
            outcome.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    assert begun.wait(SOON_S)
    return thread, outcome


@pytest.mark.parametrize("heavy", [True, False])
def test_what_computes_ends_with_the_console_and_what_changes_things_goes_on(tmp_path, heavy):
    thread, outcome = started(tmp_path, heavy=heavy)

    subprocess_work.end_heavy()
    if heavy:
        thread.join(SOON_S)
    (tmp_path / "go").write_text("")
    thread.join(SOON_S)

    assert isinstance(outcome[0], WorkerDied) is heavy
    assert (tmp_path / "whole").exists() is not heavy
    assert not (tmp_path / "half").exists()
