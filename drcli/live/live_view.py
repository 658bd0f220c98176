"""Shows a worker's cars; costs nothing while nobody watches.

The driving loop hands over wanted steps as they are. A thread draws and encodes them, as often
as `live_pace` allows.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from os import getpid
from time import thread_time
from time import time as unix_s

import torch

from drcli.base.log import get_logger
from drcli.live.live_record import LiveAddress, LiveMessage, LiveState, LiveView
from drcli.live.live_scene import LiveEpisodes, LiveFacts, chosen_rider, facts_of, scene_of
from drcli.live.live_server import (
    ChaseView,
    LiveServer,
    Pace,
    Viewer,
    WorkTime,
    camera_picture,
    jpeg,
    missing_library,
)
from drcli.live.step_snapshot import PolicyTap, Rider, StepSnapshot
from drcli.records.job import Job
from drcli.records.trace import Episode
from drcli.workers.heartbeat_thread import Heartbeat

_logger = get_logger(__name__)

Activity = Callable[[], tuple[str, bool]]
"""What a worker does, and whether it waits for another worker."""

POLL_S = 0.25
OLD_S = 1.0
FAILURE_PAUSE_S = 5.0

_DRIVEN: tuple[LiveView, ...] = ("camera", "scene", "chase")


class LiveShow:
    """The driving loop calls `see` and `ended`; all else is a thread's."""

    def __init__(
        self,
        name: str,
        activity: Activity,
        facts: LiveFacts,
        key: bytes,
        *,
        pace: Pace | None = None,
    ) -> None:
        """OSError if this machine does not let it listen."""
        self.wanted = False
        self.facts = facts
        self._name = name
        self._activity = activity
        self._episodes = LiveEpisodes()
        self._pace = pace or Pace(WorkTime(lambda: activity()[1]))
        self._chase = ChaseView()
        self._tap = PolicyTap()
        self._missing = missing_library()
        self._moment: StepSnapshot | None = None
        self._wake = threading.Event()
        self._closed = False
        self._followed: dict[int | None, Rider] = {}
        self._state: LiveState | None = None
        self._server = LiveServer(key, self._wake.set)
        self.port = self._server.port
        self._thread = threading.Thread(target=self._run, name="live-view", daemon=True)
        self._thread.start()

    def see(self, moment: StepSnapshot) -> None:
        self.wanted = False
        self._moment = replace(moment, calls=self._tap.take())
        self._tap.follow(moment.looks)
        self._wake.set()

    def ended(self, episode: Episode, racer: int, world: str) -> None:
        self._episodes.end(episode, racer, self.facts.drive(world))

    def about(self, iteration: int | None, checkpoint: str, facts: LiveFacts | None = None) -> None:
        self._episodes.forget()
        self.facts = replace(facts or self.facts, iteration=iteration, checkpoint=checkpoint)

    def close(self) -> None:
        self._closed = True
        self.wanted = False
        self._server.close()
        self._wake.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        torch.set_num_threads(1)
        failed = False
        while not self._closed:
            try:
                self._turn()
            except Exception as error:  # a fault in a picture must not end the driving
                if not failed:
                    _logger.warning("The live view has failed.", exc_info=error)
                failed = True
                self._wake.wait(FAILURE_PAUSE_S)

    def _turn(self) -> None:
        viewers = self._server.viewers
        if not viewers:
            self._rest()
            return
        self._tap.active = True
        began_s = thread_time()
        self._tell(viewers)
        due, pause_s = self._due(viewers)
        moment = self._take(wanted=bool(due))
        if moment is not None:
            self._show(moment, viewers, due)
        sent_s = sum(viewer.cost_s() for viewer in viewers)
        self._pace.spend(thread_time() - began_s + sent_s)
        if moment is None:
            self._wake.wait(min(pause_s, POLL_S))
            self._wake.clear()

    def _rest(self) -> None:
        self.wanted = self._tap.active = False
        self._tap.take()
        self._moment = self._state = None
        self._followed.clear()
        self._wake.wait()
        self._wake.clear()

    def _due(self, viewers: Sequence[Viewer]) -> tuple[list[LiveView], float]:
        wanted = {view for viewer in viewers for view in viewer.request.views}
        pauses = self._pace.pauses_s([view for view in _DRIVEN if view in wanted])
        due = [view for view, pause_s in pauses.items() if pause_s == 0.0]
        return due, POLL_S if due else min(pauses.values(), default=POLL_S)

    def _take(self, *, wanted: bool) -> StepSnapshot | None:
        """None if there is none: the next one is asked for."""
        moment, self._moment = self._moment, None
        if not wanted or (moment is not None and unix_s() - moment.step_s > OLD_S):
            moment = None
        self.wanted = wanted and moment is None
        return moment

    def _tell(self, viewers: Sequence[Viewer]) -> None:
        """Only changes; new viewers get it in any case."""
        activity, waits = self._activity()
        facts, before = self.facts, self._state
        same = before is not None and (before.activity, before.waits) == (activity, waits)
        state = LiveState(
            worker=self._name,
            pid=getpid(),
            activity=activity,
            waits=waits,
            since_s=before.since_s if before is not None and same else unix_s(),
            iteration=facts.iteration,
            checkpoint=facts.checkpoint,
            hint=self._missing or self._chase.hint or facts.hint,
        )
        everybody = state != before
        addressed = [viewer for viewer in viewers if everybody or viewer.is_new]
        if not addressed:
            return
        self._state = state
        data = LiveMessage("state", state.since_s, state.encode()).encode()
        for viewer in addressed:
            viewer.is_new = False
            viewer.offer({"state": data})

    def _show(
        self, moment: StepSnapshot, viewers: Sequence[Viewer], due: Sequence[LiveView]
    ) -> None:
        """Each view once for all viewers of a car."""
        wanted = {(view, viewer.request.car) for viewer in viewers for view in viewer.request.views}
        riders: dict[int | None, Rider | None] = {}
        for car in {car for _, car in wanted}:
            rider = riders[car] = chosen_rider(moment, car, self._followed.get(car))
            if rider is not None:
                self._followed[car] = rider
        for views in (("camera", "scene"), ("chase",)):  # the cheap ones need not wait
            made = {
                (view, car): self._message(view, moment, riders[car])
                for view, car in wanted
                if view in views and view in due
            }
            for viewer in viewers:
                request = viewer.request
                found = {v: made.get((v, request.car)) for v in request.views}
                messages = {view: data for view, data in found.items() if data is not None}
                if messages:
                    viewer.offer(messages)
        self._pace.shown(due)

    def _message(self, view: LiveView, moment: StepSnapshot, rider: Rider | None) -> bytes | None:
        car = None if rider is None else rider.car
        if view == "scene":
            scene = scene_of(moment, self.facts, self._episodes, rider)
            return LiveMessage(view, moment.step_s, scene.encode(), car).encode()
        if rider is None or self._missing:
            return None
        if view == "chase":
            if not self._chase.is_ready(rider.track):
                return None
            picture = self._chase.picture(moment, rider, self.facts.colors)
        else:
            look = moment.look_of(rider.car)
            if look is None:
                return None
            picture = camera_picture(look[0].frames[look[1]])
        rows, columns = picture.shape[:2]
        return LiveMessage(
            view, moment.step_s, jpeg(picture), car, width=columns, height=rows
        ).encode()


@contextmanager
def live_show(
    job: Job, name: str, heartbeat: Heartbeat, models: Sequence[str], worker: int = 0
) -> Iterator[LiveShow | None]:
    """Show a worker during the block; None where DR_LIVE_VIEW is off or it fails."""
    if not job.config.live_view:
        yield None
        return
    address, show = LiveAddress.own(0), None
    try:
        facts = facts_of(job.config.race(worker), models)
        show = LiveShow(name, lambda: heartbeat.activity, facts, address.secret)
        address = replace(address, port=show.port)
        address.write(job.folder, name)
    except (OSError, RuntimeError) as error:
        _logger.warning("Nobody can watch this worker: %s.", error)
        if show is not None:
            show.close()
        yield None
        return
    try:
        yield show
    finally:
        address.delete(job.folder, name)
        show.close()
