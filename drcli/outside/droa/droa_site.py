"""Finds the parts of a DeepRacer on AWS."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields
from urllib.parse import urlsplit

from drcli.base.errors import SettingsError, StorageError, shown
from drcli.base.installation import lazy_imports
from drcli.config.fields import hidden
from drcli.outside.web_request import Web

with lazy_imports():
    import requests

# Reads env.js, in which a DeepRacer on AWS names its parts.
#
# It is JavaScript: other quotes or none, comments, extra commas, variables. Nothing is executed.


NAME = "EnvironmentConfig"
"""Source: deepracer-on-aws."""

_TOKEN = re.compile(
    r"""
    (?P<space> \s+ | //[^\n]* | /\*.*?\*/ )
  | (?P<text> "(?:[^"\\\n]|\\.)*" | '(?:[^'\\\n]|\\.)*' | `(?:[^`\\]|\\.)*` )
  | (?P<word> [\w$.-]+ )
  | (?P<sign> . )
    """,
    re.VERBOSE | re.DOTALL,
)
_ESCAPE = re.compile(r"\\(?:u\{([0-9a-fA-F]{1,6})\}|u([0-9a-fA-F]{4})|x([0-9a-fA-F]{2})|(.))", re.S)
_LETTERS = {"n": "\n", "t": "\t", "r": "\r", "b": "\b", "f": "\f", "v": "\v", "0": "\0", "\n": ""}
_CLOSING = {"{": "}", "[": "]", "(": ")"}


class NotEnvJs(ValueError):
    """Says what there is instead."""


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str


def read_env_js(script: str) -> dict[str, str]:
    """The texts of `window.EnvironmentConfig`, or NotEnvJs."""
    if script.lstrip("\ufeff \t\r\n").startswith("<"):
        raise NotEnvJs("it is a web page")
    tokens = tuple(_tokens(script))
    for at, token in enumerate(tokens):
        if token.text == "=" and _names(tokens, at) == NAME:
            return _object(tokens, at + 1)
    raise NotEnvJs(f"it does not set {NAME}")


def _tokens(script: str) -> Iterator[_Token]:
    for match in _TOKEN.finditer(script):
        kind = str(match.lastgroup)
        if kind != "space":
            yield _Token(kind, match[0])


def _names(tokens: tuple[_Token, ...], at: int) -> str:
    if at and tokens[at - 1].kind == "word":
        return tokens[at - 1].text.rpartition(".")[2]
    if at > 1 and tokens[at - 1].text == "]" and tokens[at - 2].kind == "text":
        return _plain(tokens[at - 2].text)
    return ""


def _object(tokens: tuple[_Token, ...], at: int) -> dict[str, str]:
    for place in range(at, len(tokens)):
        token = tokens[place]
        following = tokens[place + 1].text if place + 1 < len(tokens) else ";"
        if token.text == "{":
            return _pairs(tokens, place + 1)
        if token.kind == "text":  # JSON.parse('...')
            return _from_json(_plain(token.text))
        if token.kind == "word" and following != "(":
            return _variable(tokens[:at], token.text)
        if token.kind == "sign" and token.text != "(":
            break
    raise NotEnvJs(f"{NAME} is not an object")


def _variable(tokens: tuple[_Token, ...], name: str) -> dict[str, str]:
    for at in range(len(tokens) - 1, 0, -1):
        if tokens[at].text == "=" and tokens[at - 1].text == name:
            return _object(tokens, at + 1)
    raise NotEnvJs(f"{NAME} is {name}, which it does not define")


def _from_json(text: str) -> dict[str, str]:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        raise NotEnvJs(f"{NAME} is not an object")
    return {str(key): value for key, value in values.items() if isinstance(value, str)}


def _pairs(tokens: tuple[_Token, ...], at: int) -> dict[str, str]:
    found: dict[str, str] = {}
    item: list[_Token] = []
    ends = ["}"]
    for token in tokens[at:]:
        text = token.text if token.kind == "sign" else ""
        if text == ends[-1]:
            ends.pop()
        elif text in _CLOSING:
            ends.append(_CLOSING[text])
        if not ends or (text == "," and len(ends) == 1):
            found.update(_pair(item))
            item = []
        else:
            item.append(token)
        if not ends:
            return found
    raise NotEnvJs(f"the object of {NAME} is not complete")


def _pair(item: list[_Token]) -> dict[str, str]:
    """`"a" + "b"` is one text."""
    if len(item) < 3 or item[1].text != ":" or item[0].kind == "sign":
        return {}
    parts = item[2:]
    texts, plus = parts[::2], parts[1::2]
    if any(t.kind != "text" or "${" in t.text for t in texts) or any(t.text != "+" for t in plus):
        return {}
    key = _plain(item[0].text) if item[0].kind == "text" else item[0].text
    return {key: "".join(_plain(token.text) for token in texts)}


def _plain(quoted: str) -> str:
    def letter(match: "re.Match[str]") -> str:
        number = match[1] or match[2] or match[3]
        if number:
            code = int(number, 16)
            return chr(code) if code <= 0x10FFFF else ""
        return _LETTERS.get(match[4], match[4])

    text = _ESCAPE.sub(letter, quoted[1:-1])
    # JavaScript writes a letter beyond 16 bits as two escapes.
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


_REGION = re.compile(r"[a-z]{2,3}(-[a-z]+)+-\d{1,2}")
_LOOPBACK = re.compile(r"localhost|127(\.\d{1,3}){3}|::1")

URL_SETTING = "DR_DROA_URL"

PASSWORD_VARIABLE = "DR_DROA_PASSWORD"
_LARGEST_BYTES = 1 << 20


@dataclass(frozen=True)
class SiteOptions:
    """Of commands."""

    url: str | None = None
    region: str | None = None
    user_pool_id: str | None = None
    user_pool_client_id: str | None = None
    identity_pool_id: str | None = None
    api_endpoint: str | None = None
    upload_bucket: str | None = None


@dataclass(frozen=True)
class Site:
    """One DeepRacer on AWS; addresses have no slash at the end.

    Attributes:
        url: Empty if only options name it.
        identity_pool_id: Gives temporary keys.
        aws_endpoint_url: Of Cognito and S3; empty for Amazon's own.
    """

    url: str
    region: str
    user_pool_id: str
    user_pool_client_id: str
    identity_pool_id: str
    api_endpoint: str
    upload_bucket: str
    aws_endpoint_url: str = ""

    @property
    def place(self) -> str:
        return self.url or self.api_endpoint


_KEYS = {
    "region": "region",
    "user_pool_id": "userPoolId",
    "user_pool_client_id": "userPoolClientId",
    "identity_pool_id": "identityPoolId",
    "api_endpoint": "apiEndpointUrl",
    "upload_bucket": "uploadBucketName",
}
"""Source: deepracer-on-aws."""


def refuse_no_site(options: SiteOptions, url: str) -> None:
    address = _given_address(options, url)
    if not address and len(_own_values(options)) < len(_KEYS):
        raise SettingsError(
            "DR_DROA_URL is not set: which DeepRacer on AWS should be used?",
            remedy="Write DR_DROA_URL=https://your-address and DR_DROA_USERNAME=you into "
            "system.env, or give --url.",
        )


def find_site(options: SiteOptions, url: str, aws_endpoint_url: str, web: Web) -> Site:
    """Read env.js of a site; options replace its values.

    Raises:
        SettingsError: A value is missing or wrong.
        StorageError: env.js cannot be read.
    """
    refuse_no_site(options, url)
    address, own = _given_address(options, url), _own_values(options)
    if len(own) < len(_KEYS):
        found = _read(address, web)
        own = {**{name: found.get(key, "") for name, key in _KEYS.items()}, **own}
        missing = [name for name, value in own.items() if not value]
        if missing:
            keys = ", ".join(_KEYS[name] for name in missing)
            options_for = " and ".join(f"--{name.replace('_', '-')}" for name in missing)
            raise StorageError(
                f"{address}/env.js lacks {keys}.",
                remedy=f"Ask who runs that site for the missing values, and give {options_for}.",
            )
    _check(own, address)
    own["api_endpoint"] = own["api_endpoint"].rstrip("/")
    return Site(url=address, aws_endpoint_url=aws_endpoint_url.rstrip("/"), **own)


def _given_address(options: SiteOptions, url: str) -> str:
    given = options.url or url
    return _address(given, "--url" if options.url else URL_SETTING) if given else ""


def _own_values(options: SiteOptions) -> dict[str, str]:
    values = {field.name: getattr(options, field.name) for field in fields(options)}
    return {name: value.strip() for name, value in values.items() if value and name in _KEYS}


def _address(given: str, setting: str) -> str:
    text = given.strip()
    whole = text if "://" in text else f"https://{text}"
    host = _web_host(whole)
    if not host or re.search(r"\s", text):
        raise SettingsError(
            f"{setting}={shown(hidden('', text))} is not the address of a web page.",
            remedy=f"Write {setting} as in https://deepracer.example.com.",
        )
    parts = urlsplit(whole)
    if parts.username or parts.password:
        raise SettingsError(
            f"{setting} contains a user name or password.",
            remedy="Keep only the address of the web page; the password is asked for.",
        )
    _refuse_plain_http(parts.scheme, host, f"{setting}={shown(text)}")
    path = parts.path.rstrip("/").removesuffix("/env.js").removesuffix("/index.html")
    return f"{parts.scheme}://{parts.netloc}{path}"


def _web_host(url: str) -> str:
    """Empty if it is no web address."""
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError:
        return ""
    return (parts.hostname or "") if parts.scheme in ("http", "https") else ""


def _refuse_plain_http(scheme: str, host: str, what: str) -> None:
    """An unprotected page must not say where a password goes."""
    if scheme != "https" and not _LOOPBACK.fullmatch(host):
        raise SettingsError(
            f"{what} is not protected: it begins with {scheme}://.",
            remedy="Use the address that begins with https://.",
        )


def _read(address: str, web: Web) -> dict[str, str]:
    url = f"{address}/env.js"
    answer = web.send(lambda: requests.Request("GET", url), repeat=True, redirects=True)
    if answer.status_code != 200:
        raise StorageError(
            f"{url} cannot be read: the server answered {answer.status_code} {answer.reason}.",
            remedy=f"Check {web.setting}: it is the address at which you open DeepRacer on AWS.",
        )
    try:
        if len(answer.content) > _LARGEST_BYTES:
            raise NotEnvJs(f"it has {len(answer.content):,} bytes")
        return read_env_js(answer.content.decode("utf-8", "replace"))
    except NotEnvJs as e:
        raise StorageError(
            f"{url} is not the configuration of a DeepRacer on AWS: {e}.",
            remedy=f"Check {web.setting}: it is the address at which you open DeepRacer on AWS.",
        ) from e


def _check(own: dict[str, str], address: str) -> None:
    source = f"{address}/env.js or an option" if address else "an option"
    if not _REGION.fullmatch(own["region"]):
        raise SettingsError(
            f"The region '{shown(own['region'])}' ({source}) is not an AWS region.",
            remedy="Give --region, as in us-east-1.",
        )
    host = _web_host(own["api_endpoint"])
    if not host:
        raise SettingsError(
            f"'{shown(own['api_endpoint'])}' ({source}) is not a web address.",
            remedy="Give --api-endpoint, as in https://abc.execute-api.us-east-1.amazonaws.com.",
        )
    scheme = urlsplit(own["api_endpoint"]).scheme
    _refuse_plain_http(scheme, host, f"The interface {shown(own['api_endpoint'])}")
