"""`dr send-message`."""

from dataclasses import dataclass, field
from typing import Annotated

import typer

from drcli.base.errors import SettingsError, StorageError
from drcli.base.installation import lazy_imports
from drcli.cli import terminal
from drcli.cli.working_folder import settings

with lazy_imports():
    from drcli.outside import messages


@dataclass(frozen=True)
class MessageReport:
    """The result of `dr-send-message`."""

    text: Annotated[str, "What was sent."]
    sent: Annotated[list[str], "Places that took the message."]
    failed: Annotated[dict[str, str], "Why others did not, by place."] = field(default_factory=dict)


def send_message(
    text: Annotated[str, typer.Argument(metavar="TEXT", help="What to say.")],
) -> None:
    """Send a message to every place that trainings send theirs to, to try the settings.

    These are the SNS topic of DR_SNS_TOPIC_ARN, the webhook of DR_WEBHOOK_URL, and DR_MAIL_TO
    through DR_SMTP_URL. Exits 4 if one of them does not take it.

    Example: dr-send-message "Does this arrive?"
    """
    loaded = settings()
    channels = messages.open_channels(loaded, loaded.storage.aws_profile)
    if not channels:
        raise SettingsError(
            "No place for messages is set.",
            remedy="Set DR_SNS_TOPIC_ARN, DR_WEBHOOK_URL, or DR_MAIL_TO and DR_SMTP_URL in "
            "system.env.",
        )
    facts = {"model": f"s3://{loaded.bucket}/{loaded.model_prefix}"}
    message = messages.Message("test", f"message: {loaded.model_prefix}", text, facts)
    with terminal.waiting("Sending ..."):
        results = messages.try_channels(channels, message)
    report = MessageReport(
        text,
        [name for name, error in results.items() if error is None],
        {name: f"{error} {error.remedy}" for name, error in results.items() if error is not None},
    )
    said = "\n".join(f"Sent to {name}." for name in report.sent)
    terminal.emit(report, said or None)
    failures = [error for error in results.values() if error is not None]
    if failures:
        raise StorageError(
            "\n".join(map(str, failures)), remedy="\n".join(each.remedy for each in failures)
        )
