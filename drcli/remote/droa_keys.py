"""Temporary keys, kept between commands, never a password.

Place and format as in DeepRacer-for-Cloud.
"""

import hashlib
import json
import os
import stat
import tempfile
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from drcli.base.regular_file import read_regular

LEAST_VALIDITY = timedelta(seconds=60)


@dataclass(frozen=True)
class Keys:
    """Never printed."""

    access_key: str = field(repr=False)
    secret_key: str = field(repr=False)
    session_token: str = field(repr=False)
    expires: datetime


def cache_path(identity_pool_id: str, username: str) -> Path:
    digest = hashlib.sha256(f"{identity_pool_id}:{username}".encode()).hexdigest()
    return Path.home() / ".droa-cache" / f"{digest[:16]}.json"


def load_keys(path: Path, now: datetime) -> Keys | None:
    """None also if they end soon."""
    try:
        if not _is_ours(path):
            return None
        keys = _keys(json.loads(read_regular(path)))
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    return keys if keys.expires > now + LEAST_VALIDITY else None


def save_keys(path: Path, keys: Keys) -> None:
    """Folder 0700 and file 0600."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    path.parent.chmod(0o700)
    values = {
        "access_key": keys.access_key,
        "secret_key": keys.secret_key,
        "session_token": keys.session_token,
        "expiry": keys.expires.isoformat(),
    }
    # mkstemp creates files that only their owner can read.
    number, scratch = tempfile.mkstemp(prefix=f".{path.stem}-", dir=path.parent)
    try:
        with os.fdopen(number, "wb") as file:
            file.write(json.dumps(values).encode())
        Path(scratch).replace(path)
    except OSError:
        with suppress(OSError):
            Path(scratch).unlink()
        raise


def forget_keys(path: Path) -> bool:
    try:
        path.unlink()
    except FileNotFoundError:
        return False
    return True


def _is_ours(path: Path) -> bool:
    found = path.lstat()
    return stat.S_ISREG(found.st_mode) and (os.name == "nt" or found.st_uid == os.getuid())


def _keys(values: Any) -> Keys:
    texts = [values["access_key"], values["secret_key"], values["session_token"], values["expiry"]]
    if not all(isinstance(text, str) and text for text in texts):
        raise ValueError("a value is not a text")
    expires = datetime.fromisoformat(texts[3])
    return Keys(
        texts[0], texts[1], texts[2], expires if expires.tzinfo else expires.replace(tzinfo=UTC)
    )
