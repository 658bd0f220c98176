"""Warns when the learning curve shows that something goes wrong."""

from drcli.base.log import get_logger
from drcli.store.alarms import trends
from drcli.store.checkpoints import CheckpointStore
from drcli.store.history import History

_logger = get_logger(__name__)


class LearningAlarms:
    def __init__(self, history: History, checkpoints: CheckpointStore) -> None:
        self._history = history
        self._checkpoints = checkpoints
        self._collapsed = False
        self._alarmed: set[str] = set()

    def check(self) -> str | None:
        """Returns a sentence if the model is collapsed."""
        fallen = self._history.collapse(self._checkpoints.best_name())
        for alarm in trends(self._history.records):
            if alarm.subject not in self._alarmed:
                _logger.warning("Warning: %s. %s", alarm.text, alarm.remedy)
            self._alarmed.add(alarm.subject)
        if fallen is not None and not self._collapsed:
            _logger.warning("%s.", fallen)
        self._collapsed = fallen is not None
        return fallen

    def begin_stage(self) -> None:
        self._collapsed = False
