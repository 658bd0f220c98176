"""Means of a model's metrics at DeepRacer on AWS."""

import json
import math
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from drcli.base.archive import read_packed, unpack_readable
from drcli.base.errors import SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.outside.droa.droa_api import Droa, RemoteModel
from drcli.records.episode_metrics import is_clean

with lazy_imports():
    import requests


@dataclass(frozen=True)
class PhaseMeans:
    """Means over all episodes of a phase.

    Attributes:
        phase: training or evaluation.
        episodes: How many episodes there are.
        mean_reward: Mean reward of an episode.
        mean_progress: Mean part of the lap, percent.
        full_laps: Episodes that completed the lap, with or without resets.
        best_lap_s: Shortest time of a clean lap; None if there is none.
        clean_laps: How many completed it without reset and penalty.
    """

    phase: str
    episodes: int
    mean_reward: float
    mean_progress: float
    full_laps: int
    best_lap_s: float | None
    clean_laps: int = 0


@dataclass(frozen=True)
class ModelReport:
    """The result of `droa-get-model`.

    Attributes:
        site: Address of DeepRacer on AWS.
        model_id: Id of the model.
        name: Its name.
        status: Such as READY, ERROR, IMPORTING or TRAINING.
        training_status: Such as COMPLETED; empty if unknown.
        created_at: When it was created, ISO 8601; empty if unknown.
        import_error: Why its import failed; empty if it did not.
        values: Everything that the interface says, with its keys, such as metadata.
        means: With --summary: means of its training metrics.
    """

    site: str
    model_id: str
    name: str
    status: str
    training_status: str
    created_at: str
    import_error: str
    values: dict[str, Any]
    means: list[PhaseMeans]


def metrics_summary(droa: Droa, model: RemoteModel) -> list[PhaseMeans]:
    """Of training; SettingsError without any."""
    url = model.text("trainingMetricsUrl")
    none = SettingsError(
        f"The model {model.name} ({model.model_id}) has no training metrics.",
        remedy="Train it there, or import it with metrics/training/training-*.json.",
    )
    if not url.startswith("http"):
        raise none
    answer = droa.web.send(lambda: requests.Request("GET", url), repeat=True)
    if answer.status_code in (403, 404):
        raise none
    if answer.status_code != 200:
        raise StorageError(
            f"The training metrics of {model.model_id} cannot be read: the server answered "
            f"{answer.status_code} {answer.reason}.",
            remedy="Try again later.",
        )
    means = means_of([answer.content])
    if not means:
        raise none
    return means


def archive_summary(file: Path) -> list[PhaseMeans]:
    """Of logs; SettingsError without any."""
    found, fault = unpack_readable(BytesIO(read_packed(file)), lambda name: name.endswith(".json"))
    if fault is not None:
        raise SettingsError(
            f"{file} is not an archive of logs, or is damaged: it {fault}.",
            remedy="Look at it; without --summary it is only downloaded.",
        )
    means = means_of(list(found.values()))
    if not means:
        raise SettingsError(
            f"{file} has no metrics.", remedy="Its other files are there; unpack it."
        )
    return means


def means_of(files: list[bytes]) -> list[PhaseMeans]:
    by_phase: dict[str, list[_Episode]] = {}
    for data in files:
        for entry in _entries(data):
            numbers = [
                _number(entry.get(key))
                for key in (
                    "reward_score",
                    "completion_percentage",
                    "elapsed_time_in_milliseconds",
                )
            ]
            reward, progress, elapsed_ms = numbers
            if progress is None:
                continue
            phase = str(entry.get("phase") or "evaluation")
            clean = is_clean(entry, finished=progress >= 100.0)
            found = _Episode(reward or 0.0, progress, elapsed_ms or math.nan, clean)
            by_phase.setdefault(phase, []).append(found)
    return [_means(phase, episodes) for phase, episodes in sorted(by_phase.items(), reverse=True)]


def _entries(data: bytes) -> list[dict[str, Any]]:
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        return []
    found = values.get("metrics") if isinstance(values, dict) else None
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, list) else []


def _number(value: Any) -> float | None:
    usable = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None


class _Episode(NamedTuple):
    reward: float
    progress: float
    elapsed_ms: float
    clean: bool


def _means(phase: str, episodes: list[_Episode]) -> PhaseMeans:
    finished = [each for each in episodes if each.progress >= 100]
    clean = [each.elapsed_ms / 1000 for each in episodes if each.clean]
    number = len(episodes)
    return PhaseMeans(
        phase,
        number,
        sum(each.reward for each in episodes) / number,
        sum(each.progress for each in episodes) / number,
        len(finished),
        min((seconds for seconds in clean if math.isfinite(seconds)), default=None),
        len(clean),
    )
