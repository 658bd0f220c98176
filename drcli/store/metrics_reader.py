"""Reads a training's episodes again and again, but only changed objects."""

import re
from typing import NamedTuple

from drcli.exchange.episode_metrics import EpisodeMetrics
from drcli.store.bucket import Bucket, ObjectDamaged, ObjectInfo, ObjectMissing
from drcli.store.complete_files import combined_metrics
from drcli.store.repair import read_metrics

_METRICS = re.compile(r"(TrainingMetrics(?:_\d+)?\.json)(\.part-\d+)?")


class DrivenEpisode(NamedTuple):
    """An episode; `evaluation` is 1 or 0, `progress` percent."""

    iteration: int
    evaluation: int
    reward: float
    progress: float


class MetricsReader:
    def __init__(self) -> None:
        self._known: dict[str, tuple[ObjectInfo, list[EpisodeMetrics]]] = {}
        self._episodes: list[DrivenEpisode] = []
        self.damaged: list[str] = []

    def read(self, bucket: Bucket, metrics_prefix: str) -> list[DrivenEpisode]:
        """By iteration; the same list if nothing has changed.

        Without damaged objects (noted in `damaged`) and without episodes of version 0.1.0, whose
        iteration is unknown.

        Raises:
            StorageError: The bucket does not answer.
        """
        folder = metrics_prefix.rstrip("/") + "/"
        infos = {
            info.key: info
            for info in bucket.list(folder)
            if _METRICS.fullmatch(info.key.removeprefix(folder))
        }
        kept = {key: found for key, found in self._known.items() if found[0] == infos.get(key)}
        if kept.keys() == infos.keys() == self._known.keys():
            return self._episodes
        self._known, self.damaged = kept, []
        # A part comes before its whole object: a part that is deleted meanwhile is in that.
        for key in sorted(infos, reverse=True):
            if key not in kept:
                try:
                    kept[key] = infos[key], read_metrics(bucket, key)
                except ObjectMissing:
                    continue
                except ObjectDamaged as error:
                    self.damaged.append(str(error))
        self._episodes = _sorted(kept, folder)
        return self._episodes


def _sorted(
    known: dict[str, tuple[ObjectInfo, list[EpisodeMetrics]]], folder: str
) -> list[DrivenEpisode]:
    files: dict[str, tuple[list[EpisodeMetrics], list[list[EpisodeMetrics]]]] = {}
    for key in sorted(known):
        found = _METRICS.fullmatch(key.removeprefix(folder))
        assert found is not None
        whole, parts = files.setdefault(found[1], ([], []))
        if found[2]:
            parts.append(known[key][1])
        else:
            whole.extend(known[key][1])
    records = [
        record for whole, parts in files.values() for record in combined_metrics(whole, parts)
    ]
    numbered = [
        (record.iteration, record.phase == "evaluation", record.episode, record)
        for record in records
        if record.iteration is not None
    ]
    numbered.sort(key=lambda each: each[:3])
    return [
        DrivenEpisode(iteration, int(evaluation), record.reward_score, record.completion_percentage)
        for iteration, evaluation, _, record in numbered
    ]
