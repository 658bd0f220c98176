"""Trains while faults happen, and audits what comes of it; see docs/faults.md.

python scripts/faults [--faults N] [--seed N] [--replay FILE] [--shrink] [--bar NAME]
                      [--crash-points] [--takeovers N] [--power-cuts N] [--workers N]
                      [--folder PATH]
"""

import argparse
import collections
import shutil
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "faults"))

from fault_run import LAST_ITERATIONS, FaultRun, Verdict
from fault_schedule import KINDS, Fault, crash_points, parse, random_schedule, text_of
from fault_shrink import shrink
from fault_takeovers import TakeoverRun
from power_cut import PowerCuts, why_not

FAULTS = 20
"""About three minutes on two cores that have nothing else to do."""

BARS = {
    "away": ("3 refuse for_s=300", LAST_ITERATIONS),
    "silent": ("3 silence for_s=300", LAST_ITERATIONS),
    "slow": ("3 slow latency_s=3 for_s=300", 6),
    "errors": ("3 errors code=internal share=0.3 for_s=300", 150),
}
"""Schedules with one long fault, and the iterations after it begins."""


def main() -> None:
    """Run what the arguments say; the exit code is 1 if the auditor found something."""
    parser = argparse.ArgumentParser(prog="scripts/faults", description=__doc__)
    parser.add_argument("--faults", type=int, default=FAULTS, help="how many random faults")
    parser.add_argument("--seed", type=int, default=1, help="chooses them")
    parser.add_argument("--kinds", default=",".join(KINDS), help="only these, with commas")
    parser.add_argument("--replay", type=Path, help="a file with a schedule, instead of chance")
    parser.add_argument("--bar", choices=BARS, help="one long fault of the network, instead")
    parser.add_argument(
        "--crash-points", action="store_true", help="kill each writer around each write, instead"
    )
    parser.add_argument("--takeovers", type=int, help="two machines on one model, so many times")
    parser.add_argument(
        "--power-cuts", type=int, help="so many of them, with the files of defaults/ (needs root)"
    )
    parser.add_argument("--shrink", action="store_true", help="shorten the schedule if it fails")
    parser.add_argument("--workers", type=int, default=2, help="simulation workers")
    parser.add_argument("--folder", type=Path, help="where; must not exist, and is kept")
    options = parser.parse_args()

    folder = options.folder or Path(tempfile.mkdtemp(prefix="drcli-faults-")) / "run"
    if options.takeovers is not None:
        result = TakeoverRun(folder, options.seed, options.takeovers, tell=_tell).run()
        print(
            f"{result.count} takeovers in {result.took_s:.0f} s, {result.iterations} iterations. "
            f"Two owners for at most {result.longest_s:.1f} s; {result.late_writes} late writes, "
            f"the latest began {result.latest_s:.1f} s after the takeover."
        )
        findings = result.findings
    elif options.power_cuts is not None:
        findings = _cut_power(folder, options)
    else:
        schedule, last = _schedule(options)
        print(f"# seed {options.seed}, {len(schedule)} faults\n{text_of(schedule)}")
        verdict = _run(folder, schedule, last, options)
        _show(verdict)
        findings = verdict.findings
        if findings and options.shrink:
            _shrink(folder, schedule, last, options)
    for finding in findings:
        print(f"\nFINDING: {finding}")
    if options.folder is None and not findings:
        shutil.rmtree(folder.parent, ignore_errors=True)
    sys.exit(bool(findings))


def _cut_power(folder: Path, options: argparse.Namespace) -> list[str]:
    """What is wrong after power cuts at random moments."""
    if why_not():
        return [f"A power cut cannot be tried here: {why_not()}."]
    trial = PowerCuts(folder, options.seed, shipped=True, workers=options.workers, tell=_tell)
    try:
        cuts = trial.run(options.power_cuts)
        findings = [sentence for cut in cuts for sentence in cut.findings] + trial.audit()
    finally:
        trial.close()
    lost = collections.Counter(cut.open - cut.left for cut in cuts)
    print(
        f"{len(cuts)} power cuts. Lost besides the open iteration: "
        + ", ".join(f"{count} times {n}" for n, count in sorted(lost.items()))
        + f" iterations. {sum(bool(cut.empty) for cut in cuts)} cuts left an empty object."
    )
    return findings


def _schedule(options: argparse.Namespace) -> tuple[list[Fault], int]:
    """The faults, and how many iterations come after the last."""
    if options.replay is not None:
        return parse(options.replay.read_text()), LAST_ITERATIONS
    if options.crash_points:
        return crash_points(), LAST_ITERATIONS
    if options.bar is not None:
        text, last = BARS[options.bar]
        return parse(text), last
    kinds = options.kinds.split(",")
    return random_schedule(options.seed, options.faults, kinds=kinds), LAST_ITERATIONS


def _run(folder: Path, schedule: list[Fault], last: int, options: argparse.Namespace) -> Verdict:
    return FaultRun(
        folder,
        schedule,
        workers=options.workers,
        last_iterations=last,
        seed=options.seed,
        tell=_tell,
    ).run()


def _shrink(folder: Path, schedule: list[Fault], last: int, options: argparse.Namespace) -> None:
    """Print the shortest part of the schedule that fails too."""
    tries = 0

    def fails(some: list[Fault]) -> bool:
        nonlocal tries
        tries += 1
        place = folder.with_name(f"{folder.name}-shrink-{tries}")
        findings = _run(place, some, last, options).findings
        shutil.rmtree(place, ignore_errors=True)
        return bool(findings)

    shortest = shrink(schedule, fails)
    print(f"\n# fails too, after {tries} tries\n{text_of(shortest)}")


def _show(verdict: Verdict) -> None:
    injected = ", ".join(f"{kind} {n}" for kind, n in sorted(verdict.injected.items()))
    print(
        f"\n{sum(verdict.injected.values())} faults ({injected}) in {verdict.took_s:.0f} s; "
        f"{verdict.iterations} iterations, {verdict.starts} starts, at most "
        f"{verdict.longest_s:.0f} s with neither progress nor a lasting fault; "
        f"{len(verdict.findings)} findings."
    )
    if len(verdict.schedule) == 1:
        said = collections.Counter(line.split(" ", 1)[0] for line in verdict.said)
        print(f"Lines about the bucket by log: {dict(said)}")
        print("".join(f"    {line}\n" for line in verdict.said[:40]))
    for reason in verdict.skipped:
        print(f"skipped: {reason}")


def _tell(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    main()
