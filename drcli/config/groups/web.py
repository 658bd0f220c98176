"""The console, a web page."""

from typing import Literal

from drcli.config.fields import Group, setting
from drcli.config.figure_types import THIS_MACHINE, ListenHost


class WebSettings(Group, title="Console", file="system.env"):
    webviewer_port: int = setting(
        "DR_WEBVIEWER_PORT", 8100, "Port of the console.", between=(1, 65_535)
    )
    webviewer_host: ListenHost = setting(
        "DR_WEBVIEWER_HOST",
        THIS_MACHINE,
        "Address on which the console listens; with 0.0.0.0, other machines can open it with its "
        "token.",
    )
    webviewer_auth: Literal["token", "none"] = setting(
        "DR_WEBVIEWER_AUTH",
        "token",
        "What the console asks for; with none, every user of this machine may use it.",
    )
