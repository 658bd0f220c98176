"""Checks Host, Origin and token of every request before anything else.

Against pages of other sites that send requests here (CSRF, also over a WebSocket): their Origin is
not ours. Against names of an attacker that suddenly lead to this machine (DNS rebinding): their
Host is not ours and has no cookie.
"""

import asyncio
import hashlib
import hmac
import re
import time
from collections import OrderedDict, deque
from html import escape
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drcli.base.processes import Stopped
from drcli.web.listen import ENTER, STREAM

# The page that asks for the token of the console.


STYLE = "/enter.css"
GET_LINK = (
    "Run `dr console` in the working folder: it opens the page with its token. "
    "`dr console start` prints the link."
)

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">{again}
<title>DeepRacer console</title>
<link rel="icon" href="data:,">
<link rel="stylesheet" href="{style}">
</head>
<body>
<main>
<h1>DeepRacer console</h1>
<p role="alert">{sentence}</p>
<p>On the machine where the console runs, type this in the working folder:</p>
<p class="command"><code>dr console</code></p>
<p>It opens the page with its token; <code>dr console start</code> only prints the link. A browser
that has opened the link keeps the token for a year, so a bookmark works without it.</p>
<form action="/enter" method="post">
<label for="token">Token, the end of the link</label>
<input id="token" name="token" autocomplete="off" required>
<button>Open</button>
</form>
</main>
</body>
</html>
"""


_REFUSED = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>DeepRacer console</title>
<link rel="stylesheet" href="{style}">
<main>
<h1>DeepRacer console</h1>
<p role="alert">{sentence}</p>
</main>
</html>
"""


def enter_page(sentence: str, *, asks_again: bool = False) -> str:
    """`asks_again`: the browser asks for the front page once more."""
    again = '\n<meta http-equiv="refresh" content="0; url=/">' if asks_again else ""
    return _PAGE.format(again=again, style=STYLE, sentence=escape(sentence))


LOOPBACK = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:[0-9]{1,5})?")
"""Only this machine can use them. Any port: ssh may forward it."""

MOST_TRIES = 10
"""Per minute and address."""

MOST_FORM_BYTES = 4096
KEPT_S = 365 * 86_400
"""Browsers keep no cookie longer than 400 days."""

MOST_ADDRESSES = 1000
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
"""Nothing inline, nothing from elsewhere."""

_HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}

_ENTER_HEADERS = {**_HEADERS, "cache-control": "no-store", "referrer-policy": "same-origin"}
"""Without a referrer, a browser says that the form comes from nowhere."""

_POLICY_VIOLATION = 1008
"""RFC 6455, section 7.4.1."""

NEEDS_TOKEN = "This console needs its token."

_STOPPED = "The console was stopped before it could answer."

_REMEDY = "Start it again with `dr console start`, then repeat what you did."


class Guard:
    """ASGI middleware that refuses strangers.

    Args:
        token: None: every user of this machine may use the console.
        here_only: Only this machine can reach it, as without a token. Then it answers only to names
            of this machine, and nobody who guesses must wait: all users share one address.
    """

    def __init__(self, app: ASGIApp, token: str | None, *, here_only: bool = False) -> None:
        self._app, self._token = app, token
        self._here_only = here_only or token is None
        self._cookie = cookie_name(token or "")
        self._wrong: OrderedDict[str, deque[float]] = OrderedDict()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
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
        hosts = headers.getlist("host")
        host = hosts[0].lower() if len(hosts) == 1 else ""
        if not host or (self._here_only and not LOOPBACK.fullmatch(host)):
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
        if scope["path"] in (ENTER, STYLE) or self._is_admitted(scope, headers):
            return None
        return 401, NEEDS_TOKEN

    def _is_admitted(self, scope: Scope, headers: Headers) -> bool:
        """Players have no cookie, but an address."""
        if self._token is None or self._knows(self._given(headers)):
            return True
        given = _token_in(scope) if scope["path"] == STREAM else ""
        return bool(given) and self._tries(scope, given)

    def _given(self, headers: Headers) -> str:
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
        """By a link, or by the form, whose token does not stay in the history of the browser."""
        given = _token_in(scope) or await _posted_token(scope, receive)
        waits = self._must_wait(scope)
        response: Response
        if not given:
            response = HTMLResponse(enter_page(NEEDS_TOKEN))
        elif not self._tries(scope, given):
            # The right one is let in at any time: it is too long to be guessed.
            text = (
                "Too many wrong tokens. Wait a minute."
                if waits
                else "This is not the token of this console."
            )
            response = HTMLResponse(enter_page(text), 429 if waits else 401)
        else:
            response = RedirectResponse("/", 303)
            response.set_cookie(
                self._cookie,
                given,
                max_age=KEPT_S,
                path="/",
                httponly=True,
                samesite="strict",
                secure=scope.get("scheme") == "https",
            )
        response.headers.update(_ENTER_HEADERS)
        await response(scope, receive, send)

    def _must_wait(self, scope: Scope) -> bool:
        tries = self._wrong.get(_address(scope))
        if self._here_only or tries is None or len(tries) < MOST_TRIES:
            return False
        return time.monotonic() - tries[0] < 60.0

    def _tries(self, scope: Scope, given: str) -> bool:
        if self._knows(given):
            return True
        tries = self._wrong.setdefault(_address(scope), deque(maxlen=MOST_TRIES))
        tries.append(time.monotonic())
        if len(self._wrong) > MOST_ADDRESSES:
            self._wrong.popitem(last=False)
        return False


def cookie_name(token: str) -> str:
    """Per console: a browser sends cookies of one port to all others of a machine."""
    return f"dr_console_{hashlib.sha256(token.encode()).hexdigest()[:8]}"


def _address(scope: Scope) -> str:
    client = scope.get("client") or [""]
    return str(client[0])


def _token_in(scope: Scope) -> str:
    query: str = scope["query_string"].decode("latin-1")
    return parse_qs(query).get("token", [""])[0]


async def _posted_token(scope: Scope, receive: Receive) -> str:
    if scope["method"] != "POST":
        return ""
    data = b""
    async for chunk in Request(scope, receive).stream():
        data += chunk
        if len(data) > MOST_FORM_BYTES:
            return ""
    return parse_qs(data.decode("latin-1")).get("token", [""])[0]


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
    headers = Headers(scope=scope)
    response: Response
    if status == 401 and "text/html" in headers.get("accept", ""):
        # A browser sends no cookie of ours with a link from elsewhere, such as a chat; it does if
        # this page asks once more.
        from_elsewhere = headers.get("sec-fetch-site") in ("cross-site", "same-site")
        page = enter_page(sentence, asks_again=from_elsewhere)
        response = HTMLResponse(page, 401, _ENTER_HEADERS)
    elif "text/html" in headers.get("accept", ""):
        response = HTMLResponse(
            _REFUSED.format(style=STYLE, sentence=escape(sentence)), status, _HEADERS
        )
    else:
        body = {"message": sentence, "remedy": GET_LINK if status == 401 else "", "code": 2}
        response = JSONResponse({"error": body}, status, _HEADERS)
    await response(scope, receive, send)
