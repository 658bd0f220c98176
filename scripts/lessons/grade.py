"""Marks the submissions of a course project, as docs/course-project.md says.

    python scripts/lessons/grade.py SUBMISSIONS --announced TRACK,... --hidden TRACK,...
                                    [--laps 20] [--seed 0] [--tracks-folder DIR] [-o marks.csv] [-f]

SUBMISSIONS holds a folder for each submission, with reward_function.py, model_metadata.json,
hyperparameters.json and one archive of the model. Every submission is examined by `dr validate`,
imported by `dr import` and driven by `dr evaluate`, in a working folder that is removed afterwards.
One that is incomplete, wrong or cannot be driven gets no marks, and the reason in the last column.
Nothing of a submission is trained, and settings of the shell (DR_...) do not count.
"""

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

FILES = ("reward_function.py", "model_metadata.json", "hyperparameters.json")
ARCHIVES = (".tar.gz", ".tgz", ".tar.bz2", ".tar.xz", ".tar", ".zip")

FOR_FILES, FOR_ANNOUNCED, FOR_HIDDEN, FOR_PACE = 10, 20, 20, 10
"""Marks; the other 40 of 100 are given by people."""

SLOW_MPS, FAST_MPS = 1.0, 2.5
"""Mean speeds of the median clean lap that get no marks and all marks for pace."""

LIMIT_S = 600
"""For each command."""

Dr = Callable[..., tuple[dict[str, Any], str]]
"""Runs `dr` with words: what it tells as JSON, and why it failed or an empty text."""


@dataclass(frozen=True)
class Course:
    """What submissions are driven on; lengths in metres."""

    announced: dict[str, float]
    hidden: dict[str, float]
    laps: int
    seed: int

    @property
    def tracks(self) -> list[str]:
        return [*self.announced, *self.hidden]


@dataclass(frozen=True)
class Marks:
    """A row of the table; `clean` are shares of clean laps by track."""

    submission: str
    files: float = 0.0
    announced: float = 0.0
    hidden: float = 0.0
    pace: float = 0.0
    clean: dict[str, float] = field(default_factory=dict)
    note: str = ""

    @property
    def total(self) -> float:
        return self.files + self.announced + self.hidden + self.pace


def main() -> int:
    """Mark all submissions of a folder; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("submissions", type=Path, help="folder with a folder for each submission")
    parser.add_argument("--announced", required=True, help="tracks that the sheet names")
    parser.add_argument("--hidden", required=True, help="tracks that it does not name")
    parser.add_argument("--laps", type=int, default=20, help="laps on each track, 1 to 1000")
    parser.add_argument("--seed", type=int, default=0, help="of the places where laps start")
    parser.add_argument("--tracks-folder", type=Path, help="folder with more tracks (.npy)")
    parser.add_argument("-o", "--out", type=Path, default=Path("marks.csv"))
    parser.add_argument("-f", "--force", action="store_true", help="replace a table that exists")
    options = parser.parse_args()
    if not options.submissions.is_dir():
        parser.error(f"{options.submissions} is not a folder.")
    if options.out.exists() and not options.force:
        parser.error(
            f"{options.out} exists already: name another file with -o, or replace it (-f)."
        )
    if not 1 <= options.laps <= 1000:
        parser.error(f"--laps {options.laps} is not between 1 and 1000.")
    announced, hidden = (_names(text) for text in (options.announced, options.hidden))
    if both := set(announced) & set(hidden):
        parser.error(f"{min(both)} is announced and hidden.")
    with tempfile.TemporaryDirectory() as work:
        dr = partial(run_dr, Path(work), options.tracks_folder)
        _, reason = dr("init", ".", "--world", announced[0], "--prefix", "submission")
        lengths = {}
        for track in [*announced, *hidden]:
            told, failed = dr("tracks", "show", track)
            reason = reason or failed
            lengths[track] = told.get("facts", {}).get("length_m", 0.0)
        if not reason:
            _, reason = dr("validate")
        if reason:
            parser.error(reason)
        course = Course(
            {track: lengths[track] for track in announced},
            {track: lengths[track] for track in hidden},
            options.laps,
            options.seed,
        )
        table = []
        try:
            for path in sorted(options.submissions.iterdir()):
                if not path.name.startswith("."):
                    table.append(grade(path.absolute(), Path(work), course, dr))
                    print(f"{path.name}: {table[-1].total:.1f} {table[-1].note}", file=sys.stderr)
        finally:
            dr("stop-all")
    write(options.out, table, course)
    return 0


def grade(submission: Path, work: Path, course: Course, dr: Dr) -> Marks:
    """The marks of a submission, examined and driven in the working folder `work`."""
    try:
        rows = drive(submission, work, course, dr)
    except OSError as error:
        reason = f"{error.filename} cannot be read ({error.strerror})."
    except Refused as error:
        reason = str(error)
    else:
        return marks_of(submission.name, rows, course)
    return Marks(submission.name, note=" ".join(reason.replace(f"{submission}/", "").split()))


class Refused(Exception):
    """A submission gets no marks, for this reason."""


def drive(submission: Path, work: Path, course: Course, dr: Dr) -> dict[str, dict[str, Any]]:
    """How a submission drove, by track: rows of `dr evaluate --models --worlds --laps`.

    Raises:
        Refused: It is incomplete, wrong, or cannot be driven.
        OSError: It cannot be read.
    """
    if not submission.is_dir():
        raise Refused(f"{submission.name} is not a folder.")
    inside = [path for path in submission.iterdir() if path.is_file() and not path.is_symlink()]
    missing = [name for name in FILES if name not in {path.name for path in inside}]
    archives = [path for path in inside if path.name.endswith(ARCHIVES)]
    if missing:
        raise Refused(f"{missing[0]} is missing.")
    if len(archives) != 1:
        raise Refused(f"There must be one archive of the model, not {len(archives)}.")
    for name in FILES:
        shutil.copy(submission / name, work / "custom_files" / name)
    steps = (
        ("validate",),
        (
            *("import", str(archives[0]), "-t", "submission", "--wipe", "-f", "--no-drive"),
            *("--metadata", str(submission / "model_metadata.json")),
        ),
        (
            *("evaluate", "--models", "submission", "--worlds", ",".join(course.tracks)),
            *("--laps", str(course.laps), "--seed", str(course.seed)),
        ),
    )
    told: dict[str, Any] = {}
    for words in steps:
        told, reason = dr(*words)
        if reason:
            raise Refused(reason)
    rows = {row["world"]: row for row in told["rows"]}
    for track in course.tracks:
        if track not in rows or rows[track]["reason"]:
            raise Refused(rows.get(track, {}).get("reason") or f"{track} was not driven.")
    return rows


def marks_of(name: str, rows: dict[str, dict[str, Any]], course: Course) -> Marks:
    """Marks for what `drive` returns."""
    clean = {track: rows[track]["clean"] / course.laps for track in course.tracks}
    paces = [
        (length_m / rows[track]["median_s"] - SLOW_MPS) / (FAST_MPS - SLOW_MPS)
        if rows[track]["median_s"]
        else 0.0
        for track, length_m in course.announced.items()
    ]
    return Marks(
        name,
        files=FOR_FILES,
        announced=FOR_ANNOUNCED * _mean([clean[track] for track in course.announced]),
        hidden=FOR_HIDDEN * _mean([clean[track] for track in course.hidden]),
        pace=FOR_PACE * _mean([min(max(pace, 0.0), 1.0) for pace in paces]),
        clean=clean,
    )


def write(path: Path, table: Sequence[Marks], course: Course) -> None:
    """Write the table as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        clean = [f"clean laps on {track}" for track in course.tracks]
        rows.writerow(
            ["submission", "total", "files", "announced", "hidden", "pace", *clean, "note"]
        )
        for marks in table:
            figures = marks.total, marks.files, marks.announced, marks.hidden, marks.pace
            shares = [f"{marks.clean[track]:.0%}" if marks.clean else "" for track in course.tracks]
            cells = [
                marks.submission,
                *(f"{figure:.1f}" for figure in figures),
                *shares,
                marks.note,
            ]
            # A spreadsheet would take these for formulas.
            rows.writerow(
                [f"'{cell}" if cell[:1] in ("=", "+", "-", "@") else cell for cell in cells]
            )


def run_dr(work: Path, tracks_folder: Path | None, *words: str) -> tuple[dict[str, Any], str]:
    """Run a command in the working folder; see `Dr`."""
    environment = {name: text for name, text in os.environ.items() if not name.startswith("DR_")}
    if tracks_folder is not None:
        environment["DR_TRACKS_DIR"] = str(tracks_folder.absolute())
    program = Path(sys.executable).with_name("dr")
    try:
        ended = subprocess.run(
            [program, *words, "--json", "-q"],
            cwd=work,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=LIMIT_S,
        )
    except subprocess.TimeoutExpired:
        return {}, f"`dr {words[0]}` took more than {LIMIT_S} s."
    lines = ended.stdout.splitlines()
    told = json.loads(lines[-1]) if lines and lines[-1].startswith("{") else {}
    if ended.returncode == 0:
        return told, ""
    for error in told.get("errors", []):
        return told, f"{error['where']}: {error['message']}"
    for line in ended.stderr.splitlines():
        if line.startswith("Error: "):
            return told, line.removeprefix("Error: ")
    return told, f"`dr {words[0]}` failed with exit code {ended.returncode}."


def _names(text: str) -> list[str]:
    return list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else 0.0


if __name__ == "__main__":
    sys.exit(main())
