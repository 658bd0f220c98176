"""Ends a training in time when its machine is about to be taken away."""

import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from drcli.base.clock import elapsed_s
from drcli.base.errors import DrError, OwnershipLost
from drcli.base.log import get_logger
from drcli.clouds.cloud import NoticeSource
from drcli.clouds.registry import CLOUDS, DMI_FOLDER, cloud_of_machine
from drcli.config.run_config import UnattendedConfig
from drcli.model.lease import STALE_S, lost_to, read_lease, write_lease
from drcli.model.model_store import ModelStore
from drcli.outside.notices.notice_watch import Announced, NoticeWatch, command_words, soonest
from drcli.records.run_record import Lease
from drcli.run.duty import Duty, RunningTraining
from drcli.run.outcome import Ending, Outcome, interrupted

_logger = get_logger(__name__)

ACT_S = 120.0
"""The notice of EC2."""

SAVE_S = 55.0
"""Clouds may be a minute early: what a successor needs is saved first."""

SPARE_S = 30.0
"""Left over of a longer notice."""

SHORTEST_S = 8.0
MARGIN_S = 5.0
"""The machine has to stop its services."""


class InterruptionWatch(Duty):
    name = "interruption watch"

    def __init__(self, run: RunningTraining, dmi: Path = DMI_FOLDER) -> None:
        super().__init__(run)
        self._dmi = dmi
        self._watch: NoticeWatch | None = None
        self._noted: set[tuple[str, str, str]] = set()

    def start(self) -> None:
        settings = self.run.job.config.unattended
        try:
            words = command_words(settings.interruption_command)
        except DrError as error:
            words = []
            _logger.warning("%s %s", error, error.remedy)
        source = chosen_source(settings, os.environ, self._dmi)
        if source is not None:
            _logger.info("Watching for notices of %s.", source.name)
        self._watch = NoticeWatch(source, words, self.run.job.directory)
        self._watch.start()

    def check(self) -> Outcome | None:
        if self._watch is None:
            return None
        now_s = time.monotonic()
        announced = self._watch.announced()
        for one in announced:
            self._note(one)
        rebalance = self.run.job.config.unattended.on_rebalance
        first = due(announced, now_s, on_rebalance=rebalance == "stop")
        return None if first is None else self._interrupted(first, first.left_s(now_s))

    def finish(self, ending: Ending) -> None:
        if self._watch is not None:
            self._watch.stop()

    after_release = finish

    def _note(self, one: Announced) -> None:
        notice = one.notice
        name = (notice.source, notice.kind, notice.action)
        if name in self._noted:
            return
        self._noted.add(name)
        _logger.warning("%s", notice.text)
        self.run.journal.note(
            "notice",
            notice.text,
            source=notice.source,
            what=notice.kind,
            action=notice.action,
            seconds_left=notice.seconds_left,
        )

    def _interrupted(self, one: Announced, left_s: float | None) -> Outcome:
        save_s = SAVE_S
        if left_s is not None:
            save_s = min(max(SAVE_S, left_s - SPARE_S), left_s - MARGIN_S)
        return interrupted(
            f"Interrupted: {one.notice.text}",
            max(SHORTEST_S, save_s),
            continues=self.run.job.config.unattended.continue_on_spot_interruption,
        )


def due(announced: Sequence[Announced], now_s: float, *, on_rebalance: bool) -> Announced | None:
    """The notice to act on now.

    A recommendation to move counts only `on_rebalance`, and without an interruption.
    """
    first = soonest(announced, now_s)
    if first is not None:
        return first if (first.left_s(now_s) or 0.0) <= ACT_S else None
    return announced[0] if announced and on_rebalance else None


def chosen_source(
    settings: UnattendedConfig, environment: Mapping[str, str], dmi: Path = DMI_FOLDER
) -> NoticeSource | None:
    """None outside clouds; a wrong address is only logged."""
    wanted = settings.interruption_watch
    if wanted == "off":
        return None
    cloud = cloud_of_machine(environment, dmi) if wanted == "auto" else wanted
    if cloud is None:
        return None
    try:
        return CLOUDS[cloud].source(environment, settings.metadata_service_url)
    except DrError as error:
        _logger.warning("No notices from %s: %s %s", CLOUDS[cloud].title, error, error.remedy)
        return None


# Renews the lease of a training, and notices when another one has taken it.


LEASE_POLL_S = 4.0
"""Who loses a lease must end within 15 seconds, which its workers need."""

RENEW_S = 10.0
_HELD_UP_S = 5.0


class Renewal:
    """Renews a lease step by step until it is lost.

    The clock must also count while this process is stopped.
    """

    def __init__(
        self, model: ModelStore, lease: Lease, *, clock: Callable[[], float] = elapsed_s
    ) -> None:
        self._model = model
        self._lease = lease
        self._clock = clock
        self._written_s = self._owned_s = clock()
        self.lost: OwnershipLost | None = None
        """Why the training must end; None while it holds the lease."""

    def begin_trainer(self, number: int) -> None:
        """Let no trainer with a lower number write any more.

        Raises:
            StorageError: The next step tries again.
        """
        self._lease = replace(self._lease, trainer=number)
        self._written_s = -math.inf
        self.step()

    def step(self) -> None:
        """Check who holds the lease, and write it if due.

        Raises:
            StorageError: The next step tries again.
        """
        now_s = self._clock()
        found = read_lease(self._model)
        if found is not None and found.outranks(self._lease.session, self._lease.term):
            self.lost = lost_to(self._model, found)
            return
        ours = found is not None and found.session == self._lease.session
        if found is None and now_s - self._owned_s > STALE_S:
            self.lost = OwnershipLost(
                f"{self._model.url} could not be reached for "
                f"{now_s - self._owned_s:.0f} s, and the lease of this training is gone.",
                remedy="Check with `dr-list-models` that the model still exists, then continue "
                "with `dr-start-training --resume`.",
            )
            return
        self._owned_s = now_s
        if ours and now_s - self._written_s < RENEW_S:
            return
        if self._clock() - now_s > _HELD_UP_S:
            return  # another training may have taken it since it was read
        write_lease(self._model, replace(self._lease, renewed=time.time()))
        self._written_s = now_s
