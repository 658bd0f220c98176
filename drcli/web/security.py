"""Who may use the console: checks Host, Origin and token of every request before anything else.

Two attacks are meant. A page of another site that sends requests to this address (CSRF, also over a
WebSocket): its Origin is not ours. A name of the attacker that suddenly leads to this machine (DNS
rebinding): its Host is not ours, and has no cookie of ours.
"""

import asyncio
import hashlib
import hmac
import re
import time
from collections import OrderedDict, deque
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drcli.base.termination import Stopped
from drcli.web.listen import ENTER

LOOPBACK = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:[0-9]{1,5})?")
"""Names of this machine that only this machine can use. Any port: it may be forwarded by ssh."""

MOST_TRIES = 10
"""Wrong tokens in a minute from one address; then it must wait for the rest of it."""

MOST_ADDRESSES = 1000
"""Whose wrong tokens are remembered."""

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        "media-src 'self' blob:",
        "font-src 'self'",
        "connect-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    )
)
"""Content-Security-Policy: nothing inline, nothing from elsewhere."""

_HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}

_POLICY_VIOLATION = 1008
"""Code with which a WebSocket is closed. Source: RFC 6455, section 7.4.1."""

_STOPPED = "The console was stopped before it could answer."

_REMEDY = "Start it again with `dr-start-viewer`, then repeat what you did."


class Guard:
    """ASGI middleware that refuses requests of strangers.

    Args:
        app: What is guarded.
        token: What a request from another machine must know; None on a loopback address, which
            only this machine can reach.
    """

    def __init__(self, app: ASGIApp, token: str | None) -> None:
        self._app, self._token = app, token
        self._cookie = cookie_name(token or "")
        self._wrong: OrderedDict[str, deque[float]] = OrderedDict()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or refuse."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await _refuse(scope, receive, send, *refusal)
            return
        if self._token is not None and scope["type"] == "http" and scope["path"] == ENTER:
            await self._enter(scope, receive, send)
            return

        answering = False

        async def send_guarded(message: Message) -> None:
            nonlocal answering
            answering = True
            if message["type"] == "http.response.start":
                _add_headers(message)
            await send(message)

        try:
            await self._app(scope, receive, send_guarded)
        except asyncio.CancelledError:  # only the end of the console cancels requests
            if scope["type"] == "http" and not answering:
                found = {"message": _STOPPED, "remedy": _REMEDY, "code": Stopped.code}
                await JSONResponse({"error": found}, 503)(scope, receive, send_guarded)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        """Status and sentence; None if the request may pass."""
        hosts = headers.getlist("host")
        host = hosts[0].lower() if len(hosts) == 1 else ""
        if not host or (self._token is None and not LOOPBACK.fullmatch(host)):
            return 421, "This console does not answer to that name. Use the printed address."
        origin = headers.get("origin")
        ours = {f"http://{host}", f"https://{host}"}
        changes = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if (changes and origin is None) or (origin is not None and origin.lower() not in ours):
            return 403, "The request comes from another site."
        if headers.get("sec-fetch-site") in ("cross-site", "same-site") and (
            headers.get("sec-fetch-mode") != "navigate" or changes
        ):
            return 403, "The request comes from another site."
        if self._token is None or scope["path"] == ENTER or self._knows(self._given(headers)):
            return None
        return 401, f"This console needs its token. Open {ENTER} or the printed address."

    def _given(self, headers: Headers) -> str:
        """The token of the cookie."""
        for part in headers.get("cookie", "").split(";"):
            name, _, value = part.strip().partition("=")
            if name == self._cookie:
                return value
        return ""

    def _knows(self, given: str) -> bool:
        return self._token is not None and hmac.compare_digest(
            given.encode("utf-8", "replace"), self._token.encode()
        )

    async def _enter(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Give the cookie for the right token; without one, a form asks for it."""
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        response: PlainTextResponse | RedirectResponse
        if not given:
            response = PlainTextResponse(_FORM, media_type="text/html")
        elif self._must_wait(scope):
            response = PlainTextResponse("Too many wrong tokens. Wait a minute.", 429)
        elif not self._knows(given):
            self._note_wrong(scope)
            response = PlainTextResponse(
                "Wrong token. `dr-start-viewer` prints the right address.", 401
            )
        else:
            response = RedirectResponse("/", 303)
            secure = scope.get("scheme") == "https"
            response.set_cookie(
                self._cookie, given, path="/", httponly=True, samesite="strict", secure=secure
            )
        response.headers.update(_HEADERS)
        response.headers["cache-control"] = "no-store"
        await response(scope, receive, send)

    def _must_wait(self, scope: Scope) -> bool:
        tries = self._wrong.get(_address(scope))
        if tries is None or len(tries) < MOST_TRIES:
            return False
        return time.monotonic() - tries[0] < 60.0

    def _note_wrong(self, scope: Scope) -> None:
        tries = self._wrong.setdefault(_address(scope), deque(maxlen=MOST_TRIES))
        tries.append(time.monotonic())
        if len(self._wrong) > MOST_ADDRESSES:
            self._wrong.popitem(last=False)


def cookie_name(token: str) -> str:
    """Each console has its own: a browser sends cookies of one port to all others of a machine."""
    return f"dr_console_{hashlib.sha256(token.encode()).hexdigest()[:8]}"


def _address(scope: Scope) -> str:
    client = scope.get("client") or [""]
    return str(client[0])


_FORM = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>DeepRacer console</title>
<h1>DeepRacer console</h1>
<form action="/enter" method="get">
<p><label for="token">Token (dr-start-viewer prints it)</label></p>
<p><input id="token" name="token" autocomplete="off" required> <button>Open</button></p>
</form>
</html>
"""


def _add_headers(message: Message) -> None:
    headers = MutableHeaders(scope=message)
    for name, value in _HEADERS.items():
        headers.setdefault(name, value)
    headers.setdefault("cache-control", "no-store")


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, sentence: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": _POLICY_VIOLATION, "reason": sentence})
        return
    body = {"error": {"message": sentence, "remedy": "", "code": 2}}
    await JSONResponse(body, status, _HEADERS)(scope, receive, send)
