"""`dr bench`."""

from typing import Annotated

import typer

from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.show import show
from drcli.cli.working_folder import working_folder

with lazy_imports():
    from drcli.checks.bench import machine_benchmark


def bench(
    no_bucket: Annotated[bool, typer.Option("--no-bucket", help="Leave the bucket out.")] = False,
) -> None:
    """Measure how fast this machine trains, in about a minute.

    Measures simulation, learner, memory and bucket, estimates the time to the first lap, says which
    part limits, and gives a number to compare with `dr docs bench`. Needs no run.env. With one, it
    measures the bucket and the files of that folder too. The bucket gets at most 32 MB, in objects
    that are deleted again, and nothing is left behind. A running training is not touched, but both
    are slower meanwhile.

    Example: dr-bench
    """
    report = machine_benchmark.measure_machine(
        working_folder(), with_bucket=not no_bucket, on_step=terminal.say
    )
    terminal.warn(*report.warnings)
    show(report)
