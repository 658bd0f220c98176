"""Sends web requests, and explains what went wrong."""

import time
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

from drcli import __version__
from drcli.base.clock import delays_s
from drcli.base.errors import StorageError, cause_of
from drcli.base.installation import lazy_imports
from drcli.config.fields import hidden

with lazy_imports():
    import requests
    from urllib3 import exceptions as urllib3

USER_AGENT = f"drcli/{__version__}"

CONNECT_TIMEOUT_S, READ_TIMEOUT_S = 10.0, 60.0
ATTEMPTS = 4
_PASSING = frozenset({429, 500, 502, 503, 504})
Pause = Callable[[float], None]
Trace = Callable[[str], None]
Make = Callable[[], "requests.Request"]
"""Each time, because a signature holds the time."""


def polls(interval_s: float, patience_s: float, pause: Pause) -> Iterator[None]:
    """Yield at once, and then after each pause."""
    for number in range(int(patience_s / interval_s) + 1):
        if number:
            pause(interval_s)
        yield


class Web:
    """`setting` is for remedies; `trace` gets no secrets."""

    def __init__(
        self, setting: str, *, pause: Pause = time.sleep, trace: Trace | None = None
    ) -> None:
        self.setting = setting
        self.pause = pause
        self._trace = trace
        self._session = requests.Session()
        self._session.headers["User-Agent"] = USER_AGENT

    def send(
        self, make: Make, *, repeat: bool, stream: bool = False, redirects: bool = False
    ) -> "requests.Response":
        """Return the answer whatever its status; StorageError without one."""
        pauses = delays_s(0.5, 4.0)
        for attempt in range(1, ATTEMPTS + 1):
            last = attempt == ATTEMPTS or not repeat
            request = make()
            # Otherwise requests would replace our signature with a password from ~/.netrc.
            request.auth = request.auth or (lambda prepared: prepared)
            try:
                answer = self._once(request, stream=stream, redirects=redirects)
            except (requests.RequestException, urllib3.LocationParseError) as error:
                # The second: a host name that cannot be one passes the checks of requests.
                self._say(request, type(error).__name__)
                if last or not _may_pass(error):
                    raise explain(error, str(request.url), self.setting) from error
            else:
                self._say(request, str(answer.status_code))
                if last or answer.status_code not in _PASSING:
                    return answer
                answer.close()
            self.pause(next(pauses))
        raise AssertionError("the last attempt returns or raises")

    def _once(
        self, request: "requests.Request", *, stream: bool, redirects: bool
    ) -> "requests.Response":
        prepared = self._session.prepare_request(request)
        settings = self._session.merge_environment_settings(
            prepared.url or "", {}, stream, None, None
        )
        return self._session.send(
            prepared,
            timeout=(CONNECT_TIMEOUT_S, READ_TIMEOUT_S),
            allow_redirects=redirects,
            **settings,
        )

    def _say(self, request: "requests.Request", result: str) -> None:
        if self._trace is not None:
            self._trace(f"{request.method} {hidden('', str(request.url))}: {result}")


def explain(error: Exception, url: str, setting: str) -> StorageError:
    host = urlsplit(url).netloc.rpartition("@")[2]
    if isinstance(error, requests.exceptions.SSLError):
        return StorageError(
            f"The certificate of {host} is not valid, or it does not speak HTTPS: "
            f"{cause_of(error)}.",
            remedy=f"Check {setting} and the clock of this machine; behind a company's proxy, set "
            "REQUESTS_CA_BUNDLE to its certificate.",
        )
    if isinstance(error, requests.exceptions.ProxyError):
        return StorageError(
            f"The proxy on the way to {host} does not work: {cause_of(error)}.",
            remedy="Correct HTTPS_PROXY, or unset it.",
        )
    if isinstance(error, requests.Timeout):
        return StorageError(
            f"{host} does not answer in time.", remedy="Check the network, and try again later."
        )
    wrong = (
        requests.exceptions.InvalidURL,
        requests.exceptions.MissingSchema,
        urllib3.LocationParseError,
    )
    if isinstance(error, wrong):
        return StorageError(
            f"'{hidden('', url)}' is not a web address ({setting}).",
            remedy=f"Correct {setting}, as in https://deepracer.example.com.",
        )
    return StorageError(
        f"{host} cannot be reached: {cause_of(error)}.",
        remedy=f"Check the network connection and {setting}.",
    )


def _may_pass(error: Exception) -> bool:
    lasting = (requests.exceptions.SSLError, requests.exceptions.InvalidURL)
    passing = (requests.ConnectionError, requests.Timeout, requests.exceptions.ChunkedEncodingError)
    return isinstance(error, passing) and not isinstance(error, lasting)
