"""Where the files of a training lie, in every known layout.

DeepRacer-for-Cloud writes `drfc` and `drfc-workers`, the DeepRacer console `console`, DeepRacer on
AWS `droa`. deepracer-utils does not know more than ten workers, archives of `drfc` and the root of
an archive.
"""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from drcli.analysis.run import Layout
from drcli.base.left_behind import is_left_behind

_TRACES: tuple[tuple[Layout, re.Pattern[str]], ...] = (
    (
        "console",
        re.compile(
            r"(?P<root>(?:.*/)?)sim-trace/training/training-simtrace/(?P<n>\d+)-iteration.csv"
        ),
    ),
    (
        "droa",
        re.compile(
            r"(?P<root>(?:.*/)?)sim-trace/training/(?P<run>[^/]+)/training-simtrace/"
            r"(?P<n>\d+)-iteration.csv"
        ),
    ),
    (
        "drfc-workers",
        re.compile(
            r"(?P<root>(?:.*/)?)(?P<worker>\d{1,3})/training-simtrace/(?P<n>\d+)-iteration.csv"
        ),
    ),
    ("drfc", re.compile(r"(?P<root>(?:.*/)?)training-simtrace/(?P<n>\d+)-iteration.csv")),
    # The folder of the traces itself, or a trace, was named.
    ("drfc", re.compile(r"(?P<root>)(?P<n>\d+)-iteration.csv")),
)
_EVALUATIONS = (
    re.compile(
        r"(?P<root>(?:.*/)?)sim-trace/evaluation/(?P<stamp>[^/]+)/evaluation-simtrace/"
        r"(?P<n>\d+)-iteration.csv"
    ),
    re.compile(
        r"(?P<root>(?:.*/)?)evaluation-(?P<stamp>[^/]+)/evaluation-simtrace/(?P<n>\d+)-iteration.csv"
    ),
)

_ROOTED = (
    r"model/model_metadata\.json",
    r"ip/hyperparameters\.json",
    r"ip/run\.json",
    r"training_params(?:_\d+)?\.yaml",
    r"evaluation_params\.yaml",
    r"reward_function\.py",
    r"metrics/.+\.(?:json|csv)(?:\.part-\d+)?",
    r"logs/.+\.log(?:\.[\w.-]+)?",
    r"model/deepracer_checkpoints\.json",
    r"TrainingMetrics(?:_\d+)?\.json",
    r"model_metadata\.json",
    r"hyperparameters\.json",
)
_OTHER = re.compile(rf"(?P<root>(?:[^/]+/)*?)(?:{'|'.join(_ROOTED)})")

_MARK = re.compile(
    r"(?P<root>(?:[^/]+/)*?)(?:model/model_metadata\.json|ip/hyperparameters\.json"
    r"|metrics/(?:TrainingMetrics|history|training/|evaluation/).*|TrainingMetrics\.json"
    r"|logs/(?:training|evaluation)/.+\.log)"
)
_STAMP = re.compile(r"\d{14}")


class Trace(NamedTuple):
    name: str
    worker: int
    iteration: int


@dataclass(frozen=True)
class ModelFiles:
    """The files of one model by what they are.

    Attributes:
        root: Common beginning of their names, empty or with a slash at its end.
        evaluations: Names of the traces of each evaluation, by its stamp.
        others: The name of each other file by its name below the root.
        problems: Files that were left aside.
    """

    root: str
    layout: Layout
    traces: tuple[Trace, ...]
    evaluations: dict[str, tuple[str, ...]]
    others: dict[str, str]
    problems: tuple[str, ...] = ()


@dataclass
class _Root:
    traces: dict[Layout, list[tuple[str, Trace]]] = field(default_factory=lambda: defaultdict(list))
    evaluations: dict[str, list[tuple[int, str]]] = field(default_factory=lambda: defaultdict(list))
    marked: bool = False


def is_read(name: str) -> bool:
    if is_left_behind(name):
        return False
    patterns = (*(pattern for _, pattern in _TRACES), *_EVALUATIONS, _OTHER)
    return any(pattern.fullmatch(name) for pattern in patterns)


def find_models(names: Iterable[str]) -> list[ModelFiles]:
    """The models among file names; first those with training traces."""
    names = sorted(name for name in names if not is_left_behind(name))
    roots: dict[str, _Root] = defaultdict(_Root)
    marked = {match["root"] for name in names if (match := _MARK.fullmatch(name))}
    for root in marked:
        roots[root].marked = True
    for name in names:
        _sort_in(name, roots, marked)
    models = [
        _model(root, found, [name for name in names if name.startswith(root)])
        for root, found in roots.items()
        if found.traces or found.evaluations or found.marked
    ]
    return sorted(models, key=lambda model: (not model.traces, model.root))


def _sort_in(name: str, roots: dict[str, _Root], marked: Collection[str]) -> None:
    for layout, pattern in _TRACES:
        match = pattern.fullmatch(name)
        if match is not None:
            groups = match.groupdict()
            if f"{match['root']}{groups.get('worker')}/" in marked:
                continue  # the model team/1 lies inside the model team
            trace = Trace(name, int(groups.get("worker") or 0), int(groups["n"]))
            roots[match["root"]].traces[layout].append((groups.get("run") or "", trace))
            return
    for pattern in _EVALUATIONS:
        match = pattern.fullmatch(name)
        if match is not None:
            stamp = _STAMP.match(match["stamp"])
            key = stamp[0] if stamp else match["stamp"]
            roots[match["root"]].evaluations[key].append((int(match["n"]), name))
            return


def _model(root: str, found: _Root, names: list[str]) -> ModelFiles:
    problems = []
    layout: Layout = "upload"
    traces: list[Trace] = []
    if {"drfc", "drfc-workers"} <= found.traces.keys():
        # Workers joined a training of one. Where both have a trace of the first one, that of the
        # time with others is the newer one.
        shared = found.traces["drfc-workers"]
        known = {trace[1:] for _, trace in shared}
        shared += [each for each in found.traces.pop("drfc") if each[1][1:] not in known]
    if found.traces:
        # A folder that was copied about may hold two layouts: the larger one is the training.
        layout = max(found.traces, key=lambda each: len(found.traces[each]))
        runs = sorted({run for run, _ in found.traces[layout]})
        traces = [trace for run, trace in found.traces[layout] if run == runs[-1]]
        if len(runs) > 1:
            problems.append(
                f"There are traces of {len(runs)} trainings in sim-trace/training; the newest, "
                f"{runs[-1]}, is analysed."
            )
        left = sum(len(each) for other, each in found.traces.items() if other != layout)
        if left:
            problems.append(
                f"Traces lie in the folders of two layouts; the {left} of the smaller part are "
                "left out."
            )
    others = {
        name.removeprefix(root): name
        for name in names
        if (match := _OTHER.fullmatch(name)) and match["root"] == root
    }
    evaluations = {
        stamp: tuple(name for _, name in sorted(files))
        for stamp, files in sorted(found.evaluations.items())
    }
    ordered = sorted(traces, key=lambda trace: (trace.iteration, trace.worker))
    return ModelFiles(root, layout, tuple(ordered), evaluations, others, tuple(problems))
