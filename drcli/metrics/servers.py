"""A run at an MLflow server, without its library.

Source: MLflow's REST API, version 2.0.
"""

import os
import time
import uuid
from abc import abstractmethod
from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar
from urllib.parse import urlsplit, urlunsplit

import requests
from urllib3.exceptions import LocationParseError

from drcli.base.errors import cause_of
from drcli.config import secret_environment
from drcli.metrics.figure_events import Ended, Event, Point, Sink, TrainingFacts

# Requests to other tools' servers, with JSON answers.


TIMEOUT_S = 10.0
"""The training does not wait."""


class ServerError(Exception):
    """A server refuses or is away; `code` is its own name of the error, or empty."""

    def __init__(self, text: str, code: str = "") -> None:
        super().__init__(text)
        self.code = code


class ServerRequests:
    """To a server of a kind such as `MLflow`; empty headers are left out."""

    def __init__(self, base: str, kind: str, headers: dict[str, str]) -> None:
        self._base, self._kind = base, kind
        self._session = requests.Session()
        self._session.trust_env = False  # no user of ~/.netrc, and no proxy that nobody named
        self._session.headers.update({name: text for name, text in headers.items() if text})

    def ask(self, method: str, what: str, **options: Any) -> dict[str, Any]:
        """The JSON answer; options are those of `requests.request`.

        Raises:
            ServerError: It refuses, does not answer, or is another program.
        """
        try:
            answer = self._session.request(
                method, self._base + what, timeout=TIMEOUT_S, allow_redirects=False, **options
            )
        except requests.Timeout:
            raise ServerError(f"{what} is not answered within {TIMEOUT_S:g} s.") from None
        except (requests.RequestException, LocationParseError) as error:
            raise ServerError(f"the server cannot be reached: {cause_of(error)}.") from None
        try:
            found = answer.json()
        except ValueError:
            found = None
        if answer.status_code == 200 and isinstance(found, dict):
            return found
        given = found if isinstance(found, dict) else {"message": f"it is no {self._kind} server"}
        reason = str(given.get("message") or given.get("error")).rstrip(".")
        raise ServerError(
            f"{what} was answered with {answer.status_code}: {reason}.",
            str(given.get("error_code", "")),
        )

    def close(self) -> None:
        self._session.close()


def variable(name: str) -> str:
    """Of the environment, or kept from the racer's code."""
    return secret_environment.all_secrets().get(name) or os.environ.get(name, "")


# A sink that keeps what a server did not take.


class RetriedSink(Sink):
    """Figures for a server that may be away."""

    most_kept: ClassVar[int]
    """While the server is away."""

    def __init__(self, server: ServerRequests) -> None:
        self._server = server
        self._newest: Event | None = None
        self._waiting: list[dict[str, Any]] = []
        self._ended: Ended | None = None

    def send(self, event: Event) -> None:
        """Send this and earlier events.

        Raises:
            ServerError: The server refuses, or cannot be reached.
        """
        self._keep(event)
        self._flush()

    def miss(self, event: Event) -> bool:
        self._keep(event)
        return True

    def close(self) -> None:
        try:
            self._flush()
        finally:
            self._server.close()

    def _keep(self, event: Event) -> None:
        """Add an event that is new, and forget the oldest of too many."""
        if isinstance(event, Ended):
            self._ended = event
        elif isinstance(event, Point) and event is not self._newest:
            self._waiting += self._entries(event)
            del self._waiting[: -self.most_kept]
        self._newest = event

    @abstractmethod
    def _entries(self, point: Point) -> list[dict[str, Any]]:
        """As the server takes them."""

    @abstractmethod
    def _flush(self) -> None:
        """Send what waits, if anything; raises ServerError."""


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
    most_kept = 20_000  # about a thousand iterations

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

    def _entries(self, point: Point) -> list[dict[str, Any]]:
        time_ms = round(point.time_s * 1000)
        return [
            {"key": name, "value": value, "timestamp": time_ms, "step": point.step}
            for name, value in point.values.items()
        ]

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
                known = [entry for point in self._earlier for entry in self._entries(point)]
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


def _authorization() -> str:
    token = variable("MLFLOW_TRACKING_TOKEN")
    if token:
        return f"Bearer {token}"
    user, password = variable("MLFLOW_TRACKING_USERNAME"), variable("MLFLOW_TRACKING_PASSWORD")
    if user and password:
        return "Basic " + b64encode(f"{user}:{password}".encode()).decode()
    return ""


# A run at a trackio server, without its library.
#
# Source: the client of trackio 0.43.


_TRACKIO_AT_A_TIME = 200


class TrackioRun(RetriedSink):
    """A training's run, which a continued training continues.

    The variable TRACKIO_WRITE_TOKEN lets us write.
    """

    takes = (Point,)
    most_kept = 5_000

    def __init__(
        self, url: str, project: str, facts: TrainingFacts, parameters: Mapping[str, str]
    ) -> None:
        self.name = f"DR_TRACKIO_URL={url.partition('?')[0]}"
        token = {"X-Trackio-Write-Token": variable("TRACKIO_WRITE_TOKEN")}
        super().__init__(ServerRequests(url.rstrip("/") + "/api/", "trackio", token))
        self._project, self._facts = project, facts
        self._parameters = dict(parameters)
        self._run = "" if facts.first_step else uuid.uuid4().hex

    def _entries(self, point: Point) -> list[dict[str, Any]]:
        # The server takes a point with the same log_id once: one may arrive without an answer.
        log_id = uuid.uuid4().hex
        return [{"metrics": dict(point.values), "step": point.step, "log_id": log_id}]

    def _flush(self) -> None:
        while self._waiting:
            self._run = self._run or self._known_run()
            own = {"project": self._project, "run": self._facts.model, "run_id": self._run}
            logs = [own | entry for entry in self._waiting[:_TRACKIO_AT_A_TIME]]
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
