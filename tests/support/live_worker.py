"""A live view over a small simulation, and viewers of it, without worker processes."""

import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from drcli.convert.build_network import TEACHER_DIMS
from drcli.drive.driving import Driven, Driver, Plan, Racer
from drcli.learn.actor_critic import ActorCritic, Teacher
from drcli.learn.data_parallel import DataParallelPolicy
from drcli.learn.policy import PolicySpec
from drcli.live.live_record import LiveAddress, LiveMessage, LiveView
from drcli.live.live_scene import LiveFacts, live_racer
from drcli.live.live_server import Pace
from drcli.live.live_view import LiveShow
from drcli.records.run_record import run_folder
from drsim.car.actions import ContinuousActions, DiscreteActions
from drsim.episode.episode_rules import EpisodeRules
from drsim.episode.reward import centre_line_reward
from drsim.episode.simulation import Simulation
from drsim.race.race import TIME_TRIAL, Race
from drsim.sensing.sensors import Sensors
from drsim.track.worlds import load_track

NETWORK = "COMPACT_CONVOLUTIONAL_NETWORK"
SOON_S = 20.0
"""A test fails after so long; usually everything comes within milliseconds."""

CHOICES = DiscreteActions(((0.0, 1.0), (20.0, 1.0), (-20.0, 1.0)))
RANGES = ContinuousActions((-30.0, 30.0), (0.5, 1.0))


def unlimited() -> Pace:
    """A pace that allows every step."""
    ticks = iter(range(1 << 30))
    return Pace(lambda: 1e3 * next(ticks), clock=lambda: 10.0 * next(ticks))


class SmallDrive:
    """Two cars with an untrained policy."""

    def __init__(
        self,
        *,
        spec: PolicySpec | None = None,
        race: Race = TIME_TRIAL,
        sensors: Sensors | None = None,
        max_steps: int = 8,
    ) -> None:
        torch.set_num_threads(1)
        torch.manual_seed(0)
        spec = spec or PolicySpec(3, network=NETWORK)
        self.racer = Racer(
            DataParallelPolicy(ActorCritic(spec).eval(), 1),
            RANGES if spec.continuous else CHOICES,
        )
        self.teacher: Racer | None = None
        self.simulation = Simulation(
            load_track("reinvent_base"),
            num_cars=2,
            reward_function=centre_line_reward,
            rules=EpisodeRules(max_steps=max_steps),
            num_threads=1,
            sensors=sensors,
            race=race,
        )

    def episodes(
        self, observer: Any = None, count: int = 2, after_step: Callable[[], Any] = lambda: None
    ) -> list[Driven]:
        """Drive so many episodes."""
        driven: list[Driven] = []
        racers = [self.racer, self.racer] if self.teacher is None else [self.racer, self.teacher]

        def stop() -> bool:
            after_step()
            return False

        who = 0 if self.teacher is None else 1
        plans = [Plan(number, "training", 0.2 * number, racer=who) for number in range(count)]
        Driver(self.simulation, racers, 5, observer=observer).drive(plans, driven.append, stop)
        return sorted(driven, key=lambda episode: episode.number)

    def teach(self) -> None:
        """Let a teacher drive from now on, for which nothing is drawn."""
        model = ActorCritic(PolicySpec(3, network=NETWORK, state_dims=TEACHER_DIMS, taught=True))
        self.teacher = Racer(Teacher(model).eval(), self.racer.actions)
        self.simulation.draws = False

    def close(self) -> None:
        """Free its threads."""
        self.simulation.close()


@contextmanager
def shown(
    folder: Path,
    *,
    activity: Callable[[], tuple[str, bool]] = lambda: ("drives iteration 3", False),
    pace: Pace | None = None,
    name: str = "sim-0",
    run_id: int = 0,
) -> Iterator[tuple[LiveShow, LiveAddress]]:
    """A live view that listens, with its file in a working folder."""
    address = LiveAddress.own(0)
    facts = LiveFacts("TIME_TRIAL", [live_racer("model-1", "Blue")])
    show = LiveShow(name, activity, facts, address.secret, pace=pace or unlimited())
    address = replace(address, port=show.port)
    address.write(run_folder(folder, run_id), name)
    try:
        yield show, address
    finally:
        address.delete(run_folder(folder, run_id), name)
        show.close()


@contextmanager
def driving(folder: Path, name: str = "sim-0") -> Iterator[LiveShow]:
    """A worker with a live view that drives until the block is left."""
    drive, ended = SmallDrive(), threading.Event()

    class Ended(Exception):
        pass

    def rest() -> None:
        if ended.wait(0.02):
            raise Ended

    def go() -> None:
        with suppress(Ended):
            while True:
                drive.episodes(show, after_step=rest)

    # The view draws from the simulation until it is closed.
    with closing(drive), shown(folder, name=name) as (show, _):
        thread = threading.Thread(target=go, daemon=True)
        thread.start()
        try:
            yield show
        finally:
            ended.set()
            thread.join(SOON_S)


class Received:
    """Messages of a feed, in order."""

    def __init__(self) -> None:
        self.messages: queue.Queue[tuple[int, str, LiveMessage]] = queue.Queue()
        self.gone: queue.Queue[tuple[int, str]] = queue.Queue()

    def take(self, run_id: int, worker: str, message: LiveMessage) -> None:
        """Callback of a feed."""
        self.messages.put((run_id, worker, message))

    def leave(self, run_id: int, worker: str) -> None:
        """Callback of a feed."""
        self.gone.put((run_id, worker))

    def next(self, *views: LiveView) -> LiveMessage:
        """The next message of one of the views."""
        while True:
            message = self.messages.get(timeout=SOON_S)[2]
            if message.view in views:
                return message


def until(is_so: Callable[[], Any]) -> None:
    """Wait until something is so."""
    pause, deadline = queue.Queue[None](), time.monotonic() + SOON_S
    while not is_so():
        assert time.monotonic() < deadline, "it did not happen"
        try:
            pause.get(timeout=0.005)
        except queue.Empty:
            continue


def all_of(views: Iterable[LiveView], received: Received) -> dict[LiveView, LiveMessage]:
    """One message of each view."""
    found: dict[LiveView, LiveMessage] = {}
    wanted = set(views)
    while wanted - found.keys():
        message = received.next(*wanted)
        found.setdefault(message.view, message)
    return found
