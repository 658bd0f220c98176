"""A sink that keeps what a server did not take, and sends it with what comes next."""

from abc import ABC, abstractmethod

from drcli.tracking.figure_events import Event
from drcli.tracking.server_requests import ServerRequests


class RetriedSink(ABC):
    """Figures for a server that may be away for a while.

    Args:
        server: Closed at the end.
    """

    def __init__(self, server: ServerRequests) -> None:
        self._server = server
        self._newest: Event | None = None

    def send(self, event: Event) -> None:
        """Send an event, and those that could not be sent before.

        Raises:
            ServerError: The server refuses, or cannot be reached.
        """
        self._newest = event
        self._keep(event)
        self._flush()

    def miss(self, event: Event) -> bool:
        """Keep it for the next time; what `send` could not send is kept already."""
        if event is not self._newest:
            self._newest = event
            self._keep(event)
        return True

    def close(self) -> None:
        """Send what was kept, and close the connection."""
        try:
            self._flush()
        finally:
            self._server.close()

    @abstractmethod
    def _keep(self, event: Event) -> None:
        """Add to what waits, and forget the oldest of too much."""

    @abstractmethod
    def _flush(self) -> None:
        """Send what waits, and forget what was sent; nothing is asked if nothing waits.

        Raises:
            ServerError: The server refuses, or cannot be reached.
        """
