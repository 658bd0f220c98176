"""Records the live display of a training as docs/pictures/training.svg.

    python scripts/docs terminal [--minutes 1] [--into docs/pictures]

Trains the shipped files in a scratch folder, in a terminal of 80 columns and 24 rows, and keeps the
last screen. Prints that folder, whose model `python scripts/docs lap` can drive.
"""

import argparse
import fcntl
import io
import os
import pty
import shutil
import struct
import tempfile
import termios
from pathlib import Path

import pyte
from rich.console import Console
from rich.text import Text

PROJECT = Path(__file__).resolve().parents[2]
COLUMNS, ROWS = 80, 24
NAMES = {"brown": "yellow", "default": ""}
"""Colours that rich calls otherwise than pyte."""


def main() -> None:
    """Train, and draw the last screen."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--into", type=Path, default=PROJECT / "docs" / "pictures")
    arguments = parser.parse_args()

    folder = Path(tempfile.mkdtemp())
    for name in ("run.env", "system.env"):
        shutil.copy(PROJECT / name, folder)
    screen = record(
        ["dr-start-training", "--max-minutes", str(arguments.minutes), "--seed", "1"], folder
    )
    drawn = Console(record=True, width=COLUMNS, file=io.StringIO(), force_terminal=True)
    drawn.print(text_of(screen))
    drawn.save_svg(str(arguments.into / "training.svg"), title="dr-start-training")
    print(folder)


def record(command: list[str], folder: Path) -> pyte.Screen:
    """The screen of a terminal in which a command has run."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(folder)
        os.environ |= {"TERM": "xterm-256color"}
        os.execv(str(PROJECT / ".venv" / "bin" / command[0]), command)
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
    screen = pyte.Screen(COLUMNS, ROWS)
    stream = pyte.ByteStream(screen)
    while data := _read(terminal):
        stream.feed(data)
    os.waitpid(pid, 0)
    return screen


def text_of(screen: pyte.Screen) -> Text:
    """The letters of a screen with their colours."""
    text = Text()
    for row in range(ROWS):
        for column in range(COLUMNS):
            cell = screen.buffer[row][column]
            color = NAMES.get(cell.fg, cell.fg)
            style = ("bold " if cell.bold else "") + (f"#{color}" if len(color) == 6 else color)
            text.append(cell.data, style.strip() or None)
        text.append("\n")
    text.rstrip()
    return text


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 1 << 16)
    except OSError:  # the command has ended
        return b""


if __name__ == "__main__":
    main()
