"""Checks of texts for settings."""

import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Annotated, Any, Literal, get_args
from urllib.parse import urlsplit

from drcli.base.errors import BadValue, closest, not_one_of, shown

CarName = Literal["release-6", "low-grip", "2022"]
"""Sets of `drsim.car.car_parameters`."""

USUAL_CAR: CarName = "release-6"

FOLDER_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,99}")
"""No path, and nothing that is hidden."""

HOME_REGION = "us-east-1"
LONGEST_KEY, LONGEST_PART = 800, 255
"""S3 allows 1024 bytes, file systems 255 for a part."""

LONGEST_TEXT = 2000
RUN_FOLDERS = ("runs", "rollouts", "training-records", "races")
BUCKET_RULE = (
    "Write 3 to 63 lowercase letters, digits, dots and hyphens, with a letter or digit first and "
    "last, as in my-bucket."
)
START_SIDES = ("left", "centre", "right")
MOST_START_OFFSET_M = 10.0
_LABEL = "[a-z0-9](?:[a-z0-9-]*[a-z0-9])?"


@dataclass(frozen=True)
class Check:
    """Checks a text and returns its value; raises BadValue."""

    check: Callable[[str], Any]


@dataclass(frozen=True)
class Shape:
    """As it reads after `Set it to`."""

    words: str


def follows_s3(bucket: str) -> bool:
    names = re.fullmatch(rf"{_LABEL}(?:\.{_LABEL})*", bucket) and 3 <= len(bucket) <= 63
    address = re.fullmatch(r"[0-9]+(?:\.[0-9]+){3}", bucket)
    return bool(names) and not address


def without_slashes(value: str) -> str:
    """A name in the bucket without empty parts."""
    return "/".join(filter(None, value.split("/")))


def object_key(written: str) -> str:
    """A name in the bucket; slashes at its ends and double ones are left out.

    Raises:
        BadValue: It cannot be one.
    """
    value = without_slashes(written)
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
    if any(part in (".", "..") for part in value.split("/")):
        raise BadValue("has . or .. between its slashes", "Write folders as in team/model-1.")
    return value


def _matching(pattern: str, reason: str, remedy: str) -> Callable[[str], str]:
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


def upload_bucket(name: str) -> str:
    """The name of the bucket for uploads.

    Raises:
        BadValue: It is none, as if it has a folder.
    """
    bucket, slash, folder = name.removeprefix("s3://").strip("/").partition("/")
    if bucket != name:
        rest = f", and begin DR_UPLOAD_S3_PREFIX with {folder}/" if slash else ""
        raise BadValue("is not the name of a bucket", f"Write {shown(bucket)}{rest}.")
    return _bucket(name)


def is_address(value: str, *schemes: str) -> bool:
    """With a scheme, a host, and a port other than 0."""
    try:
        address = urlsplit(value)
        return address.scheme in schemes and bool(address.hostname) and address.port != 0
    except ValueError:
        return False


def _address(value: str) -> str:
    if value and not is_address(value, "http", "https"):
        raise BadValue("is not a web address", "Write it as in http://192.168.1.5:9000.")
    return value


def _endpoint(value: str) -> str:
    parts = urlsplit(_address(value))
    for what, part, mark in (("query", parts.query, "?"), ("fragment", parts.fragment, "#")):
        if part:
            raise BadValue(
                f"has a {what}, which the address of an S3 server cannot have",
                f"Leave out everything from {mark} on.",
            )
    return value


def car_host_and_port(value: str) -> tuple[str, int]:
    """From HOST, HOST:PORT or an https address.

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


def _model_text(value: str) -> str:
    if len(value) > LONGEST_TEXT:
        raise BadValue("is too long", f"Write at most {LONGEST_TEXT} characters.")
    return value


def colour(value: str) -> str:
    """The colour of a car in the reference's spelling; whole shells (f1_car_...) pass.

    Raises:
        BadValue: There is no such colour.
    """
    named = {colour.casefold(): colour for colour in _COLOURS}
    if value.casefold() not in named and not value.startswith("f1_car_"):
        raise not_one_of(_COLOURS, value)
    return named.get(value.casefold(), value)


def _positions(value: str) -> tuple[tuple[float, ...], ...]:
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


def _start_offset(value: str) -> str:
    word = {"center": "centre", "": "centre"}.get(value.casefold(), value.casefold())
    if word in START_SIDES:
        return word
    try:
        metres = float(value)
    except ValueError:
        metres = float("nan")
    if not abs(metres) <= MOST_START_OFFSET_M:
        raise BadValue(
            f"is neither one of {', '.join(START_SIDES)} nor a number of metres from "
            f"-{MOST_START_OFFSET_M:g} to {MOST_START_OFFSET_M:g}",
            "Write left, centre or right, or metres to the left of the centre line, as in -0.2.",
        )
    # Every digit: a lap that is driven again must begin at the same place.
    return str(metres).removesuffix(".0")


def _log_group(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9._/#-]{1,512}", name):
        raise BadValue(
            "is not the name of a log group",
            "Write 1 to 512 letters, digits and . _ - / #, as in /deepracer-for-cloud.",
        )
    return name


def _log_stream_prefix(text: str) -> str:
    if len(text) > 200 or not text.isprintable() or set(text) & set(":*"):
        raise BadValue(
            "cannot begin the name of a log stream",
            "Write at most 200 characters without : and *, or leave it out.",
        )
    return text


_COLOURS = ("Black", "Grey", "Blue", "Red", "Orange", "White", "Purple")

ObjectKey = Annotated[
    str, Check(object_key), Shape("a name in the bucket: letters, digits and . _ - /")
]
WorldName = Annotated[str, Check(_world), Shape("the name of a track, or the path of a .npy file")]
"""`drcli.config.track_names` knows whether it is installed."""
BucketName = Annotated[
    str,
    Check(_bucket),
    Shape(
        "the name of a bucket: 3 to 63 lowercase letters, digits, . and -; with DR_CLOUD=remote or "
        "azure also uppercase letters and _"
    ),
]
"""Whether `follows_s3` must hold depends on DR_CLOUD."""
UploadBucket = Annotated[str, Shape("the name of a bucket, or not-defined")]
"""Checked when something is to be uploaded: templates of the reference hold other texts."""
Address = Annotated[str, Check(_address), Shape("an http or https address, or nothing")]
Endpoint = Annotated[
    str, Check(_endpoint), Shape("the http or https address of an S3 server, or nothing")
]
CarHost = Annotated[str, Check(_car_address), Shape("a host, host:port, or nothing")]
Region = Annotated[str, Check(lambda name: _region(name) or HOME_REGION), Shape("an AWS region")]
Colour = Annotated[
    str, Check(colour), Shape(f"one of {', '.join(_COLOURS)}, or f1_car_ and a colour")
]
FolderName = Annotated[
    str, Check(_folder_name), Shape("the name of a folder in experiments/, or nothing")
]
Gpus = Annotated[
    str, Check(_gpus), Shape("numbers or ids of GPUs separated by commas, -1 for none, or nothing")
]
"""As CUDA_VISIBLE_DEVICES has them."""
LogGroup = Annotated[
    str,
    Check(_log_group),
    Shape("the name of a log group: letters, digits and . _ - / #"),
]
LogStreamPrefix = Annotated[
    str,
    Check(_log_stream_prefix),
    Shape("at most 200 characters without : and *"),
]
ModelText = Annotated[str, Check(_model_text), Shape(f"at most {LONGEST_TEXT} characters")]
Positions = Annotated[tuple[tuple[float, float], ...], Check(_positions)]
"""Progress (fraction of the lap) and lane (-1 outer, any other inner)."""
StartOffset = Annotated[
    str,
    Check(_start_offset),
    Shape("left, centre or right, or metres to the left of the centre line"),
]


# The words that choose a checkpoint.


CheckpointWord = Literal["last", "best", "first-lap", "three-laps", "best-lap"]
CheckpointChoice = CheckpointWord | int
WORDS: tuple[CheckpointWord, ...] = get_args(CheckpointWord)

MOST_NUMBER = 10**9
_NAME = re.compile(r"(\d{1,12})(?:_Step-\d{1,18}(?:\.ckpt)?)?")


def parse_checkpoint(text: str) -> CheckpointChoice:
    """Read a word, a number, or the name of a checkpoint such as `12_Step-7824.ckpt`.

    Raises:
        BadValue: It is none of these.
    """
    word = text.strip().casefold().replace("_", "-")
    for known in WORDS:
        if word == known:
            return known
    found = _NAME.fullmatch(text.strip())
    if found is not None and found[1].isascii() and int(found[1]) <= MOST_NUMBER:
        return int(found[1])
    likely = closest(word, WORDS)
    start = f"Did you mean {likely}? " if likely is not None else ""
    raise BadValue(
        "is neither the number of a checkpoint nor a word for one",
        f"{start}Write a number such as 12, or one of {', '.join(WORDS)}.",
    )


CheckpointText = Annotated[
    str,
    Check(lambda text: str(parse_checkpoint(text))),
    Shape(f"one of {', '.join(WORDS)}, or the number of a checkpoint"),
]
OptionalCheckpointText = Annotated[
    str,
    Check(lambda text: str(parse_checkpoint(text)) if text.strip() else ""),
    Shape(f"one of {', '.join(WORDS)}, the number of a checkpoint, or nothing"),
]


# Checks of settings of live figures.


THIS_MACHINE = "127.0.0.1"
"""An empty address would let everybody read the figures."""

LOOPBACK_HOSTS = frozenset({THIS_MACHINE, "::1", "localhost"})


def _host(value: str) -> str:
    host = value.strip()
    named = re.fullmatch(r"[A-Za-z0-9_]([A-Za-z0-9._-]{0,252}[A-Za-z0-9])?\.?", host)
    address = re.fullmatch(r"[0-9a-fA-F:.]*:[0-9a-fA-F:.]*", host)  # IPv6
    if host and named is None and address is None:
        raise BadValue(
            "is not the name or address of a host",
            "Write it without a scheme or port, as in telegraf or 192.168.1.5.",
        )
    return host


def _tracking_url(value: str) -> str:
    if value and not is_address(value, "http", "https"):
        raise BadValue(
            "is not a web address",
            "Write the address of an MLflow server, as in http://192.168.1.5:5000.",
        )
    if value and "@" in urlsplit(value).netloc:
        raise BadValue(
            "contains a user or password, which logs and files would show",
            "Leave it out, and set MLFLOW_TRACKING_USERNAME and MLFLOW_TRACKING_PASSWORD, or "
            "MLFLOW_TRACKING_TOKEN, in the environment.",
        )
    return value


def _trackio_url(value: str) -> str:
    if value and not is_address(value, "http", "https"):
        raise BadValue(
            "is not a web address",
            "Write the address of a trackio server, as in http://192.168.1.5:7860.",
        )
    if value and (urlsplit(value).query or "@" in urlsplit(value).netloc):
        raise BadValue(
            "contains a token or password, which logs and files would show",
            "Write the address up to the question mark, and set TRACKIO_WRITE_TOKEN in the "
            "environment.",
        )
    return value


def _trackio_project(value: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,100}", value) or value.startswith("registry-"):
        raise BadValue(
            "is not the name of a trackio project",
            "Use letters, digits, - and _, and another beginning than registry-.",
        )
    return value


HostName = Annotated[
    str, Check(_host), Shape("the name or address of a host, without a port, or nothing")
]
ListenHost = Annotated[
    str, Check(lambda text: _host(text) or THIS_MACHINE), Shape("the name or address of a host")
]
TrackingUrl = Annotated[
    str, Check(_tracking_url), Shape("an http or https address without a password, or nothing")
]
TrackioUrl = Annotated[
    str, Check(_trackio_url), Shape("an http or https address without a token, or nothing")
]
TrackioProject = Annotated[str, Check(_trackio_project), Shape("letters, digits, - and _")]


# Checks of settings of trainings that nobody watches.


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


# The colours of DR_CAR_COLOR.


RGB = tuple[float, float, float]

_COLORS: dict[str, RGB] = {
    "Black": (0.1, 0.1, 0.1),
    "Grey": (0.529, 0.584, 0.588),
    "Blue": (0.266, 0.372, 0.898),
    "Red": (0.878, 0.101, 0.145),
    "Orange": (1.0, 0.627, 0.039),
    "White": (1.0, 1.0, 1.0),
    "Purple": (0.611, 0.164, 0.764),
}
"""Source: the reference simulator's materials."""

_HEX = re.compile(r"f1_car_#?([0-9a-fA-F]{6})")


def shell_color(name: str) -> RGB:
    """RGB, 0 to 255; red for a colour without a number."""
    match = _HEX.fullmatch(name)
    if match is not None:
        red, green, blue = bytes.fromhex(match[1])
        return float(red), float(green), float(blue)
    red_, green_, blue_ = _COLORS.get(name.capitalize(), _COLORS["Red"])
    return 255.0 * red_, 255.0 * green_, 255.0 * blue_
