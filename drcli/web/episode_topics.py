"""Topics of what was driven, from the bucket.

`episodes:RUN` has a row for each episode, `laps:RUN:WORKER` the lines of a worker's last iteration,
`elsewhere:RUN` who trains the model on another machine. RUN is DR_RUN_ID, WORKER a number.
"""

import re
from collections.abc import Callable, Sequence

from starlette.routing import BaseRoute

from drcli.base.errors import StorageError
from drcli.runs.seen_in_bucket import SeenRun, distant_run, read_lap_lines, seen_run
from drcli.store.history import HistoryReader
from drcli.store.metrics_reader import MetricsReader
from drcli.store.repair import readable_history
from drcli.web.hub import Polled, Publish
from drcli.web.served_folder import ServedFolder
from drcli.web.topics import Rows, Snapshot, Value

EPISODES_S = 2.0
LAPS_S = 2.0

ELSEWHERE_S = 4.0

_RUN = re.compile(r"(?:episodes|elsewhere):(\d{1,2})")

_LAPS = re.compile(r"laps:(\d{1,2}):(\d{1,3})")


def _numbers(pattern: re.Pattern[str], topic: str) -> list[int]:
    found = pattern.fullmatch(topic)
    if found is None:
        raise ValueError(topic)
    return [int(text) for text in found.groups()]


def _away(run: SeenRun) -> StorageError:
    return StorageError(
        f"The bucket of {run.prefix} is away: its server does not run.",
        remedy="It starts with the next training or `dr-list-models`; this page goes on by itself.",
    )


class EpisodeRows:
    """Of a run."""

    def __init__(self, topic: str, look: Callable[[], SeenRun]) -> None:
        self._look = look
        self._reader = MetricsReader()
        self._rows = Rows(topic)

    def read(self) -> Value:
        """Rows of iteration, 1 for an evaluation, reward, progress."""
        run = self._look()
        if run.model is None:
            raise _away(run)
        self._rows.update(self._reader.read(run.model.bucket, run.model.metrics_prefix))
        return self._rows


class LapReader:
    """After each iteration."""

    def __init__(self, topic: str, look: Callable[[], SeenRun], worker: int) -> None:
        self._topic, self._look, self._worker = topic, look, worker
        self._history = HistoryReader()
        self._read: tuple[str, int] | None = None

    def read(self) -> Value | None:
        """None if they were read before."""
        run = self._look()
        if run.model is None:
            self._read = None
            raise _away(run)
        history, _ = readable_history(run.model, self._history)
        newest = history[-1].iteration if history else -1
        if self._read == (run.prefix, newest):
            return None
        lines = []
        if newest >= 0:
            lines = read_lap_lines(run.model.bucket, run.prefix, newest, self._worker)
        self._read = run.prefix, newest
        iteration = newest if newest >= 0 else None
        return Snapshot.of(self._topic, {"iteration": iteration, "lines": lines})


def routes(folder: ServedFolder) -> Sequence[BaseRoute]:
    def look_at(run_id: int) -> Callable[[], SeenRun]:
        return lambda: seen_run(folder.settings(), run_id)

    def open_episodes(topic: str, publish: Publish) -> Polled:
        (run_id,) = _numbers(_RUN, topic)
        return Polled(topic, publish, EpisodeRows(topic, look_at(run_id)).read, EPISODES_S)

    def open_laps(topic: str, publish: Publish) -> Polled:
        run_id, worker = _numbers(_LAPS, topic)
        return Polled(topic, publish, LapReader(topic, look_at(run_id), worker).read, LAPS_S)

    def open_elsewhere(topic: str, publish: Publish) -> Polled:
        (run_id,) = _numbers(_RUN, topic)
        look = look_at(run_id)

        def read() -> Value:
            return Snapshot.of(topic, distant_run(look()))

        return Polled(topic, publish, read, ELSEWHERE_S)

    folder.hub.add_kind("episodes", open_episodes)
    folder.hub.add_kind("laps", open_laps)
    folder.hub.add_kind("elsewhere", open_elsewhere)
    return []
