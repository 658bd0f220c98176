"""Hides passwords and keys in what is printed."""

import re
from urllib.parse import urlsplit

from drcli.config.model import catalogue

HIDDEN = "(hidden)"

_SECRET = re.compile(r"SECRET|PASSWORD|PASSWD|TOKEN|CREDENTIAL|ACCESS_?KEY|API_?KEY", re.IGNORECASE)
"""Names of other variables with secrets, such as the AWS keys."""


def hidden(name: str, value: str) -> str:
    """A value as it may be shown: no secret, and no password or signature in an address."""
    if name not in catalogue() and _SECRET.search(name):
        return HIDDEN if value else ""
    if "://" not in value:
        return value
    try:
        address = urlsplit(value)
    except ValueError:
        return HIDDEN
    _, at, host = address.netloc.rpartition("@")
    shown = address._replace(
        netloc=f"{HIDDEN}@{host}" if at else host, query=HIDDEN if address.query else ""
    )
    return value if shown == address else shown.geturl()
