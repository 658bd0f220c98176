"""The kinds of race, DR_RACE_TYPE; `drcli.drive.build_race` builds what is on the track."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

RaceKind = Literal["TIME_TRIAL", "OBJECT_AVOIDANCE", "HEAD_TO_BOT", "HEAD_TO_MODEL"]


OTHER_HEAD_TO_HEAD = ("HEAD_TO_HEAD", "HEAD_TO_HEAD_RACING", "HEAD2HEAD", "H2H", "HEAD_TO_CAR")
HEAD_TO_HEAD_HINT = (
    "Write HEAD_TO_BOT to train against bots, or HEAD_TO_MODEL to evaluate against another model."
)


@dataclass(frozen=True)
class RaceType:
    """What the program knows of a kind of race.

    Attributes:
        words: For people.
        settings: Of what is on the track begin with this; empty for none.
        rewards: Folder of a reward function that suits it; empty for the usual one.
        trainable: Else two trained models race.
    """

    words: str
    settings: str = ""
    rewards: str = ""
    trainable: bool = True


RACE_TYPES: Mapping[str, RaceType] = MappingProxyType(
    {
        "TIME_TRIAL": RaceType("time trial"),
        "OBJECT_AVOIDANCE": RaceType("object avoidance", "DR_OA_", "rewards/object_avoidance/"),
        "HEAD_TO_BOT": RaceType("head to bot", "DR_H2B_", "rewards/head_to_bot/"),
        "HEAD_TO_MODEL": RaceType("head to head", trainable=False),
    }
)
