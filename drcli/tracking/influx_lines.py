"""InfluxDB's line protocol over UDP, with the names of DeepRacer-for-Cloud's Grafana board.

Source of the measurements, fields and tags: the reference simulator (`dr_training_episodes`,
`dr_eval_episodes`) and the board itself (`dr_sagemaker_epochs`).
"""

import socket
from collections.abc import Mapping

from drcli.tracking.figure_events import EpisodePoint, EpochPoint, Event

_NAME = str.maketrans({",": r"\,", " ": r"\ ", "=": r"\=", "\n": " ", "\r": " "})


class InfluxLines:
    """Sends each event as a datagram. Nobody says whether one arrives.

    A line has its time: the reference sends one episode after another and lets the server take the
    time, but here the episodes of an iteration end together, and the board's server keeps only one
    line of equal tags in each second.

    Args:
        host: Where Telegraf listens.
        port: Its UDP port.
        model: Prefix of the model, a tag of each line.
    """

    takes = (EpisodePoint, EpochPoint)

    def __init__(self, host: str, port: int, model: str) -> None:
        self.name = f"DR_TELEGRAF_HOST={host}"
        self._place = host, port
        self._model = model
        self._socket: socket.socket | None = None

    def send(self, event: Event) -> None:
        """Send an episode or an epoch.

        Raises:
            OSError: There is no such host, or the network refuses.
        """
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
        """Keep nothing."""
        return False

    def close(self) -> None:
        """Forget the address."""
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
    """The line of an event, without a line break."""
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
    """A line: tags and fields in the order of their names, whole numbers marked as such."""
    marks = "".join(f",{key}={text.translate(_NAME)}" for key, text in sorted(tags.items()) if text)
    values = ",".join(
        f"{key}={value}i" if isinstance(value, int) else f"{key}={value!r}"
        for key, value in sorted(fields.items())
    )
    return f"{name}{marks} {values} {round(event.time_s * 1e9)}"
