"""A user at a DeepRacer on AWS."""

import hashlib
import json
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drcli.base import errors
from drcli.base.errors import SettingsError, StorageError
from drcli.base.files import read_regular, write_private_json
from drcli.base.installation import lazy_imports
from drcli.bucket.s3_errors import error_code, error_text
from drcli.outside.droa.droa_site import Site
from drcli.outside.web_request import CONNECT_TIMEOUT_S, READ_TIMEOUT_S, USER_AGENT

if TYPE_CHECKING:
    from botocore.session import Session

with lazy_imports():
    import botocore
    from botocore import config as botocore_config
    from botocore import exceptions as boto
    from botocore import session as core

# Temporary keys, kept between commands, never a password.
#
# Place and format as in DeepRacer-for-Cloud.


LEAST_VALIDITY = timedelta(seconds=60)


@dataclass(frozen=True)
class Keys:
    """Never printed."""

    access_key: str = field(repr=False)
    secret_key: str = field(repr=False)
    session_token: str = field(repr=False)
    expires: datetime


def cache_path(identity_pool_id: str, username: str) -> Path:
    digest = hashlib.sha256(f"{identity_pool_id}:{username}".encode()).hexdigest()
    return Path.home() / ".droa-cache" / f"{digest[:16]}.json"


def load_keys(path: Path, now: datetime) -> Keys | None:
    """None also if they end soon."""
    try:
        if not _is_ours(path):
            return None
        keys = _keys(json.loads(read_regular(path)))
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    return keys if keys.expires > now + LEAST_VALIDITY else None


def save_keys(path: Path, keys: Keys) -> None:
    """Folder 0700 and file 0600."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.parent.chmod(0o700)
    values = {
        "access_key": keys.access_key,
        "secret_key": keys.secret_key,
        "session_token": keys.session_token,
        "expiry": keys.expires.isoformat(),
    }
    write_private_json(path, values)


def _is_ours(path: Path) -> bool:
    found = path.lstat()
    return stat.S_ISREG(found.st_mode) and (os.name == "nt" or found.st_uid == os.getuid())


def _keys(values: Any) -> Keys:
    texts = [values["access_key"], values["secret_key"], values["session_token"], values["expiry"]]
    if not all(isinstance(text, str) and text for text in texts):
        raise ValueError("a value is not a text")
    expires = datetime.fromisoformat(texts[3])
    return Keys(
        texts[0], texts[1], texts[2], expires if expires.tzinfo else expires.replace(tzinfo=UTC)
    )


# Clients of Amazon's services, and their failures.


def aws_client(service: str, site: Site, keys: Keys | None = None) -> Any:
    """With these temporary keys, or none.

    Settings of AWS belong to other buckets, so they are ignored.
    """
    config = botocore_config.Config(
        region_name=site.region,
        signature_version=botocore.UNSIGNED if keys is None else None,
        retries={"total_max_attempts": 4, "mode": "standard"},
        connect_timeout=CONNECT_TIMEOUT_S,
        read_timeout=READ_TIMEOUT_S,
        user_agent_extra=USER_AGENT,
    )
    return _session().create_client(
        service,
        endpoint_url=site.aws_endpoint_url or None,
        aws_access_key_id=None if keys is None else keys.access_key,
        aws_secret_access_key=None if keys is None else keys.secret_key,
        aws_session_token=None if keys is None else keys.session_token,
        config=config,
    )


@cache
def _session() -> "Session":
    """Keeps descriptions of services, slow to load."""
    # Each is (name in the files, variable, default, type).
    no_files = {"profile": (None, None, None, None), "config_file": (None, None, None, None)}
    own_address = {"ignore_configured_endpoint_urls": (None, None, True, None)}
    session: Session = core.Session(session_vars={**no_files, **own_address})
    return session


def aws_failure(error: Exception, action: str, site: Site) -> StorageError:
    """`action` is read after "Cannot"."""
    where = site.aws_endpoint_url or f"Amazon in {site.region}"
    if isinstance(error, boto.ClientError):
        return StorageError(
            f"Cannot {action}: {error_text(error)} ({error_code(error)}).",
            remedy="Try again later; if it fails again, ask who runs that DeepRacer on AWS.",
        )
    if isinstance(error, boto.SSLError):
        return StorageError(
            f"Cannot {action}: the certificate of {where} is not valid.",
            remedy="Check the clock of this machine; behind a company's proxy, set AWS_CA_BUNDLE "
            "to its certificate.",
        )
    timeouts = (boto.ConnectTimeoutError, boto.ReadTimeoutError)
    if isinstance(error, timeouts):
        return StorageError(
            f"Cannot {action}: {where} does not answer in time.",
            remedy="Check the network, and try again later.",
        )
    if isinstance(error, boto.ConnectionError | boto.HTTPClientError):
        return StorageError(
            f"Cannot {action}: {where} cannot be reached.",
            remedy="Check the network connection and the region of the site.",
        )
    return StorageError(
        f"Cannot {action}: {error_text(error)}.",
        remedy="Check the address of the site, and the options that replace its values.",
    )


# Signs in to a DeepRacer on AWS: Cognito gives temporary keys.


Ask = Callable[[str], str]

CODE_CHALLENGES = {
    "SOFTWARE_TOKEN_MFA": ("SOFTWARE_TOKEN_MFA_CODE", "Code of your authenticator app"),
    "SMS_MFA": ("SMS_MFA_CODE", "Code of the text message"),
    "EMAIL_OTP": ("EMAIL_OTP_CODE", "Code of the e-mail"),
}
_OTHER_CHALLENGES = {
    "NEW_PASSWORD_REQUIRED": "your password is a temporary one and must be replaced first",
    "MFA_SETUP": "your account needs a second factor, which is not set up yet",
    "SELECT_MFA_TYPE": "your account has several second factors, and one must be chosen",
    "CUSTOM_CHALLENGE": "your account has a sign-in of its own",
    "SELECT_CHALLENGE": "your account has several ways to sign in, and one must be chosen",
}
_REFUSALS = {
    "UserNotFoundException": "there is no such user",
    "UserNotConfirmedException": "the e-mail address of the account is not confirmed yet",
    "PasswordResetRequiredException": "the password must be reset first",
    "TooManyRequestsException": "there were too many attempts",
    "LimitExceededException": "there were too many attempts",
    "ResourceNotFoundException": "its sign-in does not exist any more",
    "CodeMismatchException": "the code is wrong",
    "ExpiredCodeException": "the code is too old",
}


def log_in(site: Site, username: str, password: str, ask: Ask) -> Keys:
    """Temporary keys; only Cognito gets the password.

    Raises:
        StorageError: Cognito refuses, or is not reached.
    """
    token = _id_token(site, username, password, ask)
    return _keys_of_answer(site, token)


def _id_token(site: Site, username: str, password: str, ask: Ask) -> str:
    action = f"sign in to {site.place} as {username}"
    try:
        cognito = aws_client("cognito-idp", site)
        answer = cognito.initiate_auth(
            AuthFlow="USER_PASSWORD_AUTH",
            AuthParameters={"USERNAME": username, "PASSWORD": password},
            ClientId=site.user_pool_client_id,
        )
        for _ in CODE_CHALLENGES:
            challenge = answer.get("ChallengeName")
            if challenge not in CODE_CHALLENGES:
                break
            name, question = CODE_CHALLENGES[challenge]
            answer = cognito.respond_to_auth_challenge(
                ClientId=site.user_pool_client_id,
                ChallengeName=challenge,
                Session=answer.get("Session", ""),
                ChallengeResponses={"USERNAME": username, name: ask(question)},
            )
    except boto.ClientError as e:
        raise _refusal(e, action, site) from e
    except (boto.BotoCoreError, ValueError) as e:
        raise aws_failure(e, action, site) from e
    token = (answer.get("AuthenticationResult") or {}).get("IdToken")
    if not token:
        challenge = str(answer.get("ChallengeName") or "something unknown")
        reason = _OTHER_CHALLENGES.get(challenge, "Cognito asks for more than a password")
        raise StorageError(
            f"Cannot {action}: {reason} ({challenge}).",
            remedy=f"Sign in once at {site.place} in a browser, do what it asks, and try again.",
        )
    return str(token)


def _keys_of_answer(site: Site, token: str) -> Keys:
    logins = {f"cognito-idp.{site.region}.amazonaws.com/{site.user_pool_id}": token}
    action = f"get temporary keys from {site.place}"
    try:
        identities = aws_client("cognito-identity", site)
        identity = identities.get_id(IdentityPoolId=site.identity_pool_id, Logins=logins)
        answer = identities.get_credentials_for_identity(
            IdentityId=identity["IdentityId"], Logins=logins
        )
        return _read_keys(answer["Credentials"])
    except boto.ClientError as e:
        if error_code(e) in ("NotAuthorizedException", "ResourceNotFoundException"):
            raise StorageError(
                f"Cannot {action}: {error_text(e)} ({error_code(e)}).",
                remedy="Check --identity-pool-id and --user-pool-id if you give them; otherwise "
                "ask who runs that site whether your account is allowed to use it.",
            ) from e
        raise aws_failure(e, action, site) from e
    except (boto.BotoCoreError, KeyError, TypeError, ValueError) as e:
        raise aws_failure(e, action, site) from e


def _read_keys(credentials: Any) -> Keys:
    expires = credentials["Expiration"]
    if not isinstance(expires, datetime):
        raise ValueError("the keys have no end")
    return Keys(
        str(credentials["AccessKeyId"]),
        str(credentials["SecretKey"]),
        str(credentials["SessionToken"]),
        expires if expires.tzinfo else expires.replace(tzinfo=UTC),
    )


def _refusal(error: Exception, action: str, site: Site) -> StorageError:
    code, message = error_code(error), error_text(error)
    if code == "NotAuthorizedException":
        return StorageError(
            f"Cannot {action}: {message}.",
            remedy="Check DR_DROA_USERNAME (or --username) and the password; after several wrong "
            "passwords, wait a few minutes.",
        )
    if code == "InvalidParameterException" and "USER_PASSWORD_AUTH" in message:
        return StorageError(
            f"Cannot {action}: its Cognito client does not allow programs to sign in with a "
            "password (USER_PASSWORD_AUTH).",
            remedy="Ask who runs that site to add ALLOW_USER_PASSWORD_AUTH to the client "
            f"{site.user_pool_client_id} of the user pool {site.user_pool_id}.",
        )
    if code in _REFUSALS:
        return StorageError(
            f"Cannot {action}: {_REFUSALS[code]} ({code}).",
            remedy=f"Sign in once at {site.place} in a browser, and try again.",
        )
    return aws_failure(error, action, site)


def now() -> datetime:
    return datetime.now(UTC)


@dataclass
class DroaSession:
    """Signs in when needed, and keeps keys."""

    site: Site
    username: str
    password: Callable[[], str]
    ask: Ask
    clock: Callable[[], datetime] = now

    def __post_init__(self) -> None:
        if not self.username:
            raise SettingsError(
                "DR_DROA_USERNAME is not set: who should sign in?",
                remedy="Write DR_DROA_USERNAME=you into system.env, or give --username.",
            )
        self._path = cache_path(self.site.identity_pool_id, self.username)
        self._keys: Keys | None = None

    def keys(self) -> Keys:
        """Valid for a minute at first; `renew` gets others.

        Raises:
            StorageError: The sign-in failed.
        """
        if self._keys is None:
            self._keys = load_keys(self._path, self.clock()) or self.renew()
        return self._keys

    def renew(self) -> Keys:
        self._keys = log_in(self.site, self.username, self.password(), self.ask)
        try:
            save_keys(self._path, self._keys)
        except OSError as e:
            errors.warn(
                f"The temporary keys cannot be kept in {self._path} ({e.strerror or e}); the next "
                "command asks for the password again."
            )
        return self._keys

    def forget(self) -> bool:
        self._keys = None
        try:
            self._path.unlink()
        except FileNotFoundError:
            return False
        except OSError as e:
            raise SettingsError(
                f"{self._path} cannot be deleted ({e.strerror or e}).",
                remedy="Delete that file yourself; it holds keys that are valid for an hour.",
            ) from e
        return True
