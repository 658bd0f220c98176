"""The questions of `dr init`."""

from collections.abc import Callable, Mapping, Sequence

from drcli.base.problems import BadValue, shown
from drcli.cli import candidates
from drcli.config.settings import catalogue

Ask = Callable[[str, str, Sequence[str]], str]
"""Takes a question, a default and the allowed words, and returns the answer."""

Tell = Callable[[str], None]
"""Prints a sentence."""


def with_answers(given: Mapping[str, str], ask: Ask, tell: Tell) -> dict[str, str]:
    """The settings that were given, and the answers to all other questions.

    Args:
        given: Texts by DR_ name; nothing is asked about these.
        ask: Asks a question.
        tell: Says what is wrong with an answer, before the question is asked again.
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

    clouds = candidates.clouds()
    trainable = [kind for kind in candidates.race_types() if kind != "HEAD_TO_MODEL"]
    settle("DR_WORLD_NAME", "Track (`dr-tracks list` shows them)", "reinvent_base")
    settle("DR_RACE_TYPE", "Race", trainable[0], trainable)
    settle("DR_LOCAL_S3_MODEL_PREFIX", "Name of the model", "rl-deepracer-sagemaker")
    settle("DR_CLOUD", "Where the bucket is", clouds[0], clouds)
    if values["DR_CLOUD"] != "local":
        if values["DR_CLOUD"] in ("remote", "azure"):
            settle("DR_REMOTE_MINIO_URL", "S3 address", "http://localhost:9000")
        settle("DR_LOCAL_S3_BUCKET", "Name of the bucket", "bucket")
        settle("DR_LOCAL_S3_PROFILE", "AWS profile that holds the keys", "default")
    return values
