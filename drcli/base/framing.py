"""Messages, each preceded by its length. Nothing is unpickled."""

import socket

_LENGTH_BYTES = 4


class WireError(Exception):
    """The other side breaks the protocol."""


def framed(data: bytes) -> bytes:
    return len(data).to_bytes(_LENGTH_BYTES, "big") + data


def receive(peer: socket.socket, most_bytes: int) -> bytes:
    """The next message.

    Raises:
        WireError: It is too long, or the other side left.
        OSError: The connection broke or timed out.
    """
    length = int.from_bytes(exactly(peer, _LENGTH_BYTES), "big")
    if length > most_bytes:
        raise WireError(f"a message of {length} bytes is too long")
    return exactly(peer, length)


def exactly(peer: socket.socket, count: int) -> bytes:
    parts, missing = [], count
    while missing:
        part = peer.recv(min(missing, 1 << 16))
        if not part:
            raise WireError("the other side has left")
        parts.append(part)
        missing -= len(part)
    return b"".join(parts)
