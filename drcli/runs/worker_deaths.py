"""Decides when a worker that dies again and again ends the run."""

import signal

from drcli.base.errors import StorageError, WorkerDied
from drcli.base.installation import installation_error
from drcli.exchange.job import WorkerExit
from drcli.runs.outcome import Outcome
from drcli.runs.worker_processes import Child

CRASHES: dict[int, str] = {
    signal.SIGSEGV: "a memory fault (signal SIGSEGV)",
    signal.SIGBUS: "a memory fault (signal SIGBUS)",
    signal.SIGILL: "an unknown instruction (signal SIGILL)",
    signal.SIGFPE: "an arithmetic fault (signal SIGFPE)",
    signal.SIGABRT: "an abort (signal SIGABRT)",
}
CRASH_S = 600.0
"""Until it reaches the same place."""

QUICK_DEATH_S = 20.0
MAX_QUICK_DEATHS = 3
MAX_QUICK_KILLS = 25


def died_too_often(
    child: Child, code: int, lived_s: float, words: WorkerExit | None
) -> Outcome | None:
    crash = CRASHES.get(-code)
    quick = lived_s < (QUICK_DEATH_S if crash is None else CRASH_S)
    child.quick_deaths = child.quick_deaths + 1 if quick else 0
    lost = words is not None and words.lost
    own_fault = (code > 0 or crash is not None) and not lost
    if child.quick_deaths <= (MAX_QUICK_DEATHS if own_fault else MAX_QUICK_KILLS):
        return None
    died = f"{child.name} died {child.quick_deaths} times in a row:"
    if words is None:
        if broken := installation_error():
            return Outcome(broken.code, f"{died} {broken}", broken.remedy)
        remedy = f"Read the reason with `dr-logs {child.name}`."
        return Outcome(WorkerDied.code, f"{died} {crash or f'exit code {code}'}.", remedy)
    exit_code = words.code if words.code == StorageError.code else WorkerDied.code
    return Outcome(exit_code, f"{died} {words.message}", words.remedy)
