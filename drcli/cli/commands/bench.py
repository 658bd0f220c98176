"""`dr bench`."""

from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from drcli.base.installation import lazy_imports
from drcli.cli import console
from drcli.cli.views.layout import counted
from drcli.cli.working_folder import working_folder

if TYPE_CHECKING:
    from drcli.checks.bench.machine_benchmark import BenchReport, WorkSpeed

with lazy_imports():
    from drcli.checks.bench import machine_benchmark

# Shows what `dr bench` measured.


_LIMITS = {
    "driving": "driving: more or faster cores would help",
    "learning": "learning: more or faster cores, or a GPU, would help",
    "bucket": "the bucket: one on this machine (DR_CLOUD=local) or nearer would help",
}


def measured(report: "BenchReport") -> RenderableType:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in _machine(report):
        table.add_row(name, text)
    _add_work(table, "shipped files", report.standard)
    if report.own is not None:
        _add_work(table, "your files", report.own)
    if report.own_left_out:
        table.add_row("your files", f"not measured: {report.own_left_out}")
    if report.bucket is not None:
        speed = report.bucket.speed
        table.add_row("bucket", report.bucket.place)
        table.add_row(
            "",
            f"{speed.put_mb_per_s:,.1f} MB/s written, {speed.get_mb_per_s:,.1f} MB/s read, "
            f"{speed.requests_per_s:,.0f} requests/s one after the other "
            f"({speed.request_ms:.1f} ms each)",
        )
    least, median, most = report.first_lap_s
    table.add_row(
        "first lap",
        f"about {median:,.0f} s after the start with the shipped files, {least:,.0f} to "
        f"{most:,.0f} s depending on the seed",
    )
    number = Text.assemble(
        (f"{report.number:,.0f} training steps/s", "bold"),
        ": the number to compare with docs/bench.md",
    )
    return Group(table, number, Text(f"Measured in {report.seconds:.0f} s."))


def _machine(report: "BenchReport") -> list[tuple[str, str]]:
    cores = counted(report.cores, "core")
    if report.usable_cores < report.cores:
        cores = f"{report.usable_cores} of {cores} used"
    if report.threads:
        cores += f" (DR_THREADS={report.threads})"
    if report.priority == "low":
        cores += ", low priority (DR_PRIORITY)"
    free, total = report.free_memory_bytes / 1e9, report.memory_bytes / 1e9
    needed = report.needed_memory_bytes / 1e9
    versions = ", ".join(f"{name} {number}" for name, number in report.versions.items())
    return [
        ("processor", f"{report.processor}, {cores}"),
        ("memory", f"{free:.1f} of {total:.1f} GB free; a training needs about {needed:.1f} GB"),
        ("versions", versions),
    ]


def _add_work(table: Table, title: str, work: "WorkSpeed") -> None:
    ready, rates, estimate = work.ready, work.rates, work.estimate
    table.add_row(title, f"{work.algorithm}, {work.network} on {work.world}, {work.race_type}")
    table.add_row(
        "  simulation",
        f"{rates.simulation_steps_per_s:,.0f} steps/s; with the policy "
        f"{rates.driving_steps_per_s:,.0f} steps/s ({rates.driving_steps_per_core_s:,.0f} per "
        f"second of a core), {ready.cars} cars, {counted(ready.driving_threads, 'thread')}",
    )
    where = "" if ready.device == "cpu" else f" on {ready.device}"
    table.add_row(
        "  learner",
        f"{rates.gradient_steps_per_s:,.1f} gradient steps/s, "
        f"{rates.learning_samples_per_s:,.0f} samples/s "
        f"({rates.learning_samples_per_core_s:,.0f} per second of a core), {ready.number_format}"
        f"{where}, {counted(ready.learning_threads, 'thread')}",
    )
    table.add_row("  memory", f"{rates.memory_bytes / 1e6:,.0f} MB for both in one process")
    table.add_row(
        "  training",
        f"{estimate.training_steps_per_s:,.0f} steps/s; limited by "
        f"{_LIMITS[estimate.limited_by]} ({100 * estimate.limiting_share:.0f} % of the time)",
    )


def bench(
    no_bucket: Annotated[bool, typer.Option("--no-bucket", help="Leave the bucket out.")] = False,
) -> None:
    """Measure how fast this machine trains, in about a minute.

    Measures simulation, learner, memory and bucket, estimates the time to the first lap, says which
    part limits, and gives a number to compare with docs/bench.md. Needs no run.env. With one, it
    measures the bucket and the files of that folder too. The bucket gets at most 32 MB, in objects
    that are deleted again, and nothing is left behind. A running training is not touched, but both
    are slower meanwhile.

    Example: dr-bench
    """
    report = machine_benchmark.measure_machine(
        working_folder(), with_bucket=not no_bucket, on_step=console.say
    )
    console.warn(*report.warnings)
    console.emit(report, measured(report))
