"""Checks of texts for settings, beyond what their types check."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Annotated, Any
from urllib.parse import urlsplit

from drcli.base.problems import BadValue

FOLDER_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}")
"""Name of a folder in experiments/: no path, and nothing that is hidden."""

HOME_REGION = "us-east-1"
"""The default region."""

LONGEST_KEY, LONGEST_PART = 800, 255
"""Characters of a name in the bucket, and of the parts between its slashes: S3 allows 1024 bytes,
of which a model's files need some, and file systems allow 255."""

RUN_FOLDERS = ("runs", "rollouts")
"""Folders of the bucket with the files of running trainings."""

BUCKET_RULE = (
    "Write 3 to 63 lowercase letters, digits, dots and hyphens, with a letter or digit first and "
    "last, as in my-bucket."
)
"""A remedy if `follows_s3` is False."""

_LABEL = "[a-z0-9](?:[a-z0-9-]*[a-z0-9])?"


@dataclass(frozen=True)
class Check:
    """Checks a text of the right kind and returns its value; raises BadValue."""

    check: Callable[[str], Any]


@dataclass(frozen=True)
class Shape:
    """What may be written into a text, as it reads after `Set it to`."""

    words: str


def follows_s3(bucket: str) -> bool:
    """Whether a text is the name of a bucket for Amazon, and for servers as strict as that."""
    names = re.fullmatch(rf"{_LABEL}(?:\.{_LABEL})*", bucket) and 3 <= len(bucket) <= 63
    address = re.fullmatch(r"[0-9]+(?:\.[0-9]+){3}", bucket)
    return bool(names) and not address


def _object_key(value: str) -> str:
    if not value:
        raise BadValue("is empty", "Write a name such as rl-deepracer-1.")
    bad = re.search(r"[^A-Za-z0-9._/-]", value)
    if bad is not None:
        raise BadValue(
            f"contains {bad[0]!a}, which is not allowed in a name in the bucket",
            "Use only letters, digits, and the characters . _ - /.",
        )
    if len(value) > LONGEST_KEY or any(len(part) > LONGEST_PART for part in value.split("/")):
        raise BadValue(
            "is too long for servers and disks",
            f"Write at most {LONGEST_PART} characters between slashes, and {LONGEST_KEY} in all.",
        )
    if any(part in ("", ".", "..") for part in value.split("/")):
        raise BadValue(
            "has an empty part, . or .. between its slashes",
            "Write folders as in team/model-1, without / at the start or the end.",
        )
    return value


def _matching(pattern: str, reason: str, remedy: str) -> Callable[[str], str]:
    """Checks texts by a regular expression."""

    def check(value: str) -> str:
        if not re.fullmatch(pattern, value):
            raise BadValue(reason, remedy)
        return value

    return check


_world = _matching(
    r"[A-Za-z0-9._-]+|.*\.npy",
    "cannot be the name of a track",
    "Write a name such as reinvent_base, or the path of a .npy file.",
)
_bucket = _matching(
    r"[A-Za-z0-9][A-Za-z0-9._-]{2,62}",
    "is not the name of a bucket",
    "Write its plain name of 3 to 63 letters, digits, dots and hyphens, without s3://.",
)
_region = _matching(
    r"(?:(?!\d+\Z)[A-Za-z0-9](?:[A-Za-z0-9-]{0,61}[A-Za-z0-9])?)?",
    "is not an AWS region",
    "Write one such as us-east-1 or eu-central-1.",
)
_folder_name = _matching(
    f"(?:{FOLDER_NAME.pattern})?",
    "is not a plain folder name",
    "Write the name of a folder in experiments/.",
)
_gpus = _matching(
    r"(?:-1|[A-Za-z0-9][A-Za-z0-9/-]*(?:, *[A-Za-z0-9][A-Za-z0-9/-]*)*)?",
    "is not a list of GPUs",
    "Write numbers as nvidia-smi counts them, such as 0 or 0,1, or -1 for none.",
)


def _address(value: str) -> str:
    try:
        address = urlsplit(value)
        fit = address.scheme in ("http", "https") and bool(address.hostname)
        fit = fit and address.port != 0
    except ValueError:
        fit = False
    if value and not fit:
        raise BadValue("is not a web address", "Write it as in http://192.168.1.5:9000.")
    return value


def car_host_and_port(value: str) -> tuple[str, int]:
    """The host and the port of a car's web page, written as HOST, HOST:PORT or an https address.

    Raises:
        BadValue: It is none of these.
    """
    text = value.strip()
    if text.casefold().startswith("http://"):
        raise BadValue("is not an https address", "Leave http:// out; cars only answer over https.")
    bare = text[8:] if text.casefold().startswith("https://") else text
    if bare.count(":") > 1 and not bare.startswith("["):
        bare = f"[{bare}]"  # an IPv6 address without a port
    try:
        parts = urlsplit(f"https://{bare}")
        host, port = parts.hostname or "", parts.port
    except ValueError:  # a port that is not a number, an unclosed bracket
        host, port = "", None
    plain = re.fullmatch(r"[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?|[0-9a-fA-F:.]+", host)
    rest = "" if not host else parts.path.strip("/") + parts.query + parts.fragment
    if plain is None or port == 0 or rest or "@" in bare:
        raise BadValue(
            "is not the address of a car",
            "Write host or host:port, such as 192.168.1.50 or amss-a1b2.local:443.",
        )
    return host, port or 443


def _car_address(value: str) -> str:
    if value:
        car_host_and_port(value)
    return value


def _colour(value: str) -> str:
    named = {colour.casefold(): colour for colour in _COLOURS}
    if value.casefold() not in named and not value.startswith("f1_car_"):
        raise BadValue(
            f"is not one of {', '.join(_COLOURS)}", f"Write one of {', '.join(_COLOURS)}."
        )
    return named.get(value.casefold(), value)


def _positions(value: str) -> tuple[tuple[float, ...], ...]:
    """`0.23,-1;0.46,1` as pairs; progress is a fraction of the lap, lane -1 is the outer one."""
    written = [pair for pair in value.split(";") if pair.strip()]
    try:
        pairs = tuple(tuple(map(float, pair.split(","))) for pair in written)
    except ValueError:
        pairs = ((),)
    if any(len(p) != 2 or not 0.0 <= p[0] <= 1.0 or not isfinite(p[1]) for p in pairs):
        raise BadValue(
            "is not a list of progress,lane pairs",
            'Write progress 0 to 1 and lane 1 or -1, as in "0.23,-1;0.46,1".',
        )
    return pairs


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
    try:
        address = urlsplit(value)
        fit = address.scheme in ("smtp", "smtps") and bool(address.hostname) and address.port != 0
    except ValueError:
        fit = False
    if value and not fit:
        raise BadValue(
            "is not the address of a mail server",
            "Write smtps://user:password@mail.example.com:465, or smtp:// for STARTTLS on port "
            "587.",
        )
    return value


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
    "best",
    "upload",
)
"""What a message can be about."""


def _message_events(value: str) -> str:
    words = [word.casefold() for word in re.split(r"[,;\s]+", value) if word]
    for word in words:
        if word not in (*MESSAGE_EVENTS, "all", "none"):
            raise BadValue(
                f"names {word!a}, which is not an event",
                f"Write some of {', '.join(MESSAGE_EVENTS)}, separated by commas, or all.",
            )
    return ",".join(words)


_RULE = re.compile(r"last(?:-[1-9]\d{0,6})?|best|every-[1-9]\d{0,6}")


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


_HIGHEST_PRICE = 10_000.0
"""USD per hour; the dearest machines that can be rented cost some hundreds."""

_COLOURS = ("Black", "Grey", "Blue", "Red", "Orange", "White", "Purple")

ObjectKey = Annotated[
    str, Check(_object_key), Shape("a name in the bucket: letters, digits and . _ - /")
]
"""A key or prefix in the bucket."""
WorldName = Annotated[str, Check(_world), Shape("the name of a track, or the path of a .npy file")]
"""May name a track; `drcli.config.track_names` knows whether that track is installed."""
BucketName = Annotated[
    str,
    Check(_bucket),
    Shape(
        "the name of a bucket: 3 to 63 lowercase letters, digits, . and -; with DR_CLOUD=remote or "
        "azure also uppercase letters and _"
    ),
]
"""A name that some server takes; whether `follows_s3` must hold depends on DR_CLOUD."""
UploadBucket = Annotated[
    str,
    Check(lambda name: _bucket(name) if name else name),
    Shape("the name of a bucket, or not-defined"),
]
Address = Annotated[str, Check(_address), Shape("an http or https address, or nothing")]
"""http or https address, or empty."""
CarHost = Annotated[str, Check(_car_address), Shape("a host, host:port, or nothing")]
"""Address of a car's web page, or empty."""
Region = Annotated[str, Check(lambda name: _region(name) or HOME_REGION), Shape("an AWS region")]
Colour = Annotated[
    str, Check(_colour), Shape(f"one of {', '.join(_COLOURS)}, or f1_car_ and a colour")
]
FolderName = Annotated[
    str, Check(_folder_name), Shape("the name of a folder in experiments/, or nothing")
]
Gpus = Annotated[
    str, Check(_gpus), Shape("numbers or ids of GPUs separated by commas, -1 for none, or nothing")
]
"""As CUDA_VISIBLE_DEVICES has them."""
Positions = Annotated[tuple[tuple[float, float], ...], Check(_positions)]
"""Progress (fraction of the lap) and lane (-1 outer, any other inner) of each obstacle."""
Price = Annotated[str, Check(_price), Shape("USD per hour, auto, or nothing")]
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
