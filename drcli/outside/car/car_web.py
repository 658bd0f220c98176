"""The web page of a physical car: aws-deepracer-webserver-pkg, or the community's.

Requests need the cookie of a login; changes also need a token on the page (CSRF), for an hour. Most
failures have status 200 and `success: false`.
"""

import warnings
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any, Self

from drcli.base.errors import DrError, SettingsError, shown
from drcli.base.installation import lazy_imports
from drcli.outside.car.car_address import (
    LOGIN_HOURS,
    CarAddress,
    CarError,
    CarLogin,
    CarRefused,
    CarSilent,
    NotLoggedIn,
    load_login,
    save_login,
)
from drcli.outside.car.car_certificate import (
    CONNECT_TIMEOUT_S,
    read_fingerprint,
    trusting_session,
    unreachable,
)

with lazy_imports():
    import requests
    from urllib3 import exceptions as urllib3

TOKEN_COOKIE = "deepracer_token"
ANSWER_TIMEOUT_S = 15.0
"""The car's own is 10 s."""

_CHANGES = frozenset({"POST", "PUT"})


def _log_in(place: str) -> str:
    return f"Log in with `dr-car login --car {place}`."


class CarWeb:
    """One car's page."""

    def __init__(self, address: CarAddress, login: CarLogin) -> None:
        self.address = address
        self._login = login
        self._session = trusting_session(login)
        self._session.cookies.update(dict(login.cookies))

    @classmethod
    def opened(cls, address: CarAddress) -> Self:
        """Sends nothing; NotLoggedIn without a login."""
        kept = load_login(address)
        if kept is None or not kept.is_open:
            raise NotLoggedIn(
                f"There is no login at the car {address.place}.", remedy=_log_in(address.place)
            )
        return cls(address, kept)

    @property
    def login(self) -> CarLogin:
        cookies = {cookie.name: cookie.value or "" for cookie in self._session.cookies}
        return replace(self._login, cookies=cookies)

    def log_in(self, password: str) -> None:
        """Log in, and keep that.

        Raises:
            SettingsError: The password is wrong.
            CarError: It is not a car, or not reached.
        """
        self._session.cookies.clear()
        self._read_token()
        answer = self._send("POST", "/login", data={"password": password})
        if answer.status_code == 400:
            raise self._csrf_refused()
        self._refuse_status(answer, "check the password")
        if TOKEN_COOKIE not in self._session.cookies:
            raise SettingsError(
                f"The car {self.address.place} does not accept the password.",
                remedy="Type the password of the car's web page; the first one is printed on a "
                "sticker at the bottom of the car.",
            )
        save_login(self.address, self.login)

    def get(self, path: str, *, action: str, timeout_s: float = ANSWER_TIMEOUT_S) -> Any:
        """JSON from below /api/; `action` as in "list its models".

        Raises:
            NotLoggedIn: The login has expired.
            CarError: There is no answer, or a failure.
        """
        return self._call("GET", path, action=action, timeout_s=timeout_s)

    def find(self, path: str, *, action: str) -> Any:
        """None for an unknown path."""
        answer = self._send("GET", path)
        if answer.status_code == 404:
            return None
        return self._content(answer, action)

    def put(
        self, path: str, content: Any, *, action: str, timeout_s: float = ANSWER_TIMEOUT_S
    ) -> Any:
        """CarRefused if the car says that it failed."""
        return self._call("PUT", path, action=action, timeout_s=timeout_s, json=content)

    def post(self, path: str, content: Any, *, action: str) -> Any:
        """Like `put`."""
        return self._call("POST", path, action=action, timeout_s=ANSWER_TIMEOUT_S, json=content)

    def stream(self, path: str, *, action: str, timeout_s: float) -> "requests.Response":
        """An answer that does not end; close it. Like `get`, `timeout_s` is that of each part."""
        answer = self._send("GET", path, timeout_s=timeout_s, stream=True)
        try:
            self._refuse_status(answer, action)
        except DrError:
            answer.close()
            raise
        return answer

    def upload(self, path: str, name: str, content: bytes, *, action: str, timeout_s: float) -> Any:
        """Like `put`."""
        files = {"file": (name, content, "application/gzip")}
        return self._call("POST", path, action=action, timeout_s=timeout_s, files=files)

    def _call(self, method: str, path: str, *, action: str, timeout_s: float, **body: Any) -> Any:
        """With a fresh token if the old one is refused."""
        answer = self._send(method, path, timeout_s=timeout_s, **body)
        if answer.status_code == 400 and method in _CHANGES:
            self._read_token()
            answer = self._send(method, path, timeout_s=timeout_s, **body)
            if answer.status_code == 400:
                raise self._csrf_refused()
            save_login(self.address, self.login)
        return self._content(answer, action)

    def _send(
        self, method: str, path: str, *, timeout_s: float = ANSWER_TIMEOUT_S, **body: Any
    ) -> "requests.Response":
        """Redirects are not followed: cookies would go with them."""
        # Flask compares the address of the page that a change comes from.
        headers = {"Referer": f"{self.address.url}/"}
        if method in _CHANGES:
            headers["X-CSRFToken"] = self._login.csrf_token
        try:
            with warnings.catch_warnings():
                warnings.simplefilter(
                    "ignore", urllib3.InsecureRequestWarning
                )  # asked for by --insecure
                return self._session.request(
                    method,
                    self.address.url + path,
                    headers=headers,
                    timeout=(CONNECT_TIMEOUT_S, timeout_s),
                    allow_redirects=False,
                    **body,
                )
        except requests.exceptions.ReadTimeout as e:
            raise CarSilent(
                f"The car {self.address.place} did not answer within {timeout_s:g} s.",
                remedy="Look at the car, and try again; restart it if it stays silent.",
            ) from e
        except (requests.exceptions.RequestException, OSError) as e:
            raise unreachable(self.address, e) from e

    def _read_token(self) -> None:
        answer = self._send("GET", "/")
        if answer.status_code >= 500:
            self._refuse_status(answer, "show its page")
        token = _csrf_token(answer.text) if answer.ok else ""
        if not token:
            raise CarError(
                f"The page at {self.address.url} is not that of a DeepRacer car.",
                remedy="Correct --car or DR_CAR_ADDRESS.",
            )
        self._login = replace(self._login, csrf_token=token)

    def _content(self, answer: "requests.Response", action: str) -> Any:
        self._refuse_status(answer, action)
        try:
            content = answer.json()
        except ValueError:
            raise CarError(
                f"The car {self.address.place} answered something that is not JSON when asked to "
                f"{action}.",
                remedy="Check that this is the address of a DeepRacer car, and restart the car if "
                "it is.",
            ) from None
        if isinstance(content, dict) and content.get("success") is False:
            reason = shown(str(content.get("reason") or content.get("message") or ""))
            raise CarRefused(
                f"The car {self.address.place} did not {action}"
                + (f": {reason.rstrip('.!')}." if reason else "."),
                remedy="Try again; if it fails again, restart the car and look at its log.",
                reason=reason,
            )
        return content

    def _refuse_status(self, answer: "requests.Response", action: str) -> None:
        status, place = answer.status_code, self.address.place
        if status in (401, 403) or status in (301, 302, 303, 307, 308):
            raise NotLoggedIn(
                f"The car {place} does not accept the login any more: it counts for "
                f"{LOGIN_HOURS} hours, and a car with the original software forgets it when "
                "somebody else logs in.",
                remedy=_log_in(place),
            )
        if status == 413:
            raise CarError(
                f"The file is larger than the car {place} accepts (answer 413).",
                remedy="Export the model again with one checkpoint only.",
            )
        if status == 404:
            raise CarError(
                f"The software of the car {place} has no request to {action} (answer 404).",
                remedy="Update the software of the car.",
            )
        if status == 504:
            raise CarSilent(
                f"The car {place} took too long to {action} (answer 504).",
                remedy="Wait a minute, and look at the car again with `dr-car status`.",
            )
        if status >= 500:
            raise CarError(
                f"The web page of the car {place} does not work now (answer {status}).",
                remedy="Wait a minute if the car has just started; otherwise restart it.",
            )
        if not answer.ok:
            raise CarError(
                f"The car {place} answered {status} when asked to {action}.",
                remedy="Check that this is the address of a DeepRacer car.",
            )

    def _csrf_refused(self) -> CarError:
        return CarError(
            f"The car {self.address.place} refuses the token (CSRF) of its own page.",
            remedy=f"Log in again with `dr-car login --car {self.address.place}`; if that fails, "
            "restart the car.",
        )


def first_login(
    address: CarAddress, *, ca_file: str, insecure: bool, new_certificate: bool
) -> tuple[CarLogin, bool]:
    """How to trust a car, and whether its certificate is new; CarError without one."""
    kept = load_login(address)
    seen = "" if kept is None else kept.fingerprint
    if insecure:
        return CarLogin("none", seen), False
    if ca_file:
        return CarLogin("ca", seen, ca_file), False
    if seen and not new_certificate:
        return CarLogin("fingerprint", seen), False
    return CarLogin("fingerprint", read_fingerprint(address)), True


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.token = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        name = (named.get("name") or named.get("id") or "").replace("_", "-")
        if tag in ("meta", "input") and name == "csrf-token":
            self.token = self.token or named.get("content") or named.get("value") or ""


def _csrf_token(page: str) -> str:
    parser = _Page()
    parser.feed(page)
    return parser.token
