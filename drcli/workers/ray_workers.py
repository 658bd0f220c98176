"""Lets Ray place the simulation workers of a training: `python -m drcli.workers.ray_workers`.

Each worker is an actor whose process joins the training through the bucket, as `dr-start-worker`
does. This process asks Ray for the actors, starts another one if a node is gone, and writes what
the workers say into their logs on this machine, where `dr-logs` finds it also afterwards.
"""

import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Protocol

from drcli.base.errors import SettingsError, WorkerDied
from drcli.base.log import get_logger
from drcli.config import secret_environment
from drcli.exchange.job import Job
from drcli.workers import worker_process
from drcli.workers.ray_extra import KEYS, connect
from drcli.workers.ray_host import WorkerHost
from drcli.workers.worker_process import Activity, Lifeline

_logger = get_logger(__name__)

NAME = "ray"

LOOK_S = 0.5
"""How often the workers are looked at."""

LEAVE_S = 8.0
"""How long workers may take to leave the training at its end."""

MOST_DEATHS = 3
"""How often in a row a worker may end by itself within `QUICK_S`."""

QUICK_S = 30.0


class Placed(Protocol):
    """A worker that Ray places on a node."""

    def look(self) -> tuple[str, list[str], int | None] | None:
        """What `WorkerHost.look` has answered; None while there is no new answer.

        Raises:
            NodeLost: Its node, or its process there, is gone.
        """
        ...

    def stop(self) -> None:
        """Let the worker leave the training."""
        ...

    def give_back(self) -> None:
        """Give its place on the node back."""
        ...


class NodeLost(Exception):
    """The node of a worker is gone, or Ray's process there."""


class Cluster(Protocol):
    """Places workers."""

    def place(self) -> Placed:
        """Ask for a place for one more worker; it may come later."""
        ...


class Seat:
    """One of the workers of a training, on whichever node it is."""

    def __init__(self, number: int, placed: Placed) -> None:
        self.number = number
        self.placed = placed
        self.node = ""
        self.began_s = time.monotonic()
        self.deaths = 0
        self.over = False


class RayWorkers:
    """Keeps so many workers in a training.

    Args:
        cluster: Places them.
        count: Their number.
    """

    def __init__(self, cluster: Cluster, count: int) -> None:
        self._cluster = cluster
        self._seats = [Seat(number, cluster.place()) for number in range(count)]

    def look(self) -> str:
        """Look at all workers, and place those again that are gone; says what they do.

        Raises:
            SettingsError: A node may not join the training, with the reason.
            WorkerDied: A worker ends again and again.
        """
        for seat in self._seats:
            if not seat.over:
                self._look_at(seat)
        nodes = [seat.node for seat in self._seats if seat.node]
        missing = sum(not (seat.node or seat.over) for seat in self._seats)
        said = [f"{nodes.count(node)} on {node}" for node in dict.fromkeys(nodes)]
        waits = [f"{missing} wait for a node with free cores"] if missing else []
        return f"workers: {', '.join(said + waits) or 'none'}"

    def leave(self) -> None:
        """Let all workers leave the training, and give their places back."""
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
            _logger.warning("Worker %d: %s It is placed again.", seat.number, error)
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
    """A cluster of Ray, or Ray on this machine alone.

    Args:
        job: The training.
        arguments: Of `dr-start-worker`.

    Raises:
        NotAvailable: Ray is not installed.
        SettingsError: The cluster does not answer, or its other machines cannot reach the bucket.
    """

    def __init__(self, job: Job, arguments: Sequence[str]) -> None:
        train, storage = job.config.train, job.config.storage
        self._ray: Any = connect(train.ray_address, storage.cloud)
        self._job = job
        self._arguments = list(arguments)

    def place(self) -> Placed:
        """Ask for a place for one more worker; it may come later."""
        threads = self._job.config.train.threads or 1
        known = secret_environment.all_secrets()
        keys = {name: known[name] for name in KEYS if name in known}
        actor = self._ray.remote(WorkerHost)
        options = actor.options(num_cpus=threads, max_restarts=0, scheduling_strategy="SPREAD")
        folder = str(self._job.directory)
        return PlacedActor(self._ray, options.remote(self._arguments, folder, keys, threads))

    def close(self) -> None:
        """Leave the cluster; Ray that was started here ends."""
        self._ray.shutdown()


class PlacedActor:
    """A worker in an actor of Ray."""

    def __init__(self, ray: Any, actor: Any) -> None:
        self._ray = ray
        self._actor = actor
        self._asked: Any = None

    def look(self) -> tuple[str, list[str], int | None] | None:
        """What the actor has answered since the last look; see `Placed`."""
        errors = self._ray.exceptions
        if self._asked is None:
            self._asked = self._actor.look.remote()
        done, _ = self._ray.wait([self._asked], timeout=0.2)
        if not done:
            return None
        asked, self._asked = self._asked, None
        try:
            found: tuple[str, list[str], int | None] = self._ray.get(asked)
        except (errors.RayActorError, errors.NodeDiedError) as error:
            raise NodeLost(f"Its node is gone ({type(error).__name__}).") from None
        return found

    def stop(self) -> None:
        """Let the worker leave the training."""
        self._actor.stop.remote()

    def give_back(self) -> None:
        """Give its place on the node back."""
        with suppress(self._ray.exceptions.RayError, ValueError):
            self._ray.kill(self._actor)


def join_arguments(job: Job) -> list[str]:
    """What follows `dr-start-worker` on a node."""
    storage, prefix = job.config.storage, job.config.model.prefix
    found = ["--join", f"s3://{storage.bucket}/{prefix}", "--wait", "--no-take-over"]
    if storage.endpoint_url is not None:
        found += ["--endpoint-url", storage.endpoint_url]
    if storage.cloud != "local":
        found += ["--region", storage.region]
        if storage.profile is not None:
            found += ["--profile", storage.profile]
    return [*found, "--end-with-parent"]


def main(job: Job, lifeline: Lifeline) -> None:
    """Keep the workers in the training until this process is to end."""
    bucket = worker_process.open_own_bucket(job, lifeline)
    activity = Activity(bucket, job.config.model.prefix, NAME, lifeline.pulse)
    cluster = RayCluster(job, join_arguments(job))
    try:
        workers = RayWorkers(cluster, job.ray_workers)
        try:
            while not lifeline.should_stop():
                activity.wait(workers.look())
                time.sleep(LOOK_S)
        finally:
            workers.leave()
    finally:
        activity.close()
        cluster.close()


if __name__ == "__main__":
    worker_process.run(NAME, main)
