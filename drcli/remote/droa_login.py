"""Signs in to a DeepRacer on AWS: Cognito gives temporary keys."""

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from drcli.base.errors import StorageError
from drcli.remote.droa_aws import aws_client, aws_failure
from drcli.remote.droa_keys import Keys
from drcli.remote.droa_site import Site
from drcli.store.s3_errors import error_code, error_text

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
    return _keys(site, token)


def _id_token(site: Site, username: str, password: str, ask: Ask) -> str:
    from botocore.exceptions import BotoCoreError, ClientError

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
    except ClientError as e:
        raise _refusal(e, action, site) from e
    except (BotoCoreError, ValueError) as e:
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


def _keys(site: Site, token: str) -> Keys:
    from botocore.exceptions import BotoCoreError, ClientError

    logins = {f"cognito-idp.{site.region}.amazonaws.com/{site.user_pool_id}": token}
    action = f"get temporary keys from {site.place}"
    try:
        identities = aws_client("cognito-identity", site)
        identity = identities.get_id(IdentityPoolId=site.identity_pool_id, Logins=logins)
        answer = identities.get_credentials_for_identity(
            IdentityId=identity["IdentityId"], Logins=logins
        )
        return _read_keys(answer["Credentials"])
    except ClientError as e:
        if error_code(e) in ("NotAuthorizedException", "ResourceNotFoundException"):
            raise StorageError(
                f"Cannot {action}: {error_text(e)} ({error_code(e)}).",
                remedy="Check --identity-pool-id and --user-pool-id if you give them; otherwise "
                "ask who runs that site whether your account is allowed to use it.",
            ) from e
        raise aws_failure(e, action, site) from e
    except (BotoCoreError, KeyError, TypeError, ValueError) as e:
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
