"""A DeepRacer on AWS on this machine: sign-in, interface, upload bucket and downloads.

It checks every signature with the keys that it issued, and keeps the rules that are known of the
real one. Everything runs in one thread of its own, without pauses.
"""

import hashlib
import json
import re
import secrets
import string
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape

import yaml
from botocore.auth import S3SigV4Auth, SigV4Auth
from botocore.awsrequest import AWSRequest
from botocore.credentials import Credentials

REGION = "eu-west-1"
POOL, CLIENT, IDENTITIES = "eu-west-1_Pool", "client-1", "eu-west-1:identities"
BUCKET = "upload-bucket"
USER, PASSWORD = "me@example.com", "Secret-1"
STAGE = "/prod"
_SKEW = timedelta(minutes=5)

Answer = tuple[int, dict[str, str], bytes]


@dataclass
class Issued:
    """Keys that were given to somebody."""

    user: str
    secret: str
    token: str
    expires: datetime


@dataclass
class FakeDroa:
    """The state of the server, which tests look at and change.

    Attributes:
        objects: The upload bucket.
        models: Models of the user by id, as the interface shows them.
        files: Downloads by path.
        calls: Method and path of all requests to the interface.
        faults: Answers to give instead of the right ones, the first one first; None drops the
            connection.
        broken_downloads: How many downloads break off in the middle.
        writable: Whether users may write to the upload bucket.
        challenge: What Cognito asks for besides the password.
        password_flow: Whether programs may sign in.
        import_polls: How often an import is asked about before it is finished.
        pack_polls: How often a model is asked for before it is packed.
        page_size: Models on a page of the list.
        races: Races by id, as the interface shows them.
        submissions: What was submitted to each race, the newest last.
        race_polls: How often a submission is asked about before it was driven.
    """

    objects: dict[str, bytes] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)
    models: dict[str, dict[str, Any]] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    calls: list[tuple[str, str]] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)
    faults: list[Answer | None] = field(default_factory=list)
    issued: dict[str, Issued] = field(default_factory=dict)
    sign_ins: int = 0
    broken_downloads: int = 0
    writable: bool = True
    challenge: str = ""
    code: str = "123456"
    password_flow: bool = True
    key_lifetime: timedelta = timedelta(hours=1)
    import_polls: int = 2
    pack_polls: int = 2
    page_size: int = 2
    env_js: str = ""
    logs_finished: bool = True
    races: dict[str, dict[str, Any]] = field(default_factory=dict)
    submissions: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    race_polls: int = 2

    def __post_init__(self) -> None:
        self._tokens: dict[str, str] = {}
        self._parts: dict[str, dict[int, bytes]] = {}
        self._waiting: dict[str, int] = {}
        self._packing: dict[str, int] = {}
        self._verdicts: dict[str, str] = {}
        self._lock = threading.Lock()
        fake = self

        class Handler(_Handler):
            state = fake

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.host = f"127.0.0.1:{self._server.server_address[1]}"
        self.url = f"http://{self.host}"
        self.env_js = self.env_js or (
            "// written by the deployment\n"
            "window.EnvironmentConfig = {\n"
            f"  apiEndpointUrl: '{self.url}{STAGE}/',\n"
            f'  "userPoolId": "{POOL}", userPoolClientId: `{CLIENT}`,\n'
            f"  identityPoolId: '{IDENTITIES}',\n"
            f"  region: '{REGION}', uploadBucketName: '{BUCKET}',\n"
            "};\n"
        )
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """End the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def add_model(self, name: str, status: str = "READY", **values: Any) -> str:
        """Put a model into the account; its id."""
        letters = string.ascii_letters + string.digits
        model_id = "".join(secrets.choice(letters) for _ in range(15))
        self.models[model_id] = {
            "modelId": model_id,
            "name": name,
            "status": status,
            "trainingStatus": "COMPLETED",
            "createdAt": f"2026-11-{len(self.models) + 1:02}T10:00:00.000Z",
            "fileSizeInBytes": 0,
            **values,
        }
        return model_id

    def add_race(self, name: str, **values: Any) -> str:
        """Put a race on the site; its id."""
        race_id = f"race{len(self.races):011}"
        now = datetime.now(UTC)
        self.races[race_id] = {
            "leaderboardId": race_id,
            "name": name,
            "openTime": (now - timedelta(days=1)).isoformat(),
            "closeTime": (now + timedelta(days=1)).isoformat(),
            "trackConfig": {"trackId": "reinvent_base", "trackDirection": "COUNTER_CLOCKWISE"},
            "raceType": "TIME_TRIAL",
            "maxSubmissionsPerUser": 3,
            **values,
        }
        self.submissions[race_id] = []
        return race_id

    def expire_keys(self) -> None:
        """End all keys that were issued so far."""
        for issued in self.issued.values():
            issued.expires = datetime.now(UTC) - timedelta(seconds=1)

    def answer(self, method: str, target: str, headers: Mapping[str, str], body: bytes) -> Any:
        """The answer to a request; None drops the connection."""
        parts = urlsplit(target)
        with self._lock:
            if parts.path == "/env.js":
                return 200, {"Content-Type": "text/javascript"}, self.env_js.encode()
            if "X-Amz-Target" in headers:
                return self._cognito(headers["X-Amz-Target"].rpartition(".")[2], json.loads(body))
            if parts.path.startswith(f"/{BUCKET}"):
                return self._bucket(method, target, headers, body)
            if parts.path in self.files:
                return self._download(parts.path)
            if not parts.path.startswith(STAGE):
                return 404, {}, b"<html>not found</html>"
            self.calls.append((method, target.removeprefix(STAGE)))
            self.headers.append(dict(headers))
            if self.faults:
                return self.faults.pop(0)
            refusal = self._refusal(method, target, headers, body, "execute-api")
            if refusal:
                return _json(403, {"message": refusal})
            return self._interface(method, parts.path.removeprefix(STAGE), parts.query, body)

    # Signatures.

    def _refusal(
        self, method: str, target: str, headers: Mapping[str, str], body: bytes, service: str
    ) -> str:
        """Why a signature is not accepted; empty if it is."""
        pattern = (
            r"AWS4-HMAC-SHA256 Credential=([^/]+)/(\d{8})/([^/]+)/([^/]+)/aws4_request, "
            r"SignedHeaders=([^,]+), Signature=([0-9a-f]{64})"
        )
        found = re.fullmatch(pattern, headers.get("Authorization", ""))
        if found is None:
            return "Missing Authentication Token"
        access, day, region, signed_for, names, signature = found.groups()
        issued = self.issued.get(access)
        token = headers.get("X-Amz-Security-Token", "")
        if issued is None or not secrets.compare_digest(token, issued.token):
            return "The security token included in the request is invalid."
        if (region, signed_for) != (REGION, service):
            return f"Credential should be scoped to {REGION}/{service}"
        signed = names.split(";")
        if "host" not in signed or "x-amz-date" not in signed:
            return "host and x-amz-date must be signed"
        date = headers.get("X-Amz-Date", "")
        at = datetime.strptime(date, "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
        if not date.startswith(day) or abs(datetime.now(UTC) - at) > _SKEW:
            return "Signature expired: the clock of the client is wrong"
        sent = headers.get("X-Amz-Content-SHA256")
        if sent and sent != "UNSIGNED-PAYLOAD" and sent != hashlib.sha256(body).hexdigest():
            return "The provided x-amz-content-sha256 header does not match what was computed"
        request = AWSRequest(
            method=method,
            url=f"{self.url}{target}",
            data=body,
            headers={name: headers[name] for name in signed},
        )
        request.context["timestamp"] = date
        credentials = Credentials(access, issued.secret, issued.token)
        kind = S3SigV4Auth if service == "s3" else SigV4Auth
        signer = kind(credentials, service, REGION)
        right = signer.signature(
            signer.string_to_sign(request, signer.canonical_request(request)), request
        )
        if not secrets.compare_digest(right, signature):
            return "The request signature we calculated does not match the signature you provided."
        if issued.expires <= datetime.now(UTC):
            return "The security token included in the request is expired"
        return ""

    # Cognito.

    def _cognito(self, call: str, body: dict[str, Any]) -> Answer:
        if call == "InitiateAuth":
            return self._initiate(body)
        if call == "RespondToAuthChallenge":
            user = body["ChallengeResponses"]["USERNAME"]
            if self.code not in body["ChallengeResponses"].values():
                return _failed("CodeMismatchException", "Invalid code received for user")
            return _json(200, {"AuthenticationResult": {"IdToken": self._token(user)}})
        user = self._tokens.get(body["Logins"].get(f"cognito-idp.{REGION}.amazonaws.com/{POOL}"))
        if user is None:
            return _failed("NotAuthorizedException", "Token is not from a supported provider")
        if call == "GetId":
            if body["IdentityPoolId"] != IDENTITIES:
                return _failed("ResourceNotFoundException", "IdentityPool not found.")
            return _json(200, {"IdentityId": f"{IDENTITIES}:{user}"})
        access = f"ASIA{secrets.token_hex(8).upper()}"
        expires = datetime.now(UTC) + self.key_lifetime
        issued = Issued(user, secrets.token_hex(20), secrets.token_urlsafe(60), expires)
        self.issued[access] = issued
        credentials = {
            "AccessKeyId": access,
            "SecretKey": issued.secret,
            "SessionToken": issued.token,
            "Expiration": expires.timestamp(),
        }
        return _json(200, {"IdentityId": body["IdentityId"], "Credentials": credentials})

    def _initiate(self, body: dict[str, Any]) -> Answer:
        self.sign_ins += 1
        given = body["AuthParameters"]
        if body["ClientId"] != CLIENT:
            return _failed("ResourceNotFoundException", "User pool client does not exist.")
        if not self.password_flow:
            message = "USER_PASSWORD_AUTH flow not enabled for this client"
            return _failed("InvalidParameterException", message)
        if (given["USERNAME"], given["PASSWORD"]) != (USER, PASSWORD):
            return _failed("NotAuthorizedException", "Incorrect username or password.")
        if self.challenge:
            return _json(200, {"ChallengeName": self.challenge, "Session": "s" * 20})
        return _json(200, {"AuthenticationResult": {"IdToken": self._token(given["USERNAME"])}})

    def _token(self, user: str) -> str:
        token = secrets.token_urlsafe(30)
        self._tokens[token] = user
        return token

    # The upload bucket.

    def _bucket(self, method: str, target: str, headers: Mapping[str, str], body: bytes) -> Answer:
        refusal = self._refusal(method, target, headers, body, "s3")
        parts = urlsplit(target)
        key = unquote(parts.path.removeprefix(f"/{BUCKET}/"))
        query = parse_qs(parts.query, keep_blank_values=True)
        place = (
            r"uploads/models/[0-9a-f]{8}-[0-9a-f]{4}-4[0-9a-f]{3}-[89ab][0-9a-f]{3}-[0-9a-f]{12}/.+"
        )
        if refusal or not self.writable or not re.fullmatch(place, key):
            return _xml(403, "AccessDenied", refusal or "Access Denied")
        if method == "DELETE":
            self.objects.pop(key, None)
            return 204, {}, b""
        if method == "POST" and "uploads" in query:
            upload = secrets.token_hex(8)
            self._parts[upload] = {}
            text = f"<InitiateMultipartUploadResult><UploadId>{upload}</UploadId>"
            return 200, {}, f"{text}</InitiateMultipartUploadResult>".encode()
        if method == "POST":
            parts_of = self._parts.pop(query["uploadId"][0])
            self.objects[key] = b"".join(data for _, data in sorted(parts_of.items()))
            return 200, {}, b"<CompleteMultipartUploadResult></CompleteMultipartUploadResult>"
        if method == "PUT" and "uploadId" in query:
            self._parts[query["uploadId"][0]][int(query["partNumber"][0])] = body
        elif method == "PUT":
            self.objects[key] = body
            self.types[key] = headers.get("Content-Type", "")
        return 200, {"ETag": f'"{hashlib.md5(body).hexdigest()}"'}, b""

    # Downloads.

    def add_file(self, path: str, data: bytes) -> str:
        """Offer a file; its address."""
        self.files[path] = data
        return f"{self.url}{path}?X-Amz-Signature=secret"

    def _download(self, path: str) -> Any:
        data = self.files[path]
        name = path.rpartition("/")[2]
        headers = {"Content-Disposition": f'attachment; filename="{name}"'}
        if self.broken_downloads:
            self.broken_downloads -= 1
            return 200, {**headers, "Content-Length": str(len(data) + 1)}, data
        return 200, headers, data

    # The interface.

    def _interface(self, method: str, path: str, query: str, body: bytes) -> Answer:
        values = {name: found[0] for name, found in parse_qs(query).items()}
        if (method, path) == ("GET", "/models"):
            return self._list(values.get("token", ""))
        if (method, path) == ("POST", "/importmodel"):
            return self._import(json.loads(body))
        if path == "/leaderboards":
            return _json(200, {"leaderboards": list(self.races.values())})
        race = re.fullmatch(r"/leaderboards/([A-Za-z0-9]{15})/submissions", path)
        if race is not None and race[1] in self.races:
            return self._submissions(method, race[1], body)
        found = re.fullmatch(r"/models/([A-Za-z0-9]{15})(/getasset)?", path)
        if found is None or found[1] not in self.models:
            return _json(404, {"message": "The requested resource does not exist."})
        model = self.models[found[1]]
        if found[2]:
            return self._asset(model, values)
        if method == "DELETE":
            if model["status"] not in ("READY", "ERROR"):
                message = "This resource cannot be deleted at this time. Try again later."
                return _json(400, {"message": message})
            model["status"] = "DELETING"
            return _json(200, {})
        self._advance(model)
        return _json(200, {"model": model})

    def _list(self, token: str) -> Answer:
        listed = list(self.models.values())
        start = int(token.partition("/")[2] or 0)  # a slash, so that the query is encoded
        page = listed[start : start + self.page_size]
        following = start + self.page_size
        more = {"token": f"page=/{following}"} if following < len(listed) else {}
        return _json(200, {"models": page, **more})

    def _submissions(self, method: str, race_id: str, body: bytes) -> Answer:
        race, made = self.races[race_id], self.submissions[race_id]
        if method == "POST":
            model = self.models.get(json.loads(body)["modelId"])
            if model is None:
                return _json(404, {"message": "The requested resource does not exist."})
            if model["status"] != "READY":
                return _json(400, {"message": "Model is not in a submittable state."})
            if datetime.fromisoformat(race["closeTime"]) < datetime.now(UTC):
                return _json(400, {"message": "The leaderboard is not accepting submissions."})
            if len(made) >= race["maxSubmissionsPerUser"]:
                return _json(400, {"message": "Max number of submissions has been reached."})
            one = {"modelId": model["modelId"], "modelName": model["name"], "status": "QUEUED"}
            made.append({**one, "submissionNumber": len(made) + 1, "polls": self.race_polls})
            model["status"] = "QUEUED"
            return _json(200, {"submissionId": f"submission{len(made):05}"})
        if made and made[-1]["status"] == "QUEUED":
            newest = made[-1]
            newest["polls"] -= 1
            if newest["polls"] < 0:
                self.models[newest["modelId"]]["status"] = "READY"
                stats = {"bestLapTime": 9_950, "completedLapCount": 3, "resetCount": 1}
                newest |= {"status": "COMPLETED", "rankingScore": 31_250, "stats": stats}
        return _json(200, {"submissions": list(reversed(made))})

    def _advance(self, model: dict[str, Any]) -> None:
        """Let an import go on."""
        model_id = model["modelId"]
        if model["status"] != "IMPORTING":
            return
        self._waiting[model_id] -= 1
        if self._waiting[model_id] < 0:
            verdict = self._verdicts[model_id]
            model["status"] = "ERROR" if verdict else "READY"
            if verdict:
                model["importErrorMessage"] = verdict

    def _import(self, body: dict[str, str]) -> Answer:
        name, description = body.get("modelName", ""), body.get("modelDescription")
        if not re.fullmatch(r"[a-zA-Z0-9-]{1,64}", name):
            return _json(400, {"message": "Model name must contain only alphanumeric characters"})
        if description is not None and not re.fullmatch(r"[a-zA-Z0-9- ]{1,255}", description):
            return _json(400, {"message": "Model description must contain only alphanumeric"})
        if body.get("s3Bucket") != BUCKET:
            return _json(500, {"message": "The service ran into an error."})
        folder = f"{body['s3Path']}/"
        files = {k.removeprefix(folder): v for k, v in self.objects.items() if k.startswith(folder)}
        try:
            message = _import_refusal(files)
        except (KeyError, ValueError, TypeError, AttributeError, yaml.YAMLError):
            return _json(500, {"message": "The service ran into an error."})
        if message:
            return _json(400, {"message": message})
        model_id = self.add_model(name, "IMPORTING", description=description)
        self._waiting[model_id] = self.import_polls
        self._verdicts[model_id] = _import_verdict(files)
        return _json(200, {"modelId": model_id})

    def _asset(self, model: dict[str, Any], query: Mapping[str, str]) -> Answer:
        kind, model_id, name = query.get("assetType"), model["modelId"], model["name"]
        if kind == "EVALUATION_LOGS" and "evaluationId" not in query:
            return _json(400, {"message": "evaluationId is required for evaluation logs."})
        if kind in ("TRAINING_LOGS", "EVALUATION_LOGS"):
            if not self.logs_finished:
                message = "Logs download is not available until job is complete."
                return _json(400, {"message": message})
            return self._offered(f"/files/{kind.lower()}-{name}.tar.gz")
        if kind == "PHYSICAL_CAR_MODEL":
            path = f"/files/physicalmodel-{name}.tar.gz"
            if path not in self.files:
                return _json(404, {"message": "Unable to find physical model artifact."})
            return self._offered(path)
        if kind == "VIRTUAL_MODEL":
            left = self._packing.setdefault(model_id, self.pack_polls)
            self._packing[model_id] = left - 1
            if left > 0:
                return _json(200, {"status": "QUEUED"})
            return self._offered(f"/files/virtualmodel-{name}.tar.gz")
        return _json(400, {"message": "This asset type is not supported."})

    def _offered(self, path: str) -> Answer:
        url = self.add_file(path, self.files.get(path, b"packed files " * 1000))
        return _json(200, {"url": url})


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    wbufsize = -1  # head and body in one packet; otherwise each answer takes 40 ms
    state: FakeDroa

    def _serve(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        answer = self.state.answer(self.command, self.path, self.headers, body)
        if answer is None:
            self.close_connection = True
            return
        status, headers, data = answer
        self.send_response(status)
        for name, value in {"Content-Length": str(len(data)), **headers}.items():
            self.send_header(name, value)
        if headers.get("Content-Length", str(len(data))) != str(len(data)):
            self.close_connection = True
        self.end_headers()
        self.wfile.write(data)

    do_GET = do_POST = do_PUT = do_DELETE = _serve  # noqa: N815  names of http.server

    def handle_expect_100(self) -> bool:
        """Answer at once; S3 clients wait for it before they send a file."""
        go_on = super().handle_expect_100()
        self.wfile.flush()
        return go_on

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""


def _json(status: int, values: Any) -> Answer:
    return status, {"Content-Type": "application/json"}, json.dumps(values).encode()


def _failed(kind: str, message: str) -> Answer:
    return _json(400, {"__type": kind, "message": message})


def _xml(status: int, code: str, message: str) -> Answer:
    text = f"<Error><Code>{code}</Code><Message>{escape(message)}</Message></Error>"
    return status, {"Content-Type": "application/xml"}, text.encode()


def _import_refusal(files: Mapping[str, bytes]) -> str:
    """What is answered at once; raises where the real server runs into an error."""
    parameters = yaml.safe_load(files["training_params.yaml"])
    metadata = json.loads(files["model_metadata.json"])
    hyperparameters = json.loads(files["ip/hyperparameters.json"])
    if not files["reward_function.py"]:
        raise ValueError("empty")
    if parameters["BODY_SHELL_TYPE"] == "deepracer" and parameters["CAR_COLOR"] == "Yellow":
        return "Invalid car customization. Car shell DEEPRACER is not available in color YELLOW."
    if parameters["WORLD_NAME"] not in ("reinvent_base", "reInvent2019_wide", "arctic_open"):
        return "Invalid track configuration."
    if metadata["training_algorithm"] == "sac":
        if metadata["action_space_type"] == "discrete":
            return "Agent algorithm SAC does not work with discrete action space."
        if hyperparameters["num_episodes_between_training"] != 1:
            return "Invalid hyperparameter number of episodes between training for SAC"
    if metadata["action_space_type"] == "continuous":
        speed = metadata["action_space"]["speed"]
        if speed["low"] >= speed["high"]:
            return "Invalid action space speeds."
    return ""


def _import_verdict(files: Mapping[str, bytes]) -> str:
    """The message of a failed import; empty if it works."""
    pointer = files.get("model/.coach_checkpoint", b"").decode().strip()
    ends = (".index", ".meta", ".data-00000-of-00001")
    if not pointer or not all(files.get(f"model/{pointer}{end}") for end in ends):
        return "Model validation failed: no checkpoint can be restored"
    return ""
