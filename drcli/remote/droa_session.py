"""A user at a DeepRacer on AWS."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from drcli.base import notices
from drcli.base.errors import SettingsError
from drcli.remote.droa_keys import (
    Keys,
    cache_path,
    forget_keys,
    load_keys,
    save_keys,
)
from drcli.remote.droa_login import Ask, log_in
from drcli.remote.droa_site import Site


def now() -> datetime:
    return datetime.now(UTC)


@dataclass
class DroaSession:
    """Signs in when needed, and keeps keys."""

    site: Site
    username: str
    password: Callable[[], str]
    ask: Ask
    clock: Callable[[], datetime] = now

    def __post_init__(self) -> None:
        if not self.username:
            raise SettingsError(
                "DR_DROA_USERNAME is not set: who should sign in?",
                remedy="Write DR_DROA_USERNAME=you into system.env, or give --username.",
            )
        self._path = cache_path(self.site.identity_pool_id, self.username)
        self._keys: Keys | None = None

    def keys(self) -> Keys:
        """Valid for a minute at first; `renew` gets others.

        Raises:
            StorageError: The sign-in failed.
        """
        if self._keys is None:
            self._keys = load_keys(self._path, self.clock()) or self.renew()
        return self._keys

    def renew(self) -> Keys:
        self._keys = log_in(self.site, self.username, self.password(), self.ask)
        try:
            save_keys(self._path, self._keys)
        except OSError as e:
            notices.warn(
                f"The temporary keys cannot be kept in {self._path} ({e.strerror or e}); the next "
                "command asks for the password again."
            )
        return self._keys

    def forget(self) -> bool:
        self._keys = None
        try:
            return forget_keys(self._path)
        except OSError as e:
            raise SettingsError(
                f"{self._path} cannot be deleted ({e.strerror or e}).",
                remedy="Delete that file yourself; it holds keys that are valid for an hour.",
            ) from e
