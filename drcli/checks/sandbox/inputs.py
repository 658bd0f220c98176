"""Has worlds and reward function tried in a process of its own, which can be given up."""

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from threading import Event

from drcli.base.problems import Problem
from drcli.checks.check_report import find_tried, forget_tried
from drcli.checks.reward_timeout import WHY, is_stuck, stuck_place
from drcli.exchange.job import Job
from drcli.modelfiles.custom_files import InputFile
from drcli.store import keys

TIMEOUT_S = 60.0
"""How long the trial may take, endless loops included."""

_LAST_WORDS_BYTES = 4_096
"""How much of its complaints is kept: a reward function may complain without end."""

_GLANCE_S = 0.05
"""How often it is looked whether the process has ended."""


def try_inputs(job: Job, reward: InputFile | None, given_up: Event) -> list[Problem]:
    """Load the worlds and try the reward function on them.

    The launcher itself never imports a racer's code.

    Args:
        job: Its settings and folder count.
        reward: The reward function; None loads the worlds only.
        given_up: Once set, the process is ended, and nothing is found.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    forget_tried(job.folder)
    arguments: list[str] = []
    if reward is not None:
        path = job.folder / keys.REWARD_FUNCTION_FILE
        path.write_bytes(reward.data)
        arguments = [str(path), reward.origin]
    code, words = _run(job, arguments, given_up)
    if given_up.is_set():
        return []
    found = find_tried(job.folder)
    if found is not None:
        return found
    if reward is None:
        raise RuntimeError(f"Loading the worlds failed:\n{words}")
    if code is None:
        what = f"Trying the reward function took longer than {TIMEOUT_S:.0f} seconds."
        return [_lost(reward, what, "Look for an endless loop in it.")]
    if is_stuck(code):
        _, line = stuck_place(words)
        what = f"The reward function{f', line {line},' if line else ''} does not return: {WHY}."
        return [_lost(reward, what, "Let that line compute less.")]
    found = try_inputs(job, None, given_up)  # raises where the reward function is not to blame
    if "Traceback" in words:
        why = words.splitlines()[-1]
        what = f"The reward function breaks the process that tried it: {why}."
        return [*found, _lost(reward, what, "Let `dr-reward check` tell what else it does.")]
    what = f"The reward function ended the process that tried it (exit code {code})."
    remedy = "Remove what ends the process, such as os._exit or os.kill."
    return [*found, _lost(reward, what, remedy)]


def _run(job: Job, arguments: list[str], given_up: Event) -> tuple[int | None, str]:
    """Exit code of the trial, None where it had to be ended, and the end of what it wrote."""
    process = job.spawn(
        # -P: files of the working folder must not be taken for modules of that name.
        [sys.executable, "-P", "-m", "drcli.checks.sandbox.inputs_process", *arguments],
        cwd=job.directory,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,  # signals that it sends to its group are for itself
    )
    with process:
        try:
            return _watch(process, given_up)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # and whatever it has started


def _watch(process: "subprocess.Popen[bytes]", given_up: Event) -> tuple[int | None, str]:
    """Wait for its end, for as long as it may take."""
    deadline = time.monotonic() + TIMEOUT_S
    words = b""
    pipe = process.stderr
    assert pipe is not None
    os.set_blocking(pipe.fileno(), False)
    while process.poll() is None and time.monotonic() < deadline and not given_up.is_set():
        if select.select([pipe], [], [], _GLANCE_S)[0]:
            more = pipe.read(_LAST_WORDS_BYTES)
            words = (words + (more or b""))[-_LAST_WORDS_BYTES:]
            if more == b"":  # it has closed its end and goes on
                time.sleep(_GLANCE_S)
    code = process.poll()
    words = (words + (pipe.read(_LAST_WORDS_BYTES) or b""))[-_LAST_WORDS_BYTES:]
    return code, words.decode("utf-8", "replace").strip()


def _lost(reward: InputFile, message: str, remedy: str) -> Problem:
    return Problem("V-21", "error", reward.origin, None, message, remedy)
