"""Makes messages of journal entries: Amazon SNS, a webhook, mail."""

import queue
import socket
import threading
import time
from collections.abc import Callable, Mapping

from drcli.base.errors import DrError
from drcli.base.log import get_logger
from drcli.model.model_list import CheckpointEntry
from drcli.outside.messages import Channel, Message, open_channels
from drcli.records.run_record import JournalEntry
from drcli.run.checkpoint_watch import LAST_LOOK_S, CheckpointWatch
from drcli.run.duty import Duty, RunningTraining
from drcli.run.outcome import Ending, Outcome

_logger = get_logger(__name__)

LEAVE_S = 25.0
RETRY_S = 3.0
BEST_EVERY_S = 600.0
MOST, PER_S = 20, 600.0
"""A fault that comes back floods nobody."""

_LAST = ("end", "failure", "stop", "interruption")
_OF_STATE = {"finished": "end", "stopped": "stop", "interrupted": "interruption"}
_STARTED_S = 5.0


class Messages(Duty):
    name = "messages"

    def __init__(
        self,
        run: RunningTraining,
        watch: CheckpointWatch,
        facts: Callable[[], Mapping[str, object]],
        *,
        channels: list[Channel] | None = None,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(run)
        settings, storage = run.job.config.unattended, run.job.config.storage
        self._watch = watch
        self._facts = facts
        self._clock = clock
        self._pause = pause
        self._channels = (
            open_channels(settings, storage.aws_profile) if channels is None else channels
        )
        self._events = settings.message_events.split(",")
        self._queue: queue.SimpleQueue[Message | None] = queue.SimpleQueue()
        self._failed: dict[str, str] = {}
        self._sent_s: list[float] = []
        self._best = ""
        self._best_s = -float("inf")
        self._sender = threading.Thread(target=self._send_all, name="messages", daemon=True)

    def start(self) -> None:
        if not self._channels:
            return
        self.run.journal.listen(self._hear)
        self._sender.start()
        if self._wants("best") or self._wants("start") or self._wants("resume"):
            self._watch.turn_on()
        threading.Thread(target=self._tell_start, name="first message", daemon=True).start()

    def check(self) -> Outcome | None:
        best = self._watch.best
        if not self._channels or best is None or best.name == self._best:
            return None
        now_s = self._clock()
        if not self._best:  # the best before this start
            self._best = best.name
        elif now_s - self._best_s >= BEST_EVERY_S:
            self._best, self._best_s = best.name, now_s
            text = CheckpointEntry.of(best, self.run.job.config.model.metric).text
            self.tell("best", f"New best checkpoint {text}.", checkpoint=best.name)
        return None

    def finish(self, ending: Ending) -> None:
        if self._channels and ending.left_s() > LAST_LOOK_S:
            self._watch.look_last()

    def after_release(self, ending: Ending) -> None:
        if not self._channels:
            return
        outcome = ending.outcome
        event = _OF_STATE.get(outcome.state, "failure")
        facts: dict[str, object] = {"state": outcome.state, "exit_code": outcome.code}
        for name, score in (("best", self._watch.best), ("last", self._watch.last)):
            if score is not None:
                facts[name] = score.name
        text = f"{outcome.message} {outcome.remedy}".strip()
        if event == "end" and self._watch.best is not None:
            entry = CheckpointEntry.of(self._watch.best, self.run.job.config.model.metric)
            text += f" Best checkpoint {entry.text}."
        self.tell(event, text, **facts, **self._facts())
        self._queue.put(None)
        if self._sender.is_alive():
            self._sender.join(min(LEAVE_S, max(1.0, ending.left_s())))

    def tell(self, event: str, text: str, **facts: object) -> None:
        if not self._wants(event) or not self._channels:
            return
        now_s = self._clock()
        self._sent_s = [sent_s for sent_s in self._sent_s if now_s - sent_s < PER_S]
        if len(self._sent_s) >= MOST and event not in _LAST:
            return
        self._sent_s.append(now_s)
        if len(self._sent_s) == MOST:
            text += f" Further messages of the next {PER_S / 60:.0f} minutes are left out."
        prefix = self.run.job.config.model.prefix
        identity = {
            "model": f"s3://{self.run.job.config.storage.bucket}/{prefix}",
            "world": self.run.job.config.race().world_name,
            "run_id": self.run.job.config.run_id,
            "machine": socket.gethostname(),
        }
        self._queue.put(Message(event, f"{event}: {prefix}", text, {**identity, **facts}))

    def _wants(self, event: str) -> bool:
        return event in self._events or "all" in self._events

    def _tell_start(self) -> None:
        deadline_s = time.monotonic() + _STARTED_S
        while self._watch.last is None and time.monotonic() < deadline_s:
            self._pause(0.2)
        last = self._watch.last
        if last is not None and not last.name.startswith("0_"):
            self.tell("resume", f"The training continues from {last.name}.", checkpoint=last.name)
        else:
            self.tell("start", "The training has started.")

    def _hear(self, entry: JournalEntry) -> None:
        named = entry.facts.get("event")
        facts = {name: value for name, value in entry.facts.items() if name != "event"}
        if isinstance(named, str) and named in ("stall", "failure", "upload", "fault"):
            event = "fault" if named == "upload" and entry.kind == "fault" else named
        elif entry.kind == "notice":
            event = "interruption" if entry.facts.get("what") == "interruption" else "fault"
        elif entry.kind in ("fault", "recovery", "stage", "upload"):
            event = entry.kind
        else:
            return  # `start` and `end` are told with more facts
        self.tell(event, entry.text, **facts)

    def _send_all(self) -> None:
        while (message := self._queue.get()) is not None:
            for channel in self._channels:
                self._send(channel, message)

    def _send(self, channel: Channel, message: Message) -> None:
        for attempt in (1, 2):
            try:
                channel.send(message)
            except DrError as error:
                words = f"{error} {error.remedy}"
            except Exception as error:  # the thread must go on after any failure
                words = f"{type(error).__name__} in {channel.name}"
            else:
                if self._failed.pop(channel.name, ""):
                    _logger.info("Messages to %s arrive again.", channel.name)
                return
            if attempt == 1:
                self._pause(RETRY_S)
        if self._failed.get(channel.name) != words:
            _logger.warning("A message could not be sent: %s", words)
        self._failed[channel.name] = words
