"""Checks of settings of live figures."""

import re
from typing import Annotated
from urllib.parse import urlsplit

from drcli.base.problems import BadValue
from drcli.config.value_types import Check, Shape, is_address

THIS_MACHINE = "127.0.0.1"
"""An empty address would let everybody read the figures."""

LOOPBACK_HOSTS = frozenset({THIS_MACHINE, "::1", "localhost"})


def _host(value: str) -> str:
    host = value.strip()
    named = re.fullmatch(r"[A-Za-z0-9_]([A-Za-z0-9._-]{0,252}[A-Za-z0-9])?\.?", host)
    address = re.fullmatch(r"[0-9a-fA-F:.]*:[0-9a-fA-F:.]*", host)  # IPv6
    if host and named is None and address is None:
        raise BadValue(
            "is not the name or address of a host",
            "Write it without a scheme or port, as in telegraf or 192.168.1.5.",
        )
    return host


def _tracking_url(value: str) -> str:
    if value and not is_address(value, "http", "https"):
        raise BadValue(
            "is not a web address",
            "Write the address of an MLflow server, as in http://192.168.1.5:5000.",
        )
    if value and "@" in urlsplit(value).netloc:
        raise BadValue(
            "contains a user or password, which logs and files would show",
            "Leave it out, and set MLFLOW_TRACKING_USERNAME and MLFLOW_TRACKING_PASSWORD, or "
            "MLFLOW_TRACKING_TOKEN, in the environment.",
        )
    return value


def _trackio_url(value: str) -> str:
    if value and not is_address(value, "http", "https"):
        raise BadValue(
            "is not a web address",
            "Write the address of a trackio server, as in http://192.168.1.5:7860.",
        )
    if value and (urlsplit(value).query or "@" in urlsplit(value).netloc):
        raise BadValue(
            "contains a token or password, which logs and files would show",
            "Write the address up to the question mark, and set TRACKIO_WRITE_TOKEN in the "
            "environment.",
        )
    return value


def _trackio_project(value: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,100}", value) or value.startswith("registry-"):
        raise BadValue(
            "is not the name of a trackio project",
            "Use letters, digits, - and _, and another beginning than registry-.",
        )
    return value


HostName = Annotated[
    str, Check(_host), Shape("the name or address of a host, without a port, or nothing")
]
ListenHost = Annotated[
    str, Check(lambda text: _host(text) or THIS_MACHINE), Shape("the name or address of a host")
]
TrackingUrl = Annotated[
    str, Check(_tracking_url), Shape("an http or https address without a password, or nothing")
]
TrackioUrl = Annotated[
    str, Check(_trackio_url), Shape("an http or https address without a token, or nothing")
]
TrackioProject = Annotated[str, Check(_trackio_project), Shape("letters, digits, - and _")]
