"""Sends messages about a training."""

import hashlib
import json
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from email.message import EmailMessage
from email.utils import formatdate, make_msgid
from functools import partial
from typing import Any
from urllib.parse import unquote, urlsplit

from drcli.base.errors import DrError, SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.base.json_record import json_default
from drcli.config.groups.train_settings import MessageSettings
from drcli.outside.aws.aws_account import Account
from drcli.outside.web_request import USER_AGENT, explain

with lazy_imports():
    import smtplib
    import ssl

    import requests
    from botocore import exceptions as boto

TIMEOUT_S = 10.0
TOPIC_VARIABLE = "MY_SNS_TOPIC"
"""Of deepracer-on-the-spot."""


@dataclass(frozen=True)
class Message:
    """`event` as in DR_MESSAGE_EVENTS, or "test"."""

    event: str
    subject: str
    text: str
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def lines(self) -> str:
        facts = [
            f"{name}: {value}" for name, value in self.facts.items() if value not in ("", None)
        ]
        return "\n".join([self.text, "", *facts]).rstrip()


# Sends a mail through a mail server.


SETTING = "DR_SMTP_URL"

_PORTS = {"smtps": 465, "smtp": 587}


class Mail:
    """Sends mails from one address to some.

    Args:
        url: smtps://, or smtp:// with STARTTLS, without which no password is sent.
        to: With commas or spaces.
        sender: Empty for the first of `to`.
    """

    def __init__(self, url: str, to: str, sender: str = "") -> None:
        self.receivers = _addresses(to)
        self._sender = (_addresses(sender) or self.receivers)[0]
        self._url = urlsplit(url)
        self._host = self._url.hostname or ""
        self._port = self._url.port or _PORTS.get(self._url.scheme, 587)

    def send(self, message: Message) -> None:
        """Send a mail.

        Raises:
            SettingsError: The password needs encryption.
            StorageError: The server refuses, or does not answer.
        """
        mail = EmailMessage()
        mail["Subject"] = " ".join(f"[drcli] {message.subject}".split())
        mail["From"] = self._sender
        mail["To"] = ", ".join(self.receivers)
        mail["Date"] = formatdate()
        mail["Message-ID"] = make_msgid(domain="drcli.invalid")
        mail.set_content(message.lines)
        try:
            self._deliver(mail)
        except smtplib.SMTPAuthenticationError as error:
            raise StorageError(
                f"The mail server {self._host} refuses the login (code {error.smtp_code}).",
                remedy=f"Correct user and password in {SETTING}; write @ : / in them as %40 %3A "
                "%2F.",
            ) from None
        except smtplib.SMTPException as error:
            raise StorageError(
                f"The mail server {self._host} does not take the mail: {_reason(error)}.",
                remedy="Check DR_MAIL_TO, DR_MAIL_FROM and DR_SMTP_URL in system.env.",
            ) from None
        except OSError as error:
            raise StorageError(
                f"The mail server {self._host}:{self._port} cannot be reached: "
                f"{error.strerror or error or type(error).__name__}.",
                remedy=f"Check {SETTING} in system.env, and the network.",
            ) from None

    def _deliver(self, mail: EmailMessage) -> None:
        context = ssl.create_default_context()
        user, password = unquote(self._url.username or ""), unquote(self._url.password or "")
        server: smtplib.SMTP
        if self._url.scheme == "smtps":
            server = smtplib.SMTP_SSL(self._host, self._port, timeout=TIMEOUT_S, context=context)
        else:
            server = smtplib.SMTP(self._host, self._port, timeout=TIMEOUT_S)
        with server:
            if self._url.scheme != "smtps":
                server.ehlo()
                if server.has_extn("starttls"):
                    server.starttls(context=context)
                    server.ehlo()
                elif user:
                    raise SettingsError(
                        f"The mail server {self._host}:{self._port} offers no encryption, so the "
                        "password is not sent.",
                        remedy=f"Write smtps:// in {SETTING}, usually with port 465.",
                    )
            if user:
                server.login(user, password)
            server.send_message(mail)


def _addresses(text: str) -> list[str]:
    return [part for part in re.split(r"[,;\s]+", text) if part]


def _reason(error: Exception) -> str:
    said = getattr(error, "smtp_error", b"") or str(error) or type(error).__name__
    text = said.decode("utf-8", "replace") if isinstance(said, bytes) else str(said)
    return " ".join(text.split()).rstrip(".")[:200]


# Publishes to a topic of Amazon SNS.


_LONGEST_SUBJECT = 99
_LONGEST_TEXT = 200_000
"""SNS takes 256 KB."""


def publish(topic: str, profile: str | None, message: Message) -> None:
    """Publish a message; the keys need `sns:Publish`.

    Raises:
        StorageError: The topic does not exist, the keys may not publish, or nobody answers.
    """
    try:
        account = Account(topic.split(":")[3], profile, attempts=1, timeout_s=TIMEOUT_S)
        account.client("sns").publish(
            TopicArn=topic,
            Subject=_subject(message.subject),
            Message=message.lines[:_LONGEST_TEXT],
            MessageAttributes={"event": {"DataType": "String", "StringValue": message.event}},
            **_order(topic, message.lines),
        )
    except (boto.BotoCoreError, boto.ClientError, ValueError, IndexError) as error:
        raise StorageError(
            f"The SNS topic {topic} does not take messages: {error}.",
            remedy="Check DR_SNS_TOPIC_ARN, the access keys, and that they allow sns:Publish.",
        ) from error


def _subject(subject: str) -> str:
    plain = "".join(letter if " " <= letter <= "~" else "?" for letter in subject)
    return plain[:_LONGEST_SUBJECT].strip() or "drcli"


def _order(topic: str, text: str) -> dict[str, str]:
    if not topic.endswith(".fifo"):
        return {}
    unique = hashlib.sha256(text.encode()).hexdigest()
    return {"MessageGroupId": "drcli", "MessageDeduplicationId": unique}


# Posts to a webhook of Slack, Discord, Mattermost or one's own.


WEBHOOK_SETTING = "DR_WEBHOOK_URL"

_LONGEST = 1900
"""Discord takes 2,000."""


def host_of(url: str) -> str:
    """The rest of the address is a secret."""
    return urlsplit(url).hostname or "?"


def body_of(message: Message) -> dict[str, Any]:
    """Slack and Mattermost show `text`, Discord `content`.

    Names of models cannot call people: Slack's signs are escaped, and Discord is told not to look
    for any.
    """
    shown = f"{message.subject}\n{message.text}"[:_LONGEST]
    return {
        "text": shown.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;"),
        "content": shown,
        "allowed_mentions": {"parse": []},
        "event": message.event,
        "facts": json.loads(json.dumps(message.facts, default=json_default)),
    }


def post(url: str, message: Message) -> None:
    """Redirections would get the message, so they are not followed.

    Raises:
        StorageError: The server refuses, or does not answer.
    """
    try:
        answer = requests.post(
            url,
            json=body_of(message),
            timeout=TIMEOUT_S,
            allow_redirects=False,
            headers={"User-Agent": USER_AGENT},
            # Otherwise requests would send a password from ~/.netrc.
            auth=lambda prepared: prepared,
        )
    except (requests.exceptions.InvalidURL, ValueError) as error:
        raise StorageError(
            f"{WEBHOOK_SETTING} cannot be used: {type(error).__name__}.",
            remedy=f"Correct {WEBHOOK_SETTING} in system.env.",
        ) from None  # its text contains the address
    except requests.RequestException as error:
        raise explain(error, f"https://{host_of(url)}", WEBHOOK_SETTING) from None
    if not 200 <= answer.status_code < 300:
        raise StorageError(
            f"The webhook at {host_of(url)} answered with status {answer.status_code}.",
            remedy=f"Check {WEBHOOK_SETTING} in system.env; it may have been withdrawn.",
        )


@dataclass(frozen=True)
class Channel:
    """Its name has no secrets; `send` raises DrError."""

    name: str
    send: Callable[[Message], None]


def open_channels(settings: MessageSettings, profile: str | None = None) -> list[Channel]:
    found = []
    topic = settings.sns_topic_arn or os.environ.get(TOPIC_VARIABLE, "")
    if topic:
        found.append(Channel(f"the SNS topic {topic}", partial(publish, topic, profile)))
    if settings.webhook_url:
        name = f"the webhook at {host_of(settings.webhook_url)}"
        found.append(Channel(name, partial(post, settings.webhook_url)))
    if settings.mail_to and settings.smtp_url:
        mail = Mail(settings.smtp_url, settings.mail_to, settings.mail_from)
        found.append(Channel(f"mail to {', '.join(mail.receivers)}", mail.send))
    return found


def try_channels(channels: list[Channel], message: Message) -> dict[str, DrError | None]:
    """Why each failed, or None."""
    results: dict[str, DrError | None] = {}
    for channel in channels:
        try:
            channel.send(message)
            results[channel.name] = None
        except DrError as error:
            results[channel.name] = error
    return results
