"""Makes the archive that the physical car loads, and uploads it."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from drcli.base.archive import read_packed
from drcli.base.errors import Problem, ProblemsError, SettingsError, of_severity, refuse
from drcli.base.files import make_folder, refuse_existing, rewrite
from drcli.base.report import BLANK, Styled, View, bold, counted, size_text, table
from drcli.bucket.connect import COMMAND_PATIENCE_S
from drcli.config.run_config import DriveConfig
from drcli.config.settings import Settings
from drcli.config.track_names import is_installed
from drcli.convert.build_network import build_policy, load_weights, policy_spec, weights_of
from drcli.convert.car_archive import CarCheck, car_archive, check_car_archive
from drcli.convert.car_rules import (
    END,
    CarAction,
    car_file_name,
    file_name_problems,
    stack_problems,
)
from drcli.convert.frozen_graph import LEAST_SAME_ACTIONS, TOLERANCE, GraphComparison, encode_policy
from drcli.model.checkpoint_list import Item
from drcli.model.model_store import ModelStore
from drcli.model.write_probe import prove_writing
from drcli.records.checkpoint import CheckpointName
from drcli.transfer.export_model import ExportSource
from drcli.transfer.put_model import Delivery, Progress
from drcli.transfer.transfer_buckets import COPY_PATIENCE_S, checked_prefix, target_bucket
from drcli.transfer.upload import KEEP_ALL, Retention, delete_surplus_archives

CAR_FILE = "carfile.tar.gz"
"""Scripts for the reference look for it."""

_NUMBERED = re.compile(r"-chk\d+" + re.escape(END) + r"\Z")

FRAMES = 200
Compare = Callable[[DriveConfig, ExportSource, bytes], GraphComparison]

FEW_SAME = 0.9
"""Below this share of equal actions the overlay is worth a warning."""


@dataclass(frozen=True)
class OverlayAgreement:
    """How a network acts under the gray overlay of the car's camera."""

    world: Annotated[str, "The track of the camera frames."]
    frames: Annotated[int, "Number of camera frames."]
    same_actions: Annotated[
        int,
        "In how many the action is the same with the overlay; continuous actions: within a tenth "
        "of the largest angle and the greatest speed.",
    ]

    @property
    def is_low(self) -> bool:
        """Whether it is less than 90 %."""
        return self.same_actions < FEW_SAME * self.frames

    def told(self) -> str:
        frames = counted(self.frames, "camera frame")
        return (
            f"With the gray overlay of the car's camera it chooses the same action in "
            f"{self.same_actions} of {frames} of {self.world}"
            f"{_OVERLAY_REMEDY if self.is_low else '.'}"
        )


@dataclass(frozen=True)
class CarReport:
    """An archive for the car."""

    source: Annotated[str, "The model, as an s3:// address."]
    choice: Annotated[str, "last, best, the word of a milestone, or the requested number."]
    checkpoint: Annotated[str, "Name of its checkpoint."]
    metric: Annotated[float | None, "Mean score of its evaluation; null without one."]
    files: Annotated[list[str], "Where the archive is: a path, or s3:// addresses."]
    size_bytes: Annotated[int, "Size of the archive."]
    world: Annotated[str, "The track on which its graph was compared with the weights."]
    frames: Annotated[int, "Number of compared camera frames."]
    same_actions: Annotated[int, "In how many both chose the same action."]
    greatest_difference: Annotated[
        float, "Of any output: a probability, or a continuous action from -1 to 1."
    ]
    actions: Annotated[list[CarAction], "The actions as the car drives them."]
    problems: Annotated[list[Problem], "What the car does differently, or cannot do."] = field(
        default_factory=list
    )
    dry_run: Annotated[bool, "Whether -d was given, so that nothing was written."] = False
    deleted: Annotated[list[str], "Names of older archives that were deleted."] = field(
        default_factory=list
    )

    def view(self) -> View:
        would = "Would write" if self.dry_run else "Wrote"
        same = f"{self.same_actions} of {counted(self.frames, 'frame')} of a drive on {self.world}"
        difference = f"greatest difference {self.greatest_difference:.1g}"
        return [
            f"{would} {self.checkpoint} of {self.source}, {size_text(self.size_bytes)}, to",
            *map(bold, self.files),
            f"Same action as the weights in {same}; {difference}.",
            BLANK,
            table(self.actions),
        ]


@dataclass(frozen=True)
class ArchiveReport:
    """The check of an archive that anybody may have made."""

    file: Annotated[str, "The archive."]
    errors: Annotated[list[Problem], "Why the car refuses it, or cannot drive it."]
    warnings: Annotated[list[Problem], "What the car does differently."]
    actions: Annotated[list[CarAction], "The actions as the car drives them; empty if unreadable."]
    overlay: Annotated[
        OverlayAgreement | None,
        "What the gray overlay of the car's camera changes; null if the graph cannot be run.",
    ] = None

    @property
    def ok(self) -> bool:
        """Whether the car loads it."""
        return not self.errors

    def view(self) -> View:
        loads, refuses = Styled("The car loads it", "green"), Styled("The car refuses it", "red")
        verdict = (bold(self.file), ": ", refuses if self.errors else loads, ".")
        lines: list[object] = [verdict]
        if self.overlay is not None:
            lines.append(self.overlay.told())
        return [*lines, *([BLANK, table(self.actions)] if self.actions else [])]


_OVERLAY_REMEDY = (
    ". See whether it laps with it: `DR_SIM_EXTRAS_IN=evaluation DR_SIM_GRAY_OVERLAY=1 "
    "dr-evaluate`. If not, leave it off in the car (`dr-car config "
    "camera.enable_gray_overlay=false`), or train with it."
)


@dataclass(frozen=True)
class CarExport:
    archive: bytes
    report: CarReport
    best: str | None = None


def export_car(
    settings: Settings, source: ExportSource, file_name: str, compare: Compare
) -> CarExport:
    """Make the archive of a checkpoint, and check it by the car's rules and on real frames.

    Raises:
        ProblemsError: The car cannot drive the model.
        SettingsError: The weights do not fit, or graph and network differ.
    """
    design = source.design
    metadata, parameters = design.metadata, design.parameters
    stacked = list(stack_problems(parameters.stack_size, design.parameters_origin))
    refuse(stacked)
    model = build_policy(metadata, parameters)
    load_weights(model, source.weights, source.chosen.name)
    graph = source.graph or encode_policy(
        weights_of(model), policy_spec(metadata, parameters), metadata.sensor
    )
    archive = car_archive(graph, metadata)
    check = check_car_archive(archive, file_name)
    errors = of_severity(check.problems, "error")
    if errors:
        raise ProblemsError(errors)
    race = _race(settings, source)
    comparison = compare(race, source, graph)
    if not comparison.is_equal:
        raise _differs(source, comparison)
    report = CarReport(
        source=source.url,
        choice=str(source.chosen.choice),
        checkpoint=source.chosen.name,
        metric=source.chosen.score.avg_eval_metric,
        files=[],
        size_bytes=len(archive),
        world=race.world_name,
        frames=comparison.frames,
        same_actions=comparison.same_actions,
        greatest_difference=comparison.greatest_difference,
        actions=list(check.actions),
        problems=list(check.problems),
    )
    return CarExport(archive, report, source.best)


def check_archive(
    path: Path, overlay: Callable[[CarCheck], OverlayAgreement | None]
) -> ArchiveReport:
    """Check by the car's rules; SettingsError if unreadable or far too large."""
    check = check_car_archive(read_packed(path), str(path))
    return ArchiveReport(
        str(path),
        list(of_severity(check.problems, "error")),
        [problem for problem in check.problems if problem.severity != "error"],
        list(check.actions),
        overlay(check),
    )


def archive_path(out: Path | None, source_name: str, *, force: bool = False) -> Path:
    """A file of a name that the car takes; `out` is a file or folder.

    Raises:
        ProblemsError: The car does not take such a name.
        SettingsError: There is a file already.
    """
    path = Path() if out is None else out
    if path.is_dir() or (not path.exists() and "." not in path.name):
        path /= car_file_name(source_name)
    refuse(file_name_problems(path.name))
    refuse_existing(path, force=force)
    return path


def write_archive(export: CarExport, path: Path) -> CarReport:
    """Write it whole or not at all; raises SettingsError."""
    try:
        make_folder(path.parent)
    except OSError as e:
        raise SettingsError(
            f"{path.parent}: cannot be created ({e.strerror or e}).",
            remedy="Choose another folder with --out.",
        ) from e
    rewrite(path, export.archive)
    return replace(export.report, files=[str(path)])


@dataclass(frozen=True)
class CarTarget:
    settings: Settings
    retention: Retention
    prefix: str
    local: bool
    url: str


def plan_car_upload(
    settings: Settings,
    prefix: str | None,
    *,
    local: bool,
    dry_run: bool,
    retention: Retention = KEEP_ALL,
) -> CarTarget:
    """Check that archives can be uploaded, before one is made.

    Raises:
        DrError: There is no such bucket, or it does not take objects.
    """
    target = checked_prefix(prefix, "-p") if prefix else settings.upload_s3_prefix
    there = target_bucket(
        settings.transfer,
        local=local,
        patience_s=COMMAND_PATIENCE_S,
        otherwise="or upload into the local bucket with -L",
    )
    if not dry_run:
        prove_writing(ModelStore(there, target), deletes=retention.is_active)
    return CarTarget(settings, retention, target, local, f"s3://{there.name}/{target}")


def upload_names(source: ExportSource, *, numbered: bool, only_numbered: bool = False) -> list[str]:
    """Two names that scripts look for, and one of its own."""
    plain = car_file_name(source.file_name)
    names = [CAR_FILE] if only_numbered else [CAR_FILE, plain]
    if numbered or only_numbered:
        names.append(f"{plain.removesuffix(END)}-chk{source.chosen.number}{END}")
    return list(dict.fromkeys(names))


def upload_archive(
    export: CarExport, target: CarTarget, names: list[str], progress: Progress, *, dry_run: bool
) -> CarReport:
    """Upload and check it, delete old ones; raises StorageError."""
    report = replace(export.report, files=[f"{target.url}/{name}" for name in names])
    if dry_run:
        return replace(report, dry_run=True)
    there = target_bucket(target.settings.transfer, local=target.local, patience_s=COPY_PATIENCE_S)
    model = ModelStore(there, target.prefix)
    with progress("Uploading archive", len(names) * len(export.archive)) as watch:
        Delivery(model, watch).send(Item(name, export.archive) for name in names)
    numbered = next((name for name in names if _NUMBERED.search(name)), None)
    if numbered is None or not target.retention.is_active:
        return report
    number = CheckpointName.parse(export.report.checkpoint)
    deleted = delete_surplus_archives(
        model,
        # Version 0.1.0 named archives after the last part of the prefix.
        {_NUMBERED.sub(END, numbered), car_file_name(report.source.rpartition("/")[2])},
        target.retention,
        export.best,
        0 if number is None else number.number,
    )
    return replace(report, deleted=deleted)


def _race(settings: Settings, source: ExportSource) -> DriveConfig:
    race = settings.race
    own = race if source.world is None else race.replaced(world_name=source.world)
    if is_installed(own):
        return own
    default = DriveConfig.declared["DR_WORLD_NAME"].default
    return race if is_installed(race) else race.replaced(world_name=default)


def _differs(source: ExportSource, comparison: GraphComparison) -> SettingsError:
    return SettingsError(
        f"The graph of {source.chosen.name} does not compute what its weights do: the likeliest "
        f"action is the same in {comparison.same_actions} of {comparison.frames} frames (at least "
        f"{LEAST_SAME_ACTIONS:.1%} are needed), the greatest difference is "
        f"{comparison.greatest_difference:.2g} (at most {TOLERANCE:g}). Nothing was written.",
        remedy="Export another checkpoint with -c N, and report this as a fault of the program.",
    )
