"""Runs the lessons of docs/lessons as they are written, and checks what each of them promises.

    python scripts/lessons [N ...] [--folder FOLDER] [--seed S] [--json]

A lesson is a page. Its blocks of shell commands are run in their order by one bash, and a block
that follows the words "into `FILE`:" is written to that file. So a lesson is written only once.
The runner changes three things: commands whose result it needs also print it as JSON (`--json`),
DR_TRAIN_SEED is set, and nothing asks (there is no terminal).

With --folder, the working folder of the lessons is made there and kept; lessons that were done in
it need not be run again before a later one. --seed sets the seed of the trainings.

Prints a line for each promise and exits with 1 if one is not kept. With --json the last line of
stdout is one object: for each lesson its promises, and its time in seconds.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from lesson_page import LESSONS, Lesson
from lesson_promises import PROMISES, Results

RACER = "racer"
"""The working folder that the first lesson makes, and all lessons use."""


def main() -> int:
    """Run lessons and check them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("lesson", nargs="*", type=int, default=list(LESSONS), choices=LESSONS)
    parser.add_argument("--folder", type=Path, help="keep the working folder there")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.folder is not None:
        options.folder.mkdir(parents=True, exist_ok=True)
        return run_all(options.lesson, options.folder, options.seed, as_json=options.json)
    with tempfile.TemporaryDirectory() as folder:
        return run_all(options.lesson, Path(folder), options.seed, as_json=options.json)


def run_all(numbers: list[int], folder: Path, seed: int, *, as_json: bool) -> int:
    """Run some lessons in one folder.

    Returns:
        The exit code.
    """
    report: dict[str, Any] = {}
    for number in numbers:
        lesson = Lesson.read(LESSONS[number])
        began_s = time.monotonic()
        results = run(lesson, folder, seed)
        kept = {text: check(results) for text, check in PROMISES[number].items()}
        report[str(number)] = {"promises": kept, "wall_s": round(time.monotonic() - began_s, 1)}
        for text, is_kept in kept.items():
            print(f"lesson {number}: {'kept' if is_kept else 'NOT KEPT'}: {text}", file=sys.stderr)
    if as_json:
        print(json.dumps(report))
    return int(not all(all(each["promises"].values()) for each in report.values()))


def run(lesson: Lesson, folder: Path, seed: int) -> Results:
    """Run one lesson.

    Args:
        lesson: The page.
        folder: In which the lessons make their working folder.
        seed: Of its trainings.

    Returns:
        What its commands printed as JSON.

    Raises:
        SystemExit: A command failed.
    """
    results = (folder / f"results-{lesson.number}").absolute()
    results.mkdir(exist_ok=True)
    for old in results.iterdir():
        old.unlink()
    programs = Path(sys.executable).parent
    environment = {
        **os.environ,
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "DR_TRAIN_SEED": str(seed),
        "RESULTS": str(results),
    }
    if lesson.number > 1 and not (folder / RACER / "run.env").exists():
        subprocess.run(["dr-init", RACER, "-q"], cwd=folder, env=environment, check=True)
    ended = subprocess.run(["bash"], input=lesson.script(), text=True, cwd=folder, env=environment)
    if ended.returncode:
        raise SystemExit(f"Lesson {lesson.number} stopped with exit code {ended.returncode}.")
    return Results.read(results)


if __name__ == "__main__":
    sys.exit(main())
