"""Lets Ray place the simulation workers: `python -m drcli.run.launchers.ray_workers`.

Each is an actor that joins through the bucket, as `dr-start-worker` does. This process replaces
those whose node is gone, and writes their logs on this machine, for `dr-logs`.
"""

import time
from collections import Counter
from collections.abc import Sequence
from typing import Any, Protocol

from drcli.base.errors import SettingsError, WorkerDied
from drcli.base.log import get_logger
from drcli.model.model_store import ModelStore
from drcli.records.job import Job
from drcli.train.ray_cluster import NodeLost, PlacedActor, connected, keys_for_nodes
from drcli.train.ray_host import WorkerHost
from drcli.workers import worker_process
from drcli.workers.worker_process import Activity, StopSignal

_logger = get_logger(__name__)

NAME = "ray"

POLL_S = 0.5
LEAVE_S = 8.0
MOST_DEATHS = 3
"""In a row, by itself within `QUICK_S`."""

QUICK_S = 30.0

MOST_NAMED = 4


class Placed(Protocol):
    def look(self) -> tuple[str, list[str], int | None] | None:
        """As `WorkerHost.look`, or None.

        Raises:
            NodeLost: Its node, or its process there, is gone.
        """
        ...

    def stop(self) -> None: ...

    def give_back(self) -> None: ...


class Cluster(Protocol):
    def place(self) -> Placed: ...


class Seat:
    def __init__(self, number: int, placed: Placed) -> None:
        self.number = number
        self.placed = placed
        self.node = ""
        self.began_s = time.monotonic()
        self.deaths = 0
        self.over = False


class RayWorkers:
    def __init__(self, cluster: Cluster, count: int) -> None:
        self._cluster = cluster
        self._seats = [Seat(number, cluster.place()) for number in range(count)]

    def look(self) -> str:
        """Place again what is gone; says what the workers do.

        Raises:
            SettingsError: A node may not join the training, with the reason.
            WorkerDied: A worker ends again and again.
        """
        for seat in self._seats:
            if not seat.over:
                self._look_at(seat)
        nodes = Counter(seat.node for seat in self._seats if seat.node)
        missing = sum(not (seat.node or seat.over) for seat in self._seats)
        said = [f"{count} on {node}" for node, count in nodes.items()]
        if len(said) > MOST_NAMED:
            said = [f"{nodes.total()} on {len(nodes)} nodes"]
        waits = [f"{missing} wait for a node with free cores"] if missing else []
        return f"workers: {', '.join(said + waits) or 'none'}"

    def leave(self) -> None:
        left = [seat for seat in self._seats if not seat.over]
        for seat in left:
            seat.placed.stop()
        ends_s = time.monotonic() + LEAVE_S
        while left and time.monotonic() < ends_s:
            left = [seat for seat in left if not self._has_ended(seat)]
            time.sleep(0.1)
        for seat in self._seats:
            seat.placed.give_back()

    def _has_ended(self, seat: Seat) -> bool:
        try:
            seen = seat.placed.look()
        except NodeLost:
            return True
        # One that was never placed has nothing to end.
        return not seat.node if seen is None else seen[2] is not None

    def _look_at(self, seat: Seat) -> None:
        try:
            seen = seat.placed.look()
        except NodeLost as error:
            _logger.warning(
                "Worker %d: its node is gone (%s). It is placed again.", seat.number, error
            )
            self._place_again(seat)
            return
        if seen is None:
            return
        node, lines, code = seen
        if not seat.node:
            _logger.info("Worker %d drives on %s.", seat.number, node)
            seat.node, seat.began_s = node, time.monotonic()
        for line in lines:
            _logger.info("Worker %d: %s", seat.number, line)
        if code is None:
            return
        if code == 0:  # the training has ended
            seat.over, seat.node = True, ""
            return
        if code == SettingsError.code:
            said = " ".join(lines[-2:]) or "its log says why"
            raise SettingsError(
                f"A worker on {node} cannot join: {said}",
                remedy="Install the same version of drcli on all nodes, and give them the keys to "
                "the bucket.",
            )
        quick = time.monotonic() - seat.began_s < QUICK_S
        seat.deaths = seat.deaths + 1 if quick else 0
        if seat.deaths >= MOST_DEATHS:
            raise WorkerDied(
                f"Worker {seat.number} ended {seat.deaths} times in a row, on {node} with exit "
                f"code {code}.",
                remedy="Read its last words with `dr-logs ray`.",
            )
        _logger.warning("Worker %d ended with exit code %d; placed again.", seat.number, code)
        self._place_again(seat)

    def _place_again(self, seat: Seat) -> None:
        seat.placed.give_back()
        seat.placed, seat.node = self._cluster.place(), ""


class RayCluster:
    def __init__(self, ray: Any, job: Job, arguments: Sequence[str]) -> None:
        self._ray = ray
        self._job = job
        self._arguments = list(arguments)

    def place(self) -> Placed:
        threads = self._job.config.train.threads or 1
        actor = self._ray.remote(WorkerHost)
        options = actor.options(num_cpus=threads, max_restarts=0, scheduling_strategy="SPREAD")
        folder = str(self._job.directory)
        placed = options.remote(self._arguments, folder, keys_for_nodes(), threads)
        return PlacedActor[tuple[str, list[str], int | None]](self._ray, placed)


def join_arguments(job: Job) -> list[str]:
    storage, prefix = job.config.storage, job.config.model.prefix
    found = ["--join", f"s3://{storage.bucket}/{prefix}", "--wait", "--no-take-over"]
    if storage.endpoint_url is not None:
        found += ["--endpoint-url", storage.endpoint_url]
    if storage.cloud != "local":
        found += ["--region", storage.region]
        if storage.profile is not None:
            found += ["--profile", storage.profile]
    return [*found, "--end-with-parent"]


def main(job: Job, stop_signal: StopSignal) -> None:
    bucket = worker_process.open_own_bucket(job, stop_signal)
    activity = Activity(ModelStore(bucket, job.config.model.prefix), NAME, stop_signal.heartbeat)
    try:
        with connected(job) as ray:
            cluster = RayCluster(ray, job, join_arguments(job))
            workers = RayWorkers(cluster, job.ray_workers)
            try:
                while not stop_signal.should_stop():
                    activity.wait(workers.look())
                    time.sleep(POLL_S)
            finally:
                workers.leave()
    finally:
        activity.close()


if __name__ == "__main__":
    worker_process.run(NAME, main)
