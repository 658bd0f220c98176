"""Sends messages about a training."""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drcli.base.errors import DrError
from drcli.base.json_record import json_default
from drcli.config.groups.unattended import MessageSettings
from drcli.remote import mail_message, sns_message, webhook_message

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


@dataclass(frozen=True)
class Channel:
    """Its name has no secrets; `send` raises DrError."""

    name: str
    send: Callable[[Message], None]


def open_channels(settings: MessageSettings, profile: str | None = None) -> list[Channel]:
    found = []
    topic = settings.sns_topic_arn or os.environ.get(TOPIC_VARIABLE, "")
    if topic:
        found.append(Channel(f"the SNS topic {topic}", lambda m: _to_topic(topic, profile, m)))
    if settings.webhook_url:
        url = settings.webhook_url
        name = f"the webhook at {webhook_message.host_of(url)}"
        found.append(Channel(name, lambda m: webhook_message.post(url, _body(m), TIMEOUT_S)))
    if settings.mail_to and settings.smtp_url:
        mail = mail_message.Mail(settings.smtp_url, settings.mail_to, settings.mail_from)
        name = f"mail to {', '.join(mail.receivers)}"
        found.append(Channel(name, lambda m: mail.send(f"[drcli] {m.subject}", m.lines, TIMEOUT_S)))
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


def _to_topic(topic: str, profile: str | None, message: Message) -> None:
    sns_message.publish(
        topic, message.subject, message.lines, message.event, profile=profile, timeout_s=TIMEOUT_S
    )


def _body(message: Message) -> dict[str, Any]:
    """For Slack and Mattermost, and Discord."""
    import json

    facts = json.loads(json.dumps(message.facts, default=json_default))
    return webhook_message.body_of(message.event, message.subject, message.text, facts)
