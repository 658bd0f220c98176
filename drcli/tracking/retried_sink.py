"""A sink that keeps what a server did not take."""

from abc import ABC, abstractmethod

from drcli.tracking.figure_events import Event
from drcli.tracking.server_requests import ServerRequests


class RetriedSink(ABC):
    """Figures for a server that may be away."""

    def __init__(self, server: ServerRequests) -> None:
        self._server = server
        self._newest: Event | None = None

    def send(self, event: Event) -> None:
        """Send this and earlier events.

        Raises:
            ServerError: The server refuses, or cannot be reached.
        """
        self._newest = event
        self._keep(event)
        self._flush()

    def miss(self, event: Event) -> bool:
        if event is not self._newest:
            self._newest = event
            self._keep(event)
        return True

    def close(self) -> None:
        try:
            self._flush()
        finally:
            self._server.close()

    @abstractmethod
    def _keep(self, event: Event) -> None:
        """Add an event, and forget the oldest of too many."""

    @abstractmethod
    def _flush(self) -> None:
        """Send what waits, if anything; raises ServerError."""
