"""A run at a trackio server, without its library.

Source: the client of trackio 0.43.
"""

import uuid
from collections.abc import Mapping
from typing import Any

from drcli.tracking.figure_events import Event, Point, TrainingFacts
from drcli.tracking.retried_sink import RetriedSink
from drcli.tracking.server_requests import ServerError, ServerRequests, variable

_MOST_KEPT = 5_000
_AT_A_TIME = 200


class TrackioRun(RetriedSink):
    """A training's run, which a continued training continues.

    The variable TRACKIO_WRITE_TOKEN lets us write.
    """

    takes = (Point,)

    def __init__(
        self, url: str, project: str, facts: TrainingFacts, parameters: Mapping[str, str]
    ) -> None:
        self.name = f"DR_TRACKIO_URL={url.partition('?')[0]}"
        token = {"X-Trackio-Write-Token": variable("TRACKIO_WRITE_TOKEN")}
        super().__init__(ServerRequests(url.rstrip("/") + "/api/", "trackio", token))
        self._project, self._facts = project, facts
        self._parameters = dict(parameters)
        self._run = "" if facts.first_step else uuid.uuid4().hex
        self._waiting: list[dict[str, Any]] = []

    def _keep(self, event: Event) -> None:
        assert isinstance(event, Point)
        # The server takes a point with the same log_id once: one may arrive without an answer.
        entry = {"metrics": dict(event.values), "step": event.step, "log_id": uuid.uuid4().hex}
        self._waiting.append(entry)
        del self._waiting[:-_MOST_KEPT]

    def _flush(self) -> None:
        while self._waiting:
            self._run = self._run or self._known_run()
            own = {"project": self._project, "run": self._facts.model, "run_id": self._run}
            logs = [own | entry for entry in self._waiting[:_AT_A_TIME]]
            logs[0]["config"] = self._parameters
            self._ask("bulk_log", {"logs": logs, "hf_token": None})
            del self._waiting[: len(logs)]

    def _known_run(self) -> str:
        found = self._ask("get_runs_for_project", {"project": self._project})
        runs = [run for run in found or [] if run.get("name") == self._facts.model]
        newest: dict[str, Any] = max(runs, key=lambda run: str(run.get("created_at")), default={})
        return str(newest.get("id") or uuid.uuid4().hex)

    def _ask(self, what: str, fields: Mapping[str, Any]) -> Any:
        answer = self._server.ask("POST", what, json={"args": [], "kwargs": fields})
        if answer.get("error") is not None:
            raise ServerError(f"{what} was refused: {str(answer['error']).rstrip('.')}.")
        return answer.get("data")
