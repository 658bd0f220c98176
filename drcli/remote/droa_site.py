"""Finds the parts of a DeepRacer on AWS."""

import re
from dataclasses import dataclass, fields
from urllib.parse import urlsplit

from drcli.base.errors import SettingsError, StorageError
from drcli.base.problems import shown
from drcli.config.setting_problems import hidden
from drcli.remote.droa_env_js import NotEnvJs, read_env_js
from drcli.remote.web_request import Web

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
    try:
        parts = urlsplit(text if "://" in text else f"https://{text}")
        host = parts.hostname
        _ = parts.port
    except ValueError:
        host = None
    if not host or parts.scheme not in ("http", "https") or re.search(r"\s", text):
        raise SettingsError(
            f"{setting}={shown(hidden('', text))} is not the address of a web page.",
            remedy=f"Write {setting} as in https://deepracer.example.com.",
        )
    if parts.username or parts.password:
        raise SettingsError(
            f"{setting} contains a user name or password.",
            remedy="Keep only the address of the web page; the password is asked for.",
        )
    _refuse_plain_http(parts.scheme, host, f"{setting}={shown(text)}")
    path = parts.path.rstrip("/").removesuffix("/env.js").removesuffix("/index.html")
    return f"{parts.scheme}://{parts.netloc}{path}"


def _refuse_plain_http(scheme: str, host: str, what: str) -> None:
    """An unprotected page must not say where a password goes."""
    if scheme != "https" and not _LOOPBACK.fullmatch(host):
        raise SettingsError(
            f"{what} is not protected: it begins with {scheme}://.",
            remedy="Use the address that begins with https://.",
        )


def _read(address: str, web: Web) -> dict[str, str]:
    import requests

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
    try:
        parts = urlsplit(own["api_endpoint"])
        host = parts.hostname or ""
        _ = parts.port
    except ValueError:
        host = ""
    if not host or parts.scheme not in ("http", "https"):
        raise SettingsError(
            f"'{shown(own['api_endpoint'])}' ({source}) is not a web address.",
            remedy="Give --api-endpoint, as in https://abc.execute-api.us-east-1.amazonaws.com.",
        )
    _refuse_plain_http(parts.scheme, host, f"The interface {shown(own['api_endpoint'])}")
