"""Opens a page in the browser of the person at this machine."""

import os
import shlex
import subprocess
import sys

from drcli.base.errors import SettingsError


def open_page(url: str, program: str = "") -> None:
    """Open a page if a browser could show it here, and not on another machine.

    Args:
        url: Its address.
        program: Opens it in any case, such as "firefox --new-tab"; empty for the usual browser.

    Raises:
        SettingsError: The program does not start.
    """
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
    elif _has_display():
        import webbrowser

        webbrowser.open(url)


def _has_display() -> bool:
    if sys.platform == "darwin":
        return "SSH_CONNECTION" not in os.environ
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
