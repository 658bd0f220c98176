"""The working folder of a console, and what its routes share."""

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
"""For a bucket that does not answer."""


@dataclass(eq=False)
class ServedFolder:
    """What the routes of the console use.

    Attributes:
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
        self.live = SharedFeed(self.directory)

    def settings(self) -> Settings:
        """The settings as the files are now."""
        return load_settings(self.directory)

    def bucket(self, settings: Settings) -> Bucket:
        """The bucket; the embedded server is started if it does not run."""
        return open_bucket(settings.storage, patience_s=PATIENCE_S)
