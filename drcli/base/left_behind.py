"""Files that programs leave behind."""

from pathlib import PurePosixPath

_NAMES = frozenset(
    {
        *(".ds_store", "__macosx", ".appledouble", ".spotlight-v100", ".trashes", ".fseventsd"),
        *("thumbs.db", "ehthumbs.db", "desktop.ini", "$recycle.bin", ".directory", "@eadir"),
        *("__pycache__", ".git", ".ipynb_checkpoints"),
    }
)
_BEGINNINGS = ("._", ".nfs", ".~lock.", "~$")


def is_left_behind(name: str) -> bool:
    return any(
        part.casefold() in _NAMES or part.startswith(_BEGINNINGS)
        for part in PurePosixPath(name).parts
    )
