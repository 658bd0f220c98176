"""InfluxDB's line protocol over UDP, for DeepRacer-for-Cloud's Grafana board.

Sources: reference simulator (`dr_training_episodes`, `dr_eval_episodes`), board
(`dr_sagemaker_epochs`).
"""

import socket
from collections.abc import Mapping

from drcli.tracking.figure_events import EpisodePoint, EpochPoint, Event

_NAME = str.maketrans({",": r"\,", " ": r"\ ", "=": r"\=", "\n": " ", "\r": " "})


class InfluxLines:
    """Sends each event to Telegraf as a datagram, without confirmation.

    Lines have a time: our episodes of an iteration end together, and the server keeps one line of
    equal tags per second.
    """

    takes = (EpisodePoint, EpochPoint)

    def __init__(self, host: str, port: int, model: str) -> None:
        self.name = f"DR_TELEGRAF_HOST={host}"
        self._place = host, port
        self._model = model
        self._socket: socket.socket | None = None

    def send(self, event: Event) -> None:
        """Raises OSError for an unknown host or a refusing network."""
        assert isinstance(event, self.takes)
        data = line_of(event, self._model).encode()
        try:
            self._connected().send(data)
        except ConnectionRefusedError:
            # The answer to an earlier datagram: this one may be the first that is heard.
            self._connected().send(data)
        except OSError:
            self.close()  # the name may have another address when it is tried again
            raise

    def miss(self, event: Event) -> bool:
        return False

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _connected(self) -> socket.socket:
        if self._socket is None:
            host, port = self._place
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
            family, kind, protocol, _, address = found[0]
            self._socket = socket.socket(family, kind, protocol)
            self._socket.settimeout(1.0)
            self._socket.connect(address)
        return self._socket


def line_of(event: EpisodePoint | EpochPoint, model: str) -> str:
    if isinstance(event, EpochPoint):
        return _line("dr_sagemaker_epochs", {"model": model}, {"entropy": event.entropy}, event)
    tags = {"model": model, "status": event.status, "worker": str(event.worker)}
    fields: dict[str, float] = {"elapsed_time": event.elapsed_ms, "progress": event.progress}
    if event.resets is not None:
        return _line("dr_eval_episodes", tags, {**fields, "reset_count": event.resets}, event)
    tags["phase"] = event.phase
    return _line("dr_training_episodes", tags, {**fields, "reward": event.reward}, event)


def _line(
    name: str,
    tags: Mapping[str, str],
    fields: Mapping[str, float],
    event: EpisodePoint | EpochPoint,
) -> str:
    """Sorted by name; whole numbers are marked."""
    marks = "".join(f",{key}={text.translate(_NAME)}" for key, text in sorted(tags.items()) if text)
    values = ",".join(
        f"{key}={value}i" if isinstance(value, int) else f"{key}={value!r}"
        for key, value in sorted(fields.items())
    )
    return f"{name}{marks} {values} {round(event.time_s * 1e9)}"
