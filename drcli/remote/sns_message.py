"""Publishes to a topic of Amazon SNS."""

import hashlib
from typing import Any

from drcli.base.errors import StorageError
from drcli.config import secret_environment
from drcli.store.profiles import lend_to_refreshes, session_of

_LONGEST_SUBJECT = 99
_LONGEST_TEXT = 200_000
"""SNS takes 256 KB."""


def publish(
    topic: str, subject: str, text: str, event: str, *, profile: str | None, timeout_s: float
) -> None:
    """Publish a message; the keys need `sns:Publish`.

    Raises:
        StorageError: The topic does not exist, the keys may not publish, or nobody answers.
    """
    from botocore.exceptions import BotoCoreError, ClientError

    try:
        client = _client(topic, profile, timeout_s)
        client.publish(
            TopicArn=topic,
            Subject=_subject(subject),
            Message=text[:_LONGEST_TEXT],
            MessageAttributes={"event": {"DataType": "String", "StringValue": event}},
            **_order(topic, text),
        )
    except (BotoCoreError, ClientError, ValueError, IndexError) as error:
        raise StorageError(
            f"The SNS topic {topic} does not take messages: {error}.",
            remedy="Check DR_SNS_TOPIC_ARN, the access keys, and that they allow sns:Publish.",
        ) from error


def _client(topic: str, profile: str | None, timeout_s: float) -> Any:
    from botocore.config import Config

    config = Config(
        retries={"total_max_attempts": 1, "mode": "standard"},
        connect_timeout=timeout_s,
        read_timeout=timeout_s,
    )
    session = session_of(profile, "DR_LOCAL_S3_PROFILE")
    with secret_environment.lent():
        client = session.client("sns", region_name=topic.split(":")[3], config=config)
        lend_to_refreshes(session.get_credentials())
    return client


def _subject(subject: str) -> str:
    plain = "".join(letter if " " <= letter <= "~" else "?" for letter in subject)
    return plain[:_LONGEST_SUBJECT].strip() or "drcli"


def _order(topic: str, text: str) -> dict[str, str]:
    if not topic.endswith(".fifo"):
        return {}
    unique = hashlib.sha256(text.encode()).hexdigest()
    return {"MessageGroupId": "drcli", "MessageDeduplicationId": unique}
