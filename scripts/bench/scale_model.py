"""A model of a training with many workers: who waits for which request, and for how long.

Events are worked off in the order of their time, as in any discrete-event simulation. The exchange
is that of docs/architecture.md: a checkpoint is published, workers notice it, fetch it, drive their
share, deliver it; the trainer notices that, fetches everything, learns, and publishes the next.
"""

import heapq
import math
import random
from collections import Counter, defaultdict
from collections.abc import Callable, Generator
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
        episode_spread: Standard deviation of that, as a share of the mean. The shorter a share of
            episodes, the more its length differs from that of the others.
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
    episode_spread: float = 0.0
    spread: float = 0.0


@dataclass(frozen=True)
class Setup:
    """How a training is set up.

    Attributes:
        workers: Simulation workers.
        episodes: Of an iteration, num_episodes_between_training.
        ahead: How many checkpoints the workers may be behind: DR_TRAIN_MAX_LAG, or 0 with
            DR_TRAIN_OVERLAP=off.
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
        lags: How many iterations older than the trainer's the weights were that drove a share, by
            how often.
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
    lags: Counter[int] = field(default_factory=Counter)
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


@dataclass(frozen=True)
class Request:
    """A request to the bucket."""

    kind: str
    size: float
    trainer: bool = False


Process = Generator[float | Request | list["Process"], None, None]
"""What a machine does: it waits so many seconds, for the answer to a request, or for the end of
several processes."""


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
        self._newest = 0
        self._delivered: Counter[int] = Counter()
        self._steps: dict[int, float] = defaultdict(float)
        self._drove: dict[int, Counter[int]] = {}
        self._members_s = setup.members_s

    def run(self, iterations: int, skipped: int = 3) -> Outcome:
        """Let the training run for some iterations, without the first ones, and say what came."""
        for worker in range(self._setup.workers):
            self._start(self._drive(worker))
            self._start(self._renew())
        self._start(self._train())
        began_s: float | None = None
        while self._newest < iterations + skipped:
            self.now_s, _, event = heapq.heappop(self._events)
            event()
            if began_s is None and self._newest >= skipped:
                began_s = self.now_s
                self.outcome = Outcome(workers=self._setup.workers)
        self.outcome.seconds = self.now_s - (began_s or 0.0)
        return self.outcome

    # --- Processes and requests --------------------------------------------------------------

    def _at(self, when_s: float, event: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._events, (when_s, self._count, event))

    def _start(self, process: Process, ended: Callable[[], None] = lambda: None) -> None:
        """Let a process go on until it waits for something."""
        try:
            awaited = next(process)
        except StopIteration:
            ended()
            return

        def go_on() -> None:
            self._start(process, ended)

        if isinstance(awaited, Request):
            self._send(awaited, go_on)
        elif isinstance(awaited, list):
            self._start_all(awaited, go_on)
        else:
            self._at(self.now_s + awaited, go_on)

    def _start_all(self, processes: list[Process], go_on: Callable[[], None]) -> None:
        left = len(processes)

        def ended() -> None:
            nonlocal left
            left -= 1
            if left == 0:
                go_on()

        for process in processes:
            self._start(process, ended)

    def _send(self, request: Request, answered: Callable[[], None]) -> None:
        """Serve a request: the bucket first, then the network of the machine."""
        costs = self._costs
        self.outcome.requests[request.kind] += 1
        writes = request.kind in ("put", "list")
        limit = costs.puts_per_s if writes else costs.gets_per_s
        served_s = (self._puts if writes else self._gets).serve(self.now_s, 1.0 / limit)
        service_s = {"put": costs.put_s, "get": costs.get_s, "list": costs.list_s}[request.kind]
        if request.kind == "put":
            self.outcome.sent_bytes += request.size
        else:
            self.outcome.received_bytes += request.size
        there_s = served_s + service_s + costs.round_trip_s

        def over_the_link() -> None:
            seconds = request.size / costs.trainer_bytes_per_s
            self._at(self._link.serve(self.now_s, seconds), answered)

        if request.trainer:
            self._at(there_s, over_the_link)
        else:
            self._at(there_s + request.size / costs.worker_bytes_per_s, answered)

    def _many(self, count: int, at_once: int, size: float) -> list[Process]:
        """GET requests of the trainer, so many at the same time."""
        left = count

        def thread() -> Process:
            nonlocal left
            while left > 0:
                left -= 1
                yield Request("get", size, trainer=True)

        return [thread() for _ in range(max(1, min(at_once, count)))]

    def _pause(self, waited_s: float) -> float:
        return min(self._setup.look_s, max(0.06, self._setup.look_share * waited_s))

    # --- A worker ----------------------------------------------------------------------------

    def _renew(self) -> Process:
        """Renew the record of a worker again and again."""
        yield self._chance.random() * self._setup.renew_s
        while True:
            yield Request("put", 300.0)
            yield self._setup.renew_s

    def _drive(self, worker: int) -> Process:
        """Drive one iteration after the other."""
        costs, iteration, episodes, loaded = self._costs, 0, self._episodes_of(worker), -1
        while not episodes:  # it asks for a share once a second
            yield Request("get", 2000.0)
            yield 1.0
        while True:
            began_s = self.now_s
            yield Request("get", 200.0)
            while self._newest < iteration - self._setup.ahead:
                yield self._pause(self.now_s - began_s)
                yield Request("get", 200.0)
            for _ in range(costs.worker_gets):
                yield Request("get", 2000.0)
            if loaded < self._newest:
                loaded = self._newest
                yield Request("get", costs.weights_bytes)
            self._drove.setdefault(iteration, Counter())[loaded] += 1
            steps = self._drawn(episodes)
            pace = max(0.2, self._chance.gauss(1.0, costs.spread))
            took_s = costs.drive_s + steps * costs.step_s * pace
            yield took_s
            self.outcome.driving_s += took_s
            yield Request("put", steps * costs.step_bytes)
            yield Request("put", steps * costs.trace_bytes)
            for _ in range(costs.worker_puts - 2):
                yield Request("put", 1000.0)
            self._steps[iteration] += steps
            self._delivered[iteration] += 1
            iteration += 1

    def _episodes_of(self, worker: int) -> int:
        """A worker's share: no episode is split."""
        episodes, workers = self._setup.episodes, self._setup.workers
        return episodes * (worker + 1) // workers - episodes * worker // workers

    def _drawn(self, episodes: int) -> float:
        """Steps of so many episodes."""
        mean, spread = self._costs.episode_steps, self._costs.episode_spread
        if not spread:
            return episodes * mean
        return self._chance.gammavariate(episodes / spread**2, mean * spread**2)

    # --- The trainer -------------------------------------------------------------------------

    def _train(self) -> Process:
        """Wait, fetch, learn and publish, again and again."""
        costs, setup = self._costs, self._setup
        drivers = min(setup.workers, setup.episodes)
        while True:
            yield from self._wait_for_rollouts(drivers)
            steps = self._steps.pop(self._newest)
            for checkpoint, times in self._drove.pop(self._newest).items():
                self.outcome.lags[self._newest - checkpoint] += times
            began_s = self.now_s
            # Parts are fetched while manifests are read.
            part = steps * costs.step_bytes / drivers
            yield [
                *self._many(drivers, setup.manifest_reads, 1500.0),
                *self._many(drivers, setup.part_reads, part),
            ]
            self.outcome.waits_s["fetch"] += self.now_s - began_s
            learns_s = costs.learn_s + steps * costs.learn_step_s
            yield learns_s
            self.outcome.learning_s += learns_s
            self.outcome.waits_s["learn"] += learns_s
            began_s = self.now_s
            yield Request("put", costs.weights_bytes, trainer=True)
            for _ in range(costs.trainer_puts - 1):
                yield Request("put", 2000.0, trainer=True)
            self.outcome.waits_s["publish"] += self.now_s - began_s
            self._newest += 1
            self.outcome.iterations += 1
            self.outcome.steps += steps
            # No worker waits for the rest.
            self._start(self._write_state())

    def _write_state(self) -> Process:
        yield Request("put", self._costs.state_bytes, trainer=True)

    def _wait_for_rollouts(self, drivers: int) -> Process:
        """Look for the rollouts of this iteration until all are there."""
        began_s = self.now_s
        while True:
            complete = self._delivered[self._newest] >= drivers
            for _ in range(math.ceil(2 * drivers / PAGE)):
                yield Request("list", 600.0 * drivers, trainer=True)
            if complete:
                self.outcome.waits_s["drive"] += self.now_s - began_s
                return
            if self.now_s >= self._members_s:
                read_s = self.now_s
                yield from self._read_members()
                self.outcome.waits_s["members"] += self.now_s - read_s
                began_s += self.now_s - read_s
                self._members_s = self.now_s + self._setup.members_s
            yield self._pause(self.now_s - began_s)

    def _read_members(self) -> Process:
        """Read the records of all workers that have renewed theirs."""
        workers, setup = self._setup.workers, self._setup
        for _ in range(math.ceil(workers / PAGE)):
            yield Request("list", 300.0 * min(workers, PAGE), trainer=True)
        yield self._many(workers, setup.member_reads, 300.0)


def predicted(costs: Costs, setup: Setup, iterations: int = 20, seed: int = 1) -> Outcome:
    """What a training with these costs and this setup comes to."""
    return Model(costs, setup, seed).run(iterations, skipped=min(3, iterations))
