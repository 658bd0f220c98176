"""Checks of texts for settings."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from drcli.base.problems import BadValue

CarName = Literal["release-6", "low-grip", "2022"]
"""Sets of `drsim.car.car_sets`."""

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
        raise BadValue(
            f"is not one of {', '.join(_COLOURS)}", f"Write one of {', '.join(_COLOURS)}."
        )
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
    str, Check(_object_key), Shape("a name in the bucket: letters, digits and . _ - /")
]
WorldName = Annotated[str, Check(_world), Shape("the name of a track, or the path of a .npy file")]
"""`drcli.config.track_names` knows whether it is installed."""
OptionalWorldName = Annotated[
    str,
    Check(lambda value: _world(value) if value else value),
    Shape("the name of a track, or the path of a .npy file"),
]
BucketName = Annotated[
    str,
    Check(_bucket),
    Shape(
        "the name of a bucket: 3 to 63 lowercase letters, digits, . and -; with DR_CLOUD=remote or "
        "azure also uppercase letters and _"
    ),
]
"""Whether `follows_s3` must hold depends on DR_CLOUD."""
UploadBucket = Annotated[
    str,
    Check(lambda name: _bucket(name) if name else name),
    Shape("the name of a bucket, or not-defined"),
]
Address = Annotated[str, Check(_address), Shape("an http or https address, or nothing")]
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
