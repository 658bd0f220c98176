"""The interface of DeepRacer on AWS for programs.

Failed calls raise StorageError.
"""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal
from urllib.parse import quote, urlencode

from drcli.base.errors import SettingsError, StorageError, shown
from drcli.base.installation import lazy_imports
from drcli.base.report import Col, second
from drcli.outside.droa.droa_session import DroaSession, Keys
from drcli.outside.web_request import Pause, Web

with lazy_imports():
    import requests
    from botocore import auth as botocore_auth
    from botocore import awsrequest
    from botocore import credentials as botocore_credentials

# Models at DeepRacer on AWS.


AssetType = Literal[
    "TRAINING_LOGS", "EVALUATION_LOGS", "PHYSICAL_CAR_MODEL", "VIRTUAL_MODEL", "VIDEOS"
]

DELETABLE = ("READY", "ERROR")


class NoSuchModel(SettingsError):
    """The account has none of that id or name."""


@dataclass(frozen=True)
class RemoteModel:
    """A model in the account; several can have the same name."""

    site: Annotated[str, "Address of DeepRacer on AWS."]
    model_id: Annotated[str, "Id of the model.", Col("model id")]
    name: Annotated[str, "Its name.", Col("name")]
    status: Annotated[
        str,
        "Such as READY, ERROR, IMPORTING or TRAINING.",
        Col("status", style={"READY": "green", "ERROR": "red"}),
    ]
    training_status: Annotated[
        str, "Such as COMPLETED; empty if unknown.", Col("training", lambda text: text or "-")
    ]
    created_at: Annotated[
        str, "When it was created, ISO 8601; empty if unknown.", Col("created", second)
    ]
    import_error: Annotated[str, "Why its import failed; empty if it did not."]
    values: Annotated[
        dict[str, Any], "Everything that the interface says, with its keys, such as metadata."
    ]


@dataclass(frozen=True)
class Asset:
    """May be unfinished."""

    url: str
    status: str


def value_at(values: Mapping[str, Any], *path: str) -> Any:
    found: Any = values
    for key in path:
        found = found.get(key) if isinstance(found, Mapping) else None
    return found


def text_at(values: Mapping[str, Any], *path: str) -> str:
    """Empty for what is no single value."""
    value = value_at(values, *path)
    return "" if value is None or isinstance(value, dict | list) else str(value)


def read_model(value: Any, place: str) -> RemoteModel:
    if not isinstance(value, dict) or not isinstance(value.get("modelId"), str):
        raise StorageError(
            f"{place} lists a model without an id.",
            remedy="Try again later; if it fails again, ask who runs that site.",
        )

    return RemoteModel(
        site=place,
        model_id=value["modelId"],
        name=text_at(value, "name"),
        status=text_at(value, "status"),
        training_status=text_at(value, "trainingStatus"),
        created_at=text_at(value, "createdAt"),
        import_error=text_at(value, "importErrorMessage"),
        values=value,
    )


_ID = re.compile(r"[A-Za-z0-9]{15}")
_STALE_KEYS = re.compile(r"security token included in the request is (expired|invalid)", re.I)
_MOST_PAGES = 1_000
_LONGEST_MESSAGE = 300


class Droa:
    """For one user."""

    def __init__(self, session: DroaSession, web: Web) -> None:
        self.session = session
        self.web = web

    @property
    def pause(self) -> Pause:
        """Takes seconds."""
        return self.web.pause

    @property
    def place(self) -> str:
        return self.session.site.place

    def models(self) -> list[RemoteModel]:
        found = [read_model(item, self.place) for item in self._listed("/models", "models")]
        return sorted(found, key=lambda model: model.created_at, reverse=True)

    def model(self, model_id: str) -> RemoteModel:
        """NoSuchModel if there is none."""
        answer = self._call("GET", f"/models/{_checked(model_id)}", model=model_id)
        return read_model(answer.get("model", answer), self.place)

    def find(self, wanted: str) -> RemoteModel:
        """By id or name; NoSuchModel without exactly one."""
        if _ID.fullmatch(wanted):
            try:
                return self.model(wanted)
            except NoSuchModel:  # a name may look like an id
                pass
        named = [model for model in self.models() if model.name == wanted]
        if not named:
            raise NoSuchModel(
                f"There is no model {shown(wanted)} in your account at {self.place}.",
                remedy="`droa-list-models` lists all ids and names.",
            )
        if len(named) > 1:
            ids = ", ".join(model.model_id for model in named)
            raise NoSuchModel(
                f"Several models at {self.place} are called {shown(wanted)}: {ids}.",
                remedy="Give the id of one of them.",
            )
        return self.model(named[0].model_id)

    def import_model(self, path: str, name: str, description: str) -> str:
        """Begin the import of a folder in the upload bucket; returns the model's id."""
        body = {
            "s3Bucket": self.session.site.upload_bucket,
            "s3Path": path,
            "modelName": name,
            **({"modelDescription": description} if description else {}),
        }
        answer = self._call("POST", "/importmodel", body=body)
        model_id = answer.get("modelId")
        if not isinstance(model_id, str) or not model_id:
            raise self._unexpected("an answer without modelId")
        return model_id

    def delete(self, model_id: str) -> None:
        """Begin to delete a model."""
        self._call("DELETE", f"/models/{_checked(model_id)}", model=model_id)

    def asset(self, model_id: str, kind: AssetType, evaluation_id: str = "") -> Asset:
        """The address of a model's file; NoSuchModel if there is none."""
        query = {"assetType": kind, **({"evaluationId": evaluation_id} if evaluation_id else {})}
        path = f"/models/{_checked(model_id)}/getasset"
        answer = self._call("GET", path, query=query, model=model_id)
        url, status = answer.get("url"), answer.get("status")
        return Asset(url if isinstance(url, str) else "", str(status or ""))

    def leaderboards(self) -> list[Mapping[str, Any]]:
        """Its races, with the keys of the interface."""
        return self._objects("/leaderboards", "leaderboards")

    def submissions(self, race_id: str) -> list[Mapping[str, Any]]:
        """Those of this user to a race, with the keys of the interface."""
        return self._objects(f"/leaderboards/{race_id}/submissions", "submissions")

    def submit(self, race_id: str, model_id: str) -> None:
        """Let a model drive in a race, when those before it are done."""
        body = {"modelId": model_id}
        self._call("POST", f"/leaderboards/{race_id}/submissions", body=body)

    def _objects(self, path: str, key: str) -> list[Mapping[str, Any]]:
        return [item for item in self._listed(path, key) if isinstance(item, dict)]

    def _listed(self, path: str, key: str) -> Iterator[Any]:
        """The items of all pages."""
        token = ""
        for _ in range(_MOST_PAGES):
            answer = self._call("GET", path, query={"token": token} if token else {})
            items = answer.get(key)
            if not isinstance(items, list):
                raise self._unexpected(f"an answer without {key}")
            yield from items
            following = answer.get("token")
            if not isinstance(following, str) or not following or following == token:
                return
            token = following

    def _call(
        self,
        method: str,
        path: str,
        *,
        query: Mapping[str, str] | None = None,
        body: Mapping[str, str] | None = None,
        model: str = "",
    ) -> Mapping[str, Any]:
        url = self.session.site.api_endpoint + path
        if query:
            url += "?" + urlencode(query, quote_via=quote)
        data = b"" if body is None else json.dumps(body).encode()
        answer = self._send(method, url, data, self.session.keys())
        if answer.status_code in (401, 403) and _STALE_KEYS.search(answer.text):
            answer = self._send(method, url, data, self.session.renew())
        return self._read(answer, model)

    def _send(self, method: str, url: str, data: bytes, keys: Keys) -> "requests.Response":
        site = self.session.site

        def make() -> "requests.Request":
            return _signed(method, url, data, keys, site.region, site.url)

        return self.web.send(make, repeat=method == "GET")

    def _read(self, answer: "requests.Response", model: str) -> Mapping[str, Any]:
        status = answer.status_code
        message = _message(answer)
        if status == 404 and model:
            raise NoSuchModel(
                f"{self.place} has no {shown(model)} for you: {message or 'not found'}.",
                remedy="`droa-list-models` lists your models.",
            )
        if status >= 400:
            raise StorageError(
                f"{self.place} answered {status}: {message or answer.reason or 'no reason'}.",
                remedy=_remedy(status),
            )
        if status == 204 or not answer.content.strip():
            return {}
        try:
            values = answer.json()
        except (ValueError, RecursionError):
            values = None
        if status >= 300 or not isinstance(values, dict):
            raise self._unexpected(f"{status} and no JSON object")
        return values

    def _unexpected(self, what: str) -> StorageError:
        return StorageError(
            f"{self.session.site.api_endpoint} is not the interface of DeepRacer on AWS: it gave "
            f"{what}.",
            remedy="Check apiEndpointUrl in env.js of that site, or --api-endpoint.",
        )


def _signed(
    method: str, url: str, data: bytes, keys: Keys, region: str, origin: str
) -> "requests.Request":
    """AWS signature version 4 for API Gateway."""
    headers = {"Accept": "application/json"}
    if data:
        headers["Content-Type"] = "application/json"
    if origin:  # as the web page sends them
        headers |= {"Origin": origin, "Referer": f"{origin}/"}
    signed = awsrequest.AWSRequest(method=method, url=url, data=data, headers=headers)
    credentials = botocore_credentials.Credentials(
        keys.access_key, keys.secret_key, keys.session_token
    )
    botocore_auth.SigV4Auth(credentials, "execute-api", region).add_auth(signed)
    return requests.Request(method, url, headers=dict(signed.headers), data=data)


def _checked(model_id: str) -> str:
    if not _ID.fullmatch(model_id):
        raise NoSuchModel(
            f"{shown(model_id)} is not the id of a model: 15 letters and digits.",
            remedy="`droa-list-models` lists your models with their ids.",
        )
    return model_id


def _message(answer: "requests.Response") -> str:
    try:
        values = answer.json()
    except (ValueError, RecursionError):
        return ""
    found = ""
    if isinstance(values, dict):
        found = str(values.get("message") or values.get("Message") or values.get("error") or "")
    text = " ".join(found.split())
    return text[:_LONGEST_MESSAGE].rstrip(".")


def _remedy(status: int) -> str:
    if status in (401, 403):
        return (
            "Run `droa-login` again; if that does not help, check the clock of this machine, and "
            "ask who runs that site whether your account may do this."
        )
    if status == 429:
        return "Wait a minute, and try again."
    if status >= 500:
        return "Try again later; if it fails again, ask who runs that site to look at its logs."
    return "Correct what it names, and try again."
