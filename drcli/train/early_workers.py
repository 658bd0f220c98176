"""The supervisor of a training that is still being planned, and its workers.

Run as `python -m drcli.train.early_workers WORKERS DESCRIPTOR`. Before it knows of any secret, it
loads what they have in common, and divides off the process that tries the reward function, the
trainer, and so many simulation workers. It becomes the supervisor when it is told what to train.
"""

import sys
from contextlib import suppress

from drcli.base import early_process

SANDBOX = "drcli.rewards.sandbox.sandbox_process"
SUPERVISOR = "drcli.run.training"
TRAINER, SIMULATION = "drcli.train.trainer", "drcli.train.sim"

COMMON = ("torch", "drcli.convert.build_network", "drcli.workers.worker_process")


def main(workers: int, descriptor: int) -> None:
    """Load, divide, and obey."""
    early_process.load(SANDBOX)
    with suppress(Exception):  # what imports it again says why
        from drsim import jit

        jit.get_ready()
    early_process.divide_off(descriptor)
    early_process.load(*COMMON)
    with suppress(Exception):
        from drcli.bucket import endpoint

        endpoint.get_ready()
    for _ in range(workers):
        early_process.divide(SIMULATION)
    early_process.divide(TRAINER)
    early_process.load(SUPERVISOR)
    early_process.obey()


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
