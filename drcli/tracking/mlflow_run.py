"""A run at an MLflow server, without its library.

Source: MLflow's REST API, version 2.0.
"""

import time
import uuid
from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import urlsplit, urlunsplit

from drcli.tracking.figure_events import Ended, Event, Point, TrainingFacts
from drcli.tracking.retried_sink import RetriedSink
from drcli.tracking.server_requests import ServerError, ServerRequests, variable

_MOST_KEPT = 20_000
"""While the server is away: about a thousand iterations."""

_AT_A_TIME = 900
"""The server takes a thousand at most."""

_LONGEST_PARAMETER = 500
"""For every version of the server."""

_MODEL, _START = "drcli.model", "drcli.start"
"""Tags of a run."""


class MlflowRun(RetriedSink):
    """A training's run, which a continued training continues.

    MLflow takes the highest step for the latest. So going on from before given-up numbers makes a
    new run, with those of `earlier`.
    """

    takes = (Point, Ended)

    def __init__(
        self,
        url: str,
        experiment: str,
        facts: TrainingFacts,
        parameters: Mapping[str, str],
        earlier: Sequence[Point] = (),
    ) -> None:
        self.name = f"DR_MLFLOW_URL={urlunsplit(urlsplit(url)._replace(query='', fragment=''))}"
        base = url.rstrip("/") + "/api/2.0/mlflow/"
        super().__init__(ServerRequests(base, "MLflow", {"Authorization": _authorization()}))
        self._experiment = experiment
        self._facts = facts
        self._parameters = dict(parameters)
        self._earlier = earlier
        self._run = ""
        self._start, self._may_exist = uuid.uuid4().hex, False
        self._waiting: list[dict[str, Any]] = []
        self._ended: Ended | None = None

    def _keep(self, event: Event) -> None:
        if isinstance(event, Ended):
            self._ended = event
        elif isinstance(event, Point):
            self._waiting += _numbers(event)
            del self._waiting[:-_MOST_KEPT]

    def _flush(self) -> None:
        if not (self._waiting or self._ended):
            return
        if not self._run:
            self._open()
        while self._waiting:
            some = self._waiting[:_AT_A_TIME]
            self._post("runs/log-batch", {"run_id": self._run, "metrics": some})
            del self._waiting[: len(some)]
        if self._ended is not None:
            status = "FINISHED" if self._ended.finished else "KILLED"
            end_ms = round(self._ended.time_s * 1000)
            self._post("runs/update", {"run_id": self._run, "status": status, "end_time": end_ms})
            self._ended = None

    def _open(self) -> None:
        experiment = self._experiment_id()
        # A run whose making was not answered in time may have been made all the same.
        run, _ = self._newest_run(experiment, _START, self._start) if self._may_exist else ("", 0)
        if not run and self._facts.first_step:
            old, last_step = self._newest_run(experiment, _MODEL, self._facts.model)
            given_up = last_step > self._facts.first_step
            if old and not given_up:
                self._post("runs/update", {"run_id": old, "status": "RUNNING"})
                self._run = old
                return
            if old:
                end_ms = round(time.time() * 1000)
                self._post("runs/update", {"run_id": old, "status": "KILLED", "end_time": end_ms})
                known = [number for point in self._earlier for number in _numbers(point)]
                self._waiting[:0], self._earlier = known, ()
        run = run or self._made(experiment)
        params = [
            {"key": key, "value": value[:_LONGEST_PARAMETER]}
            for key, value in self._parameters.items()
        ]
        for begin in range(0, len(params), 100):
            self._post("runs/log-batch", {"run_id": run, "params": params[begin : begin + 100]})
        self._run = run

    def _made(self, experiment: str) -> str:
        tags = {
            "mlflow.runName": self._facts.model,
            _MODEL: self._facts.model,
            _START: self._start,
            "mlflow.source.name": "drcli",
            "drcli.run_id": str(self._facts.run_id),
        }
        self._may_exist = True
        answer = self._post(
            "runs/create",
            {
                "experiment_id": experiment,
                "run_name": self._facts.model,
                "start_time": round(time.time() * 1000),
                "tags": [{"key": key, "value": value} for key, value in tags.items()],
            },
        )
        return str(answer["run"]["info"]["run_id"])

    def _experiment_id(self) -> str:
        name = {"experiment_name": self._experiment}
        try:
            answer = self._server.ask("GET", "experiments/get-by-name", params=name)
            return str(answer["experiment"]["experiment_id"])
        except ServerError as error:
            if error.code != "RESOURCE_DOES_NOT_EXIST":
                raise
            answer = self._post("experiments/create", {"name": self._experiment})
            return str(answer["experiment_id"])

    def _newest_run(self, experiment: str, tag: str, value: str) -> tuple[str, int]:
        quoted = value.replace("'", "")
        answer = self._post(
            "runs/search",
            {
                "experiment_ids": [experiment],
                "filter": f"tags.`{tag}` = '{quoted}'",
                "max_results": 1,
                "order_by": ["attributes.start_time DESC"],
            },
        )
        runs = answer.get("runs") or []
        if not runs:
            return "", 0
        latest = runs[0].get("data", {}).get("metrics") or []
        # The server writes 64-bit numbers as text in some versions.
        steps = (int(metric.get("step") or 0) for metric in latest)
        return str(runs[0]["info"]["run_id"]), max(steps, default=0)

    def _post(self, what: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        return self._server.ask("POST", what, json=fields)


def _numbers(point: Point) -> list[dict[str, Any]]:
    time_ms = round(point.time_s * 1000)
    return [
        {"key": name, "value": value, "timestamp": time_ms, "step": point.step}
        for name, value in point.values.items()
    ]


def _authorization() -> str:
    token = variable("MLFLOW_TRACKING_TOKEN")
    if token:
        return f"Bearer {token}"
    user, password = variable("MLFLOW_TRACKING_USERNAME"), variable("MLFLOW_TRACKING_PASSWORD")
    if user and password:
        return "Basic " + b64encode(f"{user}:{password}".encode()).decode()
    return ""
