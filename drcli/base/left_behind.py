"""Files that programs leave behind in folders and archives, and that nobody meant to hand over."""

from pathlib import PurePosixPath

_NAMES = frozenset(
    {
        *(".ds_store", "__macosx", ".appledouble", ".spotlight-v100", ".trashes", ".fseventsd"),
        *("thumbs.db", "ehthumbs.db", "desktop.ini", "$recycle.bin", ".directory", "@eadir"),
        *("__pycache__", ".git", ".ipynb_checkpoints"),
    }
)
"""Of files and folders: of macOS, of Windows, of KDE and Synology, of Python, git and Jupyter."""

_BEGINNINGS = ("._", ".nfs", ".~lock.", "~$")
"""Attributes that macOS keeps beside each file on other disks; files that were open."""


def is_left_behind(name: str) -> bool:
    """Whether a file, by its name with all folders, was left behind by a program."""
    return any(
        part.casefold() in _NAMES or part.startswith(_BEGINNINGS)
        for part in PurePosixPath(name).parts
    )
