"""The working folder of a console, and what its routes share."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from drcli.bucket.bucket import Bucket
from drcli.bucket.connect import open_bucket
from drcli.config.loading import load_settings
from drcli.config.settings import Settings
from drcli.web.hub import Hub
from drcli.web.shared_feed import SharedFeed
from drcli.web.tasks import Tasks

PATIENCE_S = 5.0


@dataclass(eq=False)
class ServedFolder:
    """What the routes share.

    Attributes:
        live: What workers here show.
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
        return load_settings(self.directory)

    def bucket(self, settings: Settings) -> Bucket:
        """Starts the embedded server if needed."""
        return open_bucket(settings.storage, patience_s=PATIENCE_S)
