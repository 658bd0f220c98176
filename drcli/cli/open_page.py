"""Opens a page in this person's browser."""

import os
import shlex
import subprocess
import sys
import webbrowser
from html import escape
from urllib.parse import parse_qs, urlsplit

from drcli.base.errors import SettingsError
from drcli.base.files import write_private
from drcli.cli.working_folder import working_folder

_LEADS_TO = """<!doctype html>
<meta charset="utf-8">
<meta http-equiv="refresh" content="0; url={0}">
<title>DeepRacer console</title>
<p><a href="{0}">DeepRacer console</a></p>
"""


def open_page(url: str, program: str = "") -> None:
    """Open a page if a browser could show it here, or with `program`.

    An address with a token is passed in a file: every user of the machine can read the arguments
    of a process.

    Raises:
        SettingsError: The program does not start.
    """
    if not program and not _has_display():
        return
    if "token" in parse_qs(urlsplit(url).query):
        path = working_folder() / "data" / "viewer" / "open.html"
        write_private(path, _LEADS_TO.format(escape(url)).encode())
        url = path.as_uri()
    if program:
        try:
            subprocess.Popen(
                [*shlex.split(program), url],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except (OSError, ValueError, IndexError) as error:
            raise SettingsError(
                f"{program}: this program does not start ({error}).",
                remedy="Name a browser, as in `-b firefox`, or open the printed address yourself.",
            ) from None
    else:
        webbrowser.open(url)


def _has_display() -> bool:
    if sys.platform == "darwin":
        return "SSH_CONNECTION" not in os.environ
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
