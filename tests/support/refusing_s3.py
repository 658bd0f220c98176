"""An S3 server that refuses requests as Amazon does, or is silent; it keeps everything."""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from moto.server import DomainDispatcherApplication, create_backend_app
from werkzeug import Request, Response
from werkzeug.serving import make_server

from drcli.bucket.endpoint import UPLOADS, Endpoint
from drcli.bucket.s3_bucket import S3Bucket

ACTIONS = {"PUT": "s3:PutObject", "GET": "s3:GetObject", "POST": "s3:DeleteObject"}
USER = "arn:aws:iam::123456789012:user/racer"


def _set() -> threading.Event:
    event = threading.Event()
    event.set()
    return event


@dataclass
class Refusals:
    """What the server refuses from now on.

    Attributes:
        only: Keys and listings that begin so are allowed, all others are refused; empty for all.
        actions: Permissions that are missing, such as s3:PutObject.
        below: Keys that the refusal is about begin so.
        code: Of the error.
        status: Of the answer.
        message: Text of the error; by default Amazon's about a missing permission.
        everything: Whether every request is refused, with `code`; a HEAD has no body that names it.
        silence: While it is cleared, requests are not answered.
        seen: Method and path of every request.
    """

    only: tuple[str, ...] = ()
    actions: set[str] = field(default_factory=set)
    below: str = ""
    code: str = "AccessDenied"
    status: int = 403
    message: str = ""
    everything: bool = False
    silence: threading.Event = field(default_factory=_set)
    seen: list[str] = field(default_factory=list)

    def text(self, action: str, resource: str) -> str:
        """The text of the error."""
        return self.message or (
            f'User: {USER} is not authorized to perform: {action} on resource: "{resource}" '
            f"because no identity-based policy allows the {action} action"
        )


class RefusingApp:
    """moto, behind a policy."""

    def __init__(self, refusals: Refusals) -> None:
        self._inner = DomainDispatcherApplication(create_backend_app)
        self._refusals = refusals

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Any:
        """Answer a request."""
        request = Request(environ, populate_request=False)
        bucket, _, key = request.path.lstrip("/").partition("/")
        self._refusals.seen.append(f"{request.method} {request.path}")
        action = ACTIONS.get(request.method, "")
        if request.method == "GET" and not key:
            action = "s3:ListBucket"
        if request.method == "PUT" and not key:
            action = "s3:CreateBucket"
        self._refusals.silence.wait()
        place = key or request.args.get("prefix", "")
        if self._refusals.everything:
            return self._denial(action, bucket, key)(environ, start_response)
        if self._refusals.only and request.method != "POST" and not self._allows(place):
            return self._denial(action, bucket, key)(environ, start_response)
        if action == "s3:DeleteObject" and action in self._refusals.actions:
            body = request.get_data()
            return self._deletions(bucket, body)(environ, start_response)
        if action in self._refusals.actions and key.startswith(self._refusals.below):
            return self._denial(action, bucket, key)(environ, start_response)
        return self._inner(environ, start_response)

    def _allows(self, place: str) -> bool:
        return place.startswith(self._refusals.only)

    def _denial(self, action: str, bucket: str, key: str) -> Response:
        resource = f"arn:aws:s3:::{bucket}/{key}" if key else f"arn:aws:s3:::{bucket}"
        text = self._refusals.text(action, resource)
        xml = f"<Error><Code>{self._refusals.code}</Code><Message>{text}</Message></Error>"
        return Response(xml, self._refusals.status, content_type="application/xml")

    def _deletions(self, bucket: str, body: bytes) -> Response:
        """Refuse each object of a deletion, in an answer that is a success."""
        entries = ""
        for key in re.findall(r"<Key>(.*?)</Key>", body.decode()):
            text = self._refusals.text("s3:DeleteObject", f"arn:aws:s3:::{bucket}/{key}")
            code = self._refusals.code
            entries += (
                f"<Error><Key>{key}</Key><Code>{code}</Code><Message>{text}</Message></Error>"
            )
        return Response(f"<DeleteResult>{entries}</DeleteResult>", 200)


@contextmanager
def refusing_server() -> Iterator[tuple[Endpoint, Refusals]]:
    """Serve, with an address that names the settings of uploads; refuses nothing at first."""
    refusals = Refusals()
    server = make_server("127.0.0.1", 0, RefusingApp(refusals), threaded=True)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    address = f"http://127.0.0.1:{server.server_port}"
    try:
        yield Endpoint(address, access_key="testing", secret_key="testing", names=UPLOADS), refusals
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def contents(bucket: S3Bucket) -> dict[str, bytes]:
    """Everything in a bucket."""
    return {info.key: bucket.get(info.key) for info in bucket.list("")}
