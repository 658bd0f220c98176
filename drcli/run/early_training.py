"""Starts the processes of a training while the command still plans it."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from drcli.base import early_process
from drcli.records.job import environment
from drcli.train.early_workers import SANDBOX, SUPERVISOR

if TYPE_CHECKING:
    from drcli.config.settings import Settings


@contextmanager
def begun(settings: "Settings") -> Iterator[None]:
    """Start them, and end those that the `with` block has not given anything to do.

    Not on macOS, whose libraries do not allow a process to divide itself.
    """
    if sys.platform == "linux" and settings.launcher != "ray":
        module = "drcli.train.early_workers"
        early_process.start(
            # -P: a file of the working folder must not replace a module of the same name.
            [
                *(sys.executable, "-P", "-m", "drcli.base.start_module", module),
                str(settings.workers),
            ],
            SUPERVISOR,
            first=SANDBOX,
            env=environment(settings.threads),
            cwd=settings.directory,
        )
    try:
        yield
    finally:
        early_process.dismiss()
