"""What `dr init` asks: the few things that everybody decides for himself."""

from collections.abc import Callable, Mapping, Sequence

from drcli.base.problems import BadValue, shown
from drcli.cli.completion.values import CLOUDS, RACE_TYPES
from drcli.config.settings import catalogue

Ask = Callable[[str, str, Sequence[str]], str]
"""Takes a question, a default and the allowed words; returns the answer."""

Tell = Callable[[str], None]
"""Says a sentence."""

TRAINABLE = RACE_TYPES[:3]
"""HEAD_TO_MODEL is for evaluations."""


def with_answers(given: Mapping[str, str], ask: Ask, tell: Tell) -> dict[str, str]:
    """The settings that were given, and the answers to all questions that are left.

    Args:
        given: Texts by DR_ name; nothing is asked about these.
        ask: Puts a question.
        tell: Says why an answer will not do; then it is asked again.
    """
    values = dict(given)

    def settle(name: str, question: str, default: str, choices: Sequence[str] = ()) -> None:
        while name not in values:
            answer = ask(question, default, choices)
            try:
                catalogue()[name].read(answer)
            except BadValue as bad:
                tell(f"{shown(answer)} {bad.reason}. {bad.remedy}")
            else:
                values[name] = answer

    settle("DR_WORLD_NAME", "Track (`dr-tracks list` shows them)", "reinvent_base")
    settle("DR_RACE_TYPE", "Race", TRAINABLE[0], TRAINABLE)
    settle("DR_LOCAL_S3_MODEL_PREFIX", "Name of the model", "rl-deepracer-sagemaker")
    settle("DR_CLOUD", "Who keeps the bucket", CLOUDS[0], CLOUDS)
    if values["DR_CLOUD"] != "local":
        if values["DR_CLOUD"] in ("remote", "azure"):
            settle("DR_REMOTE_MINIO_URL", "S3 address", "http://localhost:9000")
        settle("DR_LOCAL_S3_BUCKET", "Name of the bucket", "bucket")
        settle("DR_LOCAL_S3_PROFILE", "AWS profile with the keys", "default")
    return values
