"""Shows models at DeepRacer on AWS."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Group, RenderableType
from rich.filesize import decimal
from rich.text import Text

from drcli.cli.views.layout import Rows, counted, indented

if TYPE_CHECKING:
    from drcli.remote.droa_delete import DeletedModel
    from drcli.remote.droa_download import DownloadedAsset
    from drcli.remote.droa_import import ImportReport
    from drcli.remote.droa_metrics import PhaseMeans
    from drcli.remote.droa_models import RemoteModel

_SECOND = 19
Pairs = list[tuple[str, str]]


@dataclass(frozen=True)
class SignedIn:
    """The result of `droa-login`.

    Attributes:
        site: Address of DeepRacer on AWS.
        username: Who signed in.
        expires: When the temporary keys end, ISO 8601.
    """

    site: str
    username: str
    expires: str


@dataclass(frozen=True)
class SignedOut:
    """The result of `droa-logout`.

    Attributes:
        site: Address of DeepRacer on AWS.
        username: Whose keys were meant.
        deleted: Whether there were any.
    """

    site: str
    username: str
    deleted: bool


@dataclass(frozen=True)
class RemoteModels:
    """The models in an account.

    Attributes:
        site: Address of DeepRacer on AWS.
        models: The newest first, each with the keys of the interface, such as modelId and status.
    """

    site: str
    models: list[dict[str, Any]]


def signed_in(report: SignedIn) -> str:
    until = _time(report.expires)
    return f"Signed in to {report.site} as {report.username}, until {until} UTC."


def signed_out(report: SignedOut) -> str:
    if report.deleted:
        return f"Deleted the temporary keys of {report.username} for {report.site}."
    return f"There were no temporary keys of {report.username} for {report.site}."


def models(site: str, found: "Sequence[RemoteModel]") -> RenderableType:
    if not found:
        return f"There is no model in your account at {site}."
    rows = [
        (
            model.name,
            model.model_id,
            Text(model.status, _STYLES.get(model.status, "")),
            model.training_status or "-",
            _time(model.created_at),
        )
        for model in found
    ]
    names = ("name", "model id", "status", "training", "created")
    return Group(Text(site, style="bold"), Rows(names, rows, left=names))


_STYLES = {"READY": "green", "ERROR": "red"}


def model(
    found: "RemoteModel", means: "Sequence[PhaseMeans] | None", *, verbose: bool
) -> RenderableType:
    size = found.text("fileSizeInBytes")
    parts: list[RenderableType] = [
        _pairs(
            [
                ("model id", found.model_id),
                ("name", found.name),
                ("description", found.text("description")),
                ("status", found.status),
                ("import error", found.import_error),
                ("training", found.training_status),
                ("created", _time(found.created_at)),
                ("size", decimal(int(size)) if size.isdigit() else ""),
                ("packaging", found.text("packagingStatus")),
            ]
        ),
        *_section(
            "Car",
            [
                ("shell", found.text("carCustomization", "carShell")),
                ("colour", found.text("carCustomization", "carColor")),
            ],
        ),
        *_section(
            "Training",
            [
                ("track", found.text("trainingConfig", "trackConfig", "trackId")),
                ("direction", found.text("trainingConfig", "trackConfig", "trackDirection")),
                ("race type", found.text("trainingConfig", "raceType")),
                ("longest time", _minutes(found.text("trainingConfig", "maxTimeInMinutes"))),
            ],
        ),
        *_section(
            "Learning",
            [
                ("algorithm", found.text("metadata", "agentAlgorithm")),
                ("camera", found.text("metadata", "sensors", "camera")),
                ("lidar", found.text("metadata", "sensors", "lidar")),
                *_values(found, "metadata", "hyperparameters"),
            ],
        ),
    ]
    if verbose:
        parts += _section("Actions", _actions(found))
        addresses = [
            ("metrics", found.text("trainingMetricsUrl")),
            ("video", found.text("trainingVideoStreamUrl")),
        ]
        parts += _section("Addresses", addresses)
        reward = found.text("metadata", "rewardFunction")
        if reward:
            parts += [Text("Reward function", style="bold"), Text(reward.rstrip())]
    if means is not None:
        parts += [Text("Metrics", style="bold"), _means(means)]
    return Group(*parts)


def imported(report: "ImportReport") -> str:
    size = f"{counted(report.files, 'file')}, {decimal(report.uploaded_bytes)}"
    if report.dry_run:
        return f"Would import {report.name} into {report.site}: {size}."
    if report.existed:
        return f"{report.name} was imported into {report.site} before, as {report.model_id}."
    state = "It is ready." if report.status == "READY" else "It is being checked there."
    return f"Imported {report.name} into {report.site} as {report.model_id}: {size}. {state}"


def downloaded(report: "DownloadedAsset", means: "Sequence[PhaseMeans] | None") -> RenderableType:
    line = f"Downloaded {report.asset_type} of {report.model_id} to {report.file}: "
    text = f"{line}{decimal(report.file_bytes)}."
    return text if means is None else Group(Text(text), _means(means))


def deleted(report: "DeletedModel") -> str:
    return f"{report.site} is deleting {report.name} ({report.model_id})."


def _pairs(pairs: Pairs) -> Text:
    known = [(name, value) for name, value in pairs if value]
    width = max((len(name) for name, _ in known), default=0)
    lines = [Text.assemble((name.ljust(width), "dim"), "  ", value) for name, value in known]
    return Text("\n").join(lines)


def _section(title: str, pairs: Pairs) -> list[RenderableType]:
    known = [pair for pair in pairs if pair[1]]
    return [Text(title, style="bold"), indented(_pairs(known))] if known else []


def _values(found: "RemoteModel", *path: str) -> Pairs:
    value: Any = found.values
    for key in path:
        value = value.get(key) if isinstance(value, dict) else None
    return [(str(k), str(v)) for k, v in value.items()] if isinstance(value, dict) else []


def _actions(found: "RemoteModel") -> Pairs:
    """The interface spells `continous`."""
    metadata = found.values.get("metadata")
    space = metadata.get("actionSpace") if isinstance(metadata, dict) else None
    if not isinstance(space, dict):
        return []
    ranges = space.get("continous") or space.get("continuous")
    if isinstance(ranges, dict):
        return [
            ("speed", f"{ranges.get('lowSpeed')} to {ranges.get('highSpeed')} m/s"),
            (
                "steering",
                f"{ranges.get('lowSteeringAngle')} to {ranges.get('highSteeringAngle')} degrees",
            ),
        ]
    discrete = space.get("discrete")
    return [
        (str(index), f"{each.get('steeringAngle')} degrees, {each.get('speed')} m/s")
        for index, each in enumerate(discrete if isinstance(discrete, list) else [])
        if isinstance(each, dict)
    ]


def _means(means: "Sequence[PhaseMeans]") -> RenderableType:
    names = ("phase", "episodes", "reward", "progress", "clean laps", "finished", "best lap")
    rows = [
        (
            each.phase,
            str(each.episodes),
            f"{each.mean_reward:.1f}",
            f"{each.mean_progress:.1f} %",
            str(each.clean_laps),
            str(each.full_laps),
            "-" if each.best_lap_s is None else f"{each.best_lap_s:.3f} s",
        )
        for each in means
    ]
    return Rows(names, rows, left=("phase",))


def _minutes(text: str) -> str:
    return f"{text} min" if text and text != "0" else ""


def _time(text: str) -> str:
    return text[:_SECOND].replace("T", " ") if text else "-"
