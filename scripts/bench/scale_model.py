"""A model of a training with many workers: who waits for which request, and for how long.

Events are worked off in the order of their time, as in any discrete-event simulation. The exchange
is that of docs/architecture.md: a checkpoint is published, workers notice it, fetch it, drive their
share, deliver it; the trainer notices that, fetches everything, learns, and publishes the next.
"""

import heapq
import math
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

PAGE = 1000
"""Objects of one answer to a LIST request. Source: the documentation of S3."""


@dataclass(frozen=True)
class Costs:
    """What each piece of work takes, as it was measured or is offered.

    Attributes:
        round_trip_s: From a machine to the bucket and back.
        put_s: Service time of a PUT in the bucket, besides its bytes.
        get_s: Of a GET.
        list_s: Of a page of a LIST.
        worker_bytes_per_s: Network of a worker.
        trainer_bytes_per_s: Network of the trainer.
        puts_per_s: PUT and LIST requests that the prefix of the model may have per second.
        gets_per_s: GET requests.
        weights_bytes: Of a checkpoint, as a worker fetches it.
        state_bytes: What the trainer writes beside them for each checkpoint.
        step_bytes: Of a step in rollouts.
        trace_bytes: Of a step in traces and metrics.
        worker_puts: PUT requests of a worker for each iteration, one after the other.
        worker_gets: GET requests of a worker for each checkpoint besides its weights.
        trainer_puts: PUT requests of the trainer for each checkpoint that workers wait for.
        step_s: Time for a step of one car in a worker.
        drive_s: Time of a worker for each iteration besides its steps.
        learn_step_s: Learning from one step.
        learn_s: The trainer's time for each iteration besides steps and requests.
        episode_steps: Mean length of an episode.
        spread: Share by which the driving time of workers varies, as a standard deviation.
    """

    round_trip_s: float = 0.0
    put_s: float = 0.0
    get_s: float = 0.0
    list_s: float = 0.0
    worker_bytes_per_s: float = math.inf
    trainer_bytes_per_s: float = math.inf
    puts_per_s: float = math.inf
    gets_per_s: float = math.inf
    weights_bytes: float = 0.0
    state_bytes: float = 0.0
    step_bytes: float = 0.0
    trace_bytes: float = 0.0
    worker_puts: int = 4
    worker_gets: int = 3
    trainer_puts: int = 3
    step_s: float = 0.01
    drive_s: float = 0.0
    learn_step_s: float = 0.0
    learn_s: float = 0.0
    episode_steps: float = 100.0
    spread: float = 0.0


@dataclass(frozen=True)
class Setup:
    """How a training is set up.

    Attributes:
        workers: Simulation workers.
        episodes: Of an iteration, num_episodes_between_training.
        ahead: How many checkpoints the workers may be behind: 1 with DR_TRAIN_OVERLAP=on.
        look_s: Longest pause between two looks for something new.
        look_share: A pause is this share of the time that was waited, as for buckets elsewhere.
        renew_s: How often a worker renews its record.
        members_s: How often the trainer reads the records of workers.
        member_reads: Records that it reads at the same time.
        manifest_reads: Manifests that it reads at the same time.
        part_reads: Parts of rollouts that it reads at the same time.
    """

    workers: int = 1
    episodes: int = 20
    ahead: int = 0
    look_s: float = 1.0
    look_share: float = 0.03
    renew_s: float = 5.0
    members_s: float = 10.0
    member_reads: int = 1
    manifest_reads: int = 1
    part_reads: int = 2


@dataclass
class Outcome:
    """What came of it.

    Attributes:
        iterations: Learned from, after the first ones.
        steps: Of these.
        seconds: They took.
        learning_s: Of these, the trainer learned.
        driving_s: Of these, all workers together drove.
        workers: Their number.
        requests: By kind: put, get, list.
        sent_bytes: From the machines to the bucket.
        received_bytes: From the bucket to the machines.
        waits_s: The trainer's time by what it did: learn, drive (it waited for workers), fetch,
            members, publish.
    """

    iterations: int = 0
    steps: float = 0.0
    seconds: float = 0.0
    learning_s: float = 0.0
    driving_s: float = 0.0
    workers: int = 1
    requests: Counter[str] = field(default_factory=Counter)
    sent_bytes: float = 0.0
    received_bytes: float = 0.0
    waits_s: Counter[str] = field(default_factory=Counter)

    @property
    def iterations_per_s(self) -> float:
        """Iterations per second."""
        return self.iterations / self.seconds

    @property
    def steps_per_s(self) -> float:
        """Steps learned from per second."""
        return self.steps / self.seconds

    @property
    def learner_idle(self) -> float:
        """Share of the time in which the trainer does not learn."""
        return 1.0 - self.learning_s / self.seconds

    @property
    def worker_idle(self) -> float:
        """Share of the time in which a worker does not drive."""
        return 1.0 - self.driving_s / (self.seconds * self.workers)


class Station:
    """Serves requests in the order in which they come, some at a time.

    Args:
        servers: How many at a time.
    """

    def __init__(self, servers: int = 1) -> None:
        self._free_s = [0.0] * servers

    def serve(self, now_s: float, service_s: float) -> float:
        """When a request that comes now has been served."""
        start_s = max(now_s, heapq.heappop(self._free_s))
        heapq.heappush(self._free_s, start_s + service_s)
        return start_s + service_s


class Model:
    """A training with these costs, from its first checkpoint on.

    Args:
        costs: Of each piece of work.
        setup: Of the training.
        seed: Of the differences between workers.
    """

    def __init__(self, costs: Costs, setup: Setup, seed: int = 1) -> None:
        self._costs = costs
        self._setup = setup
        self._chance = random.Random(seed)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        self.now_s = 0.0
        self.outcome = Outcome(workers=setup.workers)
        self._puts, self._gets, self._link = Station(), Station(), Station()
        self._published = [0.0]
        self._delivered: list[int] = []
        self._done = 0
        self._goal = 0
        self._members_s = 0.0
        self._trainer_waits_since_s = 0.0
        self._fetching = False

    def run(self, iterations: int, skipped: int = 3) -> Outcome:
        """Let the training run for some iterations, without the first ones, and say what came."""
        self._goal = iterations + skipped
        self._delivered = [0] * (self._goal + 2)
        for worker in range(self._setup.workers):
            self._at(self.now_s, lambda worker=worker: self._notice(worker, 0))  # type: ignore[misc]
            phase_s = self._chance.random() * self._setup.renew_s
            self._at(phase_s, self._renew)
        self._at(0.0, self._wait_for_rollouts)
        began_s = 0.0
        measured = False
        while self._events and self._done < self._goal:
            self.now_s, _, event = heapq.heappop(self._events)
            event()
            if not measured and self._done >= skipped:
                measured, began_s = True, self.now_s
                self.outcome = Outcome(workers=self._setup.workers)
        self.outcome.seconds = self.now_s - began_s
        return self.outcome

    def _at(self, when_s: float, event: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._events, (when_s, self._count, event))

    # --- Requests ----------------------------------------------------------------------------

    def _request(self, kind: str, when_s: float, size: float, *, trainer: bool) -> float:
        """When the answer to a request is there."""
        costs = self._costs
        self.outcome.requests[kind] += 1
        writes = kind in ("put", "list")
        limit = costs.puts_per_s if writes else costs.gets_per_s
        served_s = (self._puts if writes else self._gets).serve(when_s, 1.0 / limit)
        service_s = {"put": costs.put_s, "get": costs.get_s, "list": costs.list_s}[kind]
        there_s = served_s + service_s + costs.round_trip_s
        if kind == "put":
            self.outcome.sent_bytes += size
        else:
            self.outcome.received_bytes += size
        if trainer:
            return self._link.serve(there_s, size / costs.trainer_bytes_per_s)
        return there_s + size / costs.worker_bytes_per_s

    def _requests(self, kind: str, count: int, at_once: int, size: float) -> float:
        """When all of many requests of the trainer are answered, so many at the same time."""
        threads = [self.now_s] * max(1, min(at_once, count))
        for _ in range(count):
            begins_s = heapq.heappop(threads)
            heapq.heappush(threads, self._request(kind, begins_s, size, trainer=True))
        return max(threads)

    def _pause(self, waited_s: float) -> float:
        return min(self._setup.look_s, max(0.06, self._setup.look_share * waited_s))

    # --- A worker ----------------------------------------------------------------------------

    def _renew(self) -> None:
        self._request("put", self.now_s, 300.0, trainer=False)
        self._at(self.now_s + self._setup.renew_s, self._renew)

    def _notice(self, worker: int, iteration: int, since_s: float | None = None) -> None:
        """Look for the checkpoint of an iteration; one `ahead` of it will do."""
        since_s = self.now_s if since_s is None else since_s
        answered_s = self._request("get", self.now_s, 200.0, trainer=False)
        needed = max(0, iteration - self._setup.ahead)
        if needed < len(self._published) and self._published[needed] <= self.now_s:
            self._at(answered_s, lambda: self._fetch(worker, iteration))
            return
        again_s = answered_s + self._pause(answered_s - since_s)
        self._at(again_s, lambda: self._notice(worker, iteration, since_s))

    def _fetch(self, worker: int, iteration: int) -> None:
        when_s = self.now_s
        for _ in range(self._costs.worker_gets):
            when_s = self._request("get", when_s, 2000.0, trainer=False)
        when_s = self._request("get", when_s, self._costs.weights_bytes, trainer=False)
        steps = self._steps_of(worker)
        pace = max(0.2, self._chance.gauss(1.0, self._costs.spread))
        took_s = self._costs.drive_s + steps * self._costs.step_s * pace if steps else 0.0
        self.outcome.driving_s += took_s
        self._at(when_s + took_s, lambda: self._deliver(worker, iteration, steps))

    def _steps_of(self, worker: int) -> float:
        """Steps of a worker's share: no episode is split."""
        episodes, workers = self._setup.episodes, self._setup.workers
        own = episodes * (worker + 1) // workers - episodes * worker // workers
        return own * self._costs.episode_steps

    def _deliver(self, worker: int, iteration: int, steps: float) -> None:
        when_s = self.now_s
        if steps:
            costs = self._costs
            when_s = self._request("put", when_s, steps * costs.step_bytes, trainer=False)
            when_s = self._request("put", when_s, steps * costs.trace_bytes, trainer=False)
            for _ in range(costs.worker_puts - 2):
                when_s = self._request("put", when_s, 1000.0, trainer=False)
        self._at(when_s, lambda: self._delivery(iteration))
        if iteration + 1 < self._goal:
            self._at(when_s, lambda: self._notice(worker, iteration + 1))

    def _delivery(self, iteration: int) -> None:
        self._delivered[iteration] += 1

    # --- The trainer -------------------------------------------------------------------------

    def _wait_for_rollouts(self) -> None:
        """Look for the rollouts of the next iteration until all are there."""
        began_s = self._trainer_waits_since_s
        answered_s = self.now_s
        for _ in range(math.ceil(2 * self._drivers / PAGE)):
            answered_s = self._request("list", answered_s, 300.0 * PAGE, trainer=True)
        if self._delivered[self._done] >= self._setup.workers:
            self.outcome.waits_s["drive"] += self.now_s - began_s
            self._at(answered_s, self._collect)
            return
        again_s = answered_s + self._pause(answered_s - began_s)
        if self.now_s >= self._members_s:
            read_s = self._read_members()
            self.outcome.waits_s["members"] += read_s - self.now_s
            self._members_s = read_s + self._setup.members_s
            again_s = max(again_s, read_s)
        self._at(again_s, self._wait_for_rollouts)

    @property
    def _drivers(self) -> int:
        return min(self._setup.workers, self._setup.episodes)

    def _read_members(self) -> float:
        """Read the records of all workers that have renewed theirs."""
        workers, setup = self._setup.workers, self._setup
        pages_s = self._requests("list", math.ceil(workers / PAGE), 1, 300.0 * PAGE)
        changed = workers if setup.members_s >= setup.renew_s else workers // 2
        return max(pages_s, self._requests("get", changed, setup.member_reads, 300.0))

    def _collect(self) -> None:
        began_s, drivers = self.now_s, self._drivers
        read_s = self._requests("get", drivers, self._setup.manifest_reads, 1500.0)
        steps = self._setup.episodes * self._costs.episode_steps
        part = steps * self._costs.step_bytes / drivers
        # Parts are fetched while manifests are read.
        read_s = max(read_s, self._requests("get", drivers, self._setup.part_reads, part))
        self.outcome.waits_s["fetch"] += read_s - began_s
        learns_s = self._costs.learn_s + steps * self._costs.learn_step_s
        self.outcome.learning_s += learns_s
        self.outcome.waits_s["learn"] += learns_s
        self._at(read_s + learns_s, lambda: self._publish(steps))

    def _publish(self, steps: float) -> None:
        began_s = when_s = self.now_s
        when_s = self._request("put", when_s, self._costs.weights_bytes, trainer=True)
        for _ in range(self._costs.trainer_puts - 1):
            when_s = self._request("put", when_s, 2000.0, trainer=True)
        self.outcome.waits_s["publish"] += when_s - began_s
        # What no worker waits for is written while the workers drive.
        self._request("put", when_s, self._costs.state_bytes, trainer=True)
        self._at(when_s, lambda: self._published_now(steps))

    def _published_now(self, steps: float) -> None:
        self._published.append(self.now_s)
        self.outcome.iterations += 1
        self.outcome.steps += steps
        self._done += 1
        self._trainer_waits_since_s = self.now_s
        self._at(self.now_s, self._wait_for_rollouts)


def predicted(costs: Costs, setup: Setup, iterations: int = 20, seed: int = 1) -> Outcome:
    """What a training with these costs and this setup comes to."""
    return Model(costs, setup, seed).run(iterations)
