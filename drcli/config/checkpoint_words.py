"""The words that choose a checkpoint."""

import re
from typing import Annotated, Literal, get_args

from drcli.base.problems import BadValue, closest
from drcli.config.value_types import Check, Shape

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
