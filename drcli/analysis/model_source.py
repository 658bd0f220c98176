"""Finds the model to analyse: in a bucket, folder or archive."""

import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from drcli.analysis.run import Layout
from drcli.base.archive import ENDINGS, read_packed, unpack_readable
from drcli.base.errors import SettingsError, StorageError, closest, shown
from drcli.base.files import is_left_behind, read_regular
from drcli.bucket.bucket import Bucket
from drcli.config.settings import Settings
from drcli.model import keys
from drcli.model.growing_file import read_complete
from drcli.model.model_store import ModelStore
from drcli.model.traces import models_in
from drcli.transfer.files_as_bucket import FilesAsBucket
from drcli.transfer.find_checkpoint import LARGEST_BYTES, files_in_folder
from drcli.transfer.transfer_buckets import bucket_to_look_at, source_bucket

# Where the files of a training lie, in every known layout.
#
# DeepRacer-for-Cloud writes `drfc` and `drfc-workers`, the DeepRacer console `console`, DeepRacer
# on AWS `droa`. deepracer-utils does not know more than ten workers, archives of `drfc` and the
# root of an archive.


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


_ENDINGS = (*ENDINGS, ".csv", ".log")

PATIENCE_S = 30.0
_URL = re.compile(r"s3://([A-Za-z0-9][A-Za-z0-9._-]{2,62})/?(.*)", re.IGNORECASE)

_NAMES_TOLD = 5


@dataclass(frozen=True)
class Objects:
    """Read-only files by name, with sizes in bytes."""

    sizes: Mapping[str, int]
    fetch: Callable[[str], bytes]
    modified: Mapping[str, float] = field(default_factory=dict)

    def read(self, name: str) -> bytes:
        """The content of a file.

        Raises:
            SettingsError: It is too large, or cannot be read.
            StorageError: The bucket cannot be read.
        """
        if self.sizes[name] > LARGEST_BYTES:
            raise SettingsError(
                f"{name} has {self.sizes[name]:,} bytes, more than any file of a model.",
                remedy="Remove it, and try again.",
            )
        return self.fetch(name)

    def read_whole(self, name: str) -> bytes:
        """The same with the parts that a running training has written beside the file."""
        return read_complete(FilesAsBucket("", self.sizes, self.read), name)


@dataclass(frozen=True)
class ModelSource:
    """A model to analyse; of a folder or archive, without bucket."""

    name: str
    origin: str
    files: ModelFiles
    objects: Objects
    bucket: Bucket | None = None
    prefix: str = ""
    problems: tuple[str, ...] = ()


def open_model(settings: Settings, what: str | None, *, local: bool = False) -> ModelSource:
    """Find a model: in a bucket, a folder, an archive, a trace or a log.

    Without `what` it is the model of run.env. Of a model and a folder of one name, `NAME` is the
    model and `./NAME` the folder. `local`: any s3:// address is one of our own server.

    Raises:
        SettingsError: There is no such thing, or nothing in it to analyse.
        StorageError: A bucket cannot be read.
    """
    if what is None:
        return _in_own_bucket(settings, settings.model_prefix, named=False)
    if what.casefold().startswith("s3:"):
        return _at_address(settings, what, local=local)
    path = Path(what).expanduser()
    if _is_certainly_a_path(what, path):
        return _on_disk(path, what)
    prefix = what.strip("/")
    if keys.is_valid_prefix(prefix) and not what.startswith("/"):
        found = _if_in_own_bucket(settings, prefix, path)
        if found is not None:
            return found
    return _on_disk(path, what)


def _is_certainly_a_path(what: str, path: Path) -> bool:
    return what.startswith((".", "~", "/")) or (
        path.name.casefold().endswith(_ENDINGS) and path.is_file()
    )


def _if_in_own_bucket(settings: Settings, prefix: str, path: Path) -> ModelSource | None:
    try:
        return _in_own_bucket(settings, prefix, named=True)
    except (SettingsError, StorageError) as error:
        absent = isinstance(error, SettingsError)
        if path.exists() or (absent and path.name.casefold().endswith(_ENDINGS)):
            return None
        raise


def _in_own_bucket(settings: Settings, prefix: str, *, named: bool) -> ModelSource:
    bucket = bucket_to_look_at(settings.transfer, upload=False)
    metrics = None
    if prefix == settings.model_prefix and not settings.metrics_prefix.startswith(
        keys.folder(prefix)
    ):
        metrics = settings.metrics_prefix
    return _in_bucket(ModelStore(bucket, prefix), metrics=metrics, setting=not named)


def _at_address(settings: Settings, address: str, *, local: bool) -> ModelSource:
    found = _URL.fullmatch(address.strip())
    prefix = found[2].strip("/") if found else ""
    if found is None or (prefix and not keys.is_valid_prefix(prefix)):
        raise SettingsError(
            f"'{shown(address)}' is not the address of a model.",
            remedy="Write it as s3://bucket/team/model-1.",
        )
    if found[1] == settings.transfer.own.bucket and not local:
        bucket = bucket_to_look_at(settings.transfer, upload=False)
        return _in_bucket(ModelStore(bucket, prefix))
    bucket = source_bucket(settings.transfer, found[1], local=local, patience_s=PATIENCE_S)
    return _in_bucket(ModelStore(bucket, prefix))


def _in_bucket(
    model: ModelStore, *, metrics: str | None = None, setting: bool = False
) -> ModelSource:
    bucket, prefix = model.bucket, model.prefix
    folder = keys.folder(prefix) if prefix else ""
    infos = {info.key.removeprefix(folder): info for info in bucket.list(folder)}
    real = {name: folder + name for name in infos}
    if metrics is not None:
        for info in bucket.list(keys.folder(metrics)):
            name = "metrics/" + info.key.removeprefix(keys.folder(metrics))
            infos[name], real[name] = info, info.key
    origin = f"s3://{bucket.name}/{prefix}".rstrip("/")
    if not infos:
        remedy = "`dr-list-models` lists the models that there are."
        if setting:
            remedy = "Train it with `dr-start-training`, or name another one; " + remedy
        else:
            near = closest(prefix, list(models_in(bucket.list(""))))
            remedy = (f"Did you mean {near}? " if near else "") + remedy
        raise SettingsError(f"There is nothing at {origin}.", remedy=remedy)
    objects = Objects(
        {name: info.size_bytes for name, info in infos.items()},
        lambda name: bucket.get(real[name]),
        {name: info.modified.timestamp() for name, info in infos.items()},
    )
    files = _only_model(find_models(infos), origin, at_root=bool(prefix))
    prefix = (folder + files.root).rstrip("/")
    return ModelSource(
        prefix, f"s3://{bucket.name}/{prefix}", files, objects, bucket=bucket, prefix=prefix
    )


def _on_disk(path: Path, what: str) -> ModelSource:
    try:
        if path.is_dir():
            return _in_folder(path)
        if path.is_file() and path.name.casefold().endswith(ENDINGS):
            return _in_archive(path)
        if path.is_file() and path.suffix.casefold() in (".csv", ".log"):
            return _single_trace(path)
    except OSError as e:
        raise SettingsError(
            f"{e.filename or path}: cannot be read ({e.strerror or e}).",
            remedy="Check its name and permissions.",
        ) from e
    state = "is not a folder, an archive, a trace or a log" if path.exists() else "does not exist"
    raise SettingsError(
        f"{shown(what)} {state}.",
        remedy="Name a model of `dr-list-models`, s3://bucket/prefix, a folder, or an archive "
        f"({', '.join(ENDINGS)}).",
    )


def _in_folder(path: Path) -> ModelSource:
    source = files_in_folder(path)
    if not source.sizes:
        raise SettingsError(f"{path} is empty.", remedy="Name a folder with the files of a model.")
    files = _only_model(find_models(source.sizes), str(path))
    top = path.resolve() / files.root
    modified = {name: (path / name).stat().st_mtime for name in files.others.values()}
    objects = Objects(source.sizes, lambda name: read_regular(path / name), modified)
    return ModelSource(top.name, str(path), files, objects)


def _in_archive(path: Path) -> ModelSource:
    members, fault = unpack_readable(BytesIO(read_packed(path)), is_read)
    problems: tuple[str, ...] = ()
    if fault is not None:
        member = f" ({shown(fault.member)})" if fault.member else ""
        if not members:
            raise SettingsError(
                f"{path}{member} {fault}.",
                remedy="Use another archive, or pack the files again with `tar czf NAME.tar.gz "
                "FILES`.",
            )
        problems = (f"The archive{member} {fault}: what comes before that is analysed.",)
    sizes = {name: len(content) for name, content in members.items()}
    files = _only_model(find_models(sizes), str(path))
    name = files.root.rstrip("/").rpartition("/")[2]
    if not name:
        end = next(end for end in ENDINGS if path.name.casefold().endswith(end))
        name = path.name[: -len(end)]
    objects = Objects(sizes, members.__getitem__)
    return ModelSource(name, str(path), files, objects, problems=problems)


def _single_trace(path: Path) -> ModelSource:
    digits = re.match(r"(\d+)", path.name)
    name = f"{digits[1] if digits else 0}-iteration.csv"
    if path.suffix.casefold() == ".log":
        name = f"logs/training/{path.stem}.log"
    objects = Objects({name: path.stat().st_size}, lambda _: read_regular(path))
    return ModelSource(path.stem, str(path), find_models([name])[0], objects)


def _only_model(models: list[ModelFiles], origin: str, *, at_root: bool = False) -> ModelFiles:
    if not models:
        raise SettingsError(
            f"{origin} contains no traces, metrics or evaluations of a model.",
            remedy="Name a model's folder: the one with training-simtrace, 0/training-simtrace or "
            "sim-trace in it.",
        )
    own = [model for model in models if not model.root]
    if own and (at_root or own[0].traces or len(models) == 1):
        return own[0]
    traced = [model for model in models if model.traces] or models
    if len(traced) == 1:
        return traced[0]
    roots = [model.root.rstrip("/") or "." for model in traced]
    listed = ", ".join(roots[:_NAMES_TOLD]) + (" ..." if len(roots) > _NAMES_TOLD else "")
    raise SettingsError(
        f"{origin} contains {len(roots)} models: {listed}.",
        remedy=f"Name one of them, such as {origin}/{roots[0]}.",
    )
