"""Files that programs leave behind in folders and archives."""

from pathlib import PurePosixPath

_NAMES = frozenset(
    {
        *(".ds_store", "__macosx", ".appledouble", ".spotlight-v100", ".trashes", ".fseventsd"),
        *("thumbs.db", "ehthumbs.db", "desktop.ini", "$recycle.bin", ".directory", "@eadir"),
        *("__pycache__", ".git", ".ipynb_checkpoints"),
    }
)
"""Of macOS, Windows, KDE, Synology, Python, git and Jupyter."""

_BEGINNINGS = ("._", ".nfs", ".~lock.", "~$")
"""Attributes of macOS on other disks; files that were open."""


def is_left_behind(name: str) -> bool:
    """Judges a name with all folders."""
    return any(
        part.casefold() in _NAMES or part.startswith(_BEGINNINGS)
        for part in PurePosixPath(name).parts
    )
