"""Checks of settings of trainings that nobody watches."""

import re
import shlex
from math import isfinite
from typing import Annotated

from drcli.base.problems import BadValue
from drcli.config.value_types import Check, Shape, is_address

_HIGHEST_PRICE = 10_000.0
"""USD per hour; the dearest machines cost some hundreds."""

MESSAGE_EVENTS = (
    "start",
    "resume",
    "interruption",
    "end",
    "failure",
    "stall",
    "stop",
    "fault",
    "recovery",
    "stage",
    "best",
    "upload",
)
_RULE = re.compile(r"last(?:-[1-9]\d{0,6})?|best|every-[1-9]\d{0,6}")


def _price(value: str) -> str:
    text = value.strip().removeprefix("$")
    if text.casefold() in ("", "auto"):
        return text.casefold()
    try:
        price = float(text)
    except ValueError:
        price = -1.0
    if not (isfinite(price) and 0.0 <= price <= _HIGHEST_PRICE):
        raise BadValue(
            "is not a price per hour", "Write USD per hour as in 0.25, or auto to ask EC2."
        )
    return text


def _command(value: str) -> str:
    try:
        shlex.split(value)
    except ValueError as error:
        raise BadValue(
            f"cannot be read: {error}",
            "Close every quotation mark, as in: sh -c 'wait-for-notice --json'.",
        ) from error
    return value


def _topic(value: str) -> str:
    if value and not re.fullmatch(
        r"arn:aws[a-z-]*:sns:[a-z0-9-]+:\d{12}:[\w-]{1,256}(\.fifo)?", value
    ):
        raise BadValue(
            "is not the ARN of an SNS topic",
            "Write it as in arn:aws:sns:us-east-1:123456789012:my-topic.",
        )
    return value


def _mail_addresses(value: str) -> str:
    for part in filter(None, re.split(r"[,;\s]+", value)):
        if not re.fullmatch(r"[^@\s<>\"(),:;\\]+@[A-Za-z0-9.-]*[A-Za-z0-9]", part):
            raise BadValue(
                "is not a list of mail addresses", "Write addresses as in me@example.com."
            )
    return value


def _smtp_url(value: str) -> str:
    if value and not is_address(value, "smtp", "smtps"):
        raise BadValue(
            "is not the address of a mail server",
            "Write smtps://user:password@mail.example.com:465, or smtp:// for STARTTLS on port "
            "587.",
        )
    return value


def _message_events(value: str) -> str:
    words = [word.casefold() for word in re.split(r"[,;\s]+", value) if word]
    for word in words:
        if word not in (*MESSAGE_EVENTS, "all", "none"):
            raise BadValue(
                f"names {word!a}, which is not an event",
                f"Write some of {', '.join(MESSAGE_EVENTS)}, separated by commas, or all.",
            )
    return ",".join(words)


def retention_rules(value: str) -> tuple[str, ...]:
    """The rules in a text such as `last-3,best,every-50`.

    Raises:
        BadValue: One of them is none.
    """
    rules = tuple(word.casefold() for word in re.split(r"[,;\s]+", value) if word)
    for rule in rules:
        if not _RULE.fullmatch(rule):
            raise BadValue(
                f"names {rule!a}, which is not a rule",
                "Write last or last-N, best, every-N, or several with commas between them, as in "
                "last-3,best,every-50.",
            )
    return rules


Price = Annotated[str, Check(_price), Shape("USD per hour, auto, or nothing")]
Command = Annotated[str, Check(_command), Shape("a program and its arguments, or nothing")]
TopicArn = Annotated[str, Check(_topic), Shape("the ARN of an SNS topic, or nothing")]
MailAddresses = Annotated[
    str, Check(_mail_addresses), Shape("mail addresses separated by commas, or nothing")
]
SmtpUrl = Annotated[str, Check(_smtp_url), Shape("an smtp or smtps address, or nothing")]
MessageEvents = Annotated[
    str, Check(_message_events), Shape(f"some of {', '.join(MESSAGE_EVENTS)}, or all or none")
]
Retention = Annotated[
    str,
    Check(lambda text: ",".join(retention_rules(text))),
    Shape("some of last, last-N, best, every-N, separated by commas, or nothing"),
]
