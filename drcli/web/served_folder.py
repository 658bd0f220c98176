"""The working folder that a console serves, and what its routes share."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.store.bucket import Bucket
from drcli.store.connect import open_bucket
from drcli.web.hub import Hub
from drcli.web.shared_feed import SharedFeed
from drcli.web.tasks import Tasks

PATIENCE_S = 5.0
"""How long a page waits for a bucket that does not answer."""


@dataclass(eq=False)
class ServedFolder:
    """What the routes of the console use.

    Attributes:
        directory: The racer's working folder.
        hub: Topics of the WebSocket.
        tasks: What was started on the page.
        live: What the workers on this machine show.
        at_end: Called when the console ends.
    """

    directory: Path
    hub: Hub
    tasks: Tasks
    live: SharedFeed = field(init=False)
    at_end: list[Callable[[], None]] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        """Prepare the feed; it connects when somebody looks."""
        self.live = SharedFeed(self.directory)

    def settings(self) -> Settings:
        """The settings as the files are now, as a command would read them.

        Raises:
            SettingsError: One is wrong.
        """
        return load_settings(self.directory)

    def bucket(self, settings: Settings) -> Bucket:
        """The bucket of the settings; the embedded server is started if it does not run.

        Raises:
            StorageError: It cannot be reached.
        """
        return open_bucket(settings.storage, patience_s=PATIENCE_S)
