"""Means of a model's metrics at DeepRacer on AWS."""

import json
import math
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from drcli.base.archive import read_packed, unpack_readable
from drcli.base.errors import SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.base.report import Col, View, bold, second, size_text, table
from drcli.outside.droa.droa_api import Droa, RemoteModel, text_at, value_at
from drcli.records.episode_metrics import is_clean

with lazy_imports():
    import requests


@dataclass(frozen=True)
class PhaseMeans:
    """Means over all episodes of a phase."""

    phase: Annotated[str, "training or evaluation.", Col("phase")]
    episodes: Annotated[int, "How many episodes there are.", Col("episodes")]
    mean_reward: Annotated[float, "Mean reward of an episode.", Col("reward", "{:.1f}")]
    mean_progress: Annotated[float, "Mean part of the lap, percent.", Col("progress", "{:.1f} %")]
    full_laps: Annotated[
        int, "Episodes that completed the lap, with or without resets.", Col("finished")
    ]
    best_lap_s: Annotated[
        float | None,
        "Shortest time of a clean lap; None if there is none.",
        Col("best lap", "{:.3f} s"),
    ]
    clean_laps: Annotated[
        int, "How many completed it without reset and penalty.", Col("clean laps")
    ] = 0


@dataclass(frozen=True)
class ModelReport(RemoteModel):
    """The result of `droa-get-model`."""

    means: Annotated[list[PhaseMeans], "With --summary: means of its training metrics."]

    def view(self, *, verbose: bool) -> View:
        size, minutes = (
            self._text("fileSizeInBytes"),
            self._text("trainingConfig", "maxTimeInMinutes"),
        )
        yield {
            "model id": self.model_id,
            "name": self.name,
            "description": self._text("description"),
            "status": self.status,
            "import error": self.import_error,
            "training": self.training_status,
            "created": second(self.created_at),
            "size": size_text(int(size)) if size.isdigit() else "",
            "packaging": self._text("packagingStatus"),
        }
        found = value_at(self.values, "metadata", "hyperparameters")
        known = found if isinstance(found, dict) else {}
        sections = {
            "Car": {
                "shell": self._text("carCustomization", "carShell"),
                "colour": self._text("carCustomization", "carColor"),
            },
            "Training": {
                "track": self._text("trainingConfig", "trackConfig", "trackId"),
                "direction": self._text("trainingConfig", "trackConfig", "trackDirection"),
                "race type": self._text("trainingConfig", "raceType"),
                "longest time": f"{minutes} min" if minutes not in ("", "0") else "",
            },
            "Learning": {
                "algorithm": self._text("metadata", "agentAlgorithm"),
                "camera": self._text("metadata", "sensors", "camera"),
                "lidar": self._text("metadata", "sensors", "lidar"),
                **{name: str(value) for name, value in known.items()},  # also 0
            },
        }
        if verbose:
            sections["Actions"] = self._actions()
            sections["Addresses"] = {
                "metrics": self._text("trainingMetricsUrl"),
                "video": self._text("trainingVideoStreamUrl"),
            }
        for title, values in sections.items():
            if any(values.values()):
                yield from (bold(title), [values])
        reward = self._text("metadata", "rewardFunction")
        if verbose and reward:
            yield from (bold("Reward function"), reward.rstrip())
        if self.means:
            yield from (bold("Metrics"), table(self.means))

    def _text(self, *path: str) -> str:
        return text_at(self.values, *path)

    def _actions(self) -> dict[str, str]:
        """The interface spells `continous`."""
        space = value_at(self.values, "metadata", "actionSpace")
        if not isinstance(space, dict):
            return {}
        ranges = space.get("continous") or space.get("continuous")
        if isinstance(ranges, dict):
            low, high = ranges.get("lowSteeringAngle"), ranges.get("highSteeringAngle")
            return {
                "speed": f"{ranges.get('lowSpeed')} to {ranges.get('highSpeed')} m/s",
                "steering": f"{low} to {high} degrees",
            }
        discrete = space.get("discrete")
        return {
            str(index): f"{each.get('steeringAngle')} degrees, {each.get('speed')} m/s"
            for index, each in enumerate(discrete if isinstance(discrete, list) else [])
            if isinstance(each, dict)
        }


def metrics_summary(droa: Droa, model: RemoteModel) -> list[PhaseMeans]:
    """Of training; SettingsError without any."""
    url = text_at(model.values, "trainingMetricsUrl")
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
