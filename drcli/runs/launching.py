"""Starts a process of a run, apart from the terminal, its words going to a log; and ends it."""

import subprocess
import sys
from typing import TYPE_CHECKING

from drcli.base import log_files
from drcli.runs.run_logs import log_file

if TYPE_CHECKING:
    from drcli.exchange.job import Job


def start_process(
    job: "Job", name: str, module: str, *arguments: str, gpus: str = ""
) -> "subprocess.Popen[bytes]":
    """Start a module as a process that outlives this one, in a session of its own.

    Args:
        job: What it works on; it gets it through its standard input.
        name: Whose log it writes: "trainer", "supervisor", "sim-0", "evaluation", ...
        module: What is run, as "drcli.workers.trainer".
        arguments: Its command line.
        gpus: Which it may use, as CUDA_VISIBLE_DEVICES has them; empty for those of this process.
    """
    chosen = {"CUDA_VISIBLE_DEVICES": gpus} if gpus else {}
    path = log_file(job.directory, job.config.model.prefix, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab") as log:  # at its end, because several processes may share it
        return job.spawn(
            # -P: files of the working folder must not be taken for modules of that name.
            [sys.executable, "-P", "-m", module, *arguments],
            with_secrets=True,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**chosen, log_files.VARIABLE: str(path)},
            cwd=job.directory,
            start_new_session=True,
        )


def end_process(process: "subprocess.Popen[bytes]", patience_s: float) -> bool:
    """Send a process away and wait until it is gone.

    Args:
        process: A child of this one; it may have ended already.
        patience_s: How long it may take to leave before it is killed.

    Returns:
        Whether it left by itself.
    """
    process.terminate()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True
