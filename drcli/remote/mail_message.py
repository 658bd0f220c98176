"""Sends a mail through a mail server."""

import re
from email.message import EmailMessage
from email.utils import formatdate, make_msgid
from urllib.parse import unquote, urlsplit

from drcli.base.errors import SettingsError, StorageError

SETTING = "DR_SMTP_URL"

_PORTS = {"smtps": 465, "smtp": 587}


class Mail:
    """Sends mails from one address to some.

    Args:
        url: smtps://, or smtp:// with STARTTLS, without which no password is sent.
        to: With commas or spaces.
        sender: Empty for the first of `to`.
    """

    def __init__(self, url: str, to: str, sender: str = "") -> None:
        self.receivers = _addresses(to)
        self._sender = (_addresses(sender) or self.receivers)[0]
        self._url = urlsplit(url)
        self._host = self._url.hostname or ""
        self._port = self._url.port or _PORTS.get(self._url.scheme, 587)

    def send(self, subject: str, text: str, timeout_s: float) -> None:
        """Send a mail.

        Raises:
            SettingsError: The password needs encryption.
            StorageError: The server refuses, or does not answer.
        """
        import smtplib

        message = EmailMessage()
        message["Subject"] = " ".join(subject.split())
        message["From"] = self._sender
        message["To"] = ", ".join(self.receivers)
        message["Date"] = formatdate()
        message["Message-ID"] = make_msgid(domain="drcli.invalid")
        message.set_content(text)
        try:
            self._deliver(message, timeout_s)
        except smtplib.SMTPAuthenticationError as error:
            raise StorageError(
                f"The mail server {self._host} refuses the login (code {error.smtp_code}).",
                remedy=f"Correct user and password in {SETTING}; write @ : / in them as %40 %3A "
                "%2F.",
            ) from None
        except smtplib.SMTPException as error:
            raise StorageError(
                f"The mail server {self._host} does not take the mail: {_reason(error)}.",
                remedy="Check DR_MAIL_TO, DR_MAIL_FROM and DR_SMTP_URL in system.env.",
            ) from None
        except OSError as error:
            raise StorageError(
                f"The mail server {self._host}:{self._port} cannot be reached: "
                f"{error.strerror or error or type(error).__name__}.",
                remedy=f"Check {SETTING} in system.env, and the network.",
            ) from None

    def _deliver(self, message: EmailMessage, timeout_s: float) -> None:
        import smtplib
        import ssl

        context = ssl.create_default_context()
        user, password = unquote(self._url.username or ""), unquote(self._url.password or "")
        server: smtplib.SMTP
        if self._url.scheme == "smtps":
            server = smtplib.SMTP_SSL(self._host, self._port, timeout=timeout_s, context=context)
        else:
            server = smtplib.SMTP(self._host, self._port, timeout=timeout_s)
        with server:
            if self._url.scheme != "smtps":
                server.ehlo()
                if server.has_extn("starttls"):
                    server.starttls(context=context)
                    server.ehlo()
                elif user:
                    raise SettingsError(
                        f"The mail server {self._host}:{self._port} offers no encryption, so the "
                        "password is not sent.",
                        remedy=f"Write smtps:// in {SETTING}, usually with port 465.",
                    )
            if user:
                server.login(user, password)
            server.send_message(message)


def _addresses(text: str) -> list[str]:
    return [part for part in re.split(r"[,;\s]+", text) if part]


def _reason(error: Exception) -> str:
    said = getattr(error, "smtp_error", b"") or str(error) or type(error).__name__
    text = said.decode("utf-8", "replace") if isinstance(said, bytes) else str(said)
    return " ".join(text.split()).rstrip(".")[:200]
