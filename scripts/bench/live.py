"""What it costs to watch a simulation worker, and how old its pictures are when they arrive.

    python scripts/bench live [--viewers 5] [--blocks 30] [--block-s 2] [--threads 2] [--json]

A worker's driving loop runs in this process, without a trainer: it drives all the time, which is
the worst case. In turns, it drives a while without a live view, with one that nobody watches, and
with as many viewers as asked for; each of these watches everything, over a connection of its own,
in another process. Ratios are medians over neighbouring blocks. With --json the last line of stdout
is one object with

    steps_per_s             driven steps/s without a live view
    idle_cost               share of the steps/s that a live view costs if nobody watches
    idle_share              the same as measured inside: time of calls and threads of a live view
                            that nobody watches, as a share of the time of driving; the clock that
                            measures it is in it, so it is an upper bound, but free of the noise
    watched_cost            the same as idle_cost with the viewers
    idle_processor_cost     idle_cost by processor time of this process instead of wall time: a
                            better measure where other programs use the machine
    watched_processor_cost  the same for watched_cost
    live_share              share of this process's processor time that the threads of the live view
                            use while all watch
    latency_ms              by view: median and 95th percentile of the time from the end of a step
                            until a viewer has its picture
    rate_per_s              by view: messages that one viewer gets in a second
"""

import argparse
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean, median
from tempfile import TemporaryDirectory
from typing import Any

from machine import print_json


class Gated:
    """A clock that stands still while nobody shall watch: nothing is saved or due meanwhile."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.runs = False
        self._clock = clock
        self._seconds, self._read_s = 0.0, clock()

    def __call__(self) -> float:
        """Seconds."""
        now_s = self._clock()
        if self.runs:
            self._seconds += now_s - self._read_s
        self._read_s = now_s
        return self._seconds

    def switch(self, runs: bool) -> None:
        """Let it run or stand still from now on."""
        self()
        self.runs = runs


def live_s() -> float:
    """Processor time of the threads of live views in this process."""
    own = [thread.native_id for thread in threading.enumerate() if thread.name.startswith("live-")]
    texts = [Path(f"/proc/self/task/{each}/schedstat").read_text() for each in own]
    return sum(int(text.split()[0]) for text in texts) / 1e9


class Timed:
    """An observer that measures how long another one keeps the driving loop."""

    def __init__(self, observer: Any) -> None:
        self._observer = observer
        self._kept: list[Any] = []  # freeing episodes is work of the driving loop in any case
        self.spent_s = 0.0

    @property
    def wanted(self) -> bool:
        """Whether the next step is wanted."""
        began_s = time.perf_counter()
        wanted = bool(self._observer.wanted)
        self.spent_s += time.perf_counter() - began_s
        return wanted

    def ended(self, *arguments: Any) -> None:
        """Note an episode that has ended."""
        self._kept.append(arguments)
        began_s = time.perf_counter()
        self._observer.ended(*arguments)
        self.spent_s += time.perf_counter() - began_s


class Drive:
    """The driving loop of a training worker with fresh weights."""

    def __init__(self, threads: int) -> None:
        import torch
        from learn_runs import Work

        from drcli.drive.driving import Racer
        from drcli.learn.actor_critic import ActorCritic
        from drcli.learn.data_parallel import DataParallelPolicy

        work = Work.load({}, "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW", threads)
        torch.manual_seed(1)
        torch.set_num_threads(1)
        self._cars = work.parameters.num_episodes_between_training
        self._simulation = work.simulation(self._cars)
        policy = DataParallelPolicy(ActorCritic(work.spec).eval(), threads)
        self._racer = Racer(policy, work.actions)
        self.race = work.settings.race

    def block(self, observer: Any, seconds: float) -> tuple[int, float, float]:
        """Drive equal episodes for a while: steps, wall time and processor time."""
        from drcli.drive.driving import Driver, Plan

        driver = Driver(self._simulation, [self._racer], 1, observer=observer)
        plans = [Plan(number, "training", number / self._cars) for number in range(self._cars)]
        steps = 0
        began_s, began_cpu_s = time.perf_counter(), time.process_time()
        while time.perf_counter() - began_s < seconds:
            driven: list[Any] = []
            driver.drive(plans, driven.append)
            steps += sum(episode.steps for episode in driven)
        return steps, time.perf_counter() - began_s, time.process_time() - began_cpu_s


def watch(folder: Path, count: int) -> None:
    """Be so many viewers until standard input ends; then print what they saw."""
    from drcli.live.live_feed import LiveFeed
    from drcli.live.live_record import LiveMessage, LiveView

    views: tuple[LiveView, ...] = ("camera", "chase", "scene")
    ages: dict[str, list[float]] = {view: [] for view in views}

    def take(_run: int, _worker: str, message: LiveMessage) -> None:
        if message.view in ages:
            ages[message.view].append(time.time() - message.step_s)

    feeds = [LiveFeed(folder, take) for _ in range(count)]
    for feed in feeds:
        feed.watch(0, "sim-0", views)
    while not all(worker.watched for feed in feeds for worker in feed.workers()):
        time.sleep(0.05)
    print("all watch", flush=True)
    sys.stdin.read()
    for feed in feeds:
        feed.close()
    seen = {
        view: [
            round(1e3 * median(each), 1),
            round(1e3 * sorted(each)[int(0.95 * len(each))], 1),
            len(each) / count,
        ]
        for view, each in ages.items()
        if each
    }
    print(json.dumps(seen), flush=True)


def measure(
    viewers: int, blocks: int, block_s: float, threads: int, warm_up_s: float = 15.0
) -> dict[str, Any]:
    """Drive in turns, and compare."""
    from drcli.live.live_record import LiveAddress
    from drcli.live.live_scene import facts_of
    from drcli.live.live_server import BUDGET_SHARE, SAVED_S, Pace, WorkTime
    from drcli.live.live_view import LiveShow
    from drcli.records.run_record import run_folder

    drive = Drive(threads)
    drive.block(None, 2.0)
    wall, work = Gated(time.monotonic), Gated(WorkTime(lambda: False))
    address = LiveAddress.own(0)
    facts = facts_of(drive.race, ["model"])

    def shown(pace: Pace | None = None) -> LiveShow:
        return LiveShow("sim-0", lambda: ("drives", False), facts, address.secret, pace=pace)

    pace = Pace(work, wall)
    pace.spend(BUDGET_SHARE * SAVED_S)  # only what is earned while it is measured
    alone, show = shown(), shown(pace)
    shares: list[float] = []

    def watched(seconds: float) -> tuple[int, float, float]:
        wall.switch(True)
        work.switch(True)
        before_s = live_s()
        found = drive.block(show, seconds)
        shares.append((live_s() - before_s) / found[2])
        wall.switch(False)
        work.switch(False)
        return found

    ways: dict[str, Callable[[float], tuple[int, float, float]]] = {
        "none": lambda seconds: drive.block(None, seconds),
        "idle": lambda seconds: drive.block(alone, seconds),
        "watched": watched,
    }
    found: dict[str, list[tuple[int, float, float]]] = {way: [] for way in ways}
    with TemporaryDirectory(prefix="bench-live-") as name:
        replace(address, port=show.port).write(run_folder(Path(name), 0), "sim-0")
        audience = subprocess.Popen(
            [sys.executable, __file__, "--watch", name, str(viewers)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert audience.stdout is not None
        audience.stdout.readline()
        watched(warm_up_s)  # paints the world, and spends what is saved at the beginning
        shares.clear()
        watched_s = -wall()
        for block in range(blocks):
            order = list(ways) if block % 2 else list(ways)[::-1]
            for way in order:
                found[way].append(ways[way](block_s))
        watched_s += wall()
        seen = json.loads(audience.communicate()[0])
    timed, before_s = Timed(alone), live_s()
    _, idle_s, _ = drive.block(timed, 5 * block_s)
    idle_share = (timed.spent_s + live_s() - before_s) / idle_s
    show.close()
    alone.close()
    return {
        "steps_per_s": round(median(_pace(each) for each in found["none"])),
        "idle_cost": _cost(found["none"], found["idle"], 1),
        "idle_processor_cost": _cost(found["none"], found["idle"], 2),
        "idle_share": round(idle_share, 6),
        "watched_cost": _cost(found["none"], found["watched"], 1),
        "watched_processor_cost": _cost(found["none"], found["watched"], 2),
        "live_share": round(fmean(shares), 4),
        "latency_ms": {view: each[:2] for view, each in seen.items()},
        "rate_per_s": {
            view: round(each[2] / (watched_s + warm_up_s), 2) for view, each in seen.items()
        },
    }


def _pace(block: tuple[int, float, float], of: int = 1) -> float:
    return block[0] / block[of]


def _cost(
    without: Sequence[tuple[int, float, float]],
    with_it: Sequence[tuple[int, float, float]],
    of: int,
) -> float:
    ratios = [_pace(b, of) / _pace(a, of) for a, b in zip(without, with_it, strict=True)]
    return round(1.0 - median(ratios), 4)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--viewers", type=int, default=5)
    parser.add_argument("--blocks", type=int, default=30)
    parser.add_argument("--block-s", type=float, default=2.0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.viewers, options.blocks, options.block_s, options.threads)
    for name, value in found.items():
        print(f"{name:24} {value}")
    if options.json:
        print_json(found)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--watch"]:
        watch(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        sys.path.insert(0, str(Path(__file__).parent))
        from learn_runs import become_like_a_worker

        become_like_a_worker()
        main()
