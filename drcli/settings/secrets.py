"""Keeps passwords and keys out of what is printed."""

import re
from urllib.parse import urlsplit

from drcli.settings.model import catalogue

HIDDEN = "(hidden)"

_SECRET = re.compile(r"SECRET|PASSWORD|PASSWD|TOKEN|CREDENTIAL|ACCESS_?KEY|API_?KEY", re.IGNORECASE)
"""Names that are no settings of ours and hold what nobody else may read, such as the AWS keys."""


def hidden(name: str, value: str) -> str:
    """A value as it may be shown: without a password in an address, and no secret at all.

    Args:
        name: Whose value it is.
        value: As it is set.
    """
    if name not in catalogue() and _SECRET.search(name):
        return HIDDEN if value else ""
    if "://" not in value or "@" not in value:
        return value
    try:
        address = urlsplit(value)
    except ValueError:
        return HIDDEN
    host = address.netloc.rpartition("@")[2]
    return address._replace(netloc=f"{HIDDEN}@{host}").geturl() if host != address.netloc else value
